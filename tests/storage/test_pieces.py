"""A recording read piece by piece holds what the whole one holds, wherever it is cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.storage.pieces import is_long, read_pieces
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
    assert pieces[-1].is_complete


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


def test_length_is_asked_of_the_summary(path, tmp_path):
    assert is_long(path, 50_000)
    assert not is_long(path, 500_000)
    (tmp_path / "none.mcap").write_bytes(b"no MCAP")
    assert not is_long(tmp_path / "none.mcap", 1)
    assert not is_long(tmp_path / "missing.mcap", 1)
