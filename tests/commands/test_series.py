"""`sawbench series` as a technician meets it: led through, stopped, gone on with, a bad trial found and repeated."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import sawbench.commands.recording_session as session
from sawbench.acquisition.recording_report import RecordingSummary
from sawbench.acquisition.series.plan import PlannedTrial
from sawbench.bench.errors import DeviceError
from sawbench.bench.recording import SampleBlock
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.blindcheck.settings import PlantSettings
from sawbench.blindcheck.streaming import StreamingPlant
from sawbench.commands.main import main
from sawbench.commands.series_dialogue import Dialogue, SeriesStopped
from sawbench.commands.series_verdict import measured
from sawbench.storage.amendments import amend, amendments_path
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

pytestmark = pytest.mark.pipeline

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
SAMPLES = CONFIG.parent / "recordings"
CHANNELS = ("force_n", "displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")
SECONDS = 1.5


class Workshop:
    """Writes what the plant of the blind check gives, in place of the recorder; `clamped` is what really is clamped."""

    def __init__(self):
        self.clamped: list[str | None] = []
        self.k_fc: list[float] = []
        self.fails: list[Exception | None] = []
        self.n_recorded = 0

    def record_trial(self, loaded, options, **_):
        problem = self.fails.pop(0) if self.fails else None
        if isinstance(problem, DeviceError):
            raise problem
        seconds = 0.5 * SECONDS if problem is not None else options.seconds
        settings = {"seed": self.n_recorded, "duty": options.trial.duty}
        if self.k_fc:
            settings |= {"k_fc_n_s_per_m": self.k_fc.pop(0), "stroke_rel_std": 0.0}
        clamped = self.clamped.pop(0) if self.clamped else None
        plant = StreamingPlant(PlantSettings.for_material(clamped or options.trial.material, **settings))
        plant.trigger(0.2)
        times = np.arange(0.0, seconds, 5e-4)
        now = datetime.now(UTC)
        with RecordingWriter(
            path=options.path, trial=options.trial, config_toml=loaded.text, provenance={}, started_at=now
        ) as writer:
            for name in CHANNELS:
                values, unit = plant.read(name, times), CHANNEL_BY_NAME[name].unit
                writer.write_block(
                    SampleBlock(device="d", channel=name, unit=unit, first_index=0, time_s=times, values=values)
                )
        self.n_recorded += 1
        return RecordingSummary(
            started_at=now, duration_s=seconds, end_reason="Ctrl-C" if problem else "recorded", is_complete=True,
            channels=(), devices=(), n_dropped_for_observers=0, provenance={},
        )  # fmt: skip


@pytest.fixture
def workshop(monkeypatch):
    made = Workshop()
    monkeypatch.setattr(session, "record_trial", made.record_trial)
    monkeypatch.setattr(session, "simulated_bench", lambda *_, **__: contextlib.nullcontext({}))
    return made


@pytest.fixture
def plan(tmp_path):
    """A plan of one setting, without check and tare."""

    def write(repetitions=3, **keys):
        path = tmp_path / "wood.toml"
        call = ["series", "plan", "--config", CONFIG, "--out", path, "--seconds", SECONDS, "--duty", 0.4375]
        call += ["--material", "oak", "--operator", "Kim", "--repetitions", repetitions]
        assert main([str(part) for part in call]) == 0
        text = path.read_text()
        for key, value in {"tare": '"never"', "check_seconds": 0, **keys}.items():
            text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
        path.write_text(text)
        return path

    return write


def call(capsys, *arguments):
    capsys.readouterr()
    code = main(["series", *map(str, arguments)])
    said = capsys.readouterr()
    assert "internal error" not in said.err
    return code, said.out, said.err


def answer(monkeypatch, *lines):
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def status(capsys, path):
    code, out, _ = call(capsys, "status", path, "--json")
    assert code == 0
    return json.loads(out)


def test_a_bad_trial_is_found_repeated_and_out_of_the_way(workshop, plan, capsys):
    path = plan()
    workshop.clamped = [None, "nylon"]
    code, _, err = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 0
    assert "BAD: k_Fc is -8" in err
    assert err.count("evaluating the trial …\n") == 4
    found = status(capsys, path)
    assert found["n_kept"] == 3 and found["next"] is None
    (rejected,) = found["trials"][1]["rejected"]
    assert rejected.startswith("k_Fc is -8")
    folder = path.with_suffix("")
    assert sorted(p.name for p in folder.glob("*.mcap")) == ["01-oak.mcap", "02-oak.mcap", "03-oak.mcap"]
    assert [p.name for p in (folder / "rejected").iterdir()] == ["02-oak-1.mcap"]
    assert [read_recording(p).trial.repetition for p in sorted(folder.glob("*.mcap"))] == [1, 2, 3]


def test_a_wrong_duty_is_named(tmp_path):
    path = Path(shutil.copy(SAMPLES / "oak-01.mcap", tmp_path))
    right = read_recording(path).trial
    stated = {"duty": 0.55, "feed_mm_s": right.feed_mm_s, "thickness_mm": right.thickness_mm}
    amend(path, right, {"duty": 0.55}, by="Kim", because="as if entered wrong")
    wrong = PlannedTrial(id="oak-01", material="oak", **stated)
    (said,) = [fault for fault in measured(path, wrong, seconds=2.0).faults if "duty" in fault]
    assert "likely cause: wrong duty entered: 0.55 is stated, the currents (battery over motor) show 0.43" in said
    amendments_path(path).unlink()
    assert not measured(
        path, PlannedTrial(id="oak-01", material="oak", **{**stated, "duty": right.duty}), seconds=2.0
    ).faults


def test_a_sitting_is_stopped_and_gone_on_with(workshop, plan, capsys, monkeypatch):
    path = plan()
    answer(monkeypatch, "B1", "", "n knot at the end", "", "n slow", "k", "q")
    code, out, err = call(capsys, "run", path, "--simulated")
    assert code == 0 and workshop.n_recorded == 1
    assert "clamp  oak" in err and f"continue with: sawbench series run {path}" in err
    assert "01-oak note: slow" in out and "next: 02-oak" in out
    recorded = read_recording(path.with_suffix("") / "01-oak.mcap").trial
    assert (recorded.notes, recorded.operator, recorded.blade) == ("knot at the end", "Kim", "B1")
    before = (path.with_suffix("") / "01-oak.mcap").read_bytes()
    answer(monkeypatch, "", "k", "", "r", "", "k")
    code, out, _ = call(capsys, "run", path, "--simulated")
    assert code == 0 and "3 of 3 trials kept" in out
    assert workshop.n_recorded == 4
    assert (path.with_suffix("") / "01-oak.mcap").read_bytes() == before


def test_a_crash_before_the_decision_asks_again_and_records_nothing_anew(workshop, plan, capsys, monkeypatch):
    path = plan()
    answer(monkeypatch, "", "", "")
    call(capsys, "run", path, "--simulated")
    assert workshop.n_recorded == 1 and status(capsys, path)["trials"][0]["state"] == "undecided"
    part = path.with_suffix("") / "02-oak.mcap.part"
    part.write_bytes(b"cut off")
    answer(monkeypatch, "k", "q")
    _, out, err = call(capsys, "run", path, "--simulated")
    assert workshop.n_recorded == 1 and "not yet kept or rejected" in err
    assert "1 of 3 trials kept" in out and "next: 02-oak (to do)" in out
    assert (path.with_suffix("") / "rejected" / "02-oak-1.mcap.part").read_bytes() == b"cut off"


def test_the_blade_is_changed_when_the_specific_force_has_grown_by_a_fifth(workshop, plan, capsys):
    path = plan(repeatability=0.2)
    workshop.k_fc = [300.0, 369.0, 300.0]
    code, out, err = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 0
    assert "at or above +20%, change the blade" in err
    assert [t["measures"]["blade"] for t in status(capsys, path)["trials"]] == ["B1", "B1", "B1-2"]
    assert "specific force on blade B1: +2" in out


def test_a_battery_charged_again_gets_another_identity(workshop, plan, capsys, monkeypatch):
    path = plan()
    path.write_text(path.read_text().replace('"02-oak", block = 1', '"02-oak", block = 2').replace("P1", "P2", 1))
    answer(monkeypatch, "B1", "P9", "", "k", "P9", "P10", "q")
    _, _, err = call(capsys, "run", path, "--simulated")
    assert "battery P9 was used before" in err
    progress = [json.loads(line) for line in (path.with_suffix("") / "series_journal.jsonl").read_text().splitlines()]
    assert [e["identity"] for e in progress if e["kind"] == "mounted"] == ["B1", "P9", "P10"]


def test_a_bench_that_stays_bad_ends_the_unattended_series(workshop, plan, capsys):
    path = plan(1)
    workshop.clamped = ["none"] * 3
    code, _, err = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 1 and workshop.n_recorded == 3
    assert "01-oak was bad 3 times: no cutting was found" in err
    assert status(capsys, path)["n_kept"] == 0


def test_notes_survive_a_sitting_that_ends_and_a_recording_that_fails(workshop, plan, capsys, monkeypatch):
    path = plan()
    answer(monkeypatch, "B1", "", "n blade is hot", "q")
    call(capsys, "run", path, "--simulated")
    workshop.fails = [DeviceError("the load cell is silent")]
    answer(monkeypatch, "n knot at the end", "", "", "n cracked", "q")
    call(capsys, "run", path, "--simulated")
    assert status(capsys, path)["trials"][0]["notes"] == ["blade is hot", "knot at the end", "cracked"]


def test_the_second_copy_of_a_repeated_trial_is_out_of_the_way_too(workshop, plan, capsys, tmp_path):
    copies = tmp_path / "copies"
    copies.mkdir()
    config = tmp_path / "bench_config.toml"
    text = CONFIG.read_text()
    assert text.count("\n[recording]\n") == 1
    config.write_text(text.replace("\n[recording]\n", f"\n[recording]\nsecond_copy = '{copies}'\n"))
    path = plan(1, config='"bench_config.toml"')
    assert call(capsys, "run", path, "--simulated", "--yes")[0] == 0
    (copies / "01-oak.mcap").write_bytes(b"the copy")
    assert call(capsys, "repeat", path, "01-oak", "--because", "clamp was loose")[0] == 0
    assert (copies / "rejected" / "01-oak-1.mcap").read_bytes() == b"the copy"
    assert not (copies / "01-oak.mcap").exists()


def test_input_that_is_no_text_ends_the_sitting():
    def lines():
        yield "B1\n"
        raise UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte")

    dialogue = Dialogue(lines())
    assert dialogue.ask("blade", default="") == "B1"
    with pytest.raises(SeriesStopped, match="the input ended"):
        dialogue.ask("ready", default="")


def test_a_material_of_several_words_names_its_trials(plan, capsys, tmp_path):
    path = tmp_path / "boards.toml"
    arguments = ["plan", "--material", "birch plywood/9", "--repetitions", 1, "--out"]
    assert call(capsys, *arguments, path)[0] == 0
    trial = status(capsys, path)["trials"][0]
    assert (trial["id"], trial["material"]) == ("01-birch-plywood-9", "birch plywood/9")
    code, _, err = call(capsys, *arguments, tmp_path / "boards.csv")
    assert code == 2 and "give a .toml file" in err
    code, _, err = call(capsys, "plan", "--material", "", "--out", tmp_path / "nothing.toml")
    assert code == 2 and "material" in err and not (tmp_path / "nothing.toml").exists()


def test_a_silent_instrument_is_said_and_the_trial_stays_to_do(workshop, plan, capsys, monkeypatch):
    path = plan(1)
    workshop.fails = [DeviceError("the load cell is silent")]
    answer(monkeypatch, "", "", "", "q")
    code, out, err = call(capsys, "run", path, "--simulated")
    assert code == 0 and "the load cell is silent" in err
    assert "next: 01-oak (to do)" in out


def test_an_unattended_series_tries_a_silent_bench_three_times(workshop, plan, capsys):
    path = plan(1)
    workshop.fails = [DeviceError("the load cell is silent")] * 3
    code, _, err = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 1 and workshop.n_recorded == 0
    assert err.count("recording 1.5 s") == 3 and "error: the load cell is silent" in err
    workshop.fails = [DeviceError("the load cell is silent")] * 2
    assert call(capsys, "run", path, "--simulated", "--yes")[0] == 0


def test_ctrl_c_in_a_recording_repeats_it_and_ends_the_unattended_series(workshop, plan, capsys):
    path = plan(1)
    workshop.fails = [KeyboardInterrupt()]
    code, _, err = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 130 and "continue with" in err
    found = status(capsys, path)
    assert found["next"] == "01-oak" and found["trials"][0]["rejected"] == ["Ctrl-C"]


def test_a_kept_trial_can_still_be_repeated(workshop, plan, capsys):
    path = plan(1)
    assert call(capsys, "run", path, "--simulated", "--yes")[0] == 0
    code, out, _ = call(capsys, "repeat", path, "01-oak", "--because", "clamp was loose")
    assert code == 0 and "01-oak-1.mcap" in out
    code, out, _ = call(capsys, "run", path, "--simulated", "--yes")
    assert code == 0 and "1 of 1 trials kept" in out and "rejected: clamp was loose" in out
    assert workshop.n_recorded == 2
    assert call(capsys, "repeat", path, "09-oak", "--because", "x")[0] == 2


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        (('operator = "Kim"', ""), ["--simulated", "--yes"], ["operator", "--operator"]),
        (('"material"]', '"material", "batch"]'), ["--simulated", "--yes"], ["batch of 01-oak"]),
        (("", ""), ["--yes"], ["--yes", "--simulated"]),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_starts(changes, options, words, plan, capsys, workshop):
    path = plan()
    path.write_text(path.read_text().replace(*changes))
    code, _, err = call(capsys, "run", path, *options)
    assert code == 2 and all(word in err for word in words)
    assert not workshop.n_recorded and not path.with_suffix("").exists()
