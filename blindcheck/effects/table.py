"""The tables of effects: those of the catalogue, whose names are a contract, and those outside of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from sawbench.bench.errors import InputError
from sawbench.blindcheck.effects import cutting, drive, outside, sensing, supply
from sawbench.blindcheck.effects.change import Change, Effect, Setting, combine

# Each effect with the equations of the gap report in which its own form acts: the balance of the motor's voltage
# (electrical), of the torques (mechanical), the force of the blade (cutting), battery and converter (supply), and what
# an instrument gets wrong (sensing).
_CATALOGUE: tuple[tuple[Effect, str], ...] = (
    (drive.guide_friction, "mechanical"),
    (drive.motor_coulomb_friction, "mechanical"),
    (drive.windage_drag, "mechanical"),
    (drive.load_dependent_friction, "mechanical"),
    (drive.yoke_backlash, "mechanical cutting"),
    (drive.gear_eccentricity, "mechanical"),
    (drive.winding_heating, "electrical"),
    (drive.magnet_weakening, "electrical mechanical"),
    (cutting.blade_compliance, "cutting"),
    (cutting.return_stroke_rubbing, "cutting"),
    (cutting.tooth_passing_ripple, "cutting"),
    (cutting.cutting_speed_exponent, "cutting"),
    (cutting.edge_force, "cutting"),
    (cutting.chip_thickness, "cutting"),
    (cutting.blade_wear, "cutting"),
    (cutting.grain_variation, "cutting"),
    (cutting.engagement_delay, "cutting"),
    (supply.brush_voltage_drop, "electrical"),
    (supply.converter_diode_drop, "electrical"),
    (supply.converter_loss, "supply"),
    (supply.current_limit, "electrical supply"),
    (supply.battery_internal_resistance, "supply"),
    (supply.battery_polarization, "supply"),
    (sensing.carriage_resonance, "sensing cutting"),
    (sensing.preload_lift_off, "sensing cutting"),
    (sensing.force_sensor_lag, "sensing"),
    (sensing.current_sensor_lag, "sensing"),
    (sensing.clock_offset, "sensing"),
    (sensing.force_offset_drift, "sensing"),
)
_OUTSIDE: tuple[tuple[Effect, str], ...] = (
    (outside.hand_sway, "cutting"),
    (outside.alternating_strokes, "cutting"),
    (outside.supply_ripple, "supply electrical"),
    (outside.duty_wander, "electrical supply"),
    (outside.grease_warming, "mechanical"),
    (outside.blade_whip, "cutting mechanical"),
    (outside.soft_start, "electrical supply"),
    (outside.brush_bounce, "electrical"),
    (outside.loose_pin_impacts, "sensing cutting mechanical"),
    (outside.carriage_stick_slip, "sensing cutting"),
    (outside.rotor_unbalance, "sensing mechanical"),
    (outside.interference_bursts, "sensing"),
    (outside.displacement_bow, "sensing"),
    (outside.current_crosstalk, "sensing"),
    (outside.commutation_ripple, "sensing electrical"),
)
# Hidden on foreign benches only, so that what older seeds hide stays what it was.
_ADDED: tuple[tuple[Effect, str], ...] = ((drive.cogging_torque, "mechanical"),)
CATALOGUE: Mapping[str, Effect] = MappingProxyType({effect.__name__: effect for effect, _ in _CATALOGUE})
OUTSIDE: Mapping[str, Effect] = MappingProxyType({effect.__name__: effect for effect, _ in (*_OUTSIDE, *_ADDED)})
ACTS_IN: Mapping[str, frozenset[str]] = MappingProxyType(
    {effect.__name__: frozenset(equations.split()) for effect, equations in (*_CATALOGUE, *_OUTSIDE, *_ADDED)}
)
# An ordinary fault of a sensor on a foreign bench, and so no effect there.
_NUISANCES_TOO = frozenset({"interference_bursts"})

# Besides its catalogue the diagnosis looks for a nonlinear displacement sensor, friction that falls as
# the machine warms up, a voltage ramp at the start, a force that reads the current, hardness that waves in
# time, a carriage that slips, and lines and bursts that do not follow the stroke, and answers "unknown" for
# them. Named here, since the blind check imports nothing of the diagnosis.
LOOKED_FOR_OUTSIDE = frozenset(
    effect.__name__
    for effect in (
        outside.displacement_bow,
        outside.grease_warming,
        outside.soft_start,
        outside.current_crosstalk,
        outside.hand_sway,
        outside.alternating_strokes,
        outside.supply_ripple,
        outside.rotor_unbalance,
        outside.commutation_ripple,
        outside.interference_bursts,
        outside.carriage_stick_slip,
    )
)

# Thresholds and resonances are plain to see, or mean nothing, at a few per cent of their typical size; a
# nearly rigid blade makes the equations stiff.
NOT_AS_BACKGROUND = frozenset(
    {"current_limit", "preload_lift_off", "yoke_backlash", "carriage_resonance", "blade_compliance"}
)


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnFrom:
    """Ids that the cases of a set hide as effects of the catalogue, and as outside of it."""

    catalogue: tuple[str, ...]
    outside: tuple[str, ...]


def drawn_from(catalogue: Collection[str] = ()) -> DrawnFrom:
    """Return what a set hides: the tables of the first sets, or all effects, sorted by the catalogue at hand.

    Examples
    --------
    >>> "cogging_torque" in drawn_from().outside, "cogging_torque" in drawn_from(["cogging_torque"]).catalogue
    (False, True)
    """
    if not catalogue:
        return DrawnFrom(catalogue=tuple(CATALOGUE), outside=tuple(effect.__name__ for effect, _ in _OUTSIDE))
    known = [*CATALOGUE, *(name for name in OUTSIDE if name not in _NUISANCES_TOO)]
    return DrawnFrom(
        catalogue=tuple(name for name in known if name in catalogue),
        outside=tuple(name for name in known if name not in catalogue),
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
