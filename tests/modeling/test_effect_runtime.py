"""Strokes, discharges and fits of a saw with known effects, against machines that are integrated in time here."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.configured_battery import battery_from_config
from sawbench.modeling.discharge import discharge
from sawbench.modeling.effect_discharge import discharge_with_effects
from sawbench.modeling.effect_fit import effect_share, fit_with_effects
from sawbench.modeling.effect_transient import simulate_with_effects
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import LearnedTerm, learned_effect
from sawbench.modeling.fit import cutting_fits
from sawbench.modeling.joint_fit import fit_jointly
from sawbench.modeling.machines.table import JIGSAW
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.operating_point import OperatingPoint, periodic_stroke
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.runtime import predict_runtime_with_effects
from sawbench.modeling.supplies import FixedDuty
from scipy.integrate import solve_ivp

from tests.rigs.drawn_states import running
from tests.rigs.jigsaw_in_time import BASELINE, DUTY, K_CUT, Machine, R

pytestmark = pytest.mark.contract

POINT = OperatingPoint(k_fc_n_s_per_m=K_CUT, duty=DUTY)
COULOMB = {"static_ratio": 1.0, "stribeck_m_s": 0.1}


def knowing(name, value, form=None, std=0.0):
    effect = EFFECT_BY_NAME[name]
    form = dict(effect.shapes[0]) if form is None else form
    return replace(BASELINE, known=(KnownEffect(effect=effect, value=value, std=std, form=form),))


CASES = {
    "guide_friction": (Machine(guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01)), 6.0),
    "motor_coulomb_friction": (Machine(drag=lambda w, load: 0.006), 0.006),
    "windage_drag": (Machine(drag=lambda w, load: 0.006 * (w / 1000.0) ** 2), 0.006),
    "brush_voltage_drop": (Machine(lost_voltage=lambda i, w: 0.8 * np.tanh(i / 0.1)), 0.8),
    "battery_internal_resistance": (Machine(battery_resistance=0.06), 0.04),
    "edge_force": (Machine(cut=lambda v, x, m: K_CUT * v + 40.0 * np.tanh(v / 0.01)), 40.0),
    "converter_loss": (Machine(lost_current=lambda duty, i: 0.08 * duty * i), 0.08),
}


@pytest.mark.parametrize("n_nodes", [8, 3])
@pytest.mark.parametrize(("beta", "level_v"), [(0.99, 17.6), (0.99, 16.0), (0.95, 15.0), (0.0, 15.0)])
def test_a_cut_off_voltage_ends_a_discharge_where_it_does_without_effects(beta, level_v, n_nodes):
    """The knee of the open-circuit curve is that of the battery, however few strokes are solved."""
    battery = BASELINE.battery.model_copy(update={"beta": beta})
    baseline = replace(knowing("guide_friction", 1e-6), battery=battery)
    found = discharge_with_effects(baseline, POINT, cutoff_soc=0.001, cutoff_voltage_v=level_v, n_nodes=n_nodes)
    every = discharge(
        JigsawParameters.from_config(BASELINE.plant),
        supply=FixedDuty(duty=DUTY, battery=battery_from_config(battery)),
        cutting=LinearCutting(k_fc_n_s_per_m=K_CUT),
        cutoff_soc=0.001,
        cutoff_voltage_v=level_v,
        method="brute_force",
    )
    assert found.ended_by == every.ended_by == "voltage"
    # The start, some tenths of a second, is not counted.
    assert found.runtime_s == pytest.approx(every.runtime_s, rel=2e-3, abs=0.5)


@pytest.mark.parametrize("name", CASES)
def test_a_predicted_stroke_is_that_of_the_machine(name):
    machine, value = CASES[name]
    found = periodic_stroke(knowing(name, value), POINT)
    nominal = periodic_stroke(BASELINE, POINT)
    measured = machine.run()
    assert found.is_settled
    worst, missed = 0.0, 0.0
    for channel in ("speed_rad_s", "current_a", "force_n", "battery_voltage_v", "battery_current_a"):
        true = getattr(measured, channel)[0]
        grid = np.arange(len(true)) + 0.5
        at = (np.arange(128) + 0.5) * len(true) / 128
        true = np.interp(at, grid, true, period=len(true))
        scale = np.abs(true).max()
        worst = max(worst, float(np.sqrt(np.mean((getattr(found.state, channel)[0] - true) ** 2))) / scale)
        missed = max(missed, float(np.sqrt(np.mean((getattr(nominal.state, channel)[0] - true) ** 2))) / scale)
    assert worst < 2e-3
    assert missed > 5.0 * worst, "without the effect the same comparison must fail"


@dataclass
class Discharging(Machine):
    """The same machine with its battery's charge, and the temperature of its winding, as states."""

    capacity_as: float = 72.0
    kelvin_per_w: float = 0.0
    thermal_s: float = 15.0

    def runtime_s(self, cutoff_soc: float = 0.2) -> float:
        """From the settled stroke with a full, cold start to the cut-off, every stroke integrated."""
        small = self.battery()

        def rates(t, y, is_held=False):
            self.open_voltage = float(small.open_circuit_voltage(np.array(0.0 if is_held else y[7])))
            self.resistance = R * (1.0 + 0.0039 * y[8])
            heating = 0.0 if is_held else (self.kelvin_per_w * R * y[0] ** 2 - y[8]) / self.thermal_s
            return [*self.rhs(t, y[:7]), self.duty * y[0], heating]

        settled = solve_ivp(
            lambda t, y: rates(t, y, True), (0.0, 1.5), [5.0, 80.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0],
            rtol=1e-6, max_step=1e-3,
        ).y[:, -1]  # fmt: skip
        settled[7] = 0.0

        def empty(t, y):
            return y[7] - self.capacity_as * (1.0 - cutoff_soc)

        empty.terminal = True
        return float(solve_ivp(rates, (0.0, 60.0), settled, rtol=1e-6, max_step=1e-3, events=empty).t_events[0][0])

    def battery(self):
        cells = BASELINE.battery.model_copy(update={"capacity_ah": self.capacity_as / 3600.0})
        return replace(BASELINE, battery=cells)


