"""Processed trials to HDF5 and back, and the summary table."""

from __future__ import annotations

import csv
import dataclasses
import threading
import time
from datetime import UTC, datetime

import h5py
import numpy as np
import pytest
import sawbench.storage.results
from sawbench.bench.errors import InputError
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import (
    ChannelQuality,
    CrankAngle,
    Cut,
    PeriodCandidate,
    PeriodEstimate,
    Phase,
    ProcessedTrial,
    RemovedForce,
    SteadyPart,
    StrokeOffset,
)
from sawbench.bench.recording import Trial
from sawbench.storage.results import append_summary_rows, read_processed, summary_row, write_processed

pytestmark = pytest.mark.unit


def folded(channel, unit):
    rng = np.random.default_rng(len(channel))
    return FoldedCycle(
        channel=channel,
        unit=unit,
        angle_rad=(np.arange(16) + 0.5) * np.pi / 8,
        mean=rng.normal(size=16),
        std=rng.uniform(size=16),
        count=rng.integers(0, 50, 16),
        n_cycles=40,
    )


def processed(**changes):
    full = {
        "trial": Trial(
            trial_id="T1",
            material="oak",
            duty=0.4375,
            started_at=datetime(2026, 3, 2, 9, tzinfo=UTC),
            notes="a",
        ),
        "status": "cutting",
        "period": PeriodEstimate(
            period_s=0.072,
            period_std_s=1e-5,
            spread_s=3e-4,
            n_cycles=40,
            confidence="moderate",
            reason="a rival",
            channel="displacement_mm",
            rivals=(PeriodCandidate(period_s=0.144, relative_power=0.3, reason="half the rate"),),
        ),
        "angle": CrankAngle(
            time_s=np.arange(5.0),
            angle_rad=np.arange(5.0) * 87,
            speed_rad_s=np.full(5, 87.0),
            angle_std_rad=np.full(5, 1e-3),
            radius_m=0.01,
            source="displacement_mm",
            is_absolute=True,
        ),
        "phases": (Phase(kind="rest", start_s=0.0, end_s=0.5), Phase(kind="running", start_s=0.5, end_s=3.0)),
        "folded": {"force_n": folded("force_n", "N"), "motor_current_a": folded("motor_current_a", "A")},
        "cutting_force": folded("force_n", "N"),
        "removed": RemovedForce(
            mean_n=1.0, rms_n=2.0, peak_n=9.0, share_of_impulse=0.05, half="zero_to_pi", looks_swapped=False
        ),
        "peak_force_n": 287.1,
        "peak_force_std_n": 1.2,
        "mean_values": {"motor_current_a": 10.5},
        "rms_values": {"motor_current_a": 11.0, "oil": 3.0},
        "quality": (
            ChannelQuality(
                channel="force_n",
                unit="N",
                rate_hz=5000.0,
                n_samples=15000,
                n_missing=7,
                jitter_std_s=1e-6,
                noise_std=0.3,
                n_spikes=0,
                n_clipped=2,
                problems=("clipped", "missing"),
            ),
        ),
        "offsets": (
            StrokeOffset(channel="motor_current_a", device="can", against="cell", offset_s=2e-4, offset_std_s=4e-4),
            StrokeOffset(channel="force_n", device="b", against="cell", change_s=1e-5, reason="why", problem="what"),
        ),
        "warnings": ("one", "zwei ü"),
        "source_path": "recordings/T1.mcap",
        "source_sha256": "ab" * 32,
    }
    return ProcessedTrial(**(full | changes))


def plain(item):
    """Return dataclasses, mappings and arrays as things that compare by value."""
    if dataclasses.is_dataclass(item):
        return type(item).__name__, {f.name: plain(getattr(item, f.name)) for f in dataclasses.fields(item)}
    if isinstance(item, np.ndarray):
        return item.dtype.kind, item.tolist()
    if hasattr(item, "items"):
        return {key: plain(value) for key, value in item.items()}
    return [plain(part) for part in item] if isinstance(item, tuple) else item


