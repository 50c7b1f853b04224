"""Every effect the diagnosis knows, in one explicit table, and the page that lists them."""

from __future__ import annotations

import sys
from typing import Final

from sawbench.modeling.effects import (
    battery_internal_resistance,
    battery_polarization,
    blade_compliance,
    blade_wear,
    brush_voltage_drop,
    carriage_resonance,
    chip_thickness,
    clock_offset,
    cogging,
    cogging_torque,
    converter_diode_drop,
    converter_loss,
    current_limit,
    current_sensor_lag,
    cutting_speed_exponent,
    edge_force,
    elastic_load,
    engagement_delay,
    force_offset_drift,
    force_sensor_lag,
    gear_eccentricity,
    grain_variation,
    guide_friction,
    load_cell_resonance,
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
from sawbench.modeling.effects.effect import Effect

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
    cogging.EFFECT,
    cogging_torque.EFFECT,
    elastic_load.EFFECT,
)
# Of a sensor alone: a model may hold them, and a campaign may show them, but no gap of the machine is due to them.
SENSOR_PROPERTIES: Final[tuple[Effect, ...]] = (load_cell_resonance.EFFECT,)
EFFECT_BY_NAME: Final[dict[str, Effect]] = {effect.name: effect for effect in EFFECTS}
MEMORIES: Final = tuple(dict.fromkeys(memory for effect in EFFECTS for memory in effect.memories))

_COLUMNS = (
    "effect", "equation", "shows in", "parts", "silent in", "parameter", "typical", "range", "forms", "source",
    "taken for", "told apart by",
)  # fmt: skip
_HEADER = """# The catalogue of effects

What the baseline model leaves out, one file each in `modeling/effects/`. Written by
`python -m sawbench.modeling.effects.catalogue > docs/effects.md`; a test holds every row to its file. "Range" is that
of the magnitude, or of the forms that carry it; "assumed" means an engineering estimate. A machine shows an effect if
it has the parts. Forces, torques, and resistances to heat and of the battery are typical of the paper's saw in oak
(`modeling/load.py`); a campaign takes them in proportion to what its saw carries. On a linear axis forms and magnitudes
may differ (`docs/linear_axis.md`), and without a machine they are those of an axis of 100 N and 0.1 m.

"""
_WORKSHOP = """
## In the workshop

The last row is of a sensor alone: a model may hold it in `[effects]`, `sawbench diagnose` adds it where a campaign
shows it, and no gap of the machine is due to it.

| effect | what it is | what to measure | what to do |
|---|---|---|---|
"""


def page() -> str:
    """Write `docs/effects.md`.

    Returns
    -------
    str
        Markdown, one row per effect in each of two tables; the second also has the properties of sensors.

    Examples
    --------
    >>> rows = 2 * len(EFFECTS) + len(SENSOR_PROPERTIES)
    >>> sum(line.startswith("| `") for line in page().splitlines()) == rows
    True
    """
    return (
        _HEADER
        + _cells(*_COLUMNS)
        + "|---" * len(_COLUMNS)
        + "|\n"
        + "".join(map(_row, EFFECTS))
        + _WORKSHOP
        + "".join(map(_words_row, (*EFFECTS, *SENSOR_PROPERTIES)))
    )


def _cells(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _words_row(effect: Effect) -> str:
    words = effect.words
    assert words is not None
    return _cells(f"`{effect.name}`", words.happens, words.measure, words.mend)


def _row(effect: Effect) -> str:
    strength = effect.strength
    unit = "" if strength.unit == "1" else f" {strength.unit}"
    ends = sorted(
        effect.reported_strength(strength.typical * part, shape)
        for shape in effect.shapes
        for part in ((1.0, 1.0) if effect.shape_strength else (strength.low, strength.high))
    )
    middle = ends[len(ends) // 2] if effect.shape_strength else strength.typical
    return _cells(
        f"`{effect.name}`",
        effect.equation,
        effect.place,
        ", ".join(part.replace("_", " ") for part in effect.parts),
        ", ".join(phase.replace("_", "-") for phase in effect.silent_in) or "nothing",
        f"`{strength.name}`",
        f"{middle:.3g}{unit}",
        f"{ends[0]:.3g} to {ends[-1]:.3g}{unit}",
        str(len(effect.shapes)),
        strength.source,
        ", ".join(f"`{name}`" for name in effect.confused_with) or "nothing here",
        effect.told_apart_by,
    )


if __name__ == "__main__":
    sys.stdout.write(page())