def test_a_discharge_with_guide_friction_is_that_of_every_stroke():
    machine = Discharging(guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01))
    baseline = replace(machine.battery(), known=knowing("guide_friction", 6.0).known)
    found, true = discharge_with_effects(baseline, POINT), machine.runtime_s()
    nominal = discharge_with_effects(machine.battery(), POINT)
    assert found.status == "ok"
    assert found.runtime_s == pytest.approx(true, rel=0.003)
    assert abs(nominal.runtime_s / true - 1.0) > 0.03, "without the friction the same comparison must fail"


def test_a_discharge_that_heats_the_winding_is_that_of_every_stroke():
    machine = Discharging(kelvin_per_w=6.0)
    known = knowing("winding_heating", 6.0, {"fast_s": 15.0, "slow_s": 15.0, "fast_share": 1.0}).known
    found, true = discharge_with_effects(replace(machine.battery(), known=known), POINT), machine.runtime_s()
    nominal = discharge_with_effects(machine.battery(), POINT)
    assert found.runtime_s == pytest.approx(true, rel=0.003)
    assert abs(nominal.runtime_s / true - 1.0) > 0.02, "without the heat the same comparison must fail"


def test_without_effects_strokes_and_nodes_agree_with_the_other_discharge():
    from sawbench.modeling.discharge import discharge
    from sawbench.modeling.parameters import JigsawParameters
    from sawbench.modeling.parts.eq16 import Eq16Battery
    from sawbench.modeling.parts.linear import LinearCutting
    from sawbench.modeling.supplies import FixedDuty, HeldVoltage

    battery = Eq16Battery.from_config(BASELINE.battery)
    for supply, point in (
        (FixedDuty(duty=DUTY, battery=battery), POINT),
        (HeldVoltage(voltage_v=7.8, battery=battery), replace(POINT, duty=None, held_voltage_v=7.8)),
    ):
        other = discharge(
            JigsawParameters.from_config(BASELINE.plant),
            supply=supply,
            cutting=LinearCutting(k_fc_n_s_per_m=K_CUT, cutting_half="pi_to_2pi"),
            compiles=False,
        )
        found = discharge_with_effects(BASELINE, point)
        # The spin-up is not counted: some tenths of a second.
        assert found.runtime_s == pytest.approx(other.runtime_s, rel=1e-3)
        ended = discharge_with_effects(BASELINE, point, cutoff_voltage_v=17.4)
        assert ended.ended_by == "voltage"
        assert ended.curves.battery_voltage_v[-1] == pytest.approx(17.4, abs=0.02)


def test_uncertainty_of_the_effect_reaches_the_runtime():
    sure = predict_runtime_with_effects(knowing("guide_friction", 6.0, COULOMB), POINT)
    unsure = predict_runtime_with_effects(knowing("guide_friction", 6.0, COULOMB, std=2.0), POINT)
    up, down = (discharge_with_effects(knowing("guide_friction", force_n), POINT).runtime_s for force_n in (8.0, 4.0))
    assert unsure.contributions_s["guide_friction.force_n"] == pytest.approx(0.5 * (down - up), rel=0.02)
    assert unsure.std_s == pytest.approx(np.hypot(sure.std_s, 0.5 * (down - up)), rel=0.02)


