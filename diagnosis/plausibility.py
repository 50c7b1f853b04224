"""Whether a trial's channels can be what they are called: swapped, in another unit, dead, mislabelled.

Every check compares a `Reading` with the nominal model, with the bounds of `bench.plausible`. Where one fails, the
simple mistakes are tried in turn (two channels exchanged, a factor of a unit, a sign); the one that lets every check
pass is named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal

import numpy as np
from sawbench.bench.plausible import (
    BATTERY_VOLTAGE,
    BLADE_POWER,
    CONVERTER_A,
    DROPPED_V,
    IDLE_POWER_SHARE,
    IDLE_POWER_W,
    LEAST_CURRENT,
    LEAST_CUT_SHARE,
    LENGTH_UNITS,
    MOTOR_VOLTAGE,
    STROKE_RATE,
    TOP_CURRENT,
    TRAVEL,
    VOLTAGE_RIPPLE,
    Bounds,
    excess,
    is_drawn_by_motor,
)
from sawbench.bench.recording import Floats, Trial
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.trial_reading import Reading, Track, read_trial
from sawbench.modeling.residuals import Baseline

Kind = Literal[
    "travel", "stroke rate", "battery voltage", "motor voltage", "start-up", "no load", "converter", "no cut",
    "blade power",
]  # fmt: skip
# One check: what it is, by which factor it lies outside of its bounds (above 1 it fails), what was seen and expected.
Outcome = tuple[Kind, float, str]
_NUMBERS: Final = SETTINGS.screening
# For each stroke: the shape of a stroke needs its second and third harmonic.
_LEAST_SAMPLES: Final = 8
# Checks that relate one channel to others through the model: a gap between the two can make them fail as well.
_THROUGH_THE_MODEL: Final[frozenset[Kind]] = frozenset({"motor voltage", "stroke rate", "start-up", "blade power"})
# How a channel is multiplied if it is in the unit named.
_UNITS: Final[tuple[tuple[tuple[str, ...], str, float], ...]] = (
    (("time_s",), "ms", 1e-3),
    (("time_s",), "us", 1e-6),
    *((("displacement_mm",), unit, factor) for unit, factor in LENGTH_UNITS),
    (("battery_voltage_v",), "mV", 1e-3),
    (("motor_current_a",), "mA", 1e-3),
    (("battery_current_a",), "mA", 1e-3),
    (("motor_current_a", "battery_current_a"), "mA", 1e-3),
    (("force_n",), "kN", 1e3),
    (("force_n",), "mN", 1e-3),
    (("force_n",), "gram-force", 9.80665e-3),
    (("force_n",), "kilogram-force", 9.80665),
    (("force_n",), "pound-force", 4.4482),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """One check that failed.

    Attributes
    ----------
    kind : Kind
    seen : str
        What was seen and what was expected, with units.
    excess : float
        Factor by which it lies outside of the bounds.
    """

    kind: Kind
    seen: str
    excess: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Checked:
    """Outcome of all checks on one reading.

    Attributes
    ----------
    faults : tuple of Fault
        Empty where the reading is plausible.
    done : frozenset of Kind
        Checks that the channels at hand allowed.
    """

    faults: tuple[Fault, ...]
    done: frozenset[Kind]


@dataclass(frozen=True, kw_only=True, slots=True)
class Suspicion:
    """What probably is wrong with a trial.

    Attributes
    ----------
    mistake : str
        Names the mistake where one simple mistake explains every fault, else "".
    channels : tuple of str
        Channels that must not be used; all of the trial where it holds the displacement or the time.
    faults : tuple of Fault
    remedy : str
    numbers : str
        Of this trial, for the mistake.
    is_unit : bool
        The mistake is that of a unit.
    """

    mistake: str
    channels: tuple[str, ...]
    faults: tuple[Fault, ...]
    remedy: str
    numbers: str = ""
    is_unit: bool = False

    @property
    def may_be_a_gap(self) -> bool:
        """Whether a model that lacks something may be what contradicts the trial, not a mistake of the recording."""
        return not self.mistake and all(
            fault.kind in _THROUGH_THE_MODEL and fault.excess <= _NUMBERS.most_excess for fault in self.faults
        )

    @property
    def text(self) -> str:
        """The mistake and what was seen."""
        seen = "; ".join(fault.seen for fault in self.faults)
        return f"{self.mistake}{self.numbers} ({seen})" if self.mistake else seen


@dataclass(frozen=True, kw_only=True, slots=True)
class Mistake:
    """A simple mistake that may explain what is implausible.

    Attributes
    ----------
    what, numbers : str
        Its name, and what was measured in this trial.
    channels : tuple of str
        That it spoils.
    remedy : str
    mended : dict of str to (time_s, values)
        The tracks as they would be without it.
    is_unit : bool
    """

    what: str
    channels: tuple[str, ...]
    remedy: str
    mended: dict[str, Track]
    numbers: str = ""
    is_unit: bool = False


def check(baseline: Baseline, trial: Trial, reading: Reading, idle_current_a: Bounds | None = None) -> Checked:
    """Compare a reading with the nominal model.

    Parameters
    ----------
    baseline : Baseline
    trial : Trial
        Its duty must be stated and not 0.
    reading : Reading
    idle_current_a : (float, float), optional
        Between which the motor current of an idle run at this duty lies, A; None where there is no idle run.

    Returns
    -------
    Checked
        A check whose channels are missing does not fail.
    """
    outcomes = [
        *_motion_checks(baseline, trial, reading),
        *_current_checks(baseline, trial, reading),
        *_power_checks(baseline, trial, reading, idle_current_a),
    ]
    return Checked(
        faults=tuple(
            Fault(kind=kind, seen=seen, excess=excess) for kind, excess, seen in outcomes if not excess <= 1.0
        ),
        done=frozenset(kind for kind, _, _ in outcomes),
    )


def explain_faults(
    baseline: Baseline, trial: Trial, tracks: Mapping[str, Track], idle_current_a: Bounds | None = None
) -> Suspicion | None:
    """Name the simple mistake that explains what is implausible in a trial.

    Parameters
    ----------
    baseline, trial, idle_current_a
        As in `check`.
    tracks : mapping of str to (time_s, values)

    Returns
    -------
    Suspicion or None
        None where every check passes.
    """
    reading = read_trial(tracks)
    found = check(baseline, trial, reading, idle_current_a)
    if not found.faults:
        return None
    for mistake in _simple_mistakes(baseline, trial, tracks):
        reread = read_trial(mistake.mended)
        if mistake.channels == ("force_n",) and not _is_on_one_half(reread):
            continue  # the force is wrong in phase, not in size
        if {"displacement_mm", "time_s"} & {*mistake.channels} and reread.n_strokes < _NUMBERS.least_strokes:
            continue
        after = check(baseline, trial, reread, idle_current_a)
        # A mistake explains nothing if without it there is nothing left to check.
        if not after.faults and after.done >= found.done - {"no cut"}:
            return Suspicion(
                mistake=mistake.what, numbers=mistake.numbers, channels=mistake.channels, faults=found.faults,
                remedy=mistake.remedy, is_unit=mistake.is_unit,
            )  # fmt: skip
    slow = too_slow(baseline, trial, {name: _rate_hz(time_s) for name, (time_s, _) in tracks.items()})
    usual = (
        "check duty and workpiece of the trial, the channel's name, unit and scaling, the clocks of the devices, and"
        " [plant] and [battery] of the configuration"
    )
    return Suspicion(
        mistake="", channels=_channels_of(found, reading, trial, tracks), faults=found.faults,
        remedy="; ".join([*slow.values(), usual]),
    )  # fmt: skip


def _drive_v(baseline: Baseline, trial: Trial, reading: Reading) -> float | None:
    nominal = None if baseline.battery is None else baseline.battery.nominal_voltage_v
    voltage = reading.battery_voltage_v if nominal is None else nominal
    return None if voltage is None else (trial.duty or 0.0) * voltage


def free_rate_hz(baseline: Baseline, drive_v: float) -> float:
    """Strokes a second without load, at a mean voltage of the motor, V."""
    return drive_v / (baseline.plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * 2.0 * np.pi)


def too_slow(baseline: Baseline, trial: Trial, rates_hz: Mapping[str, float]) -> dict[str, str]:
    """Say which channels have too few samples for each stroke at the speed without load, by channel.

    Parameters
    ----------
    baseline : Baseline
    trial : Trial
    rates_hz : mapping of str to float
        Samples a second, by channel.
    """
    if baseline.battery is None or not trial.duty:
        return {}
    strokes_hz = free_rate_hz(baseline, trial.duty * baseline.battery.nominal_voltage_v)
    return {
        name: f"{name} has {rates_hz[name]:.3g} samples a second, too few for up to {strokes_hz:.2g} strokes a second:"
        f" record {_LEAST_SAMPLES} or more for each stroke"
        for name in ("displacement_mm", "force_n")
        if 0.0 < rates_hz.get(name, 0.0) < _LEAST_SAMPLES * strokes_hz
    }


def _rate_hz(time_s: Floats) -> float:
    """Median samples a second; 0 where the times tell none."""
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return 1.0 / step_s if step_s > 0.0 else 0.0


def _failed(failed: bool) -> float:
    """`Outcome` of a check that fails or not, however far."""
    return np.inf if failed else 0.0


def _motion_checks(baseline: Baseline, trial: Trial, reading: Reading) -> Iterator[Outcome]:
    if baseline.battery is not None and reading.battery_voltage_v is not None and reading.voltage_ripple is not None:
        nominal = baseline.battery.nominal_voltage_v
        off = max(excess(reading.battery_voltage_v / nominal, BATTERY_VOLTAGE), reading.voltage_ripple / VOLTAGE_RIPPLE)
        seen = (
            f"battery_voltage_v is {reading.battery_voltage_v:.3g} V with {100.0 * reading.voltage_ripple:.0f} % ripple"
        )
        yield "battery voltage", off, f"{seen}, the battery has {nominal:g} V"
    if reading.travel_m is None:
        return
    nominal_m = 2.0 * baseline.radius_m
    seen = f"displacement_mm travels {1e3 * reading.travel_m:.4g} mm, the crank {1e3 * nominal_m:.4g} mm"
    # A blade that makes no strokes may travel less, never more.
    least = TRAVEL[0] if reading.n_strokes >= _NUMBERS.least_strokes else 0.0
    yield "travel", excess(reading.travel_m / nominal_m, (least, TRAVEL[1])), seen
    if reading.n_strokes < _NUMBERS.least_strokes or reading.rate_hz is None:
        return
    drive_v = _drive_v(baseline, trial, reading)
    if drive_v is not None:
        free_hz = free_rate_hz(baseline, drive_v)
        seen = f"{reading.rate_hz:.3g} strokes/s; without load at duty {trial.duty:g} it is {free_hz:.3g}"
        yield "stroke rate", excess(reading.rate_hz / free_hz, STROKE_RATE), seen


def _current_checks(baseline: Baseline, trial: Trial, reading: Reading) -> Iterator[Outcome]:
    duty, plant = trial.duty or 0.0, baseline.plant
    motor, drive_v = reading.motor_current_a, _drive_v(baseline, trial, reading)
    if motor is None:
        return
    if drive_v is not None and reading.top_current_a is not None:
        stall_a = drive_v / plant.resistance_ohm.nominal
        seen = f"motor_current_a reaches {reading.top_current_a:.4g} A, the blocked motor draws {stall_a:.3g} A"
        yield "start-up", reading.top_current_a / (TOP_CURRENT * stall_a), seen
    if drive_v is not None and reading.rate_hz is not None and reading.n_strokes >= _NUMBERS.least_strokes:
        speed = 2.0 * np.pi * reading.rate_hz * baseline.gear
        asked_v = plant.resistance_ohm.nominal * motor + plant.back_emf_constant_v_s_per_rad.nominal * speed
        seen = f"current and speed require {asked_v:.3g} V at the motor, duty times battery voltage is {drive_v:.3g} V"
        low, high = MOTOR_VOLTAGE
        yield "motor voltage", excess(asked_v / drive_v, (max(min(low, 1.0 - DROPPED_V / drive_v), 0.0), high)), seen
        least_a = plant.motor_damping_n_m_s_per_rad.nominal * speed / plant.torque_constant_n_m_per_a.nominal
        seen = f"motor_current_a is {motor:.3g} A, the damping of the motor alone requires {least_a:.3g} A"
        yield "no load", _failed(motor < LEAST_CURRENT * least_a), seen
    if reading.battery_current_a is not None:
        off = not is_drawn_by_motor(reading.battery_current_a, duty * motor) or motor < -CONVERTER_A
        seen = f"battery_current_a is {reading.battery_current_a:.3g} A, duty times motor_current_a"
        yield "converter", _failed(off), f"{seen} ({duty:g} * {motor:.3g} A) is {duty * motor:.3g} A"


def blade_power_w(baseline: Baseline, reading: Reading) -> float | None:
    """Power that the wood takes from the blade, W, with the force's sign and the configured cutting half."""
    return None if reading.blade_power_w is None else -baseline.cutting_sign * reading.blade_power_w


