"""The share of the gap that closes, and its interval."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.answer.closed_share import closed_share

pytestmark = pytest.mark.unit


def energies(retuned, left_share, floor=1.0):
    retuned = np.asarray(retuned, dtype=float)
    noise = np.full(len(retuned), floor)
    return {"retuned": retuned + noise, "with_effect": retuned * left_share + noise, "noise_floor": noise}


def test_share_is_what_is_taken_of_the_room_above_the_noise():
    closed, (low, high) = closed_share(energies([40.0, 60.0, 50.0, 45.0], 0.2))
    assert closed == pytest.approx(0.8)
    assert low == pytest.approx(0.8, abs=1e-6) and high == pytest.approx(0.8, abs=1e-6)


def test_nothing_to_close_is_said_with_an_open_interval():
    assert closed_share(energies([0.001, 0.002, 0.001], 0.5)) == (0.0, (-1.0, 1.0))


def test_a_worse_model_closes_less_than_nothing():
    closed, _ = closed_share(energies([40.0, 60.0, 50.0], 1.3))
    assert closed == pytest.approx(-0.3)


def test_two_operating_points_leave_the_interval_open():
    closed, interval = closed_share(energies([40.0, 60.0], 0.1))
    assert closed == pytest.approx(0.9)
    assert interval == (-1.0, 1.0)


def test_interval_covers_the_share_of_the_population():
    """Groups of unequal size whose remainders differ: the interval must cover in most campaigns."""
    rng = np.random.default_rng(7)
    truth, n_covered, n_campaigns = 0.9, 0, 300
    for _ in range(n_campaigns):
        size = 10.0 * rng.lognormal(-0.125, 0.5, 8)
        left = (1.0 - truth) * rng.lognormal(-0.125, 0.5, 8)
        low, high = closed_share(energies(size, left, floor=0.2))[1]
        n_covered += low <= truth <= high
    assert n_covered > 0.88 * n_campaigns


def test_interval_of_a_gap_that_is_closed_stays_near_it():
    """Little is left, of which noise takes some below nothing in every other group: a bound is stated and it covers."""
    rng = np.random.default_rng(8)
    truth, n_covered, n_campaigns = 0.99, 0, 300
    for _ in range(n_campaigns):
        found = energies(20.0 * rng.lognormal(-0.125, 0.5, 8), 1.0 - truth)
        found["with_effect"] += rng.normal(0.0, 0.3, 8)
        low, high = closed_share(found)[1]
        n_covered += low <= truth <= high
        assert low > 0.8
    assert n_covered > 0.88 * n_campaigns


def test_a_sure_gain_in_a_room_that_noise_hides_is_a_share_above_nothing():
    """Thirty-five trials, as seen: each gains a little, and the noise of all is known no better than the gap."""
    rng = np.random.default_rng(9)
    floor = np.full(35, 100.0)
    retuned = floor + 4.0 + rng.normal(0.0, 14.0, 35)
    energy = {"retuned": retuned, "with_effect": retuned - rng.normal(1.6, 1.5, 35), "noise_floor": floor}
    closed, (low, high) = closed_share(energy)
    assert 0.0 < low < closed < high
    # A gain that may be none proves nothing.
    assert closed_share(energy | {"with_effect": retuned - rng.normal(0.3, 4.0, 35)})[1][0] < 0.0


def test_a_sure_gain_shows_that_there_was_room_where_the_noise_is_stated_too_large():
    """Twenty trials, as seen: 5 % more noise is stated than there is, and every trial gains 2 nats."""
    rng = np.random.default_rng(10)
    retuned = 120.0 + rng.normal(0.0, 15.0, 20)
    energy = {"retuned": retuned, "noise_floor": np.full(20, 126.0)}
    closed, (low, high) = closed_share(energy | {"with_effect": retuned - rng.normal(4.0, 2.0, 20)})
    assert closed == high == 1.0
    assert low > 0.3
    assert closed_share(energy | {"with_effect": retuned - rng.normal(0.5, 3.0, 20)}) == (0.0, (-1.0, 1.0))
