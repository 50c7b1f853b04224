"""Numbers as they are written, and what is concluded from repetitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sawbench.reporting.quantities import (
    decimals_of,
    format_duration,
    format_interval,
    format_number,
    format_quantity,
    format_to,
)
from sawbench.reporting.repetitions import Estimate, compare_groups, group_mean

pytestmark = pytest.mark.unit


def spaced(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(
    ("value", "std", "unit", "written"),
    [
        (240.2871, 1.2345, "N·s/m", "240.3 ± 1.2 N·s/m"),
        (0.0714, 0.00002, "s", "0.071400 ± 0.000020 s"),
        (927.44, 48.2, "s", "927 ± 48 s"),
        (12345.0, 234.0, "N", "12340 ± 230 N"),
        (-3.14159, 0.0996, "A", "−3.14 ± 0.10 A"),
        (5.0, 0.095, "", "5.000 ± 0.095"),
        (0.0, 0.31, "N", "0.00 ± 0.31 N"),
        (0.0, 8.0e-7, "V", "(0.0 ± 8.0) × 10⁻⁷ V"),
        (3.4274e-6, 1.1e-7, "N·m·s", "(3.43 ± 0.11) × 10⁻⁶ N·m·s"),
        (10.9, None, "A", "10.90 A"),
        (10.9, 0.0, "A", "10.90 A"),
        (10.9, math.nan, "A", "10.90 A"),
        (None, 1.0, "A", "not known"),
        (math.nan, 1.0, "A", "not known"),
        (math.inf, 1.0, "A", "not known"),
    ],
)
def test_quantities_end_where_their_uncertainty_does(value, std, unit, written):
    assert spaced(format_quantity(value, std, unit)) == written


@given(st.floats(1e-4, 1e4), st.floats(-1e6, 1e6))
def test_the_written_uncertainty_has_two_significant_digits(std, value):
    number, _, uncertainty = spaced(format_quantity(value, std)).partition(" ± ")
    assert float(uncertainty) == pytest.approx(std, rel=0.051)
    assert float(number.replace("−", "-")) == pytest.approx(value, abs=0.051 * std)
    assert len(uncertainty.replace(".", "").strip("0")) <= 2


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (14.00638, "14.01"),
        (5000.0, "5000"),
        (0.00012, "0.0001200"),
        (1.5e-9, "1.500 × 10⁻⁹"),
        (-2.5, "−2.500"),
    ],
)
def test_bare_numbers_have_four_digits(value, written):
    assert spaced(format_number(value)) == written


def test_intervals_and_durations():
    assert spaced(format_interval(-3.42, 11.09, "N")) == "−3.4 to 11.1 N"
    assert spaced(format_interval(2.0, 2.0, "N")) == "2.000 N"
    assert format_interval(math.nan, 1.0) == "not known"
    assert spaced(format_to(-5.6249, 1, "N")) == "−5.6 N"
    assert (decimals_of(0.0994), decimals_of(0.0996)) == (3, 2)
    assert spaced(format_duration(59.6)) == "1 min 0 s"
    assert spaced(format_duration(3599.6)) == "1 h 0 min"
    assert format_duration(None) == "not known"


def test_group_mean_by_hand():
    found = group_mean([Estimate(value=v) for v in (9.0, 10.0, 11.0)])
    assert found.between_std == pytest.approx(1.0)
    assert found.std == pytest.approx(1.0 / math.sqrt(3.0))
    assert found.high - found.mean == pytest.approx(4.302653 / math.sqrt(3.0), rel=1e-6)


def test_the_common_part_does_not_shrink_with_repetitions():
    few, many = (group_mean([Estimate(value=10.0 + (-1.0) ** k, common_std=2.0) for k in range(n)]) for n in (4, 400))
    assert few.std == pytest.approx(math.sqrt(4.0 / 3.0 / 4.0 + 4.0))
    assert many.std == pytest.approx(2.0, rel=1e-3)
    assert many.high - many.mean == pytest.approx(1.96 * 2.0, rel=1e-2)


def test_scatter_that_is_small_by_chance_does_not_hide_the_trials_own_uncertainty():
    found = group_mean([Estimate(value=v, statistical_std=3.0) for v in (10.0, 10.1, 9.9)])
    assert found.std == pytest.approx(3.0 / math.sqrt(3.0))


def test_a_single_trial_has_its_own_uncertainty_only():
    found = group_mean([Estimate(value=240.0, statistical_std=3.0, common_std=4.0)])
    assert (found.n, found.between_std, found.rests_on_repetitions) == (1, None, False)
    assert found.std == pytest.approx(5.0)
    assert found.high - found.mean == pytest.approx(1.96 * 5.0, rel=1e-3)


@pytest.mark.parametrize("n", [2, 3, 10])
def test_intervals_cover_the_truth(n):
    rng = np.random.default_rng(11 + n)
    n_groups, hits = 2000, 0
    for _ in range(n_groups):
        shared = rng.normal(0.0, 0.5)
        found = group_mean([Estimate(value=shared + x, common_std=0.5) for x in rng.normal(5.0, 1.0, n)])
        hits += found.low <= 5.0 <= found.high
    # Binomial standard deviation 0.5 %; adding the two half-widths in quadrature errs on the safe side.
    assert 0.935 <= hits / n_groups <= 0.99


def test_welch_agrees_with_scipy_and_holm_with_the_textbook():
    from scipy.stats import ttest_ind

    rng = np.random.default_rng(2)
    groups = {
        name: rng.normal(mean, std, n) for name, mean, std, n in (("a", 10, 1, 4), ("b", 11, 2, 6), ("c", 14, 1, 3))
    }
    found = compare_groups(groups)
    p_raw = []
    for difference in found:
        reference = ttest_ind(groups[difference.first], groups[difference.second], equal_var=False)
        interval = reference.confidence_interval(0.95)
        assert difference.p_value == pytest.approx(reference.pvalue, rel=1e-9)
        assert (difference.low, difference.high) == pytest.approx((interval.low, interval.high), rel=1e-9)
        p_raw.append(difference.p_value)
    low, middle, high = sorted(p_raw)
    expected = {low: min(1, 3 * low), middle: max(3 * low, 2 * middle), high: max(3 * low, 2 * middle, high)}
    for difference in found:
        assert difference.p_holm == pytest.approx(expected[difference.p_value])
        assert difference.is_significant == (difference.p_holm < 0.05)


def test_the_size_of_a_difference_is_not_known_better_than_the_factor_that_all_trials_share():
    """Gains and plant constants multiply both means: the difference is wrong by their share, however many trials."""
    rng = np.random.default_rng(5)
    hits = {0.0: 0, 0.03: 0}
    for _ in range(1000):
        factor = 1.0 + 0.03 * rng.standard_normal()
        groups = {name: factor * rng.normal(mean, 2.0, 10) for name, mean in (("oak", 240.0), ("nylon", 140.0))}
        for common_rel_std in hits:
            (found,) = compare_groups(groups, common_rel_std=common_rel_std)
            hits[common_rel_std] += found.low <= 100.0 <= found.high
            assert found.is_significant
    assert 0.93 <= hits[0.03] / 1000 <= 0.985
    assert hits[0.0] / 1000 < 0.7


def test_holm_keeps_false_differences_rare():
    rng = np.random.default_rng(8)
    n_false = sum(
        any(d.is_significant for d in compare_groups({k: rng.normal(0.0, 1.0, 3) for k in "abcd"})) for _ in range(400)
    )
    assert n_false / 400 < 0.05 + 2 * math.sqrt(0.05 * 0.95 / 400)


def test_a_single_value_of_unknown_uncertainty_has_no_interval():
    found = group_mean([Estimate(value=10.7)])
    assert (found.low, found.high) == (None, None)


def test_what_cannot_be_said_is_said():
    found = compare_groups({"oak": [240.0, 241.0], "pine": [120.0], "fir": [100.0]})
    by_pair = {(d.first, d.second): d for d in found}
    assert by_pair["oak", "pine"].is_significant is None
    assert "pine has 1" in by_pair["oak", "pine"].reason
    assert by_pair["pine", "fir"].reason.count("has 1") == 2
    (same,) = compare_groups({"a": [1.0, 1.0], "b": [2.0, 2.0]})
    assert same.is_significant is None
    assert "scatter" in same.reason
