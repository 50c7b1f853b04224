"""Sliding median and maximum, and lengths of transforms, against scipy."""

import numpy as np
import pytest
from sawbench.processing.sliding import median_of_five, sliding_maximum, sliding_median
from sawbench.processing.spectrum import _fast_length
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d, median_filter

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("n", [1, 2, 3, 5, 400])
def test_filters_are_those_of_scipy(n):
    values = np.random.default_rng(n).integers(0, 40, n).astype(float)  # equal values too
    assert median_of_five(values).tolist() == median_filter(values, 5, mode="nearest").tolist()
    for width in (1, 3, 9, 129):
        assert sliding_median(values, width).tolist() == median_filter(values, width, mode="nearest").tolist()
    for width in (1, 2, 3, 8, 100, 277):
        assert sliding_maximum(values, width).tolist() == maximum_filter1d(values, width, mode="nearest").tolist()


def test_nothing_has_no_median():
    assert len(median_of_five(np.empty(0))) == 0


def test_a_fast_length_is_the_smallest_without_large_factors():
    least = [*range(1, 2000), 24_001, 120_007, 1_000_003, 23_999_999]
    assert [_fast_length(n) for n in least] == [next_fast_len(n, real=True) for n in least]
