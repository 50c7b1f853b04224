"""Corrected settings: kept beside the recording, in force for every reader, the recording itself untouched."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sawbench.acquisition.series.rejected import move_to_rejected
from sawbench.bench.errors import InputError, RecordingError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.commands.main import main
from sawbench.storage.amendments import amend, amendments_path
from sawbench.storage.describe import describe_recording
from sawbench.storage.reader import read_recording, write_recording

pytestmark = pytest.mark.unit


@pytest.fixture
def recording(tmp_path):
    time_s = np.arange(0.0, 1.0, 0.01)
    signal = Signal(channel="force_n", unit="N", time_s=time_s, values=np.sin(time_s))
    trial = Trial(trial_id="oak-01", material="oak", duty=0.35, feed_mm_s=4.0, operator="Jo")
    return write_recording(Recording(trial=trial, signals={"force_n": signal}), tmp_path / "oak-01.mcap")


def test_the_corrected_setting_is_in_force_and_the_file_is_as_it_was(recording):
    before = recording.read_bytes()
    made = amend(recording, read_recording(recording).trial, {"duty": 0.55, "feed_mm_s": 4.0}, by="Kim", because="typo")
    trial = read_recording(recording).trial
    assert (trial.duty, trial.material, trial.operator) == (0.55, "oak", "Jo")
    assert recording.read_bytes() == before
    assert made is not None and trial.amendments == (made.words,)
    assert made.words.startswith("duty 0.55 instead of 0.35 (Kim, ") and made.words.endswith(": typo)")
    # Nothing but what changed is kept.
    (line,) = amendments_path(recording).read_text().splitlines()
    assert json.loads(line)["changes"] == {"duty": {"old": 0.35, "new": 0.55}}


def test_the_latest_of_several_counts_and_all_are_told(recording):
    for duty in (0.45, 0.55):
        amend(recording, read_recording(recording).trial, {"duty": duty}, by="Kim")
    trial = describe_recording(recording).trial
    assert trial is not None and trial.duty == 0.55
    assert [words.partition(" (")[0] for words in trial.amendments] == [
        "duty 0.45 instead of 0.35",
        "duty 0.55 instead of 0.45",
    ]


def test_what_holds_already_is_no_amendment(recording):
    assert amend(recording, read_recording(recording).trial, {"material": "oak"}, by="Kim") is None
    assert not amendments_path(recording).exists()


@pytest.mark.parametrize(("new", "what"), [({"duty": 1.5}, "duty is 1.5"), ({"feed_mm_s": -1.0}, "feed_mm_s is -1.0")])
def test_a_value_that_is_not_allowed_is_refused(recording, new, what):
    with pytest.raises(InputError, match=what):
        amend(recording, read_recording(recording).trial, new, by="Kim")
    assert not amendments_path(recording).exists()


def test_a_recording_that_was_replaced_does_not_take_over_the_corrections(recording):
    amend(recording, read_recording(recording).trial, {"duty": 0.55}, by="Kim")
    other = Recording(trial=Trial(trial_id="oak-01", duty=0.4), signals={})
    write_recording(other, recording, overwrite=True)
    with pytest.raises(RecordingError, match="other content"):
        read_recording(recording)


def test_a_torn_line_is_passed_over_and_the_next_one_is_whole(recording):
    amend(recording, read_recording(recording).trial, {"duty": 0.45}, by="Kim")
    with amendments_path(recording).open("a") as file:
        file.write('{"at": "2026-')
    assert read_recording(recording).trial.duty == 0.45
    amend(recording, read_recording(recording).trial, {"duty": 0.55}, by="Kim")
    assert read_recording(recording).trial.duty == 0.55


@pytest.mark.parametrize("line", ['{"at": 1}', "[]", '{"changes": {"trial_id": {"old": "a", "new": "b"}}}'])
def test_a_line_that_is_no_amendment_is_one_clear_error(recording, line):
    amendments_path(recording).write_text(line + "\n")
    with pytest.raises(RecordingError, match="line 1: is not an amendment"):
        read_recording(recording)


def test_a_copy_keeps_the_corrections(recording, tmp_path):
    amend(recording, read_recording(recording).trial, {"duty": 0.55}, by="Kim")
    copy = write_recording(read_recording(recording), tmp_path / "copy.mcap")
    assert read_recording(copy).trial == read_recording(recording).trial


def test_the_command_corrects_and_info_shows(recording, capsys):
    call = ["amend", str(recording), "--material", "Oak", "--duty", "0.55", "--unset", "feed", "--by", "Kim", "--json"]
    assert main(call) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["is_new"] and "feed not stated instead of 4 mm/s" in row["words"]
    assert main(["info", str(recording)]) == 0
    shown = capsys.readouterr().out
    assert "material Oak, duty 0.55, operator Jo" in shown
    assert "corrected: material Oak instead of oak, duty 0.55 instead of 0.35, feed not stated" in shown


@pytest.mark.parametrize(
    ("options", "what"),
    [([], "no correction is given"), (["--blade", "B", "--unset", "blade"], "--blade is given and unset")],
)
def test_wrong_usage_is_one_clear_error(recording, capsys, options, what):
    assert main(["amend", str(recording), "--by", "Kim", *options]) == 2
    assert what in capsys.readouterr().err


def test_a_rejected_recording_takes_its_corrections_along(recording):
    amend(recording, read_recording(recording).trial, {"duty": 0.55}, by="Kim")
    moved = move_to_rejected(recording, "oak-01")
    assert moved == recording.parent / "rejected" / "oak-01-1.mcap"
    assert read_recording(moved).trial.duty == 0.55
    assert not amendments_path(recording).exists()