EMPTY = {
    "status": "no_stroke",
    "period": None,
    "angle": None,
    "phases": (),
    "folded": {},
    "cutting_force": None,
    "removed": None,
    "peak_force_n": None,
    "peak_force_std_n": None,
    "mean_values": {},
    "rms_values": {},
    "quality": (),
    "offsets": (),
    "warnings": (),
}


STEADY = SteadyPart(first_motion_s=0.25, start_s=0.25, settled_s=1.05, end_s=2.5)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        EMPTY,
        {"steady": STEADY},
        {"steady": dataclasses.replace(STEADY, cut=Cut(start_s=1.0, end_s=2.0))},
        {"steady": dataclasses.replace(STEADY, cut=Cut(end_s=2.0))},
    ],
)
def test_a_processed_trial_comes_back(tmp_path, changes):
    written = processed(**changes)
    path = write_processed(written, tmp_path / "T1.h5")
    assert plain(read_processed(path)) == plain(written)
    assert [p.name for p in tmp_path.iterdir()] == ["T1.h5"]


def test_every_dataset_has_its_unit(tmp_path):
    found = {}

    def note(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item.attrs["unit"]

    with h5py.File(write_processed(processed(), tmp_path / "T1.h5")) as store:
        store.visititems(note)
    assert found["folded/motor_current_a/mean"] == "A"
    assert found["cutting_force/std"] == "N"
    assert found["angle/speed_rad_s"] == "rad/s"


def test_results_are_kept_unless_told(tmp_path):
    path = write_processed(processed(), tmp_path / "T1.h5")
    with pytest.raises(InputError, match="--force"):
        write_processed(processed(), path)
    write_processed(processed(status="stalled"), path, overwrite=True)
    assert read_processed(path).status == "stalled"


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_processed(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("x")
    with pytest.raises(InputError, match="not a processed trial"):
        read_processed(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as store:
        store["time_s"] = [0.0]
    with pytest.raises(InputError, match="not a processed trial"):
        read_processed(tmp_path / "other.h5")


def test_the_table_has_one_line_a_recording(tmp_path):
    path = tmp_path / "summary.csv"
    append_summary_rows([processed()], path)
    append_summary_rows([processed(source_path="recordings/T2.mcap", **EMPTY)], path)
    append_summary_rows([processed(peak_force_n=300.0)], path)
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["source_path"] for row in rows] == ["recordings/T2.mcap", "recordings/T1.mcap"]
    assert float(rows[1]["peak_force_n"]) == 300.0
    assert float(rows[1]["stroke_rate_hz"]) == pytest.approx(1 / 0.072)
    assert rows[0]["peak_force_n"] == ""
    assert rows[1]["rms_motor_current_a"] == "11.0"
    assert [p.name for p in tmp_path.iterdir()] == ["summary.csv"]


def test_two_that_write_the_table_at_once_lose_no_line(tmp_path, monkeypatch):
    write_whole = sawbench.storage.results.write_whole

    def slow(*arguments, **options):
        time.sleep(0.2)
        return write_whole(*arguments, **options)

    monkeypatch.setattr("sawbench.storage.results.write_whole", slow)
    path, names = tmp_path / "summary.csv", [f"recordings/T{k}.mcap" for k in range(3)]
    writers = [
        threading.Thread(target=append_summary_rows, args=([processed(source_path=name)], path)) for name in names
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    with path.open(newline="") as stream:
        assert sorted(row["source_path"] for row in csv.DictReader(stream)) == names


def test_a_row_of_nothing_has_the_same_columns():
    assert list(summary_row(processed())) == list(summary_row(processed(**EMPTY)))


def test_another_table_is_not_spoilt(tmp_path):
    path = tmp_path / "summary.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="other columns"):
        append_summary_rows([processed()], path)
    assert path.read_text() == "a,b\n1,2\n"