def cycles_of(machine, n_cycles=40):
    """Strokes of one machine, each in wood a little harder or softer."""
    state = machine.run()
    rng = np.random.default_rng(5)
    rows = 1.0 + 0.01 * rng.standard_normal((n_cycles, 1))
    period = 2.0 * np.pi * float(np.mean(1.0 / state.speed_rad_s[0]))
    return MeasuredCycles(
        angle_rad=state.angle_rad[0],
        cycle_start_s=period * np.arange(n_cycles),
        period_s=np.full(n_cycles, period) * (1.0 + 1e-3 * (rows[:, 0] - rows.mean())),
        current_a=state.current_a[0] * (1.0 + 0.5 * (rows - rows.mean())),
        force_n=state.force_n[0] * (1.0 + rows - rows.mean()),
        crank_speed_rad_s=np.broadcast_to(state.speed_rad_s[0], (n_cycles, len(state.angle_rad[0]))),
        battery_voltage_v=np.full(n_cycles, float(state.battery_voltage_v[0].mean())),
        battery_current_a=np.full(
            n_cycles, float(np.average(state.battery_current_a[0], weights=1 / state.speed_rad_s[0]))
        ),
        duty=machine.duty,
    )


def fit(method):
    def fitted(cycles):
        joint = fit_jointly([cycles], plant=BASELINE.plant, battery=BASELINE.battery, method=method)
        return cutting_fits(joint, method)[0], joint.of_trial(0)

    return fitted


@pytest.mark.parametrize(
    ("name", "value", "machine", "method"),
    [
        ("guide_friction", 6.0, CASES["guide_friction"][0], "current"),
        ("edge_force", 40.0, CASES["edge_force"][0], "current_and_force"),
    ],
)
def test_the_fit_takes_known_effects_off(name, value, machine, method):
    cycles = cycles_of(machine)
    start = replace(POINT, k_fc_n_s_per_m=0.8 * K_CUT, battery_voltage_v=float(cycles.battery_voltage_v.mean()))
    found, estimates = fit_with_effects(cycles, fit(method), knowing(name, value, std=0.1 * value), start)
    plain, _ = fit(method)(cycles)
    assert found.k_fc_n_s_per_m == pytest.approx(K_CUT, rel=0.005)
    assert abs(plain.k_fc_n_s_per_m / K_CUT - 1.0) > 0.02, "without the effect the same comparison must fail"
    stronger, _ = fit_with_effects(cycles, fit(method), knowing(name, 1.1 * value), start)
    moved = stronger.k_fc_n_s_per_m - found.k_fc_n_s_per_m
    own = f"{name}.{EFFECT_BY_NAME[name].strength.name}"
    shared = estimates.covariance[estimates.names.index("k_fc_n_s_per_m"), estimates.names.index(own)]
    assert shared == pytest.approx(moved * 0.1 * value, rel=0.1)
    assert found.std_n_s_per_m > abs(moved) * 0.95


def test_what_a_point_does_not_say_is_asked_for_by_name():
    chip = replace(BASELINE, known=(KnownEffect(effect=EFFECT_BY_NAME["chip_thickness"], value=0.5),))
    with pytest.raises(InputError, match="chip_thickness needs the feed"):
        periodic_stroke(chip, POINT)
    assert periodic_stroke(chip, replace(POINT, feed_m_s=0.004)).is_settled
    limit = knowing("current_limit", 1.0)
    with pytest.raises(InputError, match="add top_current_a to its entry"):
        effect_share(limit, POINT, np.array([1.0]))
    with pytest.raises(InputError, match="add top_current_a to its entry"):
        discharge_with_effects(limit, POINT)


IN_TIME = ("guide_friction", "motor_coulomb_friction", "windage_drag", "brush_voltage_drop", "edge_force")


@pytest.mark.parametrize("name", IN_TIME)
def test_a_start_with_an_effect_is_that_of_the_machine(name):
    machine, value = CASES[name]
    time_s = np.linspace(0.0, 0.4, 401)
    run = simulate_with_effects(knowing(name, value), POINT, time_s)
    begin = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    true = solve_ivp(machine.rhs, (0.0, 0.4), begin, rtol=1e-8, atol=1e-8, max_step=1e-3, t_eval=time_s).y
    plain = solve_ivp(Machine().rhs, (0.0, 0.4), begin, rtol=1e-8, atol=1e-8, max_step=1e-3, t_eval=time_s).y
    assert run.status == "ok"
    missed = np.sqrt(np.mean((plain[0] - true[0]) ** 2))
    assert np.sqrt(np.mean((run.motor_current_a - true[0]) ** 2)) < max(0.02 * missed, 0.01)
    assert missed > 0.1, "without the effect the same comparison must fail"
    assert run.crank_angle_rad[-1] == pytest.approx(true[2, -1], abs=0.01)