def settled_current_a(baseline: Baseline, reading: Reading) -> float | None:
    """Motor current without what brings the machine up to speed: light motors take seconds for that."""
    if reading.motor_current_a is None:
        return None
    torque_n_m = float(baseline.inertia_kg_m2(np.zeros(()))) / baseline.gear * 2.0 * np.pi * reading.rate_gain_hz_s
    return reading.motor_current_a - torque_n_m / baseline.plant.torque_constant_n_m_per_a.nominal


def idle_current_between(by_duty: Mapping[float, Bounds], duty: float) -> Bounds | None:
    """Between which motor currents an idle run at a duty lies, by that at the nearest duty.

    What a tool draws in air grows with its speed by a power of 0 (dry friction) to 2 (a fan).

    Parameters
    ----------
    by_duty : mapping of float to (float, float)
        Least and largest motor current of the idle runs by their duty, A; may be empty.
    duty : float

    Returns
    -------
    (float, float) or None
        A; None where there is no idle run.

    Examples
    --------
    >>> runs = {0.8: (1.6, 1.8)}
    >>> idle_current_between(runs, 0.8), idle_current_between(runs, 0.4), idle_current_between({}, 0.4)
    ((1.6, 1.8), (0.4, 1.8), None)
    """
    if not by_duty:
        return None
    nearest = min(by_duty, key=lambda d: abs(d - duty))
    least, most = by_duty[nearest]
    of_a_fan = (duty / nearest) ** 2
    least, most = min(least, least * of_a_fan), max(most, most * of_a_fan)
    # No nearer than every other run allows: the nearest may have been the first one, in cold grease.
    for other, (low, high) in by_duty.items():
        of_a_fan = (duty / other) ** 2
        least, most = min(least, low * max(1.0, of_a_fan)), max(most, high * min(1.0, of_a_fan))
    return least, most


