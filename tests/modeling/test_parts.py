"""Every mechanism, battery, converter, cutting force and parameter set keeps the same promises."""

import importlib
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.machines import paper_jigsaw
from sawbench.modeling.parts import scotch_yoke, slider_crank
from sawbench.modeling.parts.converter import Converter
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.parts.measured import MeasuredForce
from sawbench.modeling.parts.ocv_table import TableBattery
from sawbench.modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from sawbench.modeling.transient import simulate

pytestmark = pytest.mark.contract

# `mechanism` dispatches to the two mechanisms for arrays: it states no equation of its own.
PACKAGE = "sawbench.modeling.parts"
NO_EQUATION = {f"{PACKAGE}.mechanism"}
BATTERIES = [
    Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.9, internal_resistance_ohm=0.02),
    Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, shape_capacity_ah=2.0, beta=0.9),
    TableBattery(soc=[0.0, 0.3, 1.0], ocv_v=[14.0, 17.0, 20.0], capacity_ah=1.5, internal_resistance_ohm=0.02),
]
CONVERTERS = [Converter(), Converter(efficiency=0.9), Converter(forward_voltage_v=0.7)]
FORCES = [
    LinearCutting(k_fc_n_s_per_m=200.0),
    LinearCutting(k_fc_n_s_per_m=200.0, cutting_half="zero_to_pi"),
    MeasuredForce(force_n=150 * np.maximum(-np.sin(2 * np.pi * np.arange(32) / 32), 0.0)),
]
NONSENSE = [
    (Eq16Battery, {"nominal_voltage_v": 18.0, "capacity_ah": 1.5, "beta": 0.9}),
    (
        Eq16Battery,
        {"nominal_voltage_v": 18.0, "capacity_ah": 1.5, "shape_capacity_ah": 2.0, "beta": 0.9},
    ),
    (TableBattery, {"capacity_ah": 1.5, "internal_resistance_ohm": 0.1}),
    (Converter, {"efficiency": 0.9, "forward_voltage_v": 0.5}),
    (LinearCutting, {"k_fc_n_s_per_m": 100.0}),
    (FixedVoltage, {"voltage_v": 8.0}),
    (FixedDuty, {"duty": 0.5}),
    (HeldVoltage, {"voltage_v": 8.0}),
]
FIXED = {
    TableBattery: {"soc": [0.0, 0.5, 1.0], "ocv_v": [14.0, 17.0, 20.0]},
    FixedDuty: {"battery": BATTERIES[0]},
    HeldVoltage: {"battery": BATTERIES[0]},
}


def part_modules():
    package = importlib.import_module(PACKAGE)
    return sorted({f"{PACKAGE}.{info.name}" for info in pkgutil.iter_modules(package.__path__)} - NO_EQUATION)


@pytest.mark.parametrize("name", part_modules())
def test_a_part_is_one_small_file_that_states_itself(name):
    module = importlib.import_module(name)
    text = module.__doc__ or ""
    assert "Source:" in text, "says where its equation is from"
    assert re.search(r"Range:|Assumptions:", text), "says where it holds"
    assert "=" in text, "states its equation"
    assert len(Path(module.__file__).read_text(encoding="utf-8").splitlines()) <= 200


TURNS = np.linspace(0.0, 6.28, 41)
SINE, COSINE = np.sin(TURNS), np.cos(TURNS)
# Arguments with which each function of a part is evaluated, arrays where the kernels pass them sample by sample.
SAMPLES = {
    "scotch_yoke.lever": (SINE, COSINE, 0.01),
    "scotch_yoke.displacement": (SINE, COSINE, 0.01),
    "slider_crank.lever": (SINE, COSINE, 0.01, 0.025),
    "slider_crank.displacement": (SINE, COSINE, 0.01, 0.025),
    "dc_motor.inductive_voltage": (0.2, 0.007, 8.0, 20.0 * SINE, 400.0 + 90.0 * COSINE),
    "dc_motor.shaft_torque": (0.006, 1e-5, 20.0 * SINE, 400.0 + 90.0 * COSINE),
    "crank.rotating_inertia": (2.4e-5, 2.3e-5, 9.0),
    "crank.inertia": (2e-3, 0.24, 0.01 * SINE),
    "crank.swing": (0.24, 0.01 * SINE, 0.01 * COSINE),
    "crank.acceleration": (500.0, SINE, 0.01 * SINE**2, 1e-5 * SINE * COSINE, 90.0 + COSINE),
    "linear.force": (240.0, np.maximum(SINE, 0.0)),
    "measured.spline_force": (FORCES[2].spline(), TURNS),
    "converter.motor_voltage": (0.44, 18.0 - SINE, 0.7),
    "converter.battery_current": (0.44, 20.0 * SINE, 0.9),
    "converter.holding_duty": (18.0 - TURNS, 2.0 + 60.0 * SINE, 8.0, 0.7),
    "eq16.voltage": (18.0, 0.9, np.linspace(-0.1, 1.0, 41)),
    "ocv_table.voltage": (BATTERIES[2].ocv_table(), np.linspace(0.0, 1.0, 41)),
}