def test_a_run_that_goes_on_settles_to_the_periodic_stroke():
    for name, value, form in (
        ("battery_polarization", 0.04, {"fast_s": 1.0, "slow_s": 1.0}),
        ("converter_loss", 0.08, None),
        ("force_offset_drift", 4.0, {"direction": 1.0, "power": 1.0}),
        ("load_dependent_friction", 0.08, {"inertia": 1.0, "slot": 0.0, "pin": 0.0}),
    ):
        baseline = knowing(name, value, form)
        # The battery has been at work before.
        slow = {m: 4.6 for known in baseline.known for m in known.effect.memories}
        run = simulate_with_effects(baseline, replace(POINT, slow=slow), np.linspace(0.0, 1.2, 2401))
        turns = run.crank_angle_rad / (2.0 * np.pi)
        last = turns >= np.floor(turns[-1]) - 5.0
        last &= turns < np.floor(turns[-1])
        used = (1.0 - run.soc[last].mean()) * 5400.0
        stroke = periodic_stroke(baseline, replace(POINT, charge_used_as=used, slow=slow)).state
        mean_a = np.average(stroke.battery_current_a[0], weights=1.0 / stroke.speed_rad_s[0])
        assert run.battery_current_a[last].mean() == pytest.approx(mean_a, rel=3e-3), name


def test_a_simulation_in_time_knows_the_time():
    """A reading that rises by 4 N a second, once as an effect of the catalogue and once as a learned table."""
    time_s, ends_s = np.linspace(0.0, 0.3, 301), tuple(np.linspace(0.0, 1.0, 4).tolist())
    values = 4.0 * np.array(ends_s)
    table = LearnedTerm(site="force_reading", quantities=("time_s",), nodes=(ends_s,), values=values, stds=0.0 * values)
    learned = replace(BASELINE, known=(KnownEffect(effect=learned_effect(table), value=1.0),))
    plain = simulate_with_effects(BASELINE, POINT, time_s)
    for baseline in (knowing("force_offset_drift", 4000.0, {"direction": 1.0, "power": 1.0}), learned):
        run = simulate_with_effects(baseline, POINT, time_s)
        np.testing.assert_allclose(run.force_n - plain.force_n, 4.0 * time_s, atol=0.05)
        np.testing.assert_allclose(run.motor_current_a, plain.motor_current_a, atol=0.05)


@pytest.mark.parametrize("effect", [e for e in JIGSAW.effects(BASELINE) if e.is_pointwise], ids=lambda e: e.name)
def test_an_effect_of_an_instant_is_the_same_instant_by_instant(effect):
    """What a simulation in time evaluates row by row is what a whole stroke has at that angle."""
    whole = running()
    n_units, n_points = whole.angle_rad.shape

    def row(wave):
        return None if wave is None else np.broadcast_to(wave, (n_units, n_points)).reshape(-1, 1)

    waves = (
        "angle_rad", "speed_rad_s", "acceleration_rad_s2", "current_a", "current_rate_a_s", "force_n", "force_rate_n_s",
        "battery_voltage_v", "battery_current_a", "motor_voltage_v", "time_s", "cut_distance_m", "charge_used_as",
    )  # fmt: skip
    instants = replace(
        whole,
        kind="instant",
        n_strokes=np.ones(n_units * n_points),
        slow={memory: row(held) for memory, held in whole.slow.items()},
        **{name: row(getattr(whole, name)) for name in waves},
    )
    for shape in effect.shapes:
        one, other = (effect.signatures(BASELINE, state, shape) for state in (whole, instants))
        for full, single in zip(one, other, strict=True):
            for equation, wave in full.items():
                np.testing.assert_allclose(single[equation].reshape(wave.shape), wave, rtol=1e-9, atol=1e-12)


def test_what_takes_a_whole_stroke_is_refused_by_name():
    with pytest.raises(InputError, match="force_sensor_lag cannot be simulated from rest"):
        simulate_with_effects(knowing("force_sensor_lag", 2e-3, {"damping": 0.0}), POINT, np.array([0.0, 0.1]))


@pytest.mark.parametrize(("share_of_top", "is_said"), [(1.2, False), (0.95, False), (0.85, True), (0.75, True)])
def test_a_limit_below_what_the_whole_stroke_draws_is_said_to_be_beyond_the_form(share_of_top, is_said):
    """No machine draws more than its limit on average."""
    top_a = float(periodic_stroke(BASELINE, POINT).state.current_a.max())
    limit = knowing("current_limit", 1.0, {"share": 0.98, "soft": 0.0})
    known = tuple(replace(one, scales={"top_current_a": share_of_top * top_a}) for one in limit.known)
    found = discharge_with_effects(replace(limit, known=known), POINT)
    exceeds = found.mean_motor_current_a > share_of_top * top_a
    assert exceeds == is_said
    assert bool(found.notes) == is_said
    assert all("the runtime is too short" in note for note in found.notes)
