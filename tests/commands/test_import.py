"""`sawbench import` as it is called: one table with a map, a CAN log with the configuration of the bench."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sawbench.commands.main import main
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.pipeline

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
CHANNELS = ["battery_current_a", "battery_voltage_v", "motor_current_a"]


def run(capsys, *arguments):
    """Exit code, standard output and standard error of one call."""
    capsys.readouterr()
    code = main(["import", *map(str, arguments)])
    said = capsys.readouterr()
    assert "Traceback" not in said.err and "internal error" not in said.err
    return code, said.out, said.err


@pytest.fixture
def log(tmp_path):
    """A candump log of the shipped bench: motor 0x100 and battery 0x101, 5 mA and 1 mV a bit (jigsaw_bench.dbc)."""
    import cantools
    from sawbench.acquisition.can_signals import SHIPPED_DBC_DIRECTORY

    database = cantools.database.load_file(SHIPPED_DBC_DIRECTORY / "jigsaw_bench.dbc")
    lines = []
    for k in range(200):
        for name in ("MotorStatus", "BatteryStatus"):
            message = database.get_message_by_name(name)
            values = {signal.name: 0 for signal in message.signals} | {"SampleCounter": k}
            if name == "MotorStatus":
                values["MotorCurrent"] = 10.0 + 0.005 * k
            data = message.encode(values, strict=False).hex().upper()
            lines.append(f"({1.7e9 + k / 1000:.6f}) can0 {message.frame_id:03X}#{data}")
    path = tmp_path / "drive.log"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_table_with_a_map_and_settings(tmp_path, capsys):
    (tmp_path / "run7.csv").write_text("t;Fz\n0;0,5\n1;-0,25\n2;0,125\n")
    (tmp_path / "map.toml").write_text(
        '[columns]\ntime_s = { column = "t", unit = "ms" }\nforce_n = { column = "Fz", unit = "kN", sign = -1 }\n'
    )
    call = [tmp_path / "run7.csv", "--map", tmp_path / "map.toml", "--material", "oak", "--duty", "0.4375"]
    call += ["--thickness", "20", "--blade", "B1", "--config", CONFIG, "--out", tmp_path / "out"]
    code, out, _ = run(capsys, *call)
    assert code == 0
    assert "force_n <- column 'Fz' in kN, times -1000" in out
    assert "time_s <- column 't' in ms, times 0.001" in out
    assert "decimal commas read as points" in out
    recording = read_recording(tmp_path / "out" / "run7.mcap")
    assert recording.signal("force_n").values.tolist() == [-500.0, 250.0, -125.0]
    trial = recording.trial
    assert (trial.material, trial.duty, trial.thickness_mm, trial.blade) == ("oak", 0.4375, 20.0, "B1")
    assert recording.config_toml == CONFIG.read_text()
    assert main(["info", str(tmp_path / "out" / "run7.mcap")]) == 0
    assert "force_n <- column 'Fz' in kN, times -1000" in capsys.readouterr().out


def test_json_says_what_was_taken(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time_s,force_n\n0,1\n1e-3,2\n")
    code, out, _ = run(capsys, tmp_path / "a.csv", "--out", tmp_path / "out", "--json")
    assert code == 0
    said = json.loads(out)
    assert said["taken"] == {"a.mcap": {"time_s": "column 'time_s'", "force_n": "column 'force_n'"}}
    assert said["n_samples"] == 2


@pytest.mark.parametrize("dbc", [[], ["--dbc", "jigsaw_bench.dbc"]], ids=["dbc of the config", "dbc named"])
def test_can_log_takes_the_signals_of_the_devices(dbc, log, tmp_path, capsys):
    settings = ["--config", CONFIG, "--material", "oak", "--duty", "0.4375"]
    code, out, _ = run(capsys, log, *dbc, *settings, "--out", tmp_path / "out")
    assert code == 0 and "motor_current_a <- column 'MotorStatus.MotorCurrent' in A" in out
    recording = read_recording(tmp_path / "out" / "drive.mcap")
    assert sorted(recording.signals) == CHANNELS
    assert recording.signal("motor_current_a").values == pytest.approx(10.0 + 0.005 * np.arange(200), abs=2.6e-3)
    assert (recording.trial.material, recording.trial.duty) == ("oak", 0.4375)
    assert recording.trial.started_at is not None
    assert recording.config_toml == CONFIG.read_text()


def test_can_log_is_calibrated_as_the_devices_say(log, tmp_path, capsys):
    text = CONFIG.read_text() + "\n[devices.power.calibration]\n"
    text += 'motor_current_a = { scale = 2.0, offset = 0.5, raw_unit = "A", source = "clamp meter" }\n'
    (tmp_path / "bench.toml").write_text(text)
    code, out, _ = run(capsys, log, "--config", tmp_path / "bench.toml", "--out", tmp_path / "out")
    assert code == 0 and "calibrated: clamp meter" in out
    current = read_recording(tmp_path / "out" / "drive.mcap").signal("motor_current_a")
    assert current.values == pytest.approx(20.5 + 0.01 * np.arange(200), abs=5.2e-3)
    assert current.unit == "A"


def test_can_log_with_a_wrong_device_names_file_and_table(log, tmp_path, capsys):
    (tmp_path / "bench.toml").write_text(CONFIG.read_text().replace('counter = "SampleCounter"', "countr = 1"))
    code, _, err = run(capsys, log, "--config", tmp_path / "bench.toml", "--out", tmp_path / "out")
    assert code == 2 and "bench.toml: [devices.power]" in err and "countr" in err


def test_can_log_with_a_map_turns_the_sign(log, tmp_path, capsys):
    (tmp_path / "map.toml").write_text(
        '[columns]\nmotor_current_a = { column = "MotorStatus.MotorCurrent", sign = -1 }\n'
    )
    call = [log, "--dbc", "jigsaw_bench.dbc", "--map", tmp_path / "map.toml", "--out", tmp_path / "out"]
    assert run(capsys, *call)[0] == 0
    recording = read_recording(tmp_path / "out" / "drive.mcap")
    assert list(recording.signals) == ["motor_current_a"]
    assert recording.signal("motor_current_a").values[0] == pytest.approx(-10.0, abs=2.6e-3)
    assert "sign = -1" in recording.provenance["map"]


def test_can_log_without_dbc_says_what_to_add(log, tmp_path, capsys):
    code, _, err = run(capsys, log, "--out", tmp_path / "out")
    assert code == 2 and "need a DBC" in err and "--dbc FILE.dbc" in err and "--config" in err


def test_settings_of_one_trial_are_refused_for_a_campaign(tmp_path, capsys):
    (tmp_path / "campaign.toml").write_text('[[trial]]\nfile = "a.csv"\n')
    code, _, err = run(capsys, tmp_path / "campaign.toml", "--duty", "0.5", "--out", tmp_path / "out")
    assert code == 2 and "--duty cannot be given for a whole campaign" in err and "[[trial]]" in err


def test_many_campaigns_and_tables_are_imported_once_and_a_bad_one_is_named(tmp_path, capsys):
    rows = "\n".join(f"{k / 1000},{k % 7}" for k in range(200))
    for name in ("monday", "tuesday"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "t1.csv").write_text(f"time_s,motor_current_a\n{rows}\n")
        (tmp_path / name / "campaign.toml").write_text('[[trial]]\nfile = "t1.csv"\n')
    (tmp_path / "single.csv").write_text(f"time_s,motor_current_a\n{rows}\n")
    (tmp_path / "bad.csv").write_text("nothing")
    given = [tmp_path / "monday/campaign.toml", tmp_path / "tuesday"]
    given += [tmp_path / "single.csv", tmp_path / "bad.csv"]
    code, out, err = run(capsys, *given, "--out", tmp_path / "out", "--jobs", "2")
    assert code == 2
    assert "3 of 4 imported: 3 recordings" in out
    assert "4 in all: 4 done now" in err
    assert "bad.csv" in err
    made = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.mcap"))
    assert made == ["monday/t1.mcap", "single.mcap", "tuesday/t1.mcap"]
    (tmp_path / "tuesday" / "t1.csv").write_text(f"time_s,motor_current_a\n{rows}\n0.2,5\n")
    _, out, err = run(capsys, *given, "--out", tmp_path / "out", "--json")
    assert "4 in all: 1 done now, 3 were done already" in err
    assert [report["n_samples"] for report in json.loads(out)] == [200, 201, 200]
    assert len(read_recording(tmp_path / "out/tuesday/t1.mcap").signals["motor_current_a"].values) == 201


def test_jobs_of_a_single_table_are_wrong_usage(tmp_path, capsys):
    (tmp_path / "t.csv").write_text("time_s,force_n\n0,1\n1,2\n")
    code, _, err = run(capsys, tmp_path / "t.csv", "--out", tmp_path / "out", "--jobs", "2")
    assert code == 2
    assert "several PATHs" in err


def test_a_setting_may_have_a_decimal_comma(tmp_path, capsys):
    (tmp_path / "t.csv").write_text("time_s,force_n\n0,1\n1,2\n")
    code, _, _ = run(capsys, tmp_path / "t.csv", "--duty", "0,44", "--feed", "2.5", "--out", tmp_path / "out")
    trial = read_recording(tmp_path / "out/t.mcap").trial
    assert code == 0 and (trial.duty, trial.feed_mm_s) == (0.44, 2.5)
    code, _, err = run(capsys, tmp_path / "t.csv", "--duty", "4,4", "--out", tmp_path / "out2")
    assert code == 2 and "4.4" in err
