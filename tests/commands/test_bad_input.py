"""Wrong input, as a technician meets it: one clear message, the right exit code, nothing lost, nothing believed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sawbench.commands.main import main
from sawbench.commands.record import recording_path

pytestmark = pytest.mark.pipeline

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
K_FC = 240.29


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Three seconds of the model, with sensor noise: a trial whose k_Fc is known."""
    path = tmp_path_factory.mktemp("model") / "trial.csv"
    call = ["simulate", "--config", str(CONFIG), "--seconds", "3", "--rate", "2000", "--k-fc", str(K_FC)]
    assert main([*call, "--out", str(path)]) == 0
    trial = pd.read_csv(path)
    rng = np.random.default_rng(7)
    for column, std in {"force_n": 1.0, "displacement_mm": 0.02, "motor_current_a": 0.1}.items():
        trial[column] += rng.normal(0.0, std, len(trial))
    return trial


def imported(table, folder, name="trial", **fields):
    """Write the table, import it through a campaign, give the recording."""
    table.to_csv(folder / f"{name}.csv", index=False)
    settings = {"duty": 0.4375, "workpiece": "oak", **fields}
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items() if value is not None]
    campaign = folder / f"{name}.toml"
    campaign.write_text("\n".join([f"config = {json.dumps(str(CONFIG))}", "[[trial]]", f'file = "{name}.csv"', *lines]))
    assert main(["import", str(campaign), "--out", str(folder / "in")]) == 0
    return folder / "in" / f"{name}.mcap"


def run(capsys, *arguments):
    """Exit code, standard output and standard error of one call, which shows no traceback."""
    capsys.readouterr()
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    assert "Traceback" not in said.err and "internal error" not in said.err
    return code, said.out, said.err


WRONG_CHANNELS = {
    "reversed force": lambda t: t.assign(force_n=-t.force_n),
    "force clipped": lambda t: t.assign(force_n=t.force_n.clip(upper=100.0)),
    "load cell of twice the gain": lambda t: t.assign(force_n=2.0 * t.force_n),
    "currents swapped": lambda t: t.assign(motor_current_a=t.battery_current_a, battery_current_a=t.motor_current_a),
    "force and displacement swapped": lambda t: t.assign(force_n=t.displacement_mm, displacement_mm=t.force_n),
    "stroke reversed": lambda t: t.assign(displacement_mm=20.0 - t.displacement_mm),
    "current in mA": lambda t: t.assign(motor_current_a=1e3 * t.motor_current_a),
}


def test_sound_trial_is_believed(table, tmp_path, capsys):
    recording = imported(table, tmp_path)
    code, out, _ = run(capsys, "fit", recording, "--json")
    (fit,) = json.loads(out)
    assert code == 0 and fit["status"] == "ok"
    assert abs(fit["k_fc_n_s_per_m"] - K_FC) < 3 * fit["std_n_s_per_m"]


@pytest.mark.parametrize("wrong", WRONG_CHANNELS)
def test_wrong_channel_is_never_believed(wrong, table, tmp_path, capsys):
    recording = imported(WRONG_CHANNELS[wrong](table), tmp_path)
    code, out, _ = run(capsys, "fit", recording, "--json")
    (fit,) = json.loads(out)
    assert code == 1
    assert fit["status"] != "ok" and fit["notes"]
    code, out, err = run(capsys, "runtime", recording)
    assert code == 1 and not out.strip("[]\n ")
    assert "no runtime" in err


def test_process_doubts_peak_force_of_clipped_channel(table, tmp_path, capsys):
    recording = imported(WRONG_CHANNELS["force clipped"](table), tmp_path)
    code, out, _ = run(capsys, "process", recording)
    assert code == 1
    assert "amplifier saturated" in out


def test_fit_without_duty_says_where_to_state_it(table, tmp_path, capsys):
    recording = imported(table, tmp_path, duty=None)
    code, _, err = run(capsys, "fit", recording)
    assert code == 2
    assert str(recording) in err and "campaign.toml" in err


def test_runtime_keeps_the_good_results_when_one_file_is_bad(table, tmp_path, capsys):
    recording = imported(table, tmp_path)
    bad = tmp_path / "bad.mcap"
    bad.write_text("no recording")
    code, out, err = run(capsys, "runtime", recording, bad, "--json")
    assert code == 2
    assert [row["trial"] for row in json.loads(out)] == ["trial"]
    assert str(bad) in err


def test_compare_takes_no_trial_twice(table, tmp_path, capsys):
    recording = imported(table, tmp_path, started_at="2026-03-02T09:00:00Z")
    code, _, _ = run(capsys, "recover", recording)
    assert code == 0
    code, out, _ = run(capsys, "compare", recording.parent, "--out", tmp_path / "report.html")
    assert code == 1
    assert "is the same trial as" in out


