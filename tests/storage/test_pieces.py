"""A recording read piece by piece holds what the whole one holds, wherever it is cut."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pyarrow.parquet
import pytest
from asammdf import MDF
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.storage import describe, export
from sawbench.storage.describe import describe_recording
from sawbench.storage.pieces import content_pieces, is_long, read_pieces, read_span
from sawbench.storage.reader import read_recording, write_recording
from sawbench.storage.writer import RecordingWriter

pytestmark = pytest.mark.unit


def signal(name, unit, rate_hz, *, seconds=30.0, lost=()):
    """Random values; of every (first, last) of `lost` those samples are missing, as a stated gap."""
    rng = np.random.default_rng(len(name))
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    keep = np.ones(len(time_s), dtype=bool)
    for first, last in lost:
        keep[first:last] = False
    gaps = tuple(
        Gap(start_s=time_s[first - 1], end_s=time_s[last], n_missing=last - first, reason="samples were lost")
        for first, last in lost
    )
    return Signal(channel=name, unit=unit, time_s=time_s[keep], values=rng.normal(size=keep.sum()), gaps=gaps)


@pytest.fixture
def path(tmp_path):
    """Half a minute of two rates, a gap in one of them, a channel that ends early, a note."""
    signals = {
        "force_n": signal("force_n", "N", 1000.0, lost=[(9_990, 10_020), (21_000, 21_001)]),
        "displacement_mm": signal("displacement_mm", "mm", 500.0),
        "motor_current_a": signal("motor_current_a", "A", 1000.0, seconds=7.0),
    }
    note = Event(kind="note", time_s=12.5, text="knot in the wood")
    trial = Trial(trial_id="long", material="oak")
    return write_recording(Recording(trial=trial, signals=signals, events=(note,)), tmp_path / "long.mcap")


@pytest.mark.parametrize("n_samples", [2_000, 5_000, 13_000])
def test_pieces_hold_every_sample_gap_and_event_once(path, n_samples):
    whole, pieces = read_recording(path), list(read_pieces(path, n_samples))
    assert len(pieces) > 2
    for name, one in whole.signals.items():
        rows = [piece.signals[name] for piece in pieces if name in piece.signals]
        assert np.array_equal(np.concatenate([row.time_s for row in rows]), one.time_s)
        assert np.array_equal(np.concatenate([row.values for row in rows]), one.values)
        assert [(g.start_s, g.end_s, g.n_missing) for row in rows for g in row.gaps] == [
            (g.start_s, g.end_s, g.n_missing) for g in one.gaps
        ]
    assert sum(event.text == "knot in the wood" for piece in pieces for event in piece.events) == 1
    assert all(piece.is_complete for piece in pieces)


def test_of_an_incomplete_recording_the_last_piece_says_so(path, tmp_path):
    left = write_recording(replace(read_recording(path), is_complete=False), tmp_path / "left.mcap")
    *others, last = read_pieces(left, 5_000)
    assert others
    assert [piece.is_complete for piece in others] == [True] * len(others)
    assert not last.is_complete


def test_all_channels_are_cut_at_one_time(path):
    pieces = list(read_pieces(path, 5_000))
    for before, after in pairwise(pieces):
        last_s = max(one.time_s[-1] for one in before.signals.values())
        assert all(one.time_s[0] > last_s for one in after.signals.values())
    for piece in pieces:
        assert sum(len(one.values) for one in piece.signals.values()) < 2 * 5_000


def test_channels_that_lie_one_behind_the_other_in_the_file_are_not_torn_apart(tmp_path):
    with RecordingWriter(
        path=tmp_path / "a.mcap", trial=Trial(trial_id="a"), config_toml="", provenance={}, started_at=None
    ) as writer:
        for name, unit in (("force_n", "N"), ("displacement_mm", "mm")):
            for first in range(0, 10_000, 1_000):
                time_s = (first + np.arange(1_000)) / 1000
                writer.write_block(
                    SampleBlock(device="d", channel=name, unit=unit, first_index=first, time_s=time_s, values=time_s)
                )
    for piece in read_pieces(tmp_path / "a.mcap", 4_000):
        assert set(piece.signals) == {"force_n", "displacement_mm"}


def test_a_file_that_was_cut_off_is_one_piece_and_says_so(path, tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (piece,) = read_pieces(torn, 2_000)
    whole = read_recording(torn)
    assert not piece.is_complete
    assert [event.text for event in piece.events] == [event.text for event in whole.events]
    assert all(np.array_equal(piece.signals[name].values, one.values) for name, one in whole.signals.items())


def test_settings_are_read_once_however_many_pieces(path, monkeypatch):
    read = []
    monkeypatch.setattr("sawbench.storage.pieces.amended", lambda trial, _: read.append(trial) or trial)
    assert len(list(read_pieces(path, 5_000))) > 2
    assert len(read) == 1


@pytest.mark.parametrize("n_samples", [5_000, 10**6])
def test_lost_settings_are_told_once(path, tmp_path, n_samples):
    damaged = tmp_path / "damaged.mcap"
    content = path.read_bytes()
    at = content.index(b"trial_id")
    damaged.write_bytes(content[:at] + b"trial_??" + content[at + 8 :])
    pieces = list(read_pieces(damaged, n_samples))
    assert pieces[0].trial.source == "damaged recording"
    told = [event.text for piece in pieces for event in piece.events if "settings of the trial" in event.text]
    assert len(told) == 1


def test_a_part_is_read_without_the_rest(path):
    part = read_span(path, 9.5, 14.0, 3_000)
    assert part.is_complete
    force = part.signals["force_n"]
    assert force.time_s.tolist() == [k / 1000 for k in range(9_500, 14_000) if not 9_990 <= k < 10_020]
    whole = read_recording(path).signals["force_n"]
    assert np.array_equal(force.values, whole.values[np.isin(whole.time_s, force.time_s)])
    assert [gap.n_missing for gap in force.gaps] == [30]
    assert "motor_current_a" not in part.signals
    assert [event.text for event in part.events if event.kind == "note"] == ["knot in the wood"]
    with pytest.raises(InputError, match="no sample from 40 s to 50 s"):
        read_span(path, 40.0, 50.0)


def test_length_is_asked_of_the_summary(path, tmp_path):
    assert is_long(path, 50_000)
    assert not is_long(path, 500_000)
    (tmp_path / "none.mcap").write_bytes(b"no MCAP")
    assert not is_long(tmp_path / "none.mcap", 1)
    assert not is_long(tmp_path / "missing.mcap", 1)


def test_a_gap_that_spans_a_cut_is_counted_once(tmp_path):
    """Force is missing from 4.5 s to 7.5 s; the cut lies inside, and an event tells of the gap, too."""
    force = signal("force_n", "N", 1000.0, seconds=12.0, lost=[(4_500, 7_500)])
    shift = signal("displacement_mm", "mm", 1000.0, seconds=12.0)
    told = Event(kind="gap", time_s=4.499, end_s=7.5, text="the link was gone", channel="force_n")
    path = write_recording(
        Recording(
            trial=Trial(trial_id="t"), signals={"force_n": force, "displacement_mm": shift}, events=(told,)
        ),
        tmp_path / "t.mcap",
    )  # fmt: skip
    pieces = list(read_pieces(path, 2_000))
    ends = [piece.signals["displacement_mm"].time_s[-1] for piece in pieces]
    assert any(4.5 < end_s < 7.4 for end_s in ends)
    gaps = [gap for piece in pieces if "force_n" in piece.signals for gap in piece.signals["force_n"].gaps]
    assert [gap.n_missing for gap in gaps] == [3_000]


def test_raw_values_come_in_pieces_where_they_are_asked_for(tmp_path):
    own = signal("force_n", "N", 1000.0)
    own = replace(own, raw=2.0 * own.values)
    path = write_recording(Recording(trial=Trial(trial_id="t"), signals={"force_n": own}), tmp_path / "t.mcap")
    pieces = [piece.signals["force_n"] for piece in read_pieces(path, 7_000, with_raw=True)]
    assert len(pieces) > 2
    assert np.array_equal(np.concatenate([piece.raw for piece in pieces]), 2.0 * own.values)
    assert all(piece.signals["force_n"].raw is None for piece in read_pieces(path, 7_000))


def test_what_is_in_a_long_file_is_told_without_reading_it_whole(path, monkeypatch):
    whole = describe_recording(path)
    monkeypatch.setattr(describe, "is_long", lambda _: True)
    monkeypatch.setattr(describe, "content_pieces", partial(content_pieces, n_samples=5_000))
    monkeypatch.setattr(describe, "read_content", None)
    pieced = describe_recording(path)
    assert replace(pieced, channels=(), events=()) == replace(whole, channels=(), events=())
    assert set(pieced.events) == set(whole.events)
    for own, other in zip(pieced.channels, whole.channels, strict=True):
        assert own.rate_hz == pytest.approx(other.rate_hz, rel=1e-9)
        assert replace(own, rate_hz=0.0) == replace(other, rate_hz=0.0)


@pytest.mark.parametrize("file_format", ["csv", "parquet", "mf4"])
def test_an_export_in_pieces_holds_what_that_of_the_whole_holds(path, tmp_path, monkeypatch, file_format):
    whole = export.export_recording(path, tmp_path / "whole", file_format=file_format)
    monkeypatch.setattr(export, "is_long", lambda _: True)
    monkeypatch.setattr(export, "read_pieces", partial(read_pieces, n_samples=5_000))
    monkeypatch.setattr(export, "read_recording", None)
    pieced = export.export_recording(path, tmp_path / "pieced", file_format=file_format)
    assert pieced.n_samples == whole.n_samples
    assert pieced.losses == whole.losses
    assert [one.name for one in pieced.paths] == [one.name for one in whole.paths]
    for own, other in zip(pieced.paths, whole.paths, strict=True):
        assert contents(own) == contents(other)


def contents(path):
    """What a table holds, bit for bit; of the metadata, all but the rate, which is a median of pieces."""
    if path.suffix == ".json":
        return re.sub(r'"rate_hz": [^,]*', "", path.read_text())
    if path.suffix == ".csv":
        return path.read_text()
    if path.suffix == ".parquet":
        return pyarrow.parquet.read_table(path).to_pydict()
    with MDF(path) as measurement:
        names = [channel.name for group in measurement.groups for channel in group.channels if channel.name != "time"]
        found = [measurement.get(name) for name in names]
    return [(one.name, one.unit, one.timestamps.tobytes(), one.samples.tobytes()) for one in found]