def cutting_power_w(baseline: Baseline, reading: Reading, idle_current_a: float) -> float | None:
    """Shaft power that the motor current beyond idling stands for, W."""
    settled_a = settled_current_a(baseline, reading)
    if settled_a is None or reading.rate_hz is None or reading.n_strokes < _NUMBERS.least_strokes:
        return None
    speed = 2.0 * np.pi * reading.rate_hz * baseline.gear
    extra_a = settled_a - idle_current_a
    return baseline.plant.torque_constant_n_m_per_a.nominal * extra_a * speed


def _power_checks(baseline: Baseline, trial: Trial, reading: Reading, idle_a: Bounds | None) -> Iterator[Outcome]:
    at_blade = blade_power_w(baseline, reading)
    if at_blade is None or reading.n_strokes < _NUMBERS.least_strokes:
        return
    in_air = (0.0, 0.0) if trial.is_idle or idle_a is None else idle_a
    most, least = (cutting_power_w(baseline, reading, current_a) for current_a in in_air)
    if most is None or least is None:
        drives = not trial.is_idle and at_blade < -_NUMBERS.clear_cut_w
        yield "blade power", _failed(drives), f"the force drives the blade with {-at_blade:.3g} W"
    elif trial.is_idle:
        seen = f"an idle run is stated, but the force takes {at_blade:.3g} W of the motor power {most:.3g} W"
        yield "blade power", _failed(abs(at_blade) > IDLE_POWER_SHARE * abs(most) + IDLE_POWER_W), seen
    else:
        is_clear = least > _NUMBERS.clear_cut_w
        least = LEAST_CUT_SHARE * most if idle_a is None else least
        shaft = f"{least:.3g} W" if least == most else f"{least:.3g} to {most:.3g} W"
        seen = f"force along the displacement takes {at_blade:.3g} W, the motor current corresponds to {shaft}"
        if not is_clear or trial.material is None:
            bound = max(4.0 * _NUMBERS.clear_cut_w, BLADE_POWER[1] * most)
            yield "no cut", _failed(abs(at_blade) > bound), seen
        else:
            # Of the ratios that idling leaves open, the one that lies best within the bounds.
            low, high = sorted((at_blade / most, at_blade / least))
            ratio = min(max(math.sqrt(math.prod(BLADE_POWER)), low), high)
            yield "blade power", excess(ratio, BLADE_POWER), seen


