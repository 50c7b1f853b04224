"""Whether a trial's channels can be what they are called: swapped, in another unit, dead, mislabelled.

Every check compares a `Reading` with the nominal model, with bounds far outside of what the effects of the
catalogue do at twice their typical size (measured: docs/diagnosis-input-checks.md). Where one fails, the simple
mistakes are tried in turn (two channels exchanged, a factor of a unit, a sign); the one that lets every check
pass is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal

import numpy as np

from bench.recording import Trial
from diagnosis.equations import Baseline
from diagnosis.trial_reading import Reading, Track, read_trial

Kind = Literal["travel", "stroke rate", "battery voltage", "motor voltage", "start-up", "converter", "blade power"]
MIN_STROKES: Final = 3
# Bounds of measured over nominal.
_TRAVEL = (0.85, 1.2)
_VOLTAGE = (0.6, 1.3)
_STROKE_RATE = (0.2, 1.25)
_MOTOR_VOLTAGE = (0.5, 1.35)
_TOP_CURRENT = 2.0
_CONVERTER_SHARE, _CONVERTER_A = 0.7, 0.15
_BLADE_POWER = (0.3, 1.5)
_IDLE_POWER_SHARE, _IDLE_POWER_W = 0.3, 1.5
# A cut that takes less shaft power than this says nothing of the force.
_CLEAR_CUT_W = 2.0
# How a channel is multiplied if it is in the unit named.
_UNITS: Final[tuple[tuple[tuple[str, ...], str, float], ...]] = (
    (("time_s",), "ms", 1e-3),
    (("time_s",), "us", 1e-6),
    (("displacement_mm",), "m", 1e3),
    (("displacement_mm",), "cm", 10.0),
    (("displacement_mm",), "inches", 25.4),
    (("displacement_mm",), "um", 1e-3),
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
    """

    kind: Kind
    seen: str


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
    """

    mistake: str
    channels: tuple[str, ...]
    faults: tuple[Fault, ...]
    remedy: str

    @property
    def text(self) -> str:
        """The mistake and what was seen."""
        seen = "; ".join(fault.seen for fault in self.faults)
        return f"{self.mistake} ({seen})" if self.mistake else seen


def find_faults(baseline: Baseline, trial: Trial, reading: Reading, idle_current_a: float = 0.0) -> list[Fault]:
    """Compare a reading with the nominal model.

    Parameters
    ----------
    baseline : Baseline
    trial : Trial
        Its duty must be stated and not 0.
    reading : Reading
    idle_current_a : float
        Motor current of an idle trial at this duty, A; 0 where there is none.

    Returns
    -------
    list of Fault
        Empty where the reading is plausible. A check whose channels are missing does not fail.
    """
    return [*_motion_faults(baseline, trial, reading), *_current_faults(baseline, trial, reading),
            *_power_faults(baseline, trial, reading, idle_current_a)]  # fmt: skip


def explain_faults(
    baseline: Baseline, trial: Trial, tracks: Mapping[str, Track], idle_current_a: float = 0.0
) -> Suspicion | None:
    """Name the simple mistake that explains what is implausible in a trial.

    Parameters
    ----------
    baseline, trial, idle_current_a
        As in `find_faults`.
    tracks : mapping of str to (time_s, values)

    Returns
    -------
    Suspicion or None
        None where every check passes.
    """
    faults = find_faults(baseline, trial, read_trial(tracks), idle_current_a)
    if not faults:
        return None
    for mistake, channels, remedy, mended in _simple_mistakes(baseline, tracks):
        if not find_faults(baseline, trial, read_trial(mended), idle_current_a):
            return Suspicion(mistake=mistake, channels=channels, faults=tuple(faults), remedy=remedy)
    return Suspicion(
        mistake="", channels=_channels_of(faults, tracks), faults=tuple(faults),
        remedy="check the channel's name, unit and scaling, and the [plant] and [battery] of the configuration",
    )  # fmt: skip


def _outside(value: float, bounds: tuple[float, float]) -> bool:
    return not bounds[0] <= value <= bounds[1]


def _drive_v(baseline: Baseline, trial: Trial, reading: Reading) -> float | None:
    nominal = None if baseline.battery is None else baseline.battery.nominal_voltage_v
    voltage = reading.battery_voltage_v if nominal is None else nominal
    return None if voltage is None else (trial.duty or 0.0) * voltage


def _motion_faults(baseline: Baseline, trial: Trial, reading: Reading) -> Iterator[Fault]:
    if baseline.battery is not None and reading.battery_voltage_v is not None:
        nominal = baseline.battery.nominal_voltage_v
        if _outside(reading.battery_voltage_v / nominal, _VOLTAGE):
            seen = f"battery_voltage_v is {reading.battery_voltage_v:.3g} V, the battery has {nominal:g} V"
            yield Fault(kind="battery voltage", seen=seen)
    if reading.n_strokes < MIN_STROKES or reading.travel_m is None or reading.rate_hz is None:
        return
    nominal_m = 2.0 * baseline.radius_m
    if _outside(reading.travel_m / nominal_m, _TRAVEL):
        seen = f"displacement_mm travels {1e3 * reading.travel_m:.4g} mm, the crank {1e3 * nominal_m:.4g} mm"
        yield Fault(kind="travel", seen=seen)
    drive_v = _drive_v(baseline, trial, reading)
    if drive_v is None:
        return
    free_hz = drive_v / (baseline.plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * 2.0 * np.pi)
    if _outside(reading.rate_hz / free_hz, _STROKE_RATE):
        yield Fault(
            kind="stroke rate",
            seen=f"{reading.rate_hz:.3g} strokes/s; without load at duty {trial.duty:g} it is {free_hz:.3g}",
        )


def _current_faults(baseline: Baseline, trial: Trial, reading: Reading) -> Iterator[Fault]:
    duty, plant = trial.duty or 0.0, baseline.plant
    motor, drive_v = reading.motor_current_a, _drive_v(baseline, trial, reading)
    if motor is None:
        return
    if drive_v is not None and reading.top_current_a is not None:
        stall_a = drive_v / plant.resistance_ohm.nominal
        if reading.top_current_a > _TOP_CURRENT * stall_a:
            seen = f"motor_current_a reaches {reading.top_current_a:.4g} A, the blocked motor draws {stall_a:.3g} A"
            yield Fault(kind="start-up", seen=seen)
    if drive_v is not None and reading.rate_hz is not None and reading.n_strokes >= MIN_STROKES:
        speed = 2.0 * np.pi * reading.rate_hz * baseline.gear
        asked_v = plant.resistance_ohm.nominal * motor + plant.back_emf_constant_v_s_per_rad.nominal * speed
        if _outside(asked_v / drive_v, _MOTOR_VOLTAGE):
            seen = f"current and speed ask for {asked_v:.3g} V at the motor, duty times battery gives {drive_v:.3g} V"
            yield Fault(kind="motor voltage", seen=seen)
    if reading.battery_current_a is not None:
        expected = duty * motor
        excess = abs(reading.battery_current_a - expected)
        if excess > _CONVERTER_SHARE * abs(expected) + _CONVERTER_A or motor < -_CONVERTER_A:
            yield Fault(
                kind="converter",
                seen=f"battery_current_a is {reading.battery_current_a:.3g} A, duty times motor_current_a"
                f" ({duty:g} * {motor:.3g} A) is {expected:.3g} A",
            )


def blade_power_w(baseline: Baseline, reading: Reading) -> float | None:
    """Power that the wood takes from the blade, W, with the force's sign and the configured cutting half."""
    return None if reading.blade_power_w is None else -baseline.cutting_sign * reading.blade_power_w


