"""What a claim leaves where it acts says how probable a cause outside the catalogue is."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.answer.ladder import Ladder, Rungs
from sawbench.diagnosis.answer.unlisted import leaves_a_gap, left_share, odds_of_unlisted

pytestmark = pytest.mark.unit

# A bench so quiet that the scatter decides.
QUIET = 1e-6
RUNGS = Rungs(nominal=1.0, retuned=1.0, with_effect=1.0, noise_floor=1.0)


def ladder(retuned, with_effect, floor, *, elsewhere=0.0, n_features=1.0):
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
        whitened=RUNGS, by_channel={}, fits={},
        held_out="operating points", energy={}, squares=squares, group_of=np.arange(len(retuned)),
        n_features={equation: np.full(len(retuned), n_features) for equation in ("mechanical", "cutting")},
    )  # fmt: skip


def share_of(one, equations=("mechanical",), quiet=QUIET):
    return left_share(one, equations, quiet=quiet)


def odds_of(one, equations=("mechanical",), quiet=QUIET):
    return odds_of_unlisted(one, equations, quiet=quiet)


def leaving(share, *, n=6, **other):
    """A strong gap of which every point leaves the same share."""
    retuned = np.linspace(800.0, 1200.0, n)
    return ladder(retuned, share * retuned + 3.0, np.ones(n), **other)


def test_what_is_left_counts_beyond_three_times_the_noise():
    share, std = share_of(ladder([100.0, 300.0], [30.0, 40.0], [5.0, 5.0]))
    assert share == pytest.approx((70.0 - 30.0) / 400.0)
    # Jackknife of two: half of the difference of the logarithms.
    assert std == pytest.approx(0.5 * abs(np.log(15.0 / 100.0) - np.log(25.0 / 300.0)))


def test_what_an_intact_machine_leaves_is_no_gap():
    """Three times the noise, in each group."""
    quiet = ladder([14.0, 15.0], [5.0, 6.0], [5.0, 5.0])
    in_one_point = ladder([14.0, 16.0], [5.0, 40.0], [5.0, 5.0])

    def is_gap(one, equations=("mechanical",)):
        return leaves_a_gap(one, equations, rung="retuned", quiet=QUIET)

    assert not is_gap(quiet)
    assert is_gap(in_one_point)
    assert not is_gap(in_one_point, ["supply"]), "an equation that nobody could evaluate"
    # A bench that is stated to leave more leaves no gap by it.
    assert not leaves_a_gap(in_one_point, ["mechanical"], rung="retuned", quiet=16.0)


def test_a_tenth_is_left_by_a_right_cause_in_one_of_ten_and_by_a_wrong_one_as_often_as_anything():
    even = [odds_of(leaving(share)) for share in (0.01, 0.1, 0.2, 0.35)]
    assert np.all(np.diff(even) > 0.0)
    # The exponential that exceeds 0.1 once in ten has the density 23 exp(-23 share).
    rate = np.log(10.0) / 0.1
    prior = (1.0 / 12.0) / (5.0 / 12.0)
    assert even[1] == pytest.approx(prior / (rate * np.exp(-rate * 0.1)), rel=0.02)
    assert even[0] < 0.02
    assert even[3] > 10.0


def test_what_stays_unexplained_elsewhere_is_not_the_claims():
    assert odds_of(leaving(0.01, elsewhere=5000.0)) == pytest.approx(odds_of(leaving(0.01)))
    assert odds_of(leaving(0.01, elsewhere=5000.0), ["mechanical", "cutting"]) > 10.0


def test_a_weak_gap_that_is_left_in_one_equation_counts_beside_a_strong_one_that_is_closed():
    """As seen: a drop of voltage closed 96 % of all, and an eccentric gear left a third of what a spring did."""
    assert odds_of(leaving(0.01, elsewhere=50.0), ["mechanical", "cutting"]) > 10.0
    # What an intact machine leaves is no gap.
    assert odds_of(leaving(0.01, elsewhere=2.0), ["mechanical", "cutting"], quiet=2.5) < 0.02


def test_what_the_noise_is_stated_to_leave_is_left_by_an_intact_machine_too():
    """Trials that scatter less than their stated noise: the model of an intact machine is no better than stated."""
    one = ladder([300.0, 320.0, 310.0], [200.0, 190.0, 210.0], [10.0, 10.0, 10.0], n_features=1500.0)
    assert share_of(one)[0] > 0.5
    assert share_of(one, quiet=0.15)[0] < 1e-3
    assert odds_of(one, quiet=0.15) < 0.02


def test_points_that_disagree_say_less():
    alike = odds_of(leaving(0.3))
    one = ladder([900.0, 1000.0, 1100.0, 1000.0], [4.0, 4.0, 1190.0, 4.0], [1.0] * 4)
    assert share_of(one)[0] == pytest.approx(0.3, abs=0.01)
    assert odds_of(one) < 0.3 * alike


def test_a_weak_gap_within_the_noise_is_nothing_left():
    assert odds_of(ladder([1.3, 1.2, 1.4], [1.25, 1.2, 1.3], [1.0, 1.0, 1.0])) < 0.02
