"""k_Fc from synthetic trials of an independent integrator: right, and clear about what it cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_statistics import fourier_basis
from sawbench.modeling.fit import available_method, cutting_fits, fit_cutting_coefficient
from sawbench.modeling.joint_fit import SensorPriors, fit_jointly
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.periodic_cycle import COLUMNS, periodic_cycles
from sawbench.processing.measured_cycles import cycles_from_samples
from scipy.integrate import solve_ivp

from benchmarks import fit_coverage
from benchmarks import synthetic_trials as synthetic

pytestmark = pytest.mark.unit

BATTERY = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02)
TRUE = {name: value for name, (value, _) in synthetic.NOMINAL.items()}


def plant(**changes) -> PlantConfig:
    table = {name: {"nominal": v, "rel_std": s} for name, (v, s) in synthetic.NOMINAL.items()}
    return PlantConfig.model_validate(table | {"gear_ratio": synthetic.GEAR_RATIO} | changes)


def measured(trial, start_s: float = 1.5, **changes) -> MeasuredCycles:
    settings = {"duty": trial.duty, "start_s": start_s} | changes
    return cycles_from_samples(trial.angle_time_s, trial.angle_rad, trial.speed_rad_s, trial.channels, **settings)


def without(cycles: MeasuredCycles, *names: str) -> MeasuredCycles:
    values = {name: getattr(cycles, name) for name in MeasuredCycles.__dataclass_fields__}
    return MeasuredCycles(**(values | dict.fromkeys(names)))


@pytest.fixture(scope="module")
def quiet():
    """No noise, no variation, plant and sensors as stated."""
    trial = synthetic.synthetic_trial(
        3, seconds=4.0, spread=0.0, plant=TRUE, sensor_gain_std=0.0, voltage_gain_std=0.0,
        angle_zero_std_rad=0.0, force_offset_std_n=0.0, noise=(0.0, 0.0, 0.0),
    )  # fmt: skip
    return measured(trial, start_s=2.0)


@pytest.fixture(scope="module")
def noisy():
    return measured(synthetic.synthetic_trial(0, seconds=7.0))


def test_periodic_stroke_matches_the_independent_integrator(quiet):
    duty = quiet.duty
    open_v = np.mean(quiet.battery_voltage_v + 0.02 * quiet.battery_current_a)
    row = TRUE | {"k_fc_n_s_per_m": 240.0, "voltage_v": duty * open_v}
    row["resistance_ohm"] = row["resistance_ohm"] + duty**2 * 0.02
    current, speed, ok = periodic_cycles(np.array([[row[name] for name in COLUMNS]]), gear_ratio=synthetic.GEAR_RATIO)
    assert ok[0]
    nodes = np.arange(64) * 2 * np.pi / 64
    at_bins = fourier_basis(quiet.angle_rad, 8)
    at_nodes = fourier_basis(nodes, 8) @ current[0] / np.sqrt(64) * np.sqrt(quiet.n_bins)
    np.testing.assert_allclose(at_bins @ quiet.mean("current_a"), at_nodes, atol=0.02 * np.sqrt(quiet.n_bins))
    assert 2 * np.pi * np.mean(1 / speed[0]) == pytest.approx(quiet.period_s.mean(), rel=2e-5)


@pytest.mark.parametrize("rod_length_m", [None, 0.025, 0.05])
@pytest.mark.parametrize("cutting_half", ["pi_to_2pi", "zero_to_pi"])
def test_a_turn_integrated_in_time_ends_where_it_began(rod_length_m, cutting_half):
    """Scotch yoke and slider-crank, written from the loop closure in motor coordinates: position, not lever."""
    gear, radius, k_fc, volts = synthetic.GEAR_RATIO, TRUE["crank_radius_m"], 240.0, 7.9
    row = np.array([[(TRUE | {"k_fc_n_s_per_m": k_fc, "voltage_v": volts})[name] for name in COLUMNS]])
    current, speed, ok = periodic_cycles(row, gear_ratio=gear, cutting_half=cutting_half, rod_length_m=rod_length_m)
    assert ok[0]

    def blade(angle):
        rod = np.inf if rod_length_m is None else rod_length_m
        return radius * (1 - np.cos(angle)) + (
            0.0 if rod_length_m is None else rod - np.sqrt(rod**2 - (radius * np.sin(angle)) ** 2)
        )

    def lever(angle, h=1e-5):
        return (blade(angle - 2 * h) - 8 * blade(angle - h) + 8 * blade(angle + h) - blade(angle + 2 * h)) / (12 * h)

    def inertia(angle):
        mass = TRUE["reciprocating_mass_kg"] * (lever(angle) / gear) ** 2
        return TRUE["rotor_inertia_kg_m2"] + TRUE["yoke_inertia_kg_m2"] / gear**2 + mass

    def rates(_, y, cuts):
        i, w, angle = y
        slope = (inertia(angle + 1e-4) - inertia(angle - 1e-4)) / 2e-4 / gear  # dJ by the motor's angle
        load = cuts * k_fc * (lever(angle) / gear) ** 2 * w + TRUE["motor_damping_n_m_s_per_rad"] * w
        voltage = volts - TRUE["resistance_ohm"] * i - TRUE["back_emf_constant_v_s_per_rad"] * w
        torque = TRUE["torque_constant_n_m_per_a"] * i - load - 0.5 * slope * w * w
        return [voltage / TRUE["inductance_h"], torque / inertia(angle), w / gear]

    y = np.array([current[0, 0], gear * speed[0, 0], 0.0])
    for half, cuts in enumerate((cutting_half == "zero_to_pi", cutting_half == "pi_to_2pi")):
        for node in range(32 * half + 1, 32 * half + 33):

            def reached(_, y, cuts, level=node * np.pi / 32):
                return y[2] - level

            reached.terminal, reached.direction = True, 1
            done = solve_ivp(
                rates, (0, 1), y, method="DOP853", rtol=1e-10, atol=1e-12, events=reached, args=(float(cuts),)
            )
            y = done.y[:, -1]
            assert y[0] == pytest.approx(current[0, node % 64], abs=3e-6 * current[0].max())
            assert y[1] == pytest.approx(gear * speed[0, node % 64], rel=3e-6)


@pytest.mark.parametrize(("method", "rel"), [("current_and_force", 1e-3), ("current", 2e-3), ("force", 1e-3)])
def test_quiet_trial_gives_the_truth(quiet, method, rel):
    fit = fit_cutting_coefficient(quiet, plant=plant(), battery=BATTERY, method=method)
    assert fit.status == "ok"
    assert fit.method == method
    assert fit.k_fc_n_s_per_m == pytest.approx(240.0, rel=rel)
    assert fit.statistical_std_n_s_per_m < 0.005 * 240.0


@pytest.mark.parametrize("method", ["current_and_force", "force"])
def test_a_force_that_comes_late_is_not_fitted(noisy, method):
    """10 of 64 bins, about 11 ms: the half wave of the cut lies beside the half turn that cuts."""
    values = {name: getattr(noisy, name) for name in MeasuredCycles.__dataclass_fields__}
    late = MeasuredCycles(**(values | {"force_n": np.roll(noisy.force_n, 10, axis=1)}))
    fit = fit_cutting_coefficient(late, plant=plant(), battery=BATTERY, method=method)
    assert fit.status == "contradicted"
    assert any("the force of the fitted stroke has an RMSE" in note for note in fit.notes)


@pytest.mark.parametrize("method", ["current_and_force", "current", "force"])
def test_noisy_trial_is_within_its_uncertainty(noisy, method):
    fit = fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY, method=method)
    assert abs(fit.k_fc_n_s_per_m - 240.0) < 3.0 * fit.std_n_s_per_m
    assert 0.003 < fit.std_n_s_per_m / 240.0 < 0.05
    assert fit.statistical_std_n_s_per_m < fit.std_n_s_per_m


def test_current_alone_cannot_separate_k_fc_from_the_torque_constant(noisy):
    fit = fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY, method="current")
    assert "torque_constant_n_m_per_a" in fit.identifiability
    assert "cannot separate" in fit.identifiability
    assert fit.estimates is not None
    assert fit.estimates.correlation("k_fc_n_s_per_m", "torque_constant_n_m_per_a") > 0.7


def test_force_separates_it_and_improves_the_torque_constant(noisy):
    fit = fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY)
    assert fit.estimates is not None
    assert fit.estimates.std("torque_constant_n_m_per_a") < 0.6 * 0.03 * 0.005632
    assert abs(fit.estimates.correlation("k_fc_n_s_per_m", "torque_constant_n_m_per_a")) < 0.5


def test_wrong_nominal_torque_constant_biases_current_alone_but_not_both():
    wrong = TRUE | {"torque_constant_n_m_per_a": TRUE["torque_constant_n_m_per_a"] * 0.94}
    cycles = measured(synthetic.synthetic_trial(5, seconds=6.0, plant=wrong))
    both = fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY)
    alone = fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY, method="current")
    assert abs(both.k_fc_n_s_per_m - 240.0) < 2.5 * both.std_n_s_per_m
    assert alone.k_fc_n_s_per_m > 247.0
    assert abs(alone.k_fc_n_s_per_m - 240.0) < 3.0 * alone.std_n_s_per_m


def test_more_strokes_shrink_only_the_statistical_part():
    fits = []
    for seconds in (4.0, 16.0):
        cycles = measured(synthetic.synthetic_trial(8, seconds=seconds, correlation=0.0))
        fits.append(fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY))
    assert fits[1].statistical_std_n_s_per_m < 0.65 * fits[0].statistical_std_n_s_per_m
    assert fits[1].std_n_s_per_m > 0.005 * 240.0 * 0.9


def test_coulomb_friction_is_seen_as_misfit_or_kept_inside_the_uncertainty(quiet):
    """A constant torque of the motor that the model does not have: force still gives k_Fc."""
    current = quiet.current_a + 0.01 / TRUE["torque_constant_n_m_per_a"]
    cycles = MeasuredCycles(
        **{name: getattr(quiet, name) for name in MeasuredCycles.__dataclass_fields__} | {"current_a": current}
    )
    fit = fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY)
    assert abs(fit.k_fc_n_s_per_m - 240.0) < 2.0 * fit.std_n_s_per_m


def test_misfit_of_the_mean_stroke_is_noted_and_widens_the_interval(quiet):
    """A third harmonic in the force that no parameter can make."""
    force = quiet.force_n + 30.0 * np.sin(3.0 * quiet.angle_rad)
    cycles = MeasuredCycles(
        **{name: getattr(quiet, name) for name in MeasuredCycles.__dataclass_fields__} | {"force_n": force}
    )
    good = fit_cutting_coefficient(quiet, plant=plant(), battery=BATTERY)
    bad = fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY)
    assert not good.notes
    assert any("model error" in note for note in bad.notes)
    assert bad.std_n_s_per_m > 1.5 * good.std_n_s_per_m


def test_battery_voltage_not_measured_is_said_and_costs_certainty(noisy):
    blind = without(noisy, "battery_voltage_v")
    fit = fit_cutting_coefficient(blind, plant=plant(), battery=BATTERY, method="current")
    known = fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY, method="current")
    assert any("battery voltage not measured" in note for note in fit.notes)
    assert fit.std_n_s_per_m > known.std_n_s_per_m


def test_held_voltage_needs_no_duty():
    converter = ConverterConfig(mode="held_voltage", voltage_v=7.9)
    row = TRUE | {"k_fc_n_s_per_m": 300.0, "voltage_v": 7.9}
    current, speed, _ = periodic_cycles(np.array([[row[name] for name in COLUMNS]]), gear_ratio=synthetic.GEAR_RATIO)
    period = 2 * np.pi * np.mean(1 / speed[0])
    cycles = MeasuredCycles(
        angle_rad=np.arange(64) * 2 * np.pi / 64 + 1e-12,
        cycle_start_s=np.arange(6) * period,
        period_s=np.full(6, period),
        current_a=np.repeat(current, 6, axis=0),
    )
    fit = fit_cutting_coefficient(cycles, plant=plant(), converter=converter, method="current")
    assert fit.k_fc_n_s_per_m == pytest.approx(300.0, rel=3e-3)
    with pytest.raises(InputError, match="duty"):
        fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY, method="current")


def test_joint_fit_of_three_materials_shares_the_plant():
    truths = (150.0, 240.0, 330.0)
    true_plant = synthetic.draw_plant(np.random.default_rng(21))
    cycles = [
        measured(
            synthetic.synthetic_trial(
                40 + n, seconds=5.0, k_fc=k, plant=true_plant, sensor_gain_std=0.0, force_offset_std_n=1.0
            )
        )
        for n, k in enumerate(truths)
    ]
    joint = fit_jointly(cycles, plant=plant(), battery=BATTERY, sensors=SensorPriors(force_gain_rel_std=0.005))
    z = (joint.k_fc_n_s_per_m - truths) / joint.std_n_s_per_m
    assert np.abs(z).max() < 3.0
    single = fit_cutting_coefficient(cycles[0], plant=plant(), battery=BATTERY)
    assert single.estimates is not None
    assert joint.estimates.std("torque_constant_n_m_per_a") < single.estimates.std("torque_constant_n_m_per_a")
    fits = cutting_fits(joint, "current_and_force")
    assert [fit.status for fit in fits] == ["ok"] * 3
    assert joint.of_trial(1).value("k_fc_n_s_per_m") == fits[1].k_fc_n_s_per_m


def test_idle_blade_is_at_the_bound_or_not_identifiable():
    cycles = measured(synthetic.synthetic_trial(2, seconds=4.0, k_fc=1e-6))
    fit = fit_cutting_coefficient(cycles, plant=plant(), battery=BATTERY)
    assert fit.status in ("at_bound", "not_identifiable")
    assert fit.k_fc_n_s_per_m < 5.0


def test_bounds_that_exclude_the_truth_are_reported(noisy):
    fit = fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY, bounds=(0.0, 200.0))
    assert fit.status == "at_bound"
    assert fit.k_fc_n_s_per_m == 200.0


def test_missing_channels_are_named(noisy):
    assert available_method(noisy) == "current_and_force"
    assert available_method(without(noisy, "current_a")) == "force"
    with pytest.raises(InputError, match="force_n"):
        fit_cutting_coefficient(without(noisy, "force_n"), plant=plant(), battery=BATTERY)
    with pytest.raises(InputError, match="neither"):
        available_method(without(noisy, "force_n", "current_a"))
    with pytest.raises(InputError, match="not enough"):
        fit_cutting_coefficient(noisy.between(0, 3), plant=plant(), battery=BATTERY)
    with pytest.raises(InputError, match="bounds"):
        fit_cutting_coefficient(noisy, plant=plant(), battery=BATTERY, bounds=(300.0, 200.0))


def test_slider_crank_periodic_stroke_is_a_yoke_for_an_endless_rod():
    row = np.array([[(TRUE | {"k_fc_n_s_per_m": 240.0, "voltage_v": 7.9})[name] for name in COLUMNS]])
    yoke = periodic_cycles(row, gear_ratio=synthetic.GEAR_RATIO)[0]
    long_rod = periodic_cycles(row, gear_ratio=synthetic.GEAR_RATIO, rod_length_m=1e4)[0]
    short_rod = periodic_cycles(row, gear_ratio=synthetic.GEAR_RATIO, rod_length_m=0.03)[0]
    np.testing.assert_allclose(long_rod, yoke, rtol=1e-5)
    assert np.abs(short_rod - yoke).max() > 0.05


@pytest.mark.slow
def test_intervals_cover_over_random_trials():
    """Ninety of a hundred would be too few at 95 %: the band is three binomial standard errors."""
    rows = fit_coverage.run(120, None, 2)
    for method in ("current_and_force", "current", "force"):
        assert 0.89 <= fit_coverage.coverage(rows, method)["coverage"] <= 1.0


def test_basis_is_orthonormal():
    basis = fourier_basis((np.arange(64) + 0.5) * 2 * np.pi / 64, 8)
    np.testing.assert_allclose(basis @ basis.T, np.eye(17), atol=1e-12)
