"""A load cell that reads the machine's vibration, and slow instruments that average: no gap, and no cause."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sawbench.bench.recording import Alignment
from sawbench.diagnosis.answer.signals import signal_findings
from sawbench.diagnosis.answer.until_closed import held
from sawbench.diagnosis.inference.bandwidth import bandwidth_nuisances, is_battery_ahead
from sawbench.diagnosis.inference.common_filter import common_filter_nuisances
from sawbench.diagnosis.inference.common_filter import filtered as common_filters
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.force_filter import force_filter_nuisances
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.plunger_drive import plunger_drive_nuisances
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.vibration import vibration_nuisances
from sawbench.diagnosis.inference.vibration_read import vibration_of

from tests.rigs.jigsaw_in_time import BASELINE, GEAR, MASS, RADIUS, Machine, compare, gap
from tests.rigs.read_stroke import tracked_ahead
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

SHAKE = 0.08  # of the inertia force
INTACT = Machine().run()


def shaken(state, *, share=SHAKE, late_rad=0.0, soft=0.0):
    """The state with what a load cell reads of the plunger that goes back and forth, on a bench that may be soft."""
    mean = np.sqrt(np.mean(state.speed_rad_s**2, axis=-1, keepdims=True))
    usual = BASELINE.load.motor_speed_rad_s / GEAR
    inertia_n = MASS * RADIUS * mean**2 * (1.0 + soft * (mean / usual) ** 2)
    return replace(state, force_n=state.force_n + share * inertia_n * np.cos(state.angle_rad - late_rad))


@pytest.mark.parametrize("cuts", [True, False])
@pytest.mark.parametrize(("late_rad", "phase"), [(0.0, "in phase"), (0.5 * np.pi, "a quarter of a turn late")])
@pytest.mark.parametrize("soft", [0.0, 1.0])
def test_vibration_leaves_what_its_nuisances_say(cuts, late_rad, phase, soft):
    state = Machine(cuts=cuts).run()
    seen = gap(shaken(state, late_rad=late_rad, soft=soft))
    claimed = {name: np.zeros_like(wave) for name, wave in seen.items()}
    names = {f"vibration in the force, {phase}": 1.0, f"vibration in the force, {phase}, of a soft bench": soft}
    for nuisance in vibration_nuisances(BASELINE):
        size = SHAKE * names.get(nuisance.name, 0.0)
        for equation, wave in nuisance.signature(BASELINE, state).items():
            claimed[equation] = claimed[equation] + size * wave
    intact = gap(state)
    compare({name: wave - intact[name] for name, wave in seen.items()}, claimed, 0.02)


def filtered(wave, state, gain):
    """A wave through a filter, by its harmonics at the mean speed."""
    rate_hz = np.mean(state.speed_rad_s) / (2 * np.pi)
    spectrum = np.fft.rfft(wave, axis=-1)
    return np.fft.irfft(spectrum * gain(np.arange(spectrum.shape[-1]) * rate_hz), wave.shape[-1], axis=-1)


def battery_through(state, gain):
    """The state with both readings of the battery's sensor filtered."""
    return replace(
        state, battery_current_a=filtered(state.battery_current_a, state, gain),
        battery_voltage_v=filtered(state.battery_voltage_v, state, gain),
    )  # fmt: skip


def of(name, setting, state):
    (nuisance,) = (n for n in bandwidth_nuisances([replace(state, setting=setting)]) if n.name == name)
    return nuisance.signature(BASELINE, state)


def held_for(period_s, *channels):
    return replace(INTACT.setting, alignments={c: Alignment(std_s=1e-4, latency_s=period_s) for c in channels})


def test_a_battery_sensor_with_a_filter_leaves_what_its_nuisance_says():
    def gain(f):
        return 1.0 / (1.0 + 2j * np.pi * f * 1.2e-3)

    state = INTACT
    read = battery_through(state, gain)
    intact, seen = gap(state), gap(read)
    seen = {name: seen[name] - intact[name] for name in ("converter", "electrical")}
    compare(seen, of("filter of battery_current_a, 1.2 ms", state.setting, state), 0.1)
    assert gap(read)["supply"] == pytest.approx(intact["supply"], abs=1e-3)


def test_an_instrument_that_sends_means_leaves_what_its_nuisance_says():
    period_s = 5e-3
    state = INTACT
    setting = held_for(period_s, "motor_current_a", "battery_current_a")
    mean = filtered(state.current_a, state, lambda f: np.sinc(f * period_s))
    drawn = filtered(state.battery_current_a, state, lambda f: np.sinc(f * period_s))
    intact = gap(state)
    motor = gap(replace(state, current_a=mean))
    battery = gap(replace(state, battery_current_a=drawn))
    seen = {name: motor[name] - intact[name] for name in ("mechanical", "converter")}
    claimed = of("average of motor_current_a", setting, replace(state, current_a=mean))
    compare(seen, {name: claimed[name] for name in seen}, 0.15)
    claimed = of("average of battery_current_a", setting, state)
    compare({"converter": battery["converter"] - intact["converter"]}, {"converter": claimed["converter"]}, 0.1)


