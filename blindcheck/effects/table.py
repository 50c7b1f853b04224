"""The tables of effects: those of the catalogue, whose names are a contract, and those outside of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bench.errors import InputError
from blindcheck.effects import cutting, drive, outside, sensing, supply
from blindcheck.effects.change import Change, Effect, Setting, combine

_CATALOGUE: tuple[Effect, ...] = (
    drive.guide_friction,
    drive.motor_coulomb_friction,
    drive.windage_drag,
    drive.load_dependent_friction,
    drive.yoke_backlash,
    drive.gear_eccentricity,
    drive.winding_heating,
    drive.magnet_weakening,
    cutting.blade_compliance,
    cutting.return_stroke_rubbing,
    cutting.tooth_passing_ripple,
    cutting.cutting_speed_exponent,
    cutting.edge_force,
    cutting.chip_thickness,
    cutting.blade_wear,
    cutting.grain_variation,
    cutting.engagement_delay,
    supply.brush_voltage_drop,
    supply.converter_diode_drop,
    supply.converter_loss,
    supply.current_limit,
    supply.battery_internal_resistance,
    supply.battery_polarization,
    sensing.carriage_resonance,
    sensing.preload_lift_off,
    sensing.force_sensor_lag,
    sensing.current_sensor_lag,
    sensing.clock_offset,
    sensing.force_offset_drift,
)
_OUTSIDE: tuple[Effect, ...] = (
    outside.hand_sway,
    outside.alternating_strokes,
    outside.supply_ripple,
    outside.duty_wander,
    outside.grease_warming,
    outside.blade_whip,
    outside.soft_start,
    outside.brush_bounce,
    outside.loose_pin_impacts,
    outside.carriage_stick_slip,
    outside.rotor_unbalance,
    outside.interference_bursts,
    outside.displacement_bow,
    outside.current_crosstalk,
    outside.commutation_ripple,
)
CATALOGUE: Mapping[str, Effect] = MappingProxyType({effect.__name__: effect for effect in _CATALOGUE})
OUTSIDE: Mapping[str, Effect] = MappingProxyType({effect.__name__: effect for effect in _OUTSIDE})

# Beside its catalogue, the diagnosis of this repository looks for a bent displacement sensor, friction that falls as
# the machine warms up, hardness that waves in time, and lines and bursts that do not follow the stroke, and answers
# "unknown" for them. Named here, since the blind check imports nothing of the diagnosis.
LOOKED_FOR_OUTSIDE = frozenset(
    effect.__name__
    for effect in (
        outside.displacement_bow,
        outside.grease_warming,
        outside.soft_start,
        outside.hand_sway,
        outside.alternating_strokes,
        outside.supply_ripple,
        outside.rotor_unbalance,
        outside.commutation_ripple,
        outside.interference_bursts,
    )
)

# Thresholds and resonances are plain to see, or mean nothing, at a few per cent of their typical size; a
# nearly rigid blade makes the equations stiff.
NOT_AS_BACKGROUND = frozenset(
    {"current_limit", "preload_lift_off", "yoke_backlash", "carriage_resonance", "blade_compliance"}
)


def changes_of(effects: Mapping[str, float], setting: Setting) -> Change:
    """Return what all the effects do together.

    Parameters
    ----------
    effects : mapping of str to float
        Severity (>= 0) by effect id, of either table; 0 does nothing.
    setting : Setting

    Raises
    ------
    InputError
        If an id is unknown or a severity negative.
    """
    both = {**CATALOGUE, **OUTSIDE}
    changes = []
    for effect_id, severity in effects.items():
        if effect_id not in both:
            raise InputError(f"no effect is called {effect_id!r}", remedy=f"choose from {', '.join(sorted(both))}")
        if not 0.0 <= severity < 100.0:
            raise InputError(f"severity of {effect_id} is {severity!r}, allowed is 0 to 100 (1 is typical)")
        if severity > 0.0:
            changes.append(both[effect_id](severity, setting))
    return combine(changes)