def functions_of_parts():
    for name in part_modules():
        module = importlib.import_module(name)
        for function in vars(module).values():
            if hasattr(function, "py_func") and function.py_func.__module__ == name:
                yield f"{name.rpartition('.')[2]}.{function.py_func.__name__}", function


def test_every_part_and_every_function_of_one_is_under_test_here():
    assert {name for name, _ in functions_of_parts()} == set(SAMPLES)
    assert {f"{PACKAGE}.{name.partition('.')[0]}" for name in SAMPLES} == set(part_modules())


@pytest.mark.parametrize(
    ("name", "function"), list(functions_of_parts()), ids=lambda x: x if isinstance(x, str) else ""
)
def test_a_function_says_the_same_compiled_and_on_arrays(name, function):
    arguments = SAMPLES[name]
    whole = np.atleast_2d(function.py_func(*arguments))
    # A table is an array for both.
    is_swept = [isinstance(value, np.ndarray) and value.ndim == 1 for value in arguments]
    for n in range(whole.shape[1]):
        one = [float(value[n]) if swept else value for value, swept in zip(arguments, is_swept, strict=True)]
        assert np.atleast_1d(function(*one)) == pytest.approx(whole[:, n], rel=1e-12, abs=1e-15), n


@pytest.mark.parametrize("lengths", [None, 0.03, 0.08, 100.0])
def test_levers_are_the_derivatives_of_the_displacement(lengths):
    angle = np.linspace(0.01, 6.28, 97)
    step = 1e-4

    def at(a):
        if lengths is None:
            return np.array([scotch_yoke.displacement(np.sin(x), np.cos(x), 0.01) for x in a])
        return np.array([slider_crank.displacement(np.sin(x), np.cos(x), 0.01, lengths) for x in a])

    if lengths is None:
        levers = np.array([scotch_yoke.lever(np.sin(x), np.cos(x), 0.01) for x in angle])
    else:
        levers = np.array([slider_crank.lever(np.sin(x), np.cos(x), 0.01, lengths) for x in angle])
    assert levers[:, 0] == pytest.approx((at(angle + step) - at(angle - step)) / (2 * step), abs=1e-9)
    curved = (at(angle + step) - 2 * at(angle) + at(angle - step)) / step**2
    assert levers[:, 1] == pytest.approx(curved, abs=5e-6)
    assert at([0.0])[0] == pytest.approx(0.0, abs=1e-15)
    assert at([np.pi])[0] == pytest.approx(0.02, rel=1e-12)


def test_a_long_rod_is_a_scotch_yoke():
    long = slider_crank.lever(0.6, 0.8, 0.01, 1e4)
    assert long == pytest.approx(scotch_yoke.lever(0.6, 0.8, 0.01), rel=1e-5)


@pytest.mark.parametrize("battery", BATTERIES, ids=lambda b: type(b).__name__)
def test_batteries(battery):
    soc = np.linspace(0.0, 1.0, 301)
    volts = np.array([battery.open_circuit_voltage_v(float(s)) for s in soc])
    assert (np.diff(volts) > 0).all() and (volts >= 0).all()
    run = simulate(
        paper_jigsaw.PARAMETERS,
        supply=FixedDuty(duty=0.4, battery=battery),
        cutting=FORCES[0],
        duration_s=0.3,
    )
    assert run.battery_voltage_v[0] == pytest.approx(volts[-1], rel=1e-9)  # at rest, no current
    drawn = np.trapezoid(run.battery_current_a, run.time_s)
    assert 1.0 - run.soc[-1] == pytest.approx(drawn / (1.5 * 3600), rel=1e-4)


