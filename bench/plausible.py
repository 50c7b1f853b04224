"""Bounds of what a channel of a healthy bench can show, relative to the nominal machine; stated once, for all checks.

They lie far outside of what the effects of the catalogue do at twice their typical size
(docs/diagnosis-input-checks.md says how that is measured). The range of each channel by itself stands in `units`.
"""

from __future__ import annotations

from typing import Final

Bounds = tuple[float, float]

# Peak to peak of the displacement over twice the crank radius.
TRAVEL: Final[Bounds] = (0.85, 1.2)
# Battery voltage over nominal, and the largest spread of it over its median, without spikes.
BATTERY_VOLTAGE: Final[Bounds] = (0.75, 1.25)
VOLTAGE_RIPPLE: Final = 0.04
# Stroke rate over that without load.
STROKE_RATE: Final[Bounds] = (0.2, 1.25)
# Voltage that current and speed ask for over duty times battery voltage.
MOTOR_VOLTAGE: Final[Bounds] = (0.58, 1.35)
# What drops of brushes and diodes take off it at most, V: of a low voltage they are more than that share.
DROPPED_V: Final = 2.0
# Largest motor current over that of the blocked motor.
TOP_CURRENT: Final = 2.0
# Battery current over duty times motor current, and what it may be off besides, A.
CONVERTER: Final[Bounds] = (0.6, 1.55)
CONVERTER_A: Final = 0.15
# Least motor current over what its nominal damping asks for.
LEAST_CURRENT: Final = 0.2
# Power of force times blade velocity over the motor's power beyond idling.
BLADE_POWER: Final[Bounds] = (0.3, 1.5)
# Least share of the motor's power that is a cut, where no idle run says what the tool takes in air.
LEAST_CUT_SHARE: Final = 0.05
# Force times blade velocity in air: share of the motor's power, and W besides.
IDLE_POWER_SHARE: Final = 0.3
IDLE_POWER_W: Final = 1.5
# What a displacement in another unit is multiplied by to be in mm.
LENGTH_UNITS: Final = (("m", 1e3), ("cm", 10.0), ("inches", 25.4), ("um", 1e-3))


def is_outside(value: float, bounds: Bounds) -> bool:
    """Whether a value lies outside of bounds, or is not a number.

    Examples
    --------
    >>> is_outside(1.3, TRAVEL), is_outside(1.0, TRAVEL), is_outside(float("nan"), TRAVEL)
    (True, False, True)
    """
    return not bounds[0] <= value <= bounds[1]


def excess(value: float, bounds: Bounds) -> float:
    """Factor by which a value lies beyond the nearer one of bounds above 0: above 1 outside of them.

    Examples
    --------
    >>> excess(2.4, TRAVEL), excess(1.0, (0.5, 2.0)), excess(-1.0, TRAVEL)
    (2.0, 0.5, inf)
    """
    low, high = bounds
    return max(low / value, value / high) if value > 0.0 else float("inf")


def most_battery_current_a(duty: float, motor_current_a: float) -> float:
    """Largest plausible mean battery current at a duty and a mean motor current, A."""
    return max(share * duty * motor_current_a for share in CONVERTER) + CONVERTER_A


def is_drawn_by_motor(battery_current_a: float, expected_a: float) -> bool:
    """Whether a battery current may be that of the motor, of which duty times motor current is expected."""
    low, high = sorted(share * expected_a for share in CONVERTER)
    return low - CONVERTER_A <= battery_current_a <= high + CONVERTER_A