def cutting_power_w(baseline: Baseline, reading: Reading, idle_current_a: float) -> float | None:
    """Shaft power that the motor current beyond idling stands for, W."""
    if reading.motor_current_a is None or reading.rate_hz is None or reading.n_strokes < MIN_STROKES:
        return None
    speed = 2.0 * np.pi * reading.rate_hz * baseline.gear
    extra_a = reading.motor_current_a - idle_current_a
    return baseline.plant.torque_constant_n_m_per_a.nominal * extra_a * speed


def _power_faults(baseline: Baseline, trial: Trial, reading: Reading, idle_a: float) -> Iterator[Fault]:
    at_blade = blade_power_w(baseline, reading)
    shaft = cutting_power_w(baseline, reading, 0.0 if trial.is_idle else idle_a)
    if at_blade is None:
        return
    if shaft is None:
        if not trial.is_idle and at_blade < -_CLEAR_CUT_W:
            yield Fault(kind="blade power", seen=f"the force drives the blade with {-at_blade:.3g} W")
        return
    if trial.is_idle:
        if abs(at_blade) > _IDLE_POWER_SHARE * abs(shaft) + _IDLE_POWER_W:
            seen = f"the trial is said to run in air, but the force takes {at_blade:.3g} W of the motor's {shaft:.3g} W"
            yield Fault(kind="blade power", seen=seen)
    elif shaft > _CLEAR_CUT_W and _outside(at_blade / shaft, _BLADE_POWER):
        yield Fault(
            kind="blade power",
            seen=f"force along the displacement takes {at_blade:.3g} W, the motor current stands for {shaft:.3g} W",
        )
    elif shaft <= _CLEAR_CUT_W and abs(at_blade) > 4.0 * _CLEAR_CUT_W:
        yield Fault(
            kind="blade power",
            seen=f"force along the displacement takes {at_blade:.3g} W, the current stands for {shaft:.2g} W only",
        )


