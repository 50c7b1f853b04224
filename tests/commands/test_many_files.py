"""`sawbench info` and `sawbench export` over many recordings, with losses and bad files among them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.commands.main import main
from sawbench.storage.reader import write_recording
from sawbench.storage.writer import RecordingWriter

pytestmark = pytest.mark.contract


def write(folder, name, *, n_missing=0, **settings):
    """Write 100 samples of force at 100 Hz; `n_missing` of them are lost behind the 50th."""
    time_s = np.r_[0:50, 50 + n_missing : 100 + n_missing] / 100
    gaps = (Gap(start_s=time_s[49], end_s=time_s[50], n_missing=n_missing),) if n_missing else ()
    force = Signal(channel="force_n", unit="N", time_s=time_s, values=np.arange(100.0), gaps=gaps)
    recording = Recording(trial=Trial(trial_id=name, **settings), signals={"force_n": force})
    return str(write_recording(recording, folder / f"{name}.mcap"))


@pytest.fixture
def bench(tmp_path):
    write(tmp_path, "a", material="oak", duty=0.4375)
    write(tmp_path, "b", n_missing=25)
    return tmp_path


def test_info_shows_a_row_for_each_file_and_names_the_loss(bench, capsys):
    assert main(["info", str(bench)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[1:] == ["a", "oak", "0.4375", "-", "-", "1.0", "1", "0.00%", "complete"]
    assert lines[2].split()[1:] == ["b", "-", "-", "-", "-", "1.2", "1", "20.00%", "LOSS"]
    assert lines[3] == f"{bench / 'b.mcap'}: force_n: 25 of 125 samples are missing"
    assert lines[4].startswith("2 recordings, 1 complete")


def test_info_lists_the_first_of_many_gaps_and_counts_the_rest(tmp_path, capsys):
    time_s = np.delete(np.arange(100) / 100, np.arange(2, 98, 4))  # one sample in four is lost
    lost = np.flatnonzero(np.diff(time_s) > 0.015)
    gaps = tuple(Gap(start_s=time_s[k], end_s=time_s[k + 1], n_missing=1, reason="lost") for k in lost)
    force = Signal(channel="force_n", unit="N", time_s=time_s, values=np.arange(76.0), gaps=gaps)
    path = write_recording(Recording(trial=Trial(trial_id="a"), signals={"force_n": force}), tmp_path / "a.mcap")
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert len(gaps) == 24
    assert (out.count("gap force_n: lost"), "14 more gaps: --json lists them" in out) == (10, True)
    assert main(["info", str(path), "--json"]) == 0
    assert sum(event["kind"] == "gap" for event in json.loads(capsys.readouterr().out)["events"]) == 24


def test_info_gives_a_list_of_what_one_file_gives(bench, capsys):
    paths = [str(bench / "a.mcap"), str(bench / "b.mcap")]
    alone = []
    for path in paths:
        assert main(["info", path, "--json"]) == 0
        alone.append(json.loads(capsys.readouterr().out))
    assert main(["info", *paths, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == alone
    assert alone[0]["trial"]["material"] == "oak"


def test_info_names_what_an_interrupted_recording_left_also_where_there_is_nothing_else(bench, tmp_path, capsys):
    """Otherwise a folder after a crash looks as if the trial had never been."""
    alone = tmp_path / "crashed"
    alone.mkdir()
    for folder, code in ((bench, 0), (alone, 2)):
        (folder / "c.mcap.part").write_bytes(b"")
        assert main(["info", str(folder), "--json"]) == code
        said = capsys.readouterr()
        assert f"sawbench recover {folder / 'c.mcap.part'}" in said.err
        json.loads(said.out)


def test_info_goes_on_behind_a_file_that_is_no_recording(bench, capsys):
    (bench / "c.mcap").write_text("no MCAP")
    assert main(["info", str(bench), "--json"]) == 2
    shown = capsys.readouterr()
    assert [info["trial"]["trial_id"] for info in json.loads(shown.out)] == ["a", "b"]
    assert "c.mcap: is not a recording" in shown.err


def test_export_writes_every_recording_and_exits_1_for_a_loss(bench, capsys):
    out = bench / "tables"
    assert main(["export", str(bench), "--out", str(out), "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)
    assert [row["losses"] for row in rows] == [[], ["force_n: 25 of 125 samples are missing"]]
    assert [row["n_samples"] for row in rows] == [100, 100]
    assert sorted(path.name for path in out.iterdir()) == ["a.csv", "a.csv.json", "b.csv", "b.csv.json"]
    assert (out / "a.csv").read_text().splitlines()[:2] == ["time_s,force_n", "0,0"]


def test_export_overwrites_nothing_without_force(bench, capsys):
    call = ["export", str(bench / "a.mcap"), "--out", str(bench / "tables")]
    assert main(call) == 0
    (bench / "tables" / "a.csv").write_text("mine")
    assert main(call) == 2
    assert "a.csv.json: already exists" in capsys.readouterr().err
    assert (bench / "tables" / "a.csv").read_text() == "mine"
    assert main([*call, "--force"]) == 0
    assert (bench / "tables" / "a.csv").read_text() != "mine"


def test_export_refuses_two_recordings_of_one_name(bench, tmp_path, capsys):
    (tmp_path / "other").mkdir()
    other = write(tmp_path / "other", "a")
    assert main(["export", str(bench / "a.mcap"), other, "--out", str(bench / "tables")]) == 2
    assert f"would be made of two recordings, {bench / 'a.mcap'} and {other}" in capsys.readouterr().err
    assert not (bench / "tables").exists()


def test_recover_says_in_samples_and_seconds_what_is_left(tmp_path, capsys):
    whole = write(tmp_path, "a")
    cut, settings = tmp_path / "cut.mcap", {"config_toml": "", "provenance": {}, "started_at": None}
    with RecordingWriter(**settings, path=cut, trial=Trial(trial_id="cut"), flush_every_s=1e9) as writer:
        for first in range(0, 400, 100):
            values = np.random.default_rng(first).standard_normal(100)
            time_s = np.arange(first, first + 100) / 100
            writer.write_block(
                SampleBlock(device="cell", channel="force_n", unit="N", first_index=first, time_s=time_s, values=values)
            )
            writer.flush()
    content = cut.read_bytes()
    chunks = [at for at in range(len(content)) if content[at : at + 8] == b"\x04\x00\x00\x00zstd"]
    cut.write_bytes(content[: chunks[2] + 50])
    assert main(["recover", str(cut)]) == 1
    out = capsys.readouterr().out
    assert "\n200 samples of 1 channel kept, known to be lost: 0.98 s\n" in out
    assert "\nthe recording ends at 1.99 s; what came after is lost\n" in out
    assert main(["recover", whole]) == 0
    assert capsys.readouterr().out.endswith("100 samples of 1 channel kept, none of them damaged\n")


def test_recover_says_that_a_recording_without_its_end_record_had_stopped(tmp_path, capsys):
    cut, settings = tmp_path / "cut.mcap", {"config_toml": "", "provenance": {}, "started_at": None}
    values, time_s = np.zeros(100), np.arange(100) / 100
    with RecordingWriter(**settings, path=cut, trial=Trial(trial_id="cut")) as writer:
        writer.write_block(
            SampleBlock(device="cell", channel="force_n", unit="N", first_index=0, time_s=time_s, values=values)
        )
        writer.write_event(Event(kind="stop", time_s=1.0, text="1 s recorded"))
    cut.write_bytes(cut.read_bytes()[:-50])
    assert main(["recover", str(cut)]) == 0
    out = capsys.readouterr().out
    assert "100 samples of 1 channel kept, none of them damaged" in out
    assert out.endswith("the recording had stopped at 1.00 s; only the end of the file is missing\n")
