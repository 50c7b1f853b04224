"""The estimate that is renewed once a stroke: agrees with the batch fit, follows a change."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.discharge import discharge
from sawbench.modeling.fit import fit_cutting_coefficient
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.recursive import RecursiveCuttingEstimator, StrokeSummary
from sawbench.modeling.supplies import FixedDuty
from sawbench.processing.measured_cycles import cycles_from_samples

from benchmarks import synthetic_trials as synthetic

pytestmark = pytest.mark.unit


BATTERY = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02)
PLANT = PlantConfig.model_validate(
    {name: {"nominal": v, "rel_std": s} for name, (v, s) in synthetic.NOMINAL.items()}
    | {"gear_ratio": synthetic.GEAR_RATIO}
)
TRUE = {name: value for name, (value, _) in synthetic.NOMINAL.items()}


def stroke_summaries(cycles):
    """Strokes of `MeasuredCycles` as the stream would give them: time means over each stroke."""

    def time_mean(values, stroke):
        return None if values is None else np.average(values[stroke], weights=1.0 / cycles.crank_speed_rad_s[stroke])

    for n in range(cycles.n_cycles):
        yield StrokeSummary(
            period_s=cycles.period_s[n],
            mean_force_n=time_mean(cycles.force_n, n),
            mean_current_a=time_mean(cycles.current_a, n),
            battery_voltage_v=None if cycles.battery_voltage_v is None else cycles.battery_voltage_v[n],
            battery_current_a=None if cycles.battery_current_a is None else cycles.battery_current_a[n],
        )


def live_strokes(values, *, seed=1, spread=0.045):
    """Noise-free physics of the mean: k = F T / (2 r)."""
    rng = np.random.default_rng(seed)
    for k in values:
        actual = k * (1 + spread * rng.normal())
        yield StrokeSummary(period_s=0.072, mean_force_n=actual * 2 * 0.01 / 0.072, battery_current_a=4.6)


def test_agrees_with_the_batch_fit_and_with_the_truth():
    z_batch, z_truth = [], []
    for seed in range(12):
        trial = synthetic.synthetic_trial(100 + seed, seconds=5.0, force_offset_std_n=0.0)
        cycles = cycles_from_samples(
            trial.angle_time_s,
            trial.angle_rad,
            trial.speed_rad_s,
            trial.channels,
            start_s=1.5,
            duty=trial.duty,
        )
        live = RecursiveCuttingEstimator(plant=PLANT, battery=BATTERY, duty=trial.duty)
        for stroke in stroke_summaries(cycles):
            estimate = live.update(stroke)
        batch = fit_cutting_coefficient(cycles, plant=PLANT, battery=BATTERY)
        z_batch.append((estimate.k_fc_n_s_per_m - batch.k_fc_n_s_per_m) / estimate.std_n_s_per_m)
        z_truth.append((estimate.k_fc_n_s_per_m - 240.0) / estimate.std_n_s_per_m)
    assert np.abs(z_batch).max() < 1.5
    assert np.abs(z_truth).max() < 3.3
    assert np.mean(np.square(z_truth)) < 2.0


def test_current_alone_gives_k_fc_too():
    t, i, w, crank, _, v, ib = synthetic.simulate(TRUE, np.full(200, 240.0), 0.4375, 4.0, 5000.0)
    channels = {"motor_current_a": (t, i), "battery_voltage_v": (t, v), "battery_current_a": (t, ib)}
    cycles = cycles_from_samples(t, crank, w / synthetic.GEAR_RATIO, channels, start_s=2.0, duty=0.4375)
    live = RecursiveCuttingEstimator(plant=PLANT, battery=BATTERY, duty=0.4375)
    for stroke in stroke_summaries(cycles):
        estimate = live.update(stroke)
    assert estimate.k_fc_n_s_per_m == pytest.approx(240.0, rel=3e-3)
    assert 0.025 < estimate.std_n_s_per_m / 240.0 < 0.06


def test_remaining_runtime_is_that_of_the_independent_discharge():
    """Charge left over current at constant k_Fc, against a whole integration."""
    t, i, w, crank, _, v, ib = synthetic.simulate(TRUE, np.full(3000, 240.0), 0.4375, 40.0, 1000.0, capacity_ah=0.05)
    small = BATTERY.model_copy(update={"capacity_ah": 0.05})
    charge = np.cumsum(ib) * 1e-3
    end = t[np.argmax(charge > 0.8 * 0.05 * 3600)]
    channels = {"motor_current_a": (t, i), "battery_voltage_v": (t, v)}
    cycles = cycles_from_samples(t, crank, w / synthetic.GEAR_RATIO, channels, start_s=1.5, end_s=20.0, duty=0.4375)
    start_soc = 1.0 - float(np.interp(cycles.cycle_start_s[0], t, charge)) / (0.05 * 3600)
    live = RecursiveCuttingEstimator(plant=PLANT, battery=small, duty=0.4375, start_soc=start_soc)
    for stroke in stroke_summaries(cycles):
        estimate = live.update(stroke)
    now = cycles.cycle_start_s[-1] + cycles.period_s[-1]
    assert estimate.remaining_s is not None
    assert estimate.remaining_s == pytest.approx(end - now, rel=0.01)
    assert estimate.soc == pytest.approx(1.0 - np.interp(now, t, charge) / 180.0, abs=2e-3)


def test_follows_a_change_of_material_within_a_few_strokes():
    live = RecursiveCuttingEstimator(plant=PLANT)
    seen = [live.update(stroke) for stroke in live_strokes([240.0] * 80 + [320.0] * 60)]
    changes = [n for n, estimate in enumerate(seen) if estimate.has_changed]
    assert len(changes) == 1
    assert 80 <= changes[0] <= 88
    assert seen[79].k_fc_n_s_per_m == pytest.approx(240.0, rel=0.02)
    assert abs(seen[-1].k_fc_n_s_per_m - 320.0) < 3.0 * seen[-1].std_n_s_per_m


def test_one_knot_is_no_change_of_material():
    live = RecursiveCuttingEstimator(plant=PLANT)
    values = [240.0] * 60
    values[40] = 900.0
    assert not any(live.update(stroke).has_changed for stroke in live_strokes(values))


def test_false_alarms_are_rare():
    live = RecursiveCuttingEstimator(plant=PLANT)
    alarms = sum(live.update(stroke).has_changed for stroke in live_strokes([240.0] * 4000, seed=9))
    assert alarms <= 1


def test_nonsense_is_refused_by_name():
    live = RecursiveCuttingEstimator(plant=PLANT)
    with pytest.raises(InputError, match="period_s"):
        live.update(StrokeSummary(period_s=0.0, mean_force_n=1.0))
    with pytest.raises(InputError, match="mean_force_n or mean_current_a"):
        live.update(StrokeSummary(period_s=0.07))
    with pytest.raises(InputError, match="duty"):
        RecursiveCuttingEstimator(plant=PLANT, battery=BATTERY)
    with pytest.raises(InputError, match="start_soc"):
        RecursiveCuttingEstimator(plant=PLANT, start_soc=0.0)


def test_a_change_after_few_strokes_is_noticed_and_the_old_ones_are_left_out():
    for seed in range(10):
        live = RecursiveCuttingEstimator(plant=PLANT)
        seen = [live.update(stroke) for stroke in live_strokes([318.0] * 15 + [58.0] * 12, seed=seed)]
        assert [n for n, estimate in enumerate(seen) if estimate.has_changed] == [18]
        assert seen[-1].n_strokes == 12
        assert abs(seen[-1].k_fc_n_s_per_m - 58.0) < 4.0 * seen[-1].std_n_s_per_m


def test_a_fitted_battery_widens_what_is_left_and_says_where_it_does_not_hold():
    """What its fit misses is charge: 4 % of the runtime of a full battery, also when half of it is gone."""
    fitted = {"n_discharges": 4, "runtime_rel_std": 0.04, "current_a": (6.0, 9.0)}
    cells = BatteryConfig.model_validate(BATTERY.model_dump() | {"fitted": fitted})
    stroke = next(live_strokes([240.0], spread=0.0))
    full, plain, half = (
        RecursiveCuttingEstimator(plant=PLANT, battery=battery, duty=0.4375, start_soc=soc).update(stroke)
        for battery, soc in ((cells, 1.0), (BATTERY, 1.0), (cells, 0.6))
    )
    assert full.remaining_s == plain.remaining_s
    assert full.remaining_std_s == pytest.approx(np.hypot(plain.remaining_std_s, 0.04 * full.remaining_s), rel=1e-3)
    assert half.remaining_s == pytest.approx(0.5 * full.remaining_s, rel=0.02)
    assert half.remaining_std_s > 0.04 * full.remaining_s
    assert plain.notes == ()
    assert full.notes[0].startswith("mean battery current 4.6 A lies outside the 6 to 9 A")


def test_a_cutoff_voltage_ends_the_runtime_as_in_a_discharge():
    parameters = JigsawParameters.from_config(PLANT)
    cells = BATTERY.model_copy(update={"cutoff_voltage_v": 17.4})
    supply = FixedDuty(duty=0.4375, battery=Eq16Battery.from_config(cells))
    cutting = LinearCutting(k_fc_n_s_per_m=240.0, cutting_half="pi_to_2pi")
    long_way = discharge(parameters, supply=supply, cutting=cutting, cutoff_voltage_v=17.4, compiles=False)
    stroke = StrokeSummary(period_s=0.072, mean_force_n=240.0 * 2 * 0.01 / 0.072)
    found = RecursiveCuttingEstimator(plant=PLANT, battery=cells, duty=0.4375).update(stroke)
    assert long_way.ended_by == "voltage"
    assert found.remaining_s == pytest.approx(long_way.runtime_s, rel=0.006)
    emptier = RecursiveCuttingEstimator(plant=PLANT, battery=cells, duty=0.4375, start_soc=0.25).update(stroke)
    assert emptier.remaining_s == 0.0
