"""The straight line of a calibration: against published figures, known truth, and nonsense."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.calibration_fit import CalibrationPoint, fit_line, judge_line, read_points, require_sound
from sawbench.bench.errors import InputError, UntrustedResult

pytestmark = pytest.mark.unit

FORMER = Calibration(scale=250.0, raw_unit="mV/V")


def points_of(loads, raw, **stds):
    return [CalibrationPoint(reference=float(f), raw=float(r), **stds) for f, r in zip(loads, raw, strict=True)]


def test_pearsons_points_with_yorks_weights():
    """Figures as published by York et al. 2004 for this set, before any widening by the scatter."""
    x = [0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4]
    y = [5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5]
    wx = [1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1.0]
    wy = [1.0, 1.8, 4.0, 8.0, 20, 20, 70, 70, 100, 500]
    order = [0, 1, 2, 3, 4, 5, 6, 8, 7, 9]
    points = [
        CalibrationPoint(reference=y[k], raw=x[k], raw_std=wx[k] ** -0.5, reference_std=wy[k] ** -0.5) for k in order
    ]
    line = fit_line(points)
    assert line.gain == pytest.approx(-0.480533, abs=2e-6)
    assert line.offset == pytest.approx(5.479910, abs=2e-6)
    assert line.chi2_per_degree * 8 == pytest.approx(11.86635, abs=1e-4)
    widening = line.chi2_per_degree**0.5
    assert line.gain_std / widening == pytest.approx(0.057985, rel=1e-3)
    assert line.offset_std / widening == pytest.approx(0.294971, rel=1e-3)


def test_stated_uncertainties_hold_the_truth():
    rng = np.random.default_rng(11)
    gain, zero = 247.0, 0.031
    loads = np.array([0.0, 100.0, 250.0, 400.0, 500.0, 300.0, 150.0, 50.0])
    pulls = []
    for _ in range(600):
        known = loads + 0.2 * rng.standard_normal(len(loads))
        raw = zero + known / gain + 5e-4 * rng.standard_normal(len(loads))
        line = fit_line(points_of(loads, raw, raw_std=5e-4, reference_std=0.2))
        pulls.append(
            ((line.gain - gain) / line.gain_std, (line.offset + gain * zero) / line.offset_std,
             (line.zero_raw - zero) / line.zero_std_raw)
        )  # fmt: skip
    pulls = np.array(pulls)
    # Widening by the scatter only ever widens: a little below 1.
    assert np.all(np.abs(pulls.mean(axis=0)) < 0.15)
    assert np.all((pulls.std(axis=0) > 0.75) & (pulls.std(axis=0) < 1.08))


def test_covariance_gives_the_uncertainty_anywhere_on_the_line():
    rng = np.random.default_rng(12)
    loads = np.array([0.0, 200.0, 400.0, 500.0, 100.0])
    lines = [
        fit_line(points_of(loads, loads / 250.0 + 1e-3 * rng.standard_normal(5), raw_std=1e-3)) for _ in range(2000)
    ]
    at = 1.5
    values = np.array([f.offset + f.gain * at for f in lines])
    stated = np.array([(f.offset_std**2 + 2 * at * f.covariance + (at * f.gain_std) ** 2) for f in lines])
    assert values.std() == pytest.approx(np.sqrt(np.mean(stated)), rel=0.2)
    assert values.std() < np.sqrt(np.mean([f.offset_std**2 + (at * f.gain_std) ** 2 for f in lines])) * 0.8


def test_without_stated_uncertainties_the_scatter_gives_them():
    rng = np.random.default_rng(13)
    loads = np.tile(np.linspace(0, 500, 11), 4)
    raw = loads / 250.0 + 2e-3 * rng.standard_normal(len(loads))
    line = fit_line(points_of(loads, raw))
    assert line.chi2_per_degree is None
    spread = np.sqrt(np.sum((raw - raw.mean()) ** 2))
    assert line.gain_std == pytest.approx(250.0 * 2e-3 / spread, rel=0.3)


@pytest.mark.parametrize("loads", [[0.0, 250.0, 500.0], [0.0, 250.0, 500.0, 0.0]])
def test_intervals_from_the_scatter_of_few_points_cover_the_truth(loads):
    rng = np.random.default_rng(14)
    gain, zero, n = 250.0, 0.1, 2000
    is_covered = np.zeros((n, 2), dtype=bool)
    for k in range(n):
        line = fit_line(points_of(loads, zero + np.array(loads) / gain + 1e-3 * rng.standard_normal(len(loads))))
        is_covered[k] = (
            abs(line.gain - gain) < 1.96 * line.gain_std, abs(line.zero_raw - zero) < 1.96 * line.zero_std_raw
        )  # fmt: skip
    assert is_covered.mean(axis=0) == pytest.approx(0.95, abs=4 * (0.95 * 0.05 / n) ** 0.5)


def test_the_common_uncertainty_of_the_weights_widens_the_gain_only():
    loads = [0.0, 100.0, 200.0]
    line = fit_line(points_of(loads, [0.0, 0.4, 0.8], raw_std=1e-6), common_rel_std=0.003)
    assert line.gain_rel_std == pytest.approx(0.003, rel=1e-3)
    assert line.gain_std < 1e-3


def test_nonlinearity_and_hysteresis_are_those_put_in():
    loads = np.array([0.0, 125.0, 250.0, 375.0, 500.0, 375.0, 250.0, 125.0, 0.0])
    is_down = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1]) * (loads > 0) * (loads < 500)
    line = fit_line(points_of(loads, (loads + 2.0 * is_down) / 250.0))
    assert line.hysteresis == pytest.approx(2.0 / 500.0, rel=2e-3)
    # A parabola over 0..1 with its top at d leaves the best line by d, up and down, within the uneven weights.
    bent = fit_line(points_of(loads, (loads + 4 * 5.0 * (loads / 500) * (1 - loads / 500)) / 250.0))
    assert 2.0 / 500.0 < bent.nonlinearity < 4.5 / 500.0
    assert bent.hysteresis == pytest.approx(0.0, abs=1e-12)
    assert fit_line(points_of(loads[:5], loads[:5] / 250.0)).hysteresis is None


@pytest.mark.parametrize(
    ("loads", "raw", "said"),
    [
        ([], [], "too few"),
        ([0.0, 100.0], [0.0, 0.4], "too few"),
        ([100.0, 100.0, 100.0], [0.4, 0.4, 0.4], "1 different"),
        ([0.0, 100.0, 0.0, 100.0], [0.0, 0.4, 0.0, 0.4], "2 different"),
        ([0.0, 100.0, 100.0, 200.0], [0.0, 0.4, 0.4, 0.8], "twice in a row"),
        ([0.0, 100.0, 200.0], [0.4, 0.4, 0.4], "same at every load"),
    ],
)
def test_nonsense_is_refused(loads, raw, said):
    with pytest.raises(InputError, match=said):
        fit_line(points_of(loads, raw))


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ([0.0, -0.4, -0.8], "sign has changed"),
        ([0.0, 0.0408, 0.0816], "9.8"),
        ([0.0, 0.45, 0.8], "deviate from a straight line"),
        ([0.0, 0.5, 0.01], "depends too weakly"),
    ],
)
def test_what_speaks_against_a_fit_is_said_and_force_keeps_it(raw, said):
    complaints = judge_line(fit_line(points_of([0.0, 100.0, 200.0], raw)), FORMER, largest_deviation=0.01)
    assert any(said in text for text in complaints)
    with pytest.raises(UntrustedResult, match="not stored"):
        require_sound(complaints, where="load_cell force_n", force=False)
    require_sound(complaints, where="load_cell force_n", force=True)


def test_a_sound_fit_has_nothing_against_it():
    line = fit_line(points_of([0.0, 100.0, 200.0, 100.0, 0.0], [0.01, 0.409, 0.81, 0.411, 0.0101]))
    assert judge_line(line, FORMER, largest_deviation=0.01) == []


def test_a_table_of_points(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("reference, raw, raw_std\n0, 0.1, 1e-4\n50, 0.3, \n")
    assert read_points(path) == (
        CalibrationPoint(reference=0.0, raw=0.1, raw_std=1e-4),
        CalibrationPoint(reference=50.0, raw=0.3),
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("load,raw\n0,1\n", "columns are load, raw"),
        ("reference,raw\n0,1\n5,x\n", "line 3: raw is 'x'"),
        ("reference,raw\n0,\n", "raw is ''"),
        ("reference,raw,raw_std\n0,1,-1\n", "raw_std"),
        ("", "none"),
    ],
)
def test_a_wrong_table_is_named(tmp_path, text, said):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_points(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_points(tmp_path / "none.csv")
