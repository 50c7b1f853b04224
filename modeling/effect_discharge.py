"""Whole discharges with effects: the slow quantities driven by the mean rates of periodic strokes.

    dz/dt = mean over the periodic stroke at z,   z = (charge, winding temperature, RC voltages, distance cut)

by the Bogacki-Shampine 3(2) pair with error control; steps are limited by the shortest time constant of an
RC element. The first second is simulated. While z moves, current and speed lag behind their periodic values
by some tenths of a second; what that costs over the whole discharge is added in closed form. Brute force
integrates every stroke.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from modeling import extended_physics as physics
from modeling import slots
from modeling.effect_strokes import EffectStroke, effect_stroke, without_extended
from modeling.periodic_kernel import PERIODIC, lag_gains, open_circuit_voltage
from modeling.transient import InitialState, Method, run_vector

Floats = NDArray[np.float64]
START_S = 1.0
TOLERANCE = 1e-6
SIZES = np.array([1.0, 10.0, 0.1, 0.1, 100.0])
PLACES = [physics.SOC, physics.HEAT, physics.RC, physics.POLARIZATION, physics.DISTANCE]
LONGEST_S = 1.0e6
N_COLUMNS = 6  # time, charge, voltage, battery current, motor current, stroke rate
BRUTE_RATE_HZ = 20.0
BRUTE_TOLERANCE = 1e-6


@dataclass(kw_only=True, slots=True)
class _Course:
    """A discharge under way: the machine, the stroke last found, and what was passed."""

    vector: Floats
    spline: Floats
    ocv: Floats
    n_steps: int
    last: EffectStroke | None = None
    rows: list[tuple[float, ...]] = field(default_factory=list)
    motor_charge: float = 0.0

    def stroke(self, z: Floats) -> EffectStroke:
        """Find the periodic stroke at slow quantities z, shape (5,)."""
        slow = InitialState(
            soc=float(min(max(z[0], 0.0), 1.0)),
            winding_temperature_rise_k=float(z[1]),
            rc_voltage_v=float(z[2]),
            polarization_v=float(z[3]),
            cut_distance_m=float(z[4]),
        )
        guess = None if self.last is None else self.last.start
        found = effect_stroke(
            self.vector, self.spline, self.ocv, slow, steps_per_turn=self.n_steps, tolerance=1e-5, guess=guess
        )
        if found.code == PERIODIC:
            self.last = found
        return found

    def voltage(self, z: Floats, stroke: EffectStroke) -> float:
        """Mean battery voltage of a stroke, V."""
        resistance = self.vector[slots.BATTERY_RESISTANCE] + self.vector[slots.EXTRA_RESISTANCE]
        current = stroke.battery_charge_a_s / stroke.period_s
        return float(open_circuit_voltage(self.vector, self.ocv, z[0]) - z[2] - z[3] - resistance * current)

    def note(self, t: float, z: Floats, stroke: EffectStroke) -> None:
        """Keep a row of the curves."""
        period = stroke.period_s
        battery, motor = stroke.battery_charge_a_s / period, stroke.motor_charge_a_s / period
        self.rows.append((t, float(z[0]), self.voltage(z, stroke), battery, motor, 1.0 / period))


def averaged(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    initial: InitialState,
    cutoff_soc: float,
    volts: float,
    n_steps: int,
) -> tuple[float, float, float, str, float, Floats]:
    """Runtime, motor charge, battery charge, how it ended, error estimate, curves (rows as `N_COLUMNS`).

    Ended by "soc", "voltage", "stall", "cannot_start" or "time".
    """
    run = run_vector(vector, spline, ocv, np.array([START_S]), initial, method=Method(time_tolerance=1e-6))
    if run.status == "stalled":
        return START_S, 0.0, 0.0, "cannot_start", 0.0, np.zeros((0, N_COLUMNS))
    course = _Course(vector=vector, spline=spline, ocv=ocv, n_steps=n_steps)
    z = _slow_at_end(vector, spline, ocv, initial)
    t = START_S
    stroke = course.stroke(z)
    if stroke.code != PERIODIC:
        return t, 0.0, 0.0, "stall", 0.0, np.zeros((0, N_COLUMNS))
    course.note(t, z, stroke)
    first = stroke
    course.motor_charge = START_S * course.rows[0][4]
    rate = stroke.mean_rates[PLACES]
    h = min(5.0, 0.05 / max(abs(rate[0]), 1e-9))
    error = 0.0
    while t < LONGEST_S:
        step = _bogacki_shampine(course, z, rate, h)
        if step is None:
            if h < 0.01:
                return (
                    t,
                    course.motor_charge,
                    _used(vector, initial, z),
                    "stall",
                    error,
                    np.array(course.rows),
                )
            h *= 0.25
            continue
        new, new_rate, miss, new_stroke = step
        ratio = float(np.max(np.abs(miss) / SIZES)) / TOLERANCE
        if ratio > 1.0:
            h *= max(0.2, 0.9 * ratio ** (-1 / 3))
            continue
        reached = course.voltage(new, new_stroke) if new[0] > 0.0 else -1.0
        if new[0] <= cutoff_soc or reached <= volts:
            part, ended = _cut(course, z, rate, new, new_rate, h, cutoff_soc, volts)
            end = _between(z, rate, new, new_rate, h, part)
            last = course.stroke(end)
            t += part * h
            if last.code == PERIODIC:
                course.note(t, end, last)
                course.motor_charge += 0.5 * part * h * (course.rows[-2][4] + course.rows[-1][4])
                t += _lag_s(course, first, last, end[0])
            error += abs(miss[0] / rate[0])
            return t, course.motor_charge, _used(vector, initial, end), ended, error, np.array(course.rows)
        error += abs(miss[0] / rate[0])
        t, z, rate = t + h, new, new_rate
        course.note(t, z, new_stroke)
        course.motor_charge += 0.5 * h * (course.rows[-2][4] + course.rows[-1][4])
        h *= min(3.0, 0.9 * max(ratio, 1e-6) ** (-1 / 3))
    return t, course.motor_charge, _used(vector, initial, z), "time", error, np.array(course.rows)


def _lag_s(course: _Course, first: EffectStroke, last: EffectStroke, soc: float) -> float:
    """How much longer the discharge takes because current and speed lag behind their periodic values, s."""
    vector = last.vector
    if last.kind == "extended":
        vector = without_extended(vector)
    i, w = last.start[0], last.start[1]
    time_i, charge_i, time_r, charge_r = lag_gains(
        vector, course.spline, course.ocv, soc, max(course.n_steps, last.steps_per_turn), i, w
    )
    moved_i, moved_r = i - first.start[0], 1.0 / w - 1.0 / first.start[1]
    more_time = -(time_i * moved_i + time_r * moved_r)
    more_charge = -(charge_i * moved_i + charge_r * moved_r)
    return float(more_time - more_charge * last.period_s / last.motor_charge_a_s)


def _used(vector: Floats, initial: InitialState, z: Floats) -> float:
    return float((initial.soc - z[0]) * vector[slots.CAPACITY])


def _slow_at_end(vector: Floats, spline: Floats, ocv: Floats, initial: InitialState) -> Floats:
    """Slow quantities at the end of the first second, shape (5,)."""
    from modeling import extended_kernel as kernel
    from modeling.extended_transient import NOT_FROZEN, scales

    turns = int(np.floor(initial.crank_angle_rad / np.pi))
    state = np.zeros(physics.N_ALL)
    state[: physics.N_STATES] = initial.to_state(vector[slots.GEAR])
    state[physics.ANGLE] -= turns * np.pi
    counts = np.zeros(kernel.N_RECORD)
    counts[kernel.SCALE_CURRENT], counts[kernel.SCALE_SPEED] = scales(vector)
    counts[kernel.TURN_S] = 2 * np.pi / (0.75 * counts[kernel.SCALE_SPEED])
    end = np.empty(physics.N_ALL)
    out, seen = np.empty((4, 1)), np.empty((physics.N_SEEN, 1))
    kernel.simulate_extended(
        vector, spline, ocv, np.array([START_S]), state, turns, -1, NOT_FROZEN, 1e-6, out, seen, end, counts
    )
    return end[PLACES]


def _bogacki_shampine(
    course: _Course, z: Floats, rate: Floats, h: float
) -> tuple[Floats, Floats, Floats, EffectStroke] | None:
    """One step: end, rates there, error estimate, stroke there; None where a stroke does not exist."""
    rates = [rate]
    for part in (0.5, 0.75):
        stroke = course.stroke(z + part * h * rates[-1])
        if stroke.code != PERIODIC:
            return None
        rates.append(stroke.mean_rates[PLACES])
    new = z + h * (2 * rates[0] + 3 * rates[1] + 4 * rates[2]) / 9
    stroke = course.stroke(new)
    if stroke.code != PERIODIC:
        return None
    last = stroke.mean_rates[PLACES]
    miss = h * (-5 / 72 * rates[0] + rates[1] / 12 + rates[2] / 9 - last / 8)
    return new, last, miss, stroke


def _between(z: Floats, rate: Floats, new: Floats, new_rate: Floats, h: float, u: float) -> Floats:
    """Cubic Hermite between the ends of a step."""
    rise = new - z
    bend = 3 * rise - h * (2 * rate + new_rate)
    more = h * (rate + new_rate) - 2 * rise
    return z + u * (h * rate + u * (bend + u * more))


def _cut(
    course: _Course,
    z: Floats,
    rate: Floats,
    new: Floats,
    new_rate: Floats,
    h: float,
    cutoff_soc: float,
    volts: float,
) -> tuple[float, str]:
    """Part of the step at which a cut-off is reached, and which."""
    low, high = 0.0, 1.0
    ended = "soc"
    for _ in range(40):
        u = 0.5 * (low + high)
        at = _between(z, rate, new, new_rate, h, u)
        is_past = at[0] <= cutoff_soc
        ended_here = "soc"
        if not is_past and volts > 0:
            stroke = course.stroke(at)
            is_past = stroke.code != PERIODIC or course.voltage(at, stroke) <= volts
            ended_here = "voltage"
        if is_past:
            high, ended = u, ended_here
        else:
            low = u
        if high - low < 1e-9:
            break
    return high, ended


def brute_force(
    vector: Floats, spline: Floats, ocv: Floats, initial: InitialState, cutoff_soc: float, volts: float
) -> tuple[float, float, float, str, float, Floats]:
    """Every stroke; returns the same as `averaged`. The voltage is the mean over one second."""
    capacity = vector[slots.CAPACITY]
    rows: list[Floats] = []
    begin, state = 0.0, initial
    motor = 0.0
    chunk_s = 200.0
    n = int(chunk_s * BRUTE_RATE_HZ)
    times = np.arange(1, n + 1) / BRUTE_RATE_HZ
    while begin < LONGEST_S:
        run = run_vector(vector, spline, ocv, times, state, method=Method(time_tolerance=BRUTE_TOLERANCE))
        if run.seen is None:
            raise ValueError("a discharge without effects belongs to discharge_kernel")
        width = int(BRUTE_RATE_HZ)
        smooth = np.convolve(run.seen[3], np.ones(width) / width, mode="same")
        smooth[: width // 2], smooth[-(width // 2) :] = smooth[width // 2], smooth[-(width // 2) - 1]
        block = np.column_stack(
            [
                begin + times,
                run.soc,
                smooth,
                run.seen[4],
                run.motor_current_a,
                run.crank_speed_rad_s / (2 * np.pi),
            ]
        )
        past = (run.soc <= cutoff_soc) | ((smooth <= volts) & (begin + times > START_S))
        stop = int(np.argmax(past)) if past.any() else n
        rows.append(block[: max(stop, 1)])
        motor += float(run.motor_current_a[:stop].sum() / BRUTE_RATE_HZ)
        if past.any():
            is_soc = run.soc[stop] <= cutoff_soc
            values, level = (run.soc, cutoff_soc) if is_soc else (smooth, volts)
            before = values[stop - 1] if stop else initial.soc
            part = (before - level) / (before - values[stop])
            end = begin + (stop + part) / BRUTE_RATE_HZ
            used = (initial.soc - (cutoff_soc if is_soc else run.soc[stop])) * capacity
            return end, motor, float(used), "soc" if is_soc else "voltage", 0.0, np.vstack(rows)
        if run.status == "stalled":
            ended = "stall" if run.crank_angle_rad[-1] > 4 * np.pi or begin > 0 else "cannot_start"
            standing = np.flatnonzero(run.crank_speed_rad_s > 1.0)
            end = begin + (float(times[standing[-1]]) if len(standing) else 0.0)
            return end, motor, float((initial.soc - run.soc[-1]) * capacity), ended, 0.0, np.vstack(rows)
        begin += chunk_s
        state = _continued(run.record, run.soc[-1], state)
    return begin, motor, float((initial.soc - state.soc) * capacity), "time", 0.0, np.vstack(rows)


def _continued(record: Floats, soc: float, before: InitialState) -> InitialState:
    from modeling.extended_transient import end_state

    return replace(before, soc=float(max(soc, 0.0)), **end_state(record))
