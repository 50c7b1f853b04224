"""What a claim leaves where it acts says how probable a cause outside the catalogue is."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.answer.ladder import Ladder, Rungs
from sawbench.diagnosis.answer.unlisted import left_share, odds_of_unlisted

pytestmark = pytest.mark.unit

RUNGS = Rungs(nominal=1.0, retuned=1.0, with_effect=1.0, noise_floor=1.0)


def ladder(retuned, with_effect, floor, *, elsewhere=0.0):
    """Withheld squares in the mechanical equation, and what stays unexplained in the cutting one."""
    rungs = {"nominal": retuned, "retuned": retuned, "with_effect": with_effect, "noise_floor": floor}
    squares = {
        name: {
            "mechanical": np.array(values, dtype=float),
            "cutting": np.full(len(values), 0.0 if name == "noise_floor" else elsewhere),
        }
        for name, values in rungs.items()
    }
    return Ladder(
        whitened=RUNGS, by_channel={}, gap_closed=0.0, gap_closed_ci95=(-1.0, 1.0), fits={},
        held_out="operating points", energy={}, squares=squares,
    )  # fmt: skip


def leaving(share, *, n=6, elsewhere=0.0):
    """A strong gap of which every point leaves the same share."""
    retuned = np.linspace(800.0, 1200.0, n)
    return ladder(retuned, share * retuned + 3.0, np.ones(n), elsewhere=elsewhere)


def test_what_is_left_counts_beyond_three_times_the_noise():
    share, std = left_share(ladder([100.0, 300.0], [30.0, 40.0], [5.0, 5.0]), ["mechanical"])
    assert share == pytest.approx((70.0 - 30.0) / 400.0)
    # Jackknife of two: half of the difference of the logarithms.
    assert std == pytest.approx(0.5 * abs(np.log(15.0 / 100.0) - np.log(25.0 / 300.0)))


def test_a_tenth_is_left_by_a_right_cause_in_one_of_ten_and_by_a_wrong_one_as_often_as_anything():
    even = [odds_of_unlisted(leaving(share), ["mechanical"]) for share in (0.01, 0.1, 0.2, 0.35)]
    assert np.all(np.diff(even) > 0.0)
    # The exponential that exceeds 0.1 once in ten has the density 23 exp(-23 share).
    rate = np.log(10.0) / 0.1
    prior = 0.06 / 0.34
    assert even[1] == pytest.approx(prior / (rate * np.exp(-rate * 0.1)), rel=0.02)
    assert even[0] < 0.02
    assert even[3] > 10.0


def test_what_stays_unexplained_elsewhere_is_not_the_claims():
    assert odds_of_unlisted(leaving(0.01, elsewhere=5000.0), ["mechanical"]) == pytest.approx(
        odds_of_unlisted(leaving(0.01), ["mechanical"])
    )
    assert odds_of_unlisted(leaving(0.01, elsewhere=5000.0), ["mechanical", "cutting"]) > 10.0


def test_points_that_disagree_say_less():
    alike = odds_of_unlisted(leaving(0.3), ["mechanical"])
    one = ladder([900.0, 1000.0, 1100.0, 1000.0], [4.0, 4.0, 1190.0, 4.0], [1.0] * 4)
    assert left_share(one, ["mechanical"])[0] == pytest.approx(0.3, abs=0.01)
    assert odds_of_unlisted(one, ["mechanical"]) < 0.3 * alike


def test_a_weak_gap_within_the_noise_is_nothing_left():
    assert odds_of_unlisted(ladder([1.3, 1.2, 1.4], [1.25, 1.2, 1.3], [1.0, 1.0, 1.0]), ["mechanical"]) < 0.02
