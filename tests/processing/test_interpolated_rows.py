"""Values of a slow instrument between which a table draws lines: one sample each, at its own time."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.recording import Signal
from sawbench.processing.interpolated_rows import own_samples, without_interpolated_rows
from sawbench.processing.quality import clean_channel

pytestmark = pytest.mark.unit

SECONDS = 6.0


def ripple(time_s):
    return 6.0 + 3.0 * np.sin(2 * np.pi * 17.0 * time_s) + 0.8 * np.cos(2 * np.pi * 34.0 * time_s + 1.0)


def table(slow_hz, *, rate_hz=4000.0, digits=4, noise=0.02, late=0.0, jitter=0.0, phase=0.37):
    """Samples of the slow instrument, and rows interpolated between them.

    Samples come `late` by standard deviations of their period; rows are stamped off their times by shares of theirs.
    """
    rng = np.random.default_rng(3)
    at_s = (phase + np.arange(np.floor(SECONDS * slow_hz))) / slow_hz
    at_s = at_s + late / slow_hz * rng.standard_normal(len(at_s))
    values = ripple(at_s) + noise * rng.standard_normal(len(at_s))
    time_s = np.arange(at_s[0], at_s[-1], 1.0 / rate_hz)
    stamped_s = time_s + jitter / rate_hz * rng.uniform(-1.0, 1.0, len(time_s))
    return at_s, values, stamped_s, np.round(np.interp(time_s, at_s, values), digits)


@pytest.mark.parametrize(
    "written",
    [
        {}, {"late": 0.02}, {"jitter": 0.05}, {"noise": 0.3}, {"rate_hz": 20_000.0, "digits": 3},
        {"rate_hz": 20_000.0, "digits": 4, "noise": 0.0},
    ],
    ids=["plain", "messages early or late", "stamps", "noisy", "rows finer than the last digit", "without noise"],
)  # fmt: skip
@pytest.mark.parametrize("slow_hz", [50.0, 200.0, 500.0])
def test_each_sample_comes_back_at_its_time(slow_hz, written):
    at_s, values, time_s, rows = table(slow_hz, **written)
    found_s, found = without_interpolated_rows(time_s, rows)
    assert abs(len(found) - len(values)) <= 0.01 * len(values) + 2
    nearest = np.argmin(np.abs(found_s[:, None] - at_s), axis=1)
    assert np.percentile(np.abs(found_s - at_s[nearest]), 90) < 0.06 / slow_hz + np.median(np.diff(time_s))
    # As good as the lines between the samples say it at the clock's time, and stamps that of the rows.
    missed = np.abs(found - np.interp(found_s, at_s, values))
    assert np.percentile(missed, 90) < 0.05 * np.std(values)


@pytest.mark.parametrize(("slow_hz", "rate_hz", "step"), [(200.0, 2000.0, 0.0122), (200.0, 4000.0, 0.0244)])
def test_each_sample_comes_back_where_the_rows_have_the_steps_of_a_converter(slow_hz, rate_hz, step):
    """As seen: 14 bits of 100 A, written with four digits, are no multiples of a power of ten."""
    _, values, time_s, rows = table(slow_hz, rate_hz=rate_hz, digits=9)
    found_s, found = without_interpolated_rows(time_s, np.round(np.round(rows / step) * step, 4))
    assert abs(len(found) - len(values)) <= 0.01 * len(values) + 2
    assert np.median(np.diff(found_s)) == pytest.approx(1.0 / slow_hz, rel=1e-3)


def test_what_interpolation_takes_off_the_ripple_is_there_again():
    """At 50 Hz lines between samples have a third of a ripple of 34 Hz, the samples themselves all of it."""
    _, _, time_s, rows = table(50.0, noise=0.0)
    found_s, found = own_samples(time_s, rows)

    def second_harmonic(at_s, values):
        waves = np.column_stack(
            [np.ones_like(at_s), *(f(2 * np.pi * hz * at_s) for hz in (17.0, 34.0) for f in (np.cos, np.sin))]
        )
        return np.hypot(*np.linalg.lstsq(waves, values, rcond=None)[0][3:])

    assert second_harmonic(time_s, rows) < 0.4 * 0.8
    assert second_harmonic(found_s, found) == pytest.approx(0.8, rel=0.02)


def test_nothing_is_made_up_where_rows_are_missing():
    """Rows are lost for a while, twice, and single ones here and there."""
    at_s, values, time_s, rows = table(200.0)
    is_lost = (np.abs(time_s - 2.0) < 0.06) | (np.abs(time_s - 4.0) < 0.02)
    is_lost[np.random.default_rng(6).choice(len(time_s), 100, replace=False)] = True
    time_s, rows = time_s[~is_lost], rows[~is_lost]
    found_s, found = without_interpolated_rows(time_s, rows)
    assert len(found) < 0.1 * len(rows)
    assert not np.any((np.abs(found_s - 2.0) < 0.055) | (np.abs(found_s - 4.0) < 0.015))
    assert np.max(np.abs(found - np.interp(found_s, at_s, values))) < 0.05 * np.std(values)
    clean = clean_channel(Signal(channel="battery_current_a", unit="A", time_s=time_s, values=rows))
    assert [round(begin) for begin, _ in clean.holes] == [2, 4]


T = np.arange(0.0, SECONDS, 1.0 / 20_000.0)


@pytest.mark.parametrize(
    "values",
    [
        np.round(ripple(T), 4),
        np.round(ripple(T) + 0.05 * np.random.default_rng(5).standard_normal(len(T)), 3),
        np.round(10.0 * (1.0 - np.cos(2 * np.pi * 31.25 * T)), 3),
        np.round(ripple(T) / 0.05) * 0.05,
        np.abs(np.sin(2 * np.pi * 17.0 * T)).round(4),
        np.clip(np.round(ripple(T), 4), 4.0, 8.0),
        np.zeros(len(T)),
    ],
    ids=["smooth", "noisy", "in step with the rows looked at", "coarse", "kinks of its own", "clipped", "dead"],
)
def test_nothing_is_taken_from_a_channel_of_which_every_row_is_a_sample(values):
    found_s, found = own_samples(T, values)
    assert found_s is T
    assert found is values


def test_a_channel_that_is_held_is_no_lines():
    at_s = np.arange(0.0, SECONDS, 1.0 / 500.0)
    time_s = np.arange(0.0, SECONDS, 1.0 / 4000.0)
    rows = np.repeat(np.round(ripple(at_s), 3), 8)[: len(time_s)]
    _, found = own_samples(time_s, rows)
    assert np.mean(np.isin(found, rows)) == 1.0
    assert len(found) == pytest.approx(len(at_s), abs=2)


def test_the_channel_says_so_and_its_times_are_known_to_a_period():
    _, values, time_s, rows = table(200.0)
    clean = clean_channel(Signal(channel="battery_current_a", unit="A", time_s=time_s, values=rows))
    assert clean.quality.rate_hz == pytest.approx(200.0, rel=1e-3)
    assert len(clean.values) == pytest.approx(len(values), abs=3)
    assert any("20 rows for each sample" in problem for problem in clean.quality.problems)
    assert clean.alignment.latency_s == pytest.approx(5e-3, rel=1e-3)


@pytest.mark.parametrize("own_hz", [4100.0, 4800.0, 7800.0, 13_300.0])
@pytest.mark.parametrize("stroke_hz", [11.6, 14.4, 15.6, 18.0, 22.6])
def test_a_fast_instrument_whose_last_sample_a_table_takes_is_no_slow_one(stroke_hz, own_hz):
    """The rows come late by a share of the instrument's period that changes from row to row, and turns over again."""
    row_s = 1e-3 * np.arange(1, 5000)
    held_s = np.floor(row_s * own_hz) / own_hz
    displacement = 10.0 - 10.0 * np.cos(2 * np.pi * stroke_hz * held_s)
    found_s, found = own_samples(row_s, displacement)
    assert found is displacement
    assert found_s is row_s