@pytest.mark.parametrize("converter", CONVERTERS, ids=["ideal", "loss", "diode"])
@pytest.mark.parametrize("mode", ["duty", "held"])
def test_converters_never_make_power(converter, mode):
    battery = BATTERIES[0]
    supply = (
        FixedDuty(duty=0.44, battery=battery, converter=converter)
        if mode == "duty"
        else HeldVoltage(voltage_v=7.9, battery=battery, converter=converter)
    )
    run = simulate(paper_jigsaw.PARAMETERS, supply=supply, cutting=FORCES[0], duration_s=0.5)
    into, out = run.battery_voltage_v * run.battery_current_a, run.motor_voltage_v * run.motor_current_a
    assert (into >= out - 1e-9).all()
    if converter == Converter():
        assert into == pytest.approx(out, rel=1e-10)
    if converter.efficiency < 1.0:
        assert out[1:] == pytest.approx(0.9 * into[1:], rel=1e-10)
    if mode == "held":
        assert run.motor_voltage_v == pytest.approx(7.9, rel=1e-12)


def test_a_held_voltage_gives_way_when_the_battery_cannot_reach_it():
    run = simulate(
        paper_jigsaw.PARAMETERS,
        supply=HeldVoltage(voltage_v=17.9, battery=BATTERIES[0]),
        cutting=FORCES[0],
        duration_s=0.3,
    )
    assert run.motor_voltage_v.min() < 17.5
    low = run.motor_voltage_v < 17.89
    assert run.motor_voltage_v[low] == pytest.approx(run.battery_voltage_v[low], rel=1e-12)


@pytest.mark.parametrize("force", FORCES, ids=["linear", "other half", "measured"])
def test_forces_oppose_the_motion(force):
    run = simulate(paper_jigsaw.PARAMETERS, supply=FixedVoltage(voltage_v=8.0), cutting=force, duration_s=0.5)
    sign = -1.0 if force.cutting_half == "pi_to_2pi" else 1.0
    assert (run.force_n * sign * run.blade_velocity_m_s >= -1e-9).all()
    assert run.force_n.max() > 50
    assert (run.force_n[sign * run.blade_velocity_m_s < -1e-6] == 0.0).all()


def test_measured_force_runs_through_its_nodes_and_keeps_the_kink():
    force = FORCES[2]
    nodes = 2 * np.pi * np.arange(32) / 32
    assert force.force_at(nodes) == pytest.approx(force.force_n, abs=1e-9)
    assert np.abs(force.force_at(np.linspace(0, np.pi, 500))).max() < 1e-9
    angle = np.sort(np.random.default_rng(3).uniform(0, 2 * np.pi, 400))
    resampled = MeasuredForce.from_samples(angle, 150 * np.maximum(-np.sin(angle), 0.0), n_nodes=64)
    inside = np.linspace(3.4, 6.0, 50)
    assert resampled.force_at(inside) == pytest.approx(-150 * np.sin(inside), abs=0.5)


@pytest.mark.parametrize(("part", "values"), NONSENSE, ids=lambda x: getattr(x, "__name__", ""))
def test_nonsense_names_the_parameter(part, values):
    for name in values:
        for bad in (float("nan"), float("inf"), -1.0, True):
            with pytest.raises(InputError, match=name):
                part(**FIXED.get(part, {}), **{**values, name: bad})


def test_nonsense_tables():
    for soc, ocv in (
        ([0.0, 1.0], [1.0, 2.0]),
        ([0.1, 0.5, 1.0], [1.0, 2.0, 3.0]),
        ([0.0, 0.5, 1.0], [1.0, 3.0, 2.0]),
        ([0.0, 0.5, 1.0], [1.0, float("nan"), 2.0]),
    ):
        with pytest.raises(InputError, match=r"soc|ocv_v"):
            TableBattery(soc=soc, ocv_v=ocv, capacity_ah=1.0)


@pytest.mark.parametrize("part", [*BATTERIES, *CONVERTERS, *FORCES], ids=lambda p: type(p).__name__)
def test_a_part_fills_the_vector_whole(part):
    """Filling over any other part of its kind leaves nothing of that behind."""
    kind = next(group for group in (BATTERIES, CONVERTERS, FORCES) if any(part is other for other in group))
    clean = slots.defaults()
    part.fill(clean)
    assert np.isfinite(clean).all()
    for other in kind:
        used = slots.defaults()
        other.fill(used)
        part.fill(used)
        assert (used == clean).all(), type(other).__name__


def test_slots_have_names_and_units():
    assert len(set(slots.NAMES)) == slots.N_SLOTS
    assert all(slots.UNITS[name] for name in slots.NAMES)