def test_compare_takes_the_fullest_copy_of_a_trial(table, tmp_path, capsys):
    recording = imported(table, tmp_path, started_at="2026-03-02T09:00:00Z")
    cut = recording.with_name("a-cut.mcap")
    cut.write_bytes(recording.read_bytes()[: 2 * recording.stat().st_size // 3])
    _code, out, _ = run(capsys, "compare", recording.parent, "--out", tmp_path / "report.html", "--json")
    (left_out,) = json.loads(out)["left_out"]
    assert left_out["name"] == cut.name
    assert f"the same trial as {recording.name}" in left_out["reason"]


def test_compare_shows_no_value_of_a_doubted_channel(table, tmp_path, capsys):
    recording = imported(WRONG_CHANNELS["current in mA"](table), tmp_path)
    page = tmp_path / "report.csv"
    run(capsys, "compare", recording.parent, "--out", tmp_path / "report.html", "--csv", page)
    (row,) = pd.read_csv(page).to_dict("records")
    assert np.isnan(float(row["rms_motor_current_a"]))
    assert row["peak_force_n"] == pytest.approx(table.force_n[3000:].max(), rel=0.05)


# name -> (what is written into bench_config.toml, what stands there instead, what the message must name)
WRONG_DEVICES = {
    "rate": ("rate_hz = 6000", 'rate_hz = "fast"', "rate_hz"),
    "driver": ('driver = "gsv8"', 'driver = "gsv9"', "did you mean 'gsv8'"),
    "channel": ("channels.force_n]", "channels.forze_n]", "forze_n"),
    "calibration key": ("scale = 250.0", "sclae = 250.0", "did you mean 'scale'"),
    "input": ("input = 1", "input = 99", "inputs are numbered"),
    "no port": ('port = "/dev/ttyACM0"', "", "missing key 'port'"),
    "no DBC": ('dbc = "jigsaw_bench.dbc"', 'dbc = "nope.dbc"', "no such DBC file"),
    "counter": ('counter = "SampleCounter"', 'counter = "SampleCountr"', "SampleCounter"),
    "signal": ("MotorStatus.MotorCurrent", "MotorStatus.MotorCurent", "MotorStatus.MotorCurrent"),
}


@pytest.mark.parametrize("wrong", WRONG_DEVICES)
def test_wrong_device_table_is_named_before_anything_starts(wrong, tmp_path, capsys):
    right, instead, named = WRONG_DEVICES[wrong]
    text = CONFIG.read_text()
    assert right in text
    config = tmp_path / "wrong.toml"
    config.write_text(text.replace(right, instead, 1))
    record = ["record", "--material", "oak", "--simulated", "--config", config, "--out", tmp_path / "out"]
    code, _, err = run(capsys, *record)
    assert code == 2
    assert f"{config}: " in err and named in err and ": :" not in err
    assert not (tmp_path / "out").exists()


def test_trial_id_is_no_path(tmp_path, capsys):
    call = ["record", "--material", "oak", "--simulated", "--config", CONFIG, "--out", tmp_path / "out"]
    code, _, err = run(capsys, *call, "--trial", "../evil")
    assert code == 2 and "'../evil'" in err
    assert not list(tmp_path.rglob("*.mcap*"))


def test_missing_folder_is_said_before_the_work(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call = ["simulate", "--config", CONFIG, "--seconds", "0.1", "--out", "nowhere/x.csv"]
    code, out, err = run(capsys, *call)
    assert code == 2 and not out
    assert "nowhere/x" in err and "create nowhere first" in err
    (tmp_path / "nowhere").touch()
    code, out, err = run(capsys, *call)
    assert code == 2 and not out and "nowhere: cannot be written to: Not a directory" in err


@pytest.mark.parametrize(
    "call",
    [
        ["diagnose", "no-recording.mcap"],
        ["process", "no-recording.mcap"],
        ["import", "no-table.csv"],
        ["demo"],
        ["record", "--material", "oak", "--simulated"],
        ["blind", "make", "--seed", "1", "--cases", "1"],
    ],
    ids=lambda call: call[0],
)
def test_folder_that_cannot_be_made_is_said_before_the_work(call, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("no-recording.mcap", "no-table.csv", "file"):  # what is read before would be the error
        (tmp_path / name).write_text("nothing of the kind")
    code, out, err = run(capsys, *call, "--out", "file/out")
    assert code == 2 and not out
    assert "file/out: cannot be written to: Not a directory" in err and "give another folder" in err


def test_compare_makes_the_folder_of_its_page(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = CONFIG.with_name("recordings") / "oak-01.mcap"
    assert run(capsys, "compare", recording, "--out", "new/folder/x.html")[0] == 0
    assert sorted(path.name for path in Path("new/folder").iterdir()) == ["x.csv", "x.h5", "x.html"]
    Path("file").touch()
    code, out, err = run(capsys, "compare", recording, "--out", "file/x.html")
    assert code == 2 and not out and "file: cannot be written to: Not a directory" in err


@pytest.mark.parametrize("command", ["process", "report", "export"])
def test_two_recordings_with_one_result_are_both_named(command, table, tmp_path, capsys):
    one, other = (tmp_path / name / "trial.mcap" for name in ("a", "b"))
    recording = imported(table, tmp_path)
    for path in (one, other):
        path.parent.mkdir()
        shutil.copy(recording, path)
    capsys.readouterr()
    code, out, err = run(capsys, command, one, other, "--out", tmp_path / "out")
    assert code == 2 and not out
    assert f"{one} and {other}" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [["--out", "a.csv"], ["--out", "a.html", "--csv", "a.html"], ["--out", "a.h5"]])
def test_one_file_for_page_and_table_is_said_before_the_work(options, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "compare", CONFIG.with_name("recordings"), *options)
    assert code == 2 and not out and "would have the same name" in err
    assert not list(tmp_path.iterdir())


def test_simulate_refuses_more_samples_than_fit(capsys):
    code, _, err = run(capsys, "simulate", "--config", CONFIG, "--rate", "1e9")
    assert code == 2 and "lower rate" in err


def test_full_disk_is_no_mistake_of_the_program(capsys):
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    call = ["simulate", "--config", CONFIG, "--seconds", "0.05", "--out", full, "--force"]
    code, _, err = run(capsys, *call)
    assert code == 1 and "No space left" in err


def test_view_without_a_display_says_so(capsys, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    recording = CONFIG.with_name("recordings") / "oak-01.mcap"
    code, out, err = run(capsys, "view", recording)
    assert code == 2 and not out
    assert "no display" in err and "--no-view --rrd" in err


def test_open_brackets_in_a_key_are_no_mistake_of_the_program(tmp_path, capsys):
    (tmp_path / "set").mkdir()
    key = tmp_path / "key.json"
    key.write_text(20_000 * "[")
    code, _, err = run(capsys, "blind", "score", tmp_path / "set", "--key", key)
    assert code == 2 and "key.json: cannot be read" in err


def test_recover_of_nothing_is_not_trusted(tmp_path, capsys):
    whole = (CONFIG.with_name("recordings") / "oak-01.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[:20000])
    code, out, err = run(capsys, "recover", cut, "--out", cut / "out.mcap")
    assert code == 2 and not out and "cut.mcap: cannot be written to: Not a directory" in err
    code, out, _ = run(capsys, "recover", cut)
    assert code == 1 and "0 messages kept" in out
    assert cut.read_bytes() == whole[:20000]


AXIS = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
drive_channel = "drive_force_n"
[effects]
guide_friction = { force_n = 8.0, std = 0.8 }
"""


@pytest.mark.parametrize("command", ["simulate", "fit", "runtime"])
def test_what_needs_a_saw_refuses_an_axis_with_known_effects(command, table, tmp_path, capsys):
    axis = tmp_path / "axis.toml"
    axis.write_text(AXIS)
    recording = [] if command == "simulate" else [imported(table, tmp_path)]
    code, _, err = run(capsys, command, *recording, "--config", axis)
    assert code == 2
    assert f"{axis}: describes a linear axis" in err and "diagnose" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--material", " "], "the material is empty"),
        (["--material", "Eiche/Öl"], "'Eiche/Öl-NN' is not a valid trial name"),
        (["--material", "oak", "--trial", ".."], "'..' is not a valid trial name"),
        (["--material", "oak", "--trial", "a\nb"], "is not a valid trial name"),
        (["--material", "oak", "--trial", "run 9:30"], "is not a valid trial name"),
        (["--material", "\udcff"], "is not a valid trial name"),
        (["--material", "oak", "--trial", 101 * "ä"], "has 202 bytes, a file name may have 200"),
        (["--material", 300 * "x"], "has 303 bytes, a file name may have 200"),
    ],
)
def test_a_name_that_no_file_can_have_is_refused_before_any_instrument(tmp_path, capsys, arguments, words):
    """The ports of this configuration do not exist: what is said of the name is said before they are opened."""
    code, _, err = run(capsys, "record", "--config", CONFIG, "--out", tmp_path, *arguments)
    assert code == 2 and words in err and "-> " in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["Eiche Öl 樫", 100 * "ä", "run.2026-03-02", "trial 7 (new blade)"])
def test_other_names_are_those_of_files(tmp_path, name):
    assert recording_path(tmp_path, name, "oak") == tmp_path / f"{name}.mcap"