def test_no_average_where_nothing_says_how_long_a_value_stands():
    assert [n.name for n in bandwidth_nuisances([INTACT]) if n.name.startswith("average")] == []


@pytest.mark.parametrize("late_rad", [0.0, 0.9])
def test_a_bench_that_shakes_is_no_gap(late_rad):
    """Nine tenths of what the diagnosis takes for ordinary twice over, at all three duties."""
    states = [shaken(state, share=0.09, late_rad=late_rad) for state in strokes()]
    problem = problem_of(states)
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"
    found = vibration_of(problem, Marginal(problem))
    usual = BASELINE.load.motor_speed_rad_s / GEAR
    expected_n = 0.09 * MASS * RADIUS * usual**2
    assert found.amplitude_n == pytest.approx(expected_n, abs=max(3.0 * found.std_n, 0.1 * expected_n))
    (listed,) = signal_findings(problem.campaign, None, {}, found)
    assert (listed["channel"], listed["finding"], listed["unit"]) == ("force_n", "vibration", "N")
    assert listed["magnitude"] == found.amplitude_n


def test_a_vibration_that_is_not_there_is_not_listed():
    problem = problem_of(strokes())
    found = vibration_of(problem, Marginal(problem))
    assert signal_findings(problem.campaign, None, {}, found) == []


def test_a_battery_sensor_of_a_few_hertz_is_no_gap():
    def gain(f):
        return np.sinc(f * 4e-3) / (1.0 + 2j * np.pi * f * 8e-4)

    problem = problem_of([battery_through(state, gain) for state in strokes()])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"


@pytest.mark.parametrize("period_s", [5e-3, 14e-3])
def test_lines_between_samples_of_a_battery_that_no_row_shows_are_no_gap(period_s):
    """As seen: coarse steps hid the corners of lines at 200 Hz, and a lag of the motor current was declared."""

    def gain(f):
        return np.sinc(f * period_s) ** 2

    problem = problem_of([battery_through(state, gain) for state in strokes()])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"


def behind(wave, state, tau_s):
    return filtered(wave, state, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s))


def test_a_lag_of_the_motor_current_is_no_filter_of_the_battery_s_sensor_that_reads_ahead():
    """As seen: lags of 0.6 to 1.8 ms were hidden by it, seven of nine."""

    def lagging(state):
        slow_a = behind(state.current_a, state, 1.2e-3)
        rate_a_s = behind(state.current_rate_a_s, state, 1.2e-3)
        return replace(state, current_a=slow_a, current_rate_a_s=rate_a_s)

    states = [lagging(state) for state in strokes()]
    assert is_battery_ahead(states)
    problem = problem_of(states)
    assert not [name for name in problem.names if name.startswith("filter of")]
    assert judge(problem, effect_columns(problem)).best.effects == ("current_sensor_lag",)


def test_a_filter_of_the_battery_s_sensor_is_behind():
    states = [replace(s, battery_current_a=behind(s.battery_current_a, s, 1.2e-3)) for s in strokes()]
    assert not is_battery_ahead(states)
    assert not is_battery_ahead([])


def behind_a_common_filter(state, corner_hz, order):
    """The state as a recorder shows it whose channels, the displacement among them, have one filter.

    The angle is late by as much as slow signals are, so that against it the others are ahead by that.
    """
    poles = 2 * np.pi * corner_hz * np.exp(0.5j * np.pi * (1 + (2 * np.arange(order) + 1) / order))
    late_s = np.sum(-1 / poles).real

    def gain(f):
        s = 2j * np.pi * f
        return np.exp(late_s * s) * np.prod([-pole / (s - pole) for pole in poles], axis=0)

    names = ("force_n", "current_a", "current_rate_a_s", "battery_voltage_v", "motor_voltage_v", "battery_current_a")
    return replace(state, **{name: filtered(getattr(state, name), state, gain) for name in names})


@pytest.mark.parametrize(("corner_hz", "order"), [(400.0, 2), (400.0, 4), (650.0, 4)])
def test_a_common_filter_leaves_what_its_nuisance_says(corner_hz, order):
    intact, seen = gap(INTACT), gap(behind_a_common_filter(INTACT, corner_hz, order))
    (nuisance,) = (n for n in common_filter_nuisances() if n.name.endswith(f" {corner_hz:g} Hz, order {order}"))
    claimed = nuisance.signature(BASELINE, INTACT)
    assert set(claimed) == {"cutting"}
    change = seen["cutting"] - intact["cutting"]
    assert np.std(change - claimed["cutting"]) < 0.25 * np.std(change)


