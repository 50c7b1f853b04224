"""Runs and discharges against an independent integrator: DOP853 at 1e-12, split at the dead centres.

The reference is written from the paper's equations in motor coordinates, shares nothing with the kernels,
and solves the battery's algebraic loop by bisection.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from sawbench.modeling.discharge import discharge
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.converter import Converter
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.parts.measured import MeasuredForce
from sawbench.modeling.parts.ocv_table import TableBattery
from sawbench.modeling.periodic_cycle import PLANT_NAMES, periodic_cycles
from sawbench.modeling.steady_state import steady_state
from sawbench.modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from sawbench.modeling.transient import InitialState, Method, simulate
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, PchipInterpolator

pytestmark = pytest.mark.unit

EQ16 = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.95, internal_resistance_ohm=0.02)
FREE = Eq16Battery(
    nominal_voltage_v=20.0, capacity_ah=1.5, shape_capacity_ah=2.1, beta=0.9, internal_resistance_ohm=0.03
)
TABLE = TableBattery(
    soc=[0.0, 0.15, 0.4, 0.7, 1.0],
    ocv_v=[14.0, 16.5, 17.6, 18.8, 20.4],
    capacity_ah=1.5,
    internal_resistance_ohm=0.02,
)
SLIDER = replace(paper.PARAMETERS, mechanism="slider_crank", rod_length_m=0.035)
ANGLE = 2 * np.pi * np.arange(64) / 64
PART = np.maximum(ANGLE / np.pi - 1, 0.0)  # of the cutting half
SKEWED = MeasuredForce(force_n=260 * np.sin(np.pi * PART**1.2))
HELD = HeldVoltage(voltage_v=paper.MOTOR_VOLTAGE_V, battery=EQ16)
DUTY = FixedDuty(duty=paper.DUTY, battery=EQ16)
SOURCE = FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V)


class Reference:
    """The paper's equations, motor angle and speed, any part."""

    def __init__(self, parameters, supply, cutting):
        self.p, self.supply, self.cutting = parameters, supply, cutting
        self.k = 1.0 / parameters.gear_ratio
        battery = supply.battery
        if isinstance(battery, TableBattery):
            # Between its 200 nodes the model's table is a cubic Hermite of the monotone interpolant.
            rough = PchipInterpolator(battery.soc, battery.ocv_v)
            from scipy.interpolate import CubicHermiteSpline

            grid = np.linspace(0, 1, 201)
            self.ocv = CubicHermiteSpline(grid, rough(grid), rough.derivative()(grid))
        if isinstance(cutting, MeasuredForce):
            closed = np.append(cutting.force_n, cutting.force_n[0])
            half = len(cutting.force_n) // 2
            nodes = 2 * np.pi * np.arange(len(closed)) / len(cutting.force_n)
            self.force = [
                CubicSpline(nodes[: half + 1], closed[: half + 1]),
                CubicSpline(nodes[half:], closed[half:]),
            ]

    def blade(self, angle):
        p = self.p
        s, c = math.sin(angle), math.cos(angle)
        if p.mechanism == "scotch_yoke":
            return p.crank_radius_m * s, p.crank_radius_m * c
        ratio = p.crank_radius_m / p.rod_length_m
        root = math.sqrt(1 - (ratio * s) ** 2)
        first = p.crank_radius_m * (s + ratio * s * c / root)
        second = p.crank_radius_m * (c + ratio * (c * c - s * s) / root + ratio**3 * (s * c) ** 2 / root**3)
        return first, second

    def inner_voltage(self, soc):
        battery = self.supply.battery
        if isinstance(battery, TableBattery):
            return float(self.ocv(soc))
        if battery.shape_capacity_ah is not None:
            soc = 1 - (1 - soc) * battery.capacity_ah / battery.shape_capacity_ah
        return battery.nominal_voltage_v * soc / (1 - battery.beta * (1 - soc))

    def electric(self, i, soc):
        """Motor voltage and battery current."""
        if isinstance(self.supply, FixedVoltage):
            return self.supply.voltage_v, 0.0
        converter = self.supply.converter
        eta, drop = converter.efficiency, converter.forward_voltage_v
        inner, r_b = self.inner_voltage(soc), self.supply.battery.internal_resistance_ohm

        def motor(duty):
            return duty * (inner - r_b * duty * i / eta) - (1 - duty) * drop

        if isinstance(self.supply, FixedDuty):
            return motor(self.supply.duty), self.supply.duty * i / eta
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if motor(middle) < self.supply.voltage_v else (low, middle)
        return motor(high), high * i / eta

    def rates(self, y, half):
        p, k = self.p, self.k
        i, w, phi, soc = y
        angle = k * phi
        g, bend = self.blade(angle)
        u, i_b = self.electric(i, soc)
        is_second = half % 2 == 1
        cuts = is_second == (self.cutting.cutting_half == "pi_to_2pi")
        torque = 0.0
        if isinstance(self.cutting, MeasuredForce):
            sign = -1.0 if self.cutting.cutting_half == "pi_to_2pi" else 1.0
            turn = angle - 2 * np.pi * (half // 2)
            torque = float(self.force[half % 2](turn)) * sign * g * k
        elif cuts:
            torque = self.cutting.k_fc_n_s_per_m * (g * k) ** 2 * w
        inertia = p.rotor_inertia_kg_m2 + p.yoke_inertia_kg_m2 * k * k + p.reciprocating_mass_kg * (g * k) ** 2
        half_slope = p.reciprocating_mass_kg * g * bend * k**3
        di = (u - p.resistance_ohm * i - p.back_emf_constant_v_s_per_rad * w) / p.inductance_h
        drive = p.torque_constant_n_m_per_a * i - p.motor_damping_n_m_s_per_rad * w
        dw = (drive - torque - half_slope * w * w) / inertia
        if isinstance(self.supply, FixedVoltage):
            return [di, dw, w, 0.0]
        battery = self.supply.battery
        return [di, dw, w, -i_b / (3600 * battery.capacity_ah)]

    def run(self, times, *, start=(0.0, 0.0, 0.0, 1.0), tolerance=1e-12):
        """Motor current, speed, motor angle, charge at the times, shape (4, n)."""
        y = np.array(start, dtype=float)
        half = int(np.floor(y[2] * self.k / np.pi))
        t, out = 0.0, np.empty((4, len(times)))
        while t < times[-1]:
            at_end = _crossing((half + 1) * np.pi / self.k)
            done = solve_ivp(
                lambda _, state, half=half: self.rates(state, half),
                (t, times[-1]),
                y,
                method="DOP853",
                rtol=tolerance,
                atol=[1e-11, 1e-9, 1e-10, 1e-14],
                events=at_end,
                dense_output=True,
            )
            here = (times >= t) & (times <= done.t[-1])
            if here.any():
                out[:, here] = done.sol(times[here])[:4]
            t, y, half = done.t[-1], done.y[:, -1], half + 1
        return out


def _crossing(level):
    def event(_, y):
        return y[2] - level

    event.terminal, event.direction = True, 1
    return event


def rms(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))


