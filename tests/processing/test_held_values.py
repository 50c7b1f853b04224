"""Values of a slow instrument that a table repeats: one sample each, at its own time."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.recording import Signal
from sawbench.processing.held_values import alignment_of_rows, without_repeats
from sawbench.processing.quality import clean_channel

pytestmark = pytest.mark.unit

RATE_HZ, SECONDS = 4000.0, 5.0


def measured(time_s, step):
    exact = 5.0 + 3.0 * np.sin(2 * np.pi * 14.0 * time_s) + 0.05 * np.random.default_rng(1).standard_normal(len(time_s))
    return np.round(exact / step) * step


def held(slow_hz, *, step=0.005, phase_s=0.0, lost=0, jitter=0.0, late=0.0):
    """Samples of the slow instrument, and rows that hold the last of them; `lost` rows are missing.

    Rows jitter by a share of theirs, and samples come `late` by standard deviations of their period.
    """
    rng = np.random.default_rng(2)
    at_s = phase_s + np.arange(0.0, SECONDS, 1.0 / slow_hz)
    at_s = at_s + late / slow_hz * np.random.default_rng(4).standard_normal(len(at_s)) if late else at_s
    values = measured(at_s, step)
    time_s = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    time_s = np.delete(time_s, rng.choice(np.arange(1, len(time_s)), lost, replace=False)) if lost else time_s
    time_s = time_s + jitter / RATE_HZ * rng.uniform(-1.0, 1.0, len(time_s))
    last = np.searchsorted(at_s, time_s, side="right") - 1
    keep = last >= 0
    return at_s, values, time_s[keep], values[last[keep]]


@pytest.mark.parametrize("slow_hz", [500.0, 1000.0, 600.0])
@pytest.mark.parametrize(
    ("lost", "jitter", "phase_s"), [(0, 0.0, 0.0), (60, 0.0, 0.0), (40, 0.1, 0.0), (0, 0.1, 1.1e-4)]
)
def test_each_sample_comes_back_at_its_time(slow_hz, lost, jitter, phase_s):
    at_s, values, time_s, repeated = held(slow_hz, lost=lost, jitter=jitter, phase_s=phase_s)
    found_s, found = without_repeats(time_s, repeated)
    assert abs(len(found) - len(values)) <= 0.01 * len(values)
    nearest = np.argmin(np.abs(found_s[:, None] - at_s), axis=1)
    off_s = found_s - at_s[nearest]
    # Half a row either way is all that such a table tells; a row that is lost makes it one more.
    assert abs(np.mean(off_s)) < 0.5 / RATE_HZ + 1e-12  # exactly that where rows and updates coincide
    assert np.percentile(np.abs(off_s), 95) <= 1.01 / RATE_HZ
    assert np.mean(found == values[nearest]) > 0.98


@pytest.mark.parametrize(("slow_hz", "jitter"), [(2000.0, 0.15), (50.0, 0.0)])
def test_rows_that_jitter_or_are_lost_for_a_while_hide_no_period(slow_hz, jitter):
    """As seen: two rows a value and a jitter of 15 % of a row, and a 50 Hz channel in a table with holes."""
    at_s, values, time_s, repeated = held(slow_hz, jitter=jitter, phase_s=1e-4)
    there = ~((time_s % 0.9 > 0.3) & (time_s % 0.9 < 0.325))
    found_s, found = without_repeats(time_s[there], repeated[there])
    nearest = np.argmin(np.abs(found_s[:, None] - at_s), axis=1)
    assert len(found) == pytest.approx(there.mean() * len(values), rel=0.03)
    assert np.percentile(np.abs(found_s - at_s[nearest]), 95) <= 1.01 / RATE_HZ
    assert np.mean(found == values[nearest]) > 0.95


@pytest.mark.parametrize("slow_hz", [50.0, 100.0, 400.0])
def test_messages_of_a_bus_that_come_a_little_early_or_late_hide_no_period(slow_hz):
    """As seen: a bus of 100 Hz whose messages scatter by 2 % of their period, held in rows that are much closer."""
    at_s, values, time_s, repeated = held(slow_hz, late=0.02, phase_s=0.3 / slow_hz)
    found_s, found = without_repeats(time_s, repeated)
    assert abs(len(found) - len(values)) <= 1
    nearest = np.argmin(np.abs(found_s[:, None] - at_s), axis=1)
    off_s = found_s - at_s[nearest]
    assert abs(np.mean(off_s)) < 0.5 / RATE_HZ + 0.005 / slow_hz
    assert np.mean(found == values[nearest]) > 0.98


def test_rows_with_wrong_stamps_hide_no_period():
    """12.5 rows a value, and stamps that are off by up to 15 % of a row."""
    _, values, time_s, repeated = held(320.0, phase_s=1e-6)
    stamped_s = time_s + 0.15 / RATE_HZ * np.random.default_rng(3).uniform(-1.0, 1.0, len(time_s))
    _, found = without_repeats(stamped_s, repeated)
    assert abs(len(found) - len(values)) <= 1


def test_an_update_that_changes_nothing_is_a_sample_too():
    """Coarse steps: one update of three repeats the value before it, and none goes missing."""
    _, values, time_s, repeated = held(500.0, step=0.25)
    assert np.mean(np.diff(values) == 0.0) > 0.1
    _, found = without_repeats(time_s, repeated)
    assert len(found) == len(values)
    assert (found == values).all()


@pytest.mark.parametrize(
    "values",
    [
        measured(np.arange(0.0, SECONDS, 1.0 / RATE_HZ), 0.005),
        np.clip(measured(np.arange(0.0, SECONDS, 1.0 / RATE_HZ), 1e-9), 3.0, 7.0),
        np.round(10.0 * (1.0 - np.cos(2 * np.pi * 14.0 * np.arange(0.0, SECONDS, 1.0 / RATE_HZ))) / 0.1) * 0.1,
        np.zeros(20000),
    ],
    ids=["noisy", "clipped", "coarse", "dead"],
)
def test_nothing_is_taken_from_a_channel_that_is_not_held(values):
    time_s = np.arange(len(values)) / RATE_HZ
    found_s, found = without_repeats(time_s, values)
    assert found_s is time_s
    assert found is values


def test_the_channel_says_so_and_has_the_rate_of_its_instrument():
    _, values, time_s, repeated = held(500.0)
    clean = clean_channel(Signal(channel="motor_current_a", unit="A", time_s=time_s, values=repeated))
    assert clean.quality.rate_hz == pytest.approx(500.0, rel=1e-3)
    assert len(clean.values) == len(values)
    assert any("8 rows for each sample" in problem for problem in clean.quality.problems)
    assert clean.quality.n_missing == 0


@pytest.mark.parametrize(("rate_hz", "std_s"), [(1000.0, 1e-3 / np.sqrt(12.0)), (20_000.0, 1e-4)])
def test_times_of_a_table_are_known_to_a_row_and_to_no_less_than_a_tenth_of_a_millisecond(rate_hz, std_s):
    found = alignment_of_rows(np.arange(1000) / rate_hz)
    assert found.std_s == pytest.approx(std_s)
    assert found.latency_s == pytest.approx(np.sqrt(12.0) * std_s)


def test_a_value_that_a_table_holds_may_be_from_anywhere_in_that_time():
    """A table may be made of the latest values or of the nearest ones."""
    time_s = np.arange(12_000) / 4000.0
    held = np.repeat(measured(time_s[::8], 1e-3), 8)
    found = clean_channel(Signal(channel="battery_voltage_v", unit="V", time_s=time_s, values=held)).alignment
    assert found.std_s == pytest.approx(1e-4)
    assert found.latency_s == pytest.approx(2e-3)


def held_with(pickup):
    """Values of 100 Hz in rows of 2 kHz, in hundredths, with something picked up behind the instrument."""
    time_s = np.arange(8000) / 2000.0
    at = np.floor(time_s * 100.0)
    return time_s, np.round(10.0 + 4.0 * np.sin(2 * np.pi * 13.0 * at / 100.0) + pickup(time_s), 2)


@pytest.mark.parametrize(
    "pickup",
    [
        lambda t: 0.008 * np.sin(2 * np.pi * 50.0 * t),
        lambda t: 0.02 * np.random.default_rng(4).standard_normal(len(t)),
    ],
    ids=["hum", "noise"],
)
def test_a_held_value_with_something_picked_up_behind_the_instrument_is_held(pickup):
    """As seen: a battery current of 100 Hz in rows of 2 kHz was late by 5 ms in the start of every trial."""
    time_s, values = held_with(pickup)
    found_s, found = without_repeats(time_s, values)
    assert len(found) == pytest.approx(400, abs=2)
    assert np.diff(found_s) == pytest.approx(0.01, rel=1e-3)
    sent = 10.0 + 4.0 * np.sin(2 * np.pi * 13.0 * np.round(found_s * 100.0) / 100.0)
    assert found == pytest.approx(sent, abs=0.1)


@pytest.mark.parametrize(
    "wave",
    [
        lambda t: 4.0 * np.sin(2 * np.pi * 13.0 * t),
        lambda t: 4.0 * np.sin(2 * np.pi * 13.0 * t) + 2.0 * (np.arange(len(t)) % 40 == 0),
        lambda t: 4.0 * np.sin(2 * np.pi * 13.0 * t) + 2.0 * (np.arange(len(t)) % 40 < 4),
    ],
    ids=["smooth", "spikes", "bursts"],
)
def test_what_comes_with_a_clock_but_does_not_stay_is_not_held(wave):
    time_s = np.arange(8000) / 2000.0
    values = np.round(wave(time_s) + 0.01 * np.random.default_rng(5).standard_normal(8000), 3)
    found_s, found = without_repeats(time_s, values)
    assert found is values
    assert found_s is time_s
