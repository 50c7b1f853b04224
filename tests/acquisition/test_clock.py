"""The common clock on synthetic arrivals (jitter, drift, a stalled host), where the truth is known."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sawbench.acquisition.clock import ArrivalClock

pytestmark = pytest.mark.unit

RATE_HZ = 6000.0
START_S = 12.5
PER_READ = 48


def arrivals(*, n_reads, ppm=0.0, jitter_s=1e-3, floor_s=0.0, seed=0, stall=(0.0, 0.0)):
    """Index of the newest sample of each read, when it came, and the true period."""
    rng = np.random.default_rng(seed)
    period_s = 1.0 / (RATE_HZ * (1.0 + ppm * 1e-6))
    newest = np.arange(1, n_reads + 1) * PER_READ - 1
    came_s = START_S + newest * period_s + floor_s + rng.exponential(jitter_s, n_reads)
    begins, lasts = stall
    during = (came_s >= START_S + begins) & (came_s < START_S + begins + lasts)
    came_s[during] = START_S + begins + lasts + 1e-5 * np.arange(during.sum())
    # Reads come one after the other.
    return newest, np.maximum.accumulate(came_s), period_s


def errors_ms(newest, came_s, period_s, *, settle_s=0.4):
    clock = ArrivalClock(rate_hz=RATE_HZ)
    waiting, stamped, indices = 0, [], []
    for index, arrival_s in zip(newest, came_s, strict=True):
        clock.observe(int(index), float(arrival_s))
        waiting += PER_READ
        # As a stream begins: not before its clock is steady.
        if clock.span_s < settle_s or not (stamped or clock.is_steady):
            continue
        first = int(index) - waiting + 1
        t0, dt = clock.stamp(first, waiting)
        stamped.append(t0 + dt * np.arange(waiting))
        indices.append(np.arange(first, first + waiting))
        waiting = 0
    time_s, index = np.concatenate(stamped), np.concatenate(indices)
    assert np.all(np.diff(time_s) > 0)
    return (time_s - START_S - index * period_s) * 1e3, clock


def test_jitter_of_usb_is_taken_out():
    error_ms, clock = errors_ms(*arrivals(n_reads=2500, jitter_s=1e-3))
    assert np.max(np.abs(error_ms)) < 0.25
    assert clock.uncertainty_s < 0.3e-3


def test_constant_latency_is_what_remains():
    error_ms, _ = errors_ms(*arrivals(n_reads=2500, jitter_s=0.5e-3, floor_s=0.8e-3))
    assert np.median(error_ms) == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize("ppm", [50.0, -50.0])
def test_drift_is_followed(ppm):
    error_ms, clock = errors_ms(*arrivals(n_reads=7500, ppm=ppm, jitter_s=0.5e-3))
    assert np.max(np.abs(error_ms)) < 0.25
    assert np.max(np.abs(error_ms[-60_000:])) < 0.1
    assert 1.0 / clock.line.period_s == pytest.approx(RATE_HZ * (1 + ppm * 1e-6), rel=1e-5)


def test_a_rate_off_by_two_tenths_of_a_percent_is_followed():
    error_ms, _ = errors_ms(*arrivals(n_reads=7500, ppm=2000.0, jitter_s=0.5e-3))
    assert np.max(np.abs(error_ms)) < 2.5
    assert np.max(np.abs(error_ms[-60_000:])) < 0.2


def test_a_stalled_host_moves_nothing():
    calm, _ = errors_ms(*arrivals(n_reads=1250, jitter_s=0.3e-3))
    stalled, _ = errors_ms(*arrivals(n_reads=1250, jitter_s=0.3e-3, stall=(4.0, 0.05)))
    assert np.max(np.abs(stalled - calm)) < 0.05


def test_stamping_backwards_is_refused():
    clock = ArrivalClock(rate_hz=100.0)
    clock.observe(0, 0.0)
    clock.stamp(0, 10)
    with pytest.raises(ValueError, match="stamped before"):
        clock.stamp(5, 5)


def test_statement_names_rate_and_uncertainty():
    _, clock = errors_ms(*arrivals(n_reads=2500, ppm=50.0))
    assert "alignment +/-" in clock.statement()
    assert re.search(r"\+(4[5-9]|5[0-5]) ppm", clock.statement())
