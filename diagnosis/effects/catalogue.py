"""Every effect the diagnosis knows, in one explicit table, and the page that lists them."""

from __future__ import annotations

from typing import Final

from diagnosis.effects import (
    battery_internal_resistance,
    battery_polarization,
    blade_compliance,
    blade_wear,
    brush_voltage_drop,
    carriage_resonance,
    chip_thickness,
    clock_offset,
    converter_diode_drop,
    converter_loss,
    current_limit,
    current_sensor_lag,
    cutting_speed_exponent,
    edge_force,
    engagement_delay,
    force_offset_drift,
    force_sensor_lag,
    gear_eccentricity,
    grain_variation,
    guide_friction,
    load_dependent_friction,
    magnet_weakening,
    motor_coulomb_friction,
    preload_lift_off,
    return_stroke_rubbing,
    tooth_passing_ripple,
    windage_drag,
    winding_heating,
    yoke_backlash,
)
from diagnosis.effects.effect import Effect

EFFECTS: Final[tuple[Effect, ...]] = (
    guide_friction.EFFECT,
    motor_coulomb_friction.EFFECT,
    windage_drag.EFFECT,
    load_dependent_friction.EFFECT,
    yoke_backlash.EFFECT,
    gear_eccentricity.EFFECT,
    blade_compliance.EFFECT,
    return_stroke_rubbing.EFFECT,
    tooth_passing_ripple.EFFECT,
    cutting_speed_exponent.EFFECT,
    edge_force.EFFECT,
    chip_thickness.EFFECT,
    blade_wear.EFFECT,
    grain_variation.EFFECT,
    engagement_delay.EFFECT,
    winding_heating.EFFECT,
    magnet_weakening.EFFECT,
    brush_voltage_drop.EFFECT,
    converter_diode_drop.EFFECT,
    converter_loss.EFFECT,
    current_limit.EFFECT,
    battery_internal_resistance.EFFECT,
    battery_polarization.EFFECT,
    carriage_resonance.EFFECT,
    preload_lift_off.EFFECT,
    force_sensor_lag.EFFECT,
    current_sensor_lag.EFFECT,
    clock_offset.EFFECT,
    force_offset_drift.EFFECT,
)
EFFECT_BY_NAME: Final[dict[str, Effect]] = {effect.name: effect for effect in EFFECTS}

_HEADER = """# The catalogue of effects

What the baseline model leaves out, one file each in `diagnosis/effects/`. Written by
`diagnosis.effects.catalogue.page()`; a test keeps it up to date. "Range" is that of the strength, or of the
forms that carry it; "assumed" means an engineering estimate.

| effect | equation | shows in | parameter | typical | range | forms | source | taken for | told apart by |
|---|---|---|---|---|---|---|---|---|---|
"""


def page() -> str:
    """Write `docs/effects.md`.

    Returns
    -------
    str
        Markdown, one table row per effect.

    Examples
    --------
    >>> sum(line.startswith("| `") for line in page().splitlines()) == len(EFFECTS)
    True
    """
    return _HEADER + "".join(_row(effect) for effect in EFFECTS)


def _row(effect: Effect) -> str:
    strength = effect.strength
    unit = "" if strength.unit == "1" else f" {strength.unit}"
    ends = sorted(
        effect.reported_strength(strength.typical * part, shape)
        for shape in effect.shapes
        for part in ((1.0, 1.0) if effect.shape_strength else (strength.low, strength.high))
    )
    middle = ends[len(ends) // 2] if effect.shape_strength else strength.typical
    cells = (
        f"`{effect.name}`",
        effect.equation,
        effect.place,
        f"`{strength.name}`",
        f"{middle:.3g}{unit}",
        f"{ends[0]:.3g} to {ends[-1]:.3g}{unit}",
        str(len(effect.shapes)),
        strength.source,
        ", ".join(f"`{name}`" for name in effect.confused_with) or "nothing here",
        effect.told_apart_by,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"
