"""Causes in the words of the workshop: what each effect is, and what to look at or do."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

# Effect -> (what happens, what to do about it).
_WORDS: Final = MappingProxyType(
    {
        "guide_friction": ("the plunger rubs in its guides", "clean, oil and align the guides"),
        "motor_coulomb_friction": ("the motor drags at every speed", "check brushes, bearings and seals of the motor"),
        "windage_drag": ("air and fan brake the motor, the more the faster it runs", "check the fan and its duct"),
        "load_dependent_friction": (
            "gear and yoke rub the harder they are loaded",
            "check lubrication of gear, yoke slot and crank pin",
        ),
        "yoke_backlash": ("there is play between crank pin and yoke", "measure the play; renew pin or yoke"),
        "gear_eccentricity": ("the gear runs out of true", "measure the runout of the gear wheel"),
        "blade_compliance": ("blade, clamp or workpiece give way", "clamp shorter and tighter; check the blade's seat"),
        "return_stroke_rubbing": ("the blade rubs in the kerf on its way back", "check set and alignment of the blade"),
        "tooth_passing_ripple": (
            "single teeth show in the force",
            "nothing is broken; count it in, or use a finer blade",
        ),
        "cutting_speed_exponent": (
            "the cutting force does not grow in proportion to the blade's speed",
            "nothing is broken; the straight-line law of cutting is too simple for this material",
        ),
        "edge_force": (
            "the blade presses with a force that does not depend on its speed",
            "look for blunt teeth; otherwise the law of cutting is too simple for this material",
        ),
        "chip_thickness": (
            "the force depends on the thickness of the chip",
            "nothing is broken; compare trials at equal feed per stroke only",
        ),
        "blade_wear": (
            "the blade gets blunt during the campaign",
            "change the blade, and note the distance it has cut",
        ),
        "grain_variation": (
            "the wood is harder in some places than in others",
            "cut along the grain, or average longer",
        ),
        "engagement_delay": ("the teeth bite late in the stroke", "check the play of blade and workpiece"),
        "winding_heating": (
            "the motor's winding gets warm",
            "let the motor cool between trials, or measure its temperature",
        ),
        "magnet_weakening": ("the motor's magnets weaken with heat", "let the motor cool between trials"),
        "brush_voltage_drop": ("the brushes take a fixed voltage", "check brushes and commutator"),
        "converter_diode_drop": (
            "the converter loses voltage while it does not drive",
            "check diode and dead time of the converter",
        ),
        "converter_loss": (
            "the converter takes more from the battery than it hands on",
            "check the converter's losses",
        ),
        "current_limit": ("the controller limits the current", "check the current limit of the controller"),
        "battery_internal_resistance": (
            "the battery has more resistance than stated",
            "measure the battery's resistance, its leads and contacts",
        ),
        "battery_polarization": (
            "the battery sags under load and recovers at rest",
            "nothing is broken; wait between trials, or use another battery",
        ),
        "carriage_resonance": ("the carriage with the load cell rings", "stiffen or damp the carriage"),
        "preload_lift_off": ("the force lifts the carriage off its preload", "preload the carriage more"),
        "force_sensor_lag": ("the force is read late and rounded off", "widen the filter of the force amplifier"),
        "current_sensor_lag": (
            "the motor current is read late and rounded off",
            "widen the filter of the current sensor",
        ),
        "clock_offset": ("the clock of one device is late", "align the clocks of the devices"),
        "force_offset_drift": (
            "the zero of the load cell drifts",
            "let the load cell warm up and tare before each trial",
        ),
        "cogging": ("the drive is pulled towards fixed positions", "nothing is broken; count it in"),
        "elastic_load": ("something springy acts on the axis", "look for cables, bellows and end stops"),
    }
)


def name_of(effect: str) -> str:
    """Write an identifier as words.

    Examples
    --------
    >>> name_of("guide_friction")
    'guide friction'
    """
    return effect.replace("_", " ")


def what_happens(effect: str) -> str:
    """Say in plain words what an effect is; its name where there are none."""
    return _WORDS[effect][0] if effect in _WORDS else name_of(effect)


def what_to_do(effect: str) -> str:
    """Say what to look at or do about it; empty where there is nothing to say."""
    return _WORDS[effect][1] if effect in _WORDS else ""