def test_several_filters_leave_the_sum_of_what_each_does():
    sizes, nuisances = (0.3, -0.2, 0.7), list(common_filter_nuisances())[:3]
    parts = [size * n.signature(BASELINE, INTACT)["cutting"] for size, n in zip(sizes, nuisances, strict=True)]
    together = common_filters(list(zip(sizes, (n.transfer for n in nuisances), strict=True)))
    assert together(BASELINE, INTACT)["cutting"] == pytest.approx(sum(parts), abs=1e-9)


@pytest.mark.parametrize(("corner_hz", "order"), [(300.0, 4), (400.0, 2), (500.0, 1)])
def test_a_recorder_that_filters_all_of_its_channels_is_no_gap(corner_hz, order):
    """As seen: on benches of a simulator whose recorders filter at 400 Hz it was a resonance or a lag."""
    problem = problem_of([behind_a_common_filter(state, corner_hz, order) for state in strokes()])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"


def test_a_duty_that_is_off_by_less_than_a_step_of_eight_bits_is_no_gap():
    """As seen: saws whose trigger sets the duty were "unknown", where the balance of the motor's voltage is quiet."""

    def commanded(state, off):
        voltage_v = state.motor_voltage_v + off * state.battery_voltage_v
        return replace(state, motor_voltage_v=voltage_v, setting=replace(state.setting, duty=state.setting.duty + off))

    off_by = 2.6e-3 * np.array([-1.0, 1.0, 1.0, -1.0, 1.0])
    problem = problem_of([commanded(state, off) for state, off in zip(strokes(), off_by, strict=True)])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"


def behind_a_force_filter(state, gain):
    """The state with a filter of the force alone, whose delay the logger takes out."""
    return replace(state, force_n=filtered(state.force_n, state, gain))


def bessel(f):
    """Third order, 200 Hz, with the delay of slow signals taken out."""
    s = 1j * f / 200.0 * 1.7557  # half of the power is left at the corner
    return 15.0 / (s**3 + 6 * s**2 + 15 * s + 15) * np.exp(s)


def mean_between_samples(f):
    """Means over 2 ms at the middle of their time, with lines between them."""
    return np.sinc(2e-3 * f) ** 3


@pytest.mark.parametrize("gain", [bessel, mean_between_samples])
def test_a_filter_of_the_force_whose_delay_is_taken_out_is_no_gap(gain):
    """As seen: it was a lag of the force measurement, alone and beside a friction."""
    problem = problem_of([behind_a_force_filter(state, gain) for state in strokes()])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"


def test_a_force_that_ends_with_the_cut_went_through_no_filter():
    """A force that grows as the root of the speed is larger where the cut begins and ends, but not beyond."""
    sharper = strokes(cut=lambda speed, travelled, force: 170.0 * speed**0.5)
    assert list(force_filter_nuisances(BASELINE, sharper)) == []


def test_a_mean_of_the_force_leaves_what_its_nuisance_says():
    intact = gap(INTACT)
    seen = gap(behind_a_force_filter(INTACT, lambda f: np.sinc(4e-3 * f)))
    rounded = [behind_a_force_filter(state, mean_between_samples) for state in strokes()]
    (nuisance,) = (n for n in force_filter_nuisances(BASELINE, rounded) if n.name == "mean of force_n over 4 ms")
    claimed = nuisance.signature(BASELINE, INTACT)
    compare({name: seen[name] - intact[name] for name in claimed}, claimed, 0.1)


@pytest.mark.parametrize(
    ("share", "frequency_hz", "damping"),
    [(0.03, 115.0, 0.07), (0.03, 171.0, 0.03), (0.08, 95.0, 0.04), (0.08, 171.0, 0.03)],
)
def test_a_light_mode_of_the_carriage_is_no_gap(share, frequency_hz, damping):
    """As seen: with 3 % of the force, between the frequencies that background had; and with 5 to 10 %."""

    def gain(f):
        ratio = f / frequency_hz
        return 1.0 + share * (1.0 / (1.0 - ratio**2 + 2j * damping * ratio) - 1.0)

    problem = problem_of([replace(s, force_n=filtered(s.force_n, s, gain)) for s in strokes()])
    columns = effect_columns(problem)
    assert held(problem, columns, judge(problem, columns)).posterior.verdict == "no_gap"


def around(wave):
    """Derivative of a periodic wave over the crank angle, by central differences."""
    return (np.roll(wave, -1, axis=-1) - np.roll(wave, 1, axis=-1)) / (4.0 * np.pi / wave.shape[-1])