def _simple_mistakes(baseline: Baseline, trial: Trial, tracks: Mapping[str, Track]) -> Iterator[Mistake]:
    """Simple mistakes, the likeliest first."""
    is_cut_felt = "force_n" in tracks and not trial.is_idle
    if is_cut_felt:
        yield _sign_of_force(baseline, tracks)
    for channels, unit, factor in _UNITS:
        if channels == ("time_s",):
            scaled = {n: (factor * t, v) for n, (t, v) in tracks.items()}
        elif all(n in tracks for n in channels) and (channels != ("force_n",) or is_cut_felt):
            scaled = {n: (t, factor * v if n in channels else v) for n, (t, v) in tracks.items()}
        else:
            continue
        name = " and ".join(channels)
        remedy = f"multiply the column by {factor:g}, or import it with its unit"
        what = f"{name} is probably in {unit}"
        yield Mistake(what=what, channels=channels, remedy=remedy, mended=scaled, is_unit=True)
    for one, other in combinations(sorted(tracks), 2):
        swapped = {**tracks, one: tracks[other], other: tracks[one]}
        what = f"{one} and {other} are probably swapped"
        yield Mistake(what=what, channels=(one, other), remedy="exchange the two columns", mended=swapped)
    for name in ("motor_current_a", "battery_current_a"):
        if name in tracks:
            what = f"{name} has probably the wrong sign"
            yield Mistake(what=what, channels=(name,), remedy=_inverted(name), mended=_negative(tracks, name))


