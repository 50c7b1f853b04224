"""Sensitivities against an independent integrator; sensors against their transfer functions."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.errors import InputError
from modeling import sensors, slots
from modeling.parameter_sets import paper_jigsaw as paper
from modeling.sensitivity import run_sensitivities, stroke_sensitivities
from modeling.supplies import FixedDuty, FixedVoltage
from modeling.transient import InitialState

SOURCE = FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V)
NAMES = [
    "resistance_ohm",
    "inductance_h",
    "back_emf_constant_v_s_per_rad",
    "torque_constant_n_m_per_a",
    "rotor_inertia_kg_m2",
    "reciprocating_mass_kg",
    "crank_radius_m",
    "motor_damping_n_m_s_per_rad",
    "gear_ratio",
    "k_fc_n_s_per_m",
    "voltage_v",
]


def reference(values, times):
    """Current, motor speed and crank angle from rest; `values` by name."""
    v = values
    gear = v["gear_ratio"]

    def rates(y, cuts):
        i, w, a = y
        s, c = math.sin(a), math.cos(a)
        g = v["crank_radius_m"] * s
        inertia = v["rotor_inertia_kg_m2"] + (v["yoke_inertia_kg_m2"] + v["reciprocating_mass_kg"] * g * g) / gear**2
        load = v["k_fc_n_s_per_m"] * g * g * w / gear**2 if cuts else 0.0
        load += v["motor_damping_n_m_s_per_rad"] * w
        load += v["reciprocating_mass_kg"] * g * v["crank_radius_m"] * c * w * w / gear**3
        di = (v["voltage_v"] - v["resistance_ohm"] * i - v["back_emf_constant_v_s_per_rad"] * w) / v["inductance_h"]
        return [di, (v["torque_constant_n_m_per_a"] * i - load) / inertia, w / gear]

    def at_end(_, y, half):
        return y[2] - (half + 1) * math.pi

    at_end.terminal, at_end.direction = True, 1
    out, y, t, half = np.empty((3, len(times))), np.zeros(3), 0.0, 0
    while t < times[-1]:
        done = solve_ivp(
            lambda _, y, half: rates(y, half % 2 == 1),
            (t, times[-1]), y, method="DOP853", rtol=1e-13, atol=1e-13, events=at_end, args=(half,),
            dense_output=True,
        )  # fmt: skip
        here = (times >= t) & (times <= done.t[-1])
        if here.any():
            out[:, here] = done.sol(times[here])
        t, y, half = done.t[-1], done.y[:, -1], half + 1
    return out


def test_derivatives_of_a_run():
    found = run_sensitivities(
        paper.PARAMETERS, NAMES, supply=SOURCE, cutting=paper.CUTTING, duration_s=0.4, rate_hz=250.0
    )
    times = np.arange(101) / 250.0
    vector = paper.PARAMETERS.to_vector()
    SOURCE.fill(vector)
    paper.CUTTING.fill(vector)
    values = dict(zip(slots.NAMES, vector, strict=True))
    for name in NAMES:
        step = 1e-4 * values[name]
        runs = {a: reference({**values, name: values[name] + a * step}, times) for a in (-2, -1, 1, 2)}
        slope = (8 * (runs[1] - runs[-1]) - (runs[2] - runs[-2])) / (12 * step)
        mine = found[name]
        for got, expected in zip((mine.motor_current, mine.motor_speed, mine.crank_angle), slope, strict=True):
            assert np.abs(got - expected).max() < 1e-5 * np.abs(expected).max(), name


def test_derivatives_of_the_periodic_stroke_follow_the_run():
    """Against one-sided differences of the mean current, at another step and other settings."""
    supply = FixedDuty(duty=paper.DUTY, battery=paper.BATTERY)
    names = [
        "k_fc_n_s_per_m",
        "duty",
        "edge_force_n",
        "motor_coulomb_n_m",
        "brush_drop_v",
        "cutting_exponent",
    ]
    found = stroke_sensitivities(paper.PARAMETERS, names, supply=supply, cutting=paper.CUTTING, soc=0.8)
    from modeling.steady_state import steady_state

    for name in names:
        size = 1e-3 * max(1.0, slots.TYPICAL.get(name, 1.0))
        means = []
        for sign in (0.5, 1.0):
            if name == "k_fc_n_s_per_m":
                changed = {"cutting": type(paper.CUTTING)(k_fc_n_s_per_m=240.29 + sign * size)}
            elif name == "duty":
                changed = {"supply": FixedDuty(duty=paper.DUTY + sign * size, battery=paper.BATTERY)}
            else:
                base = 1.0 if name == "cutting_exponent" else 0.0
                changed = {"effects": {name: base + sign * size}}
            kwargs = {"supply": supply, "cutting": paper.CUTTING, "soc": 0.8, **changed}
            means.append(steady_state(paper.PARAMETERS, **kwargs).mean_motor_current_a)
        plain = steady_state(paper.PARAMETERS, supply=supply, cutting=paper.CUTTING, soc=0.8).mean_motor_current_a
        slope = (4 * means[0] - means[1] - 3 * plain) / size  # second order, one-sided
        assert found[name].mean_motor_current == pytest.approx(slope, rel=5e-3), name


def test_derivatives_say_what_they_cannot_take():
    kwargs = {"supply": SOURCE, "cutting": paper.CUTTING, "duration_s": 0.1}
    with pytest.raises(InputError, match="unknown slot 'k'"):
        run_sensitivities(paper.PARAMETERS, ["k"], **kwargs)
    with pytest.raises(InputError, match="rod_length_m"):
        run_sensitivities(paper.PARAMETERS, ["rod_length_m"], **kwargs)
    with pytest.raises(InputError, match="stalled"):
        weak = {**kwargs, "supply": FixedVoltage(voltage_v=0.0), "duration_s": 0.5}
        run_sensitivities(paper.PARAMETERS, ["resistance_ohm"], **weak)


def sine(rate, frequency, seconds=2.0):
    t = np.arange(int(rate * seconds)) / rate
    return t, np.sin(2 * np.pi * frequency * t)


@pytest.mark.parametrize("rate", [2000.0, 10_000.0])
def test_filters_have_their_gain_and_phase(rate):
    frequency = 14.0
    t, x = sine(rate, frequency)
    late = t > 1.5
    w = 2 * np.pi * frequency
    cases = [
        (sensors.lagged(x, rate_hz=rate, time_constant_s=0.004), 1 / (1 + 1j * w * 0.004)),
        (
            sensors.resonant(x, rate_hz=rate, frequency_hz=150.0, damping=0.05),
            1 / (1 - (14 / 150) ** 2 + 2j * 0.05 * 14 / 150),
        ),
        (sensors.late(x, rate_hz=rate, delay_s=0.003), np.exp(-1j * w * 0.003)),
    ]
    for y, gain in cases:
        basis = np.stack([np.sin(w * t[late]), np.cos(w * t[late])], axis=1)
        real, imaginary = np.linalg.lstsq(basis, y[late], rcond=None)[0]
        assert complex(real, imaginary) == pytest.approx(gain, abs=3e-4 * (10_000 / rate) ** 1)


def test_resonance_rings_at_its_frequency_after_a_step():
    x = np.r_[np.zeros(10), np.ones(4000)]
    y = sensors.resonant(x, rate_hz=20_000.0, frequency_hz=200.0, damping=0.1)
    assert y.max() == pytest.approx(1 + math.exp(-math.pi * 0.1 / math.sqrt(1 - 0.01)), abs=2e-3)
    assert y[-1] == pytest.approx(1.0, abs=1e-4)


def test_lift_off_offset_and_drift():
    force = np.array([0.0, 150.0, 287.0, -5.0])
    assert sensors.lifted_off(force, preload_n=200.0).tolist() == [0.0, 150.0, 200.0, -5.0]
    assert sensors.offset(force, rate_hz=2.0, start=1.0, drift_per_s=0.5).tolist() == [
        1.0,
        151.25,
        288.5,
        -3.25,
    ]
    assert sensors.lagged(force, rate_hz=1e4, time_constant_s=0.0).tolist() == force.tolist()


def test_nonsense_sensors_are_named():
    x = np.zeros(4)
    for make, name in (
        (lambda: sensors.lagged(x, rate_hz=0.0, time_constant_s=1.0), "rate_hz"),
        (lambda: sensors.lagged(x, rate_hz=1.0, time_constant_s=-1.0), "time_constant_s"),
        (lambda: sensors.resonant(x, rate_hz=1.0, frequency_hz=1.0, damping=1.5), "damping"),
        (lambda: sensors.lifted_off(x, preload_n=0.0), "preload_n"),
        (lambda: sensors.late(x, rate_hz=1.0, delay_s=math.nan), "delay_s"),
        (lambda: InitialState(winding_temperature_rise_k=math.nan), "winding_temperature_rise_k"),
    ):
        with pytest.raises(InputError, match=name):
            make()