def behind_the_crank(state, compliance_m_per_n):
    """The state as the plunger shows it: the force holds it back, and the angle is told from where it is."""
    at = state.angle_rad
    moved = np.cos(at) - compliance_m_per_n * np.maximum(state.force_n, 0.0) / RADIUS
    shown = np.where(at > np.pi, 2 * np.pi - np.arccos(np.clip(moved, -1.0, 1.0)), at)
    # A tracker of the angle follows no jump: over 0.3 rad on either side of a dead centre.
    window = np.fft.rfft(np.exp(-0.5 * (np.sin(0.5 * at[0]) * 2 / 0.15) ** 2))
    behind = np.fft.irfft(np.fft.rfft(shown - at) * window / window[0].real, at.shape[-1])
    shown = at + behind
    seen = {"speed_rad_s": state.speed_rad_s * (1.0 + around(behind))}
    seen["acceleration_rad_s2"] = seen["speed_rad_s"] * around(seen["speed_rad_s"])
    names = ("force_n", "current_a", "current_rate_a_s", "battery_voltage_v", "motor_voltage_v", "battery_current_a")
    seen |= {name: getattr(state, name) for name in names}
    placed = {
        name: np.array(
            [np.interp(at[0], angle, wave, period=2 * np.pi) for angle, wave in zip(shown, waves, strict=True)]
        )
        for name, waves in seen.items()
    }
    return replace(state, **placed)


SPEED = float(INTACT.speed_rad_s.mean())


CUTS = {
    "air": lambda linear: 0.0 * linear,
    "linear": lambda linear: linear,
    "of a compliant blade": lambda linear: np.roll(linear, linear.size // 20),
    "with an edge": lambda linear: np.sqrt(linear * linear.max()),
}
CLEARANCE = 2e-5


def loose(pushed_n):
    """How far a plunger is behind its pin that moves freely between two stops, which do not throw it back."""
    n_steps, angle = 20_000, INTACT.angle_rad[0]
    turn = 2 * np.pi * (np.arange(n_steps) + 0.5) / n_steps
    parting = np.interp(turn, angle, pushed_n, period=2 * np.pi) / MASS
    step_s, behind, speed, found = 2 * np.pi / SPEED / n_steps, 0.0, 0.0, np.zeros(n_steps)
    for k in range(3 * n_steps):
        speed += parting[k % n_steps] * step_s
        behind += speed * step_s
        if abs(behind) > CLEARANCE / 2:
            behind, speed = np.sign(behind) * CLEARANCE / 2, 0.0
        found[k % n_steps] = behind
    return np.interp(angle, turn, found, period=2 * np.pi)


BEHIND = {"compliance": lambda pushed_n: 1.5e-7 * pushed_n, "clearance": loose}


# In air the compliance is a change of the radius, which is found anyway.
@pytest.mark.parametrize(("drive", "cut"), sorted({*product(BEHIND, CUTS)} - {("compliance", "air")}))
@pytest.mark.parametrize("std_m", [1e-6, 1e-5])
def test_a_plunger_that_is_behind_its_pin_leaves_what_the_nuisances_say(drive, cut, std_m):
    """But for a tenth, whatever the noise lets the tracker follow by itself."""
    angle = INTACT.angle_rad[0]
    force = CUTS[cut](np.maximum(INTACT.force_n, 0.0).mean(axis=0))
    pushed = MASS * RADIUS * SPEED**2 * np.cos(angle) + BASELINE.cutting_sign * force
    speed = np.full_like(INTACT.speed_rad_s, SPEED)
    state = replace(
        INTACT, force_n=np.broadcast_to(force, speed.shape), speed_rad_s=speed, acceleration_rad_s2=0.0 * speed
    )
    orders = np.arange(1, 7)
    tracked = (tracked_ahead(state, off_m, std_m)[: len(orders)] for off_m in (0.0 * angle, -BEHIND[drive](pushed)))
    missed = next(tracked) - next(tracked)
    waves = [
        one.signature(BASELINE, state)["electrical"].mean(axis=0)
        for one in plunger_drive_nuisances()
        if drive in one.name
    ]
    said = np.mean(np.array(waves) * np.exp(-1j * orders[:, None, None] * angle), axis=-1)
    said, change = (np.concatenate([wave.real, wave.imag]) for wave in (said, 1j * orders * missed))
    left = change - said @ np.linalg.lstsq(said, change)[0]
    assert left @ left < 0.1 * (change @ change)


def test_a_plunger_that_yields_by_some_hundredths_of_a_millimetre_is_no_gap():
    """As seen: it was an eccentric gear on four benches; here it is play of the yoke, with more than 90 %."""
    problem = problem_of([behind_the_crank(state, 5e-7) for state in strokes()])
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"
