"""Equations 14 to 18 on curves whose deviations are known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError

from benchmarks.deviations import amplitude_spectrum, deviations

pytestmark = pytest.mark.unit


def test_sine_against_scaled_sine():
    time_s = np.arange(1000) / 1000.0
    real = 10.0 + 4.0 * np.sin(2 * np.pi * 10 * time_s)
    linear = 10.0 + 3.0 * np.sin(2 * np.pi * 10 * time_s)
    found = deviations(time_s, real, linear, unit="A")
    assert found.rmse == pytest.approx(1.0 / np.sqrt(2.0), rel=1e-9)
    assert found.ise == pytest.approx(500.0, rel=1e-9)
    assert found.ise_integral == pytest.approx(0.4995, rel=1e-3)
    assert found.peak_real == pytest.approx(14.0)
    assert found.max_absolute == pytest.approx(1.0)
    line = np.argmin(np.abs(found.frequency_hz - 10.0))
    assert found.amplitude_real[line] == pytest.approx(4.0)
    assert found.amplitude_linear[line] == pytest.approx(3.0)
    np.testing.assert_allclose(found.relative_percent, 100.0 * (real - linear) / real)


def test_return_stroke_has_no_relative_deviation():
    found = deviations([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 0.0, 4.0], [1.0, 1.0, 0.0, 5.0], unit="N")
    assert found.is_relative_valid.tolist() == [False, True, False, True]
    assert found.relative.tolist() == [0.0, 0.5, 0.0, -0.25]


def test_spectrum_of_a_constant_is_its_mean():
    _, amplitude = amplitude_spectrum(np.full(9, -2.5), rate_hz=1.0)
    assert amplitude[0] == pytest.approx(2.5)
    np.testing.assert_allclose(amplitude[1:], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("time_s", "real", "message"),
    [
        ([0.0, 1.0, 3.0], [1.0, 1.0, 1.0], "equally spaced"),
        ([0.0, 1.0, 2.0], [1.0, np.nan, 1.0], "real"),
        ([0.0, 1.0, 2.0], [1.0, 1.0], "real"),
    ],
)
def test_nonsense_is_refused_by_name(time_s, real, message):
    with pytest.raises(InputError, match=message):
        deviations(time_s, real, [1.0, 1.0, 1.0], unit="A")