def _is_on_one_half(reading: Reading) -> bool:
    """Whether one half of the turn has most of the force, as a cut has."""
    weak, strong = sorted((abs(reading.falling_force_n or 0.0), abs(reading.rising_force_n or 0.0)))
    return weak < _NUMBERS.other_half * strong


def _sign_of_force(baseline: Baseline, tracks: Mapping[str, Track]) -> Mistake:
    half = "zero_to_pi" if baseline.cutting_sign < 0 else "pi_to_2pi"
    reading = read_trial(tracks)
    falling, rising = reading.falling_force_n or 0.0, reading.rising_force_n or 0.0
    stated, other = (falling, rising) if baseline.cutting_sign < 0 else (rising, falling)
    if abs(other) > abs(stated) and other > 0:
        what = "the blade does not cut on the half of the turn given by cutting_half"
        numbers = f" (mean force {other:.3g} N there, {stated:.3g} N on the stated half)"
        remedy = f'set cutting_half = "{half}", or invert the displacement if it is measured from the other dead centre'
    else:
        what = "force_n has probably the wrong sign"
        numbers = f" (mean {stated:.3g} N on the cutting half; positive is cutting)"
        remedy = _inverted("force_n")
    mended = _negative(tracks, "force_n")
    return Mistake(what=what, numbers=numbers, channels=("force_n",), remedy=remedy, mended=mended)


def _inverted(name: str) -> str:
    return f"invert the column: write sign = -1 for {name} into the map of the import, or remove it there (--map)"


def _negative(tracks: Mapping[str, Track], name: str) -> dict[str, Track]:
    return {**tracks, name: (tracks[name][0], -tracks[name][1])}


def _channels_of(found: Checked, reading: Reading, trial: Trial, tracks: Mapping[str, Track]) -> tuple[str, ...]:
    """Channels to do without where no simple mistake is found: as few as the faults allow."""
    kinds = {fault.kind for fault in found.faults}
    if kinds == {"battery voltage"}:
        return ("battery_voltage_v",)
    if kinds == {"converter"}:
        # More than the duty's share may be a loss that only the battery sees; less is one gain or the other.
        expected = (trial.duty or 0.0) * (reading.motor_current_a or 0.0)
        too_much = (reading.battery_current_a or 0.0) > expected
        return ("battery_current_a",) if too_much else ("motor_current_a", "battery_current_a")
    return tuple(tracks)