CASES = {
    "the paper's run": (paper.PARAMETERS, SOURCE, paper.CUTTING),
    "cutting on 0..pi": (
        paper.PARAMETERS,
        SOURCE,
        LinearCutting(k_fc_n_s_per_m=240.29, cutting_half="zero_to_pi"),
    ),
    "no cutting": (paper.PARAMETERS, SOURCE, LinearCutting(k_fc_n_s_per_m=0.0)),
    "hard cut at low voltage": (
        paper.PARAMETERS,
        FixedVoltage(voltage_v=3.0),
        LinearCutting(k_fc_n_s_per_m=500.0),
    ),
    "measured force": (paper.PARAMETERS, SOURCE, SKEWED),
    "slider-crank": (SLIDER, SOURCE, paper.CUTTING),
    "slider-crank, measured force": (SLIDER, DUTY, SKEWED),
    "Eq. 16, fixed duty": (paper.PARAMETERS, DUTY, paper.CUTTING),
    "Eq. 16, held voltage": (paper.PARAMETERS, HELD, paper.CUTTING),
    "free capacity": (paper.PARAMETERS, FixedDuty(duty=0.5, battery=FREE), paper.CUTTING),
    "battery table": (paper.PARAMETERS, FixedDuty(duty=0.4, battery=TABLE), paper.CUTTING),
    "lossy converter": (
        paper.PARAMETERS,
        replace(DUTY, converter=Converter(efficiency=0.9)),
        paper.CUTTING,
    ),
    "diode drop": (
        paper.PARAMETERS,
        replace(DUTY, converter=Converter(forward_voltage_v=0.7)),
        paper.CUTTING,
    ),
    "diode drop, held": (
        paper.PARAMETERS,
        replace(HELD, converter=Converter(forward_voltage_v=0.7)),
        paper.CUTTING,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_default_settings_keep_the_current_within_1e6(name):
    parameters, supply, cutting = CASES[name]
    run = simulate(parameters, supply=supply, cutting=cutting, duration_s=0.6)
    expected = Reference(parameters, supply, cutting).run(run.time_s)
    assert run.status == "ok"
    assert rms(run.motor_current_a, expected[0]) < 1e-6
    assert rms(run.motor_speed_rad_s, expected[1]) < 1e-6
    assert rms(run.motor_angle_rad, expected[2]) < 1e-6
    assert np.abs(run.soc - expected[3]).max() < 1e-9
    assert abs(run.energy.closure_error) < 1e-6


def test_start_at_any_angle_and_speed():
    initial = InitialState(crank_angle_rad=9.0, motor_speed_rad_s=500.0, current_a=-4.0, soc=0.6)
    run = simulate(paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING, duration_s=0.5, rate_hz=777.0, initial=initial)
    start = (-4.0, 500.0, 9.0 * paper.PARAMETERS.gear_ratio, 0.6)
    expected = Reference(paper.PARAMETERS, DUTY, paper.CUTTING).run(run.time_s, start=start)
    assert rms(run.motor_current_a, expected[0]) < 1e-6
    assert rms(run.motor_angle_rad, expected[2]) < 1e-6


def test_order_of_convergence_over_the_angle_is_five():
    kwargs = {"supply": SOURCE, "cutting": paper.CUTTING, "duration_s": 1.0}
    times = simulate(paper.PARAMETERS, **kwargs).time_s
    expected = Reference(paper.PARAMETERS, SOURCE, paper.CUTTING).run(times, tolerance=1e-13)[0]
    errors = []
    for n in (16, 32, 64):
        method = Method(steps_per_turn=n, angle_tolerance=np.inf, time_tolerance=1e-12)
        errors.append(rms(simulate(paper.PARAMETERS, method=method, **kwargs).motor_current_a, expected))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 4.5).all()
    assert errors[-1] < 2e-10


def test_periodic_stroke_is_where_a_long_run_settles():
    endless = replace(EQ16, capacity_ah=1e6)
    for parameters, cutting in ((paper.PARAMETERS, paper.CUTTING), (SLIDER, SKEWED)):
        supply = FixedDuty(duty=paper.DUTY, battery=endless)
        state = steady_state(parameters, supply=supply, cutting=cutting)
        w = state.start_motor_speed_rad_s
        times = np.array([0.0, state.period_s])
        start = (state.start_current_a, w, 0.0, 1.0)
        end = Reference(parameters, supply, cutting).run(times, start=start)[:, -1]
        assert end[0] == pytest.approx(state.start_current_a, rel=2e-6)
        assert end[1] == pytest.approx(w, rel=2e-6)
        assert end[2] == pytest.approx(2 * np.pi * parameters.gear_ratio, rel=1e-7)
        used = (1.0 - end[3]) * 3600 * endless.capacity_ah / state.period_s
        assert used == pytest.approx(state.mean_battery_current_a, rel=1e-3)  # 16 digits of the charge, 3e-10 used


@pytest.mark.parametrize(
    ("inductance_h", "voltage_v", "k_fc"), [(1e-4, 7.5, 675.0), (1e-5, 7.5, 240.0), (3.21e-3, 5.4, 2000.0)]
)
def test_a_stroke_whose_current_or_speed_changes_fast_is_found(inductance_h, voltage_v, k_fc):
    parameters = replace(paper.PARAMETERS, inductance_h=inductance_h)
    supply, cutting = FixedVoltage(voltage_v=voltage_v), LinearCutting(k_fc_n_s_per_m=k_fc)
    state = steady_state(parameters, supply=supply, cutting=cutting)
    assert state.status == "ok"
    start = (state.start_current_a, state.start_motor_speed_rad_s, 0.0, 1.0)
    times = np.linspace(0.0, state.period_s, 4001)
    current, speed, angle, _ = Reference(parameters, supply, cutting).run(times, start=start, tolerance=1e-9)
    assert current[-1] == pytest.approx(state.start_current_a, rel=1e-3)
    assert speed[-1] == pytest.approx(state.start_motor_speed_rad_s, rel=1e-3)
    assert angle[-1] == pytest.approx(2 * np.pi * parameters.gear_ratio, rel=1e-5)
    assert state.mean_motor_current_a == pytest.approx(np.trapezoid(current, times) / state.period_s, rel=1e-4)
    row = [float(getattr(parameters, name)) for name in PLANT_NAMES]
    currents, speeds, (is_periodic,) = periodic_cycles(
        np.array([[*row, k_fc, voltage_v]]), gear_ratio=parameters.gear_ratio
    )
    pace = 1.0 / speeds[0]
    assert is_periodic
    assert 2 * np.pi * pace.mean() == pytest.approx(state.period_s, rel=2e-3)
    assert (currents[0] * pace).mean() / pace.mean() == pytest.approx(state.mean_motor_current_a, rel=2e-3)


@pytest.mark.parametrize("make", ["duty", "held", "free"])
def test_discharge_agrees_with_the_reference_stroke_by_stroke(make):
    small = {"capacity_ah": 0.06}
    supply = {
        "duty": replace(DUTY, battery=replace(EQ16, **small)),
        "held": replace(HELD, battery=replace(EQ16, **small)),
        "free": FixedDuty(duty=0.5, battery=replace(FREE, capacity_ah=0.06, shape_capacity_ah=0.084)),
    }[make]
    reference = Reference(paper.PARAMETERS, supply, paper.CUTTING)
    brute = discharge(paper.PARAMETERS, supply=supply, cutting=paper.CUTTING, method="brute_force")
    fast = discharge(paper.PARAMETERS, supply=supply, cutting=paper.CUTTING)
    near = brute.runtime_s
    times = np.array([0.0, near - 2e-3, near - 1e-3, near, near + 1e-3, near + 2e-3])
    soc = reference.run(times, tolerance=1e-10)[3]
    expected = float(np.interp(-0.2, -soc[1:], times[1:]))
    assert brute.runtime_s == pytest.approx(expected, rel=1e-6)
    assert fast.runtime_s == pytest.approx(expected, rel=2e-5)  # 500 strokes: 25 times coarser than a real battery
    assert brute.ended_by == fast.ended_by == "soc"