def _simple_mistakes(
    baseline: Baseline, tracks: Mapping[str, Track]
) -> Iterator[tuple[str, tuple[str, ...], str, dict[str, Track]]]:
    """Mistake, channels it spoils, remedy, and the tracks as they would be without it."""
    for channels, unit, factor in _UNITS:
        if channels == ("time_s",):
            scaled = {n: (factor * t, v) for n, (t, v) in tracks.items()}
        elif all(n in tracks for n in channels):
            scaled = {n: (t, factor * v if n in channels else v) for n, (t, v) in tracks.items()}
        else:
            continue
        name = " and ".join(channels)
        remedy = f"multiply the column by {factor:g}, or import it with its unit"
        yield f"{name} is probably in {unit}", channels, remedy, scaled
    for one, other in combinations(sorted(tracks), 2):
        swapped = {**tracks, one: tracks[other], other: tracks[one]}
        yield f"{one} and {other} are probably swapped", (one, other), "exchange the two columns", swapped
    for name in ("motor_current_a", "battery_current_a"):
        if name in tracks:
            yield f"{name} has probably the wrong sign", (name,), "invert the column", _negative(tracks, name)
    if "force_n" in tracks:
        half = "zero_to_pi" if baseline.cutting_sign < 0 else "pi_to_2pi"
        reading = read_trial(tracks)
        falling, rising = reading.falling_force_n or 0.0, reading.rising_force_n or 0.0
        stated, other = (falling, rising) if baseline.cutting_sign < 0 else (rising, falling)
        flipped = _negative(tracks, "force_n")
        if abs(other) > abs(stated) and other > 0:
            yield (
                f"the blade cuts on the other half of the turn than cutting_half says (mean force {other:.3g} N there,"
                f" {stated:.3g} N on the stated half)",
                ("force_n",),
                f'set cutting_half = "{half}", or invert the displacement if it is counted from the other dead centre',
                flipped,
            )
        else:
            yield (
                f"force_n has probably the wrong sign (mean {stated:.3g} N on the cutting half; positive is cutting)",
                ("force_n",), "invert the column", flipped,
            )  # fmt: skip


def _negative(tracks: Mapping[str, Track], name: str) -> dict[str, Track]:
    return {**tracks, name: (tracks[name][0], -tracks[name][1])}


def _channels_of(faults: list[Fault], tracks: Mapping[str, Track]) -> tuple[str, ...]:
    """Channels to do without where no simple mistake is found: as few as the faults allow."""
    kinds = {fault.kind for fault in faults}
    if kinds in ({"converter"}, {"battery voltage"}):
        name = "battery_current_a" if kinds == {"converter"} else "battery_voltage_v"
        return (name,)
    return tuple(tracks)
