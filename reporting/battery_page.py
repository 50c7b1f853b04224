"""A fitted battery: why its model was chosen, how far it is off on every discharge, and its curves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.reporting.figures import INK, SERIES_COLOURS, WIDTH_IN, figure_style
from sawbench.reporting.html import Picture, figure_to_svg, render
from sawbench.reporting.quantities import format_quantity
from sawbench.storage.output import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from sawbench.modeling.battery_choice import BatteryChoice, ModelTrial

MODEL_WORDS: Final[Mapping[str, str]] = {
    "eq16": "Eq. 16, its charge the largest delivered",
    "eq16_free": "Eq. 16, its charge fitted to the curve",
    "eq16_free_r": "Eq. 16 and a resistance, fitted to the curve",
    "eq16_end": "Eq. 16, fitted to curve and end",
    "eq16_end_r": "Eq. 16 and a resistance, fitted to curve and end",
    "ocv_r": "table of the slowest discharge and a resistance",
}
DISCHARGE_HEAD: Final = (
    "discharge", "mean current", "start", "measured", "withheld: predicted", "runtime error", "voltage error",
    "own fit",
)  # fmt: skip
MODEL_HEAD: Final = ("model", "runtime RMS", "voltage RMS", "u(runtime)", "worst own miss", "verdict")


@dataclass(frozen=True, kw_only=True, slots=True)
class BatteryText:
    """What terminal and page both say of a choice.

    Attributes
    ----------
    summary : str
    discharges, models : list of list of str
        Cells under `DISCHARGE_HEAD` and `MODEL_HEAD`.
    refusals : list of str
        Why models cannot be taken.
    """

    summary: str
    discharges: list[list[str]]
    models: list[list[str]]
    refusals: list[str]


def battery_text(choice: BatteryChoice) -> BatteryText:
    """Put a choice into words and cells."""
    chosen = choice.chosen
    summary = (
        f"{chosen.model} ({MODEL_WORDS[chosen.model]}) is chosen: of the models that keep their own runtimes it has"
        f" the smallest error on withheld discharges. One standard uncertainty of a runtime: {chosen.rel_std:.1%}."
        f" Discharges end at {choice.cutoff_voltage_v:.4g} V."
    )
    rows = []
    for discharge, withheld, own in zip(choice.discharges, chosen.withheld, chosen.own, strict=True):
        start = discharge.start_temperature_c
        rows.append(
            [
                discharge.label,
                f"{discharge.mean_current_a:.4g} A",
                "-" if start is None else f"{start:.1f} degC",
                f"{withheld.measured_s:.0f} s",
                f"{withheld.predicted_s:.0f} s",
                f"{withheld.runtime_error:+.1%}",
                f"{withheld.voltage_error:+.1%}",
                f"{own.runtime_error:+.1%}",
            ]
        )
    return BatteryText(
        summary=summary,
        discharges=rows,
        models=[_model_cells(one, chosen) for one in choice.trials],
        refusals=[f"{one.model} {one.refusal}" for one in choice.trials if one.refusal],
    )


def _model_cells(trial: ModelTrial, chosen: ModelTrial) -> list[str]:
    verdict = "refused" if trial.refusal else "chosen" if trial is chosen else "errs more"
    if not trial.withheld:
        return [trial.model, "-", "-", "-", "-", verdict]
    errors = ([miss.runtime_error for miss in trial.withheld], [miss.voltage_error for miss in trial.withheld])
    rms = (f"{math.sqrt(float(np.mean(np.square(of)))):.1%}" for of in errors)
    return [trial.model, *rms, f"{trial.rel_std:.1%}", f"{trial.largest_own_miss:.1%}", verdict]


def write_battery_page(
    path: str | Path,
    choice: BatteryChoice,
    table: Mapping[str, Any],
    *,
    notes: tuple[str, ...] = (),
    overwrite: bool = False,
) -> Path:
    """Write the page of a fitted battery.

    Parameters
    ----------
    path : str or Path
    choice : BatteryChoice
    table : mapping
        The `[battery]` table that was made of it.
    notes : tuple of str
        How the tables were read.
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    text = battery_text(choice)
    with figure_style():
        figure = draw_curves(choice)
        picture = Picture(
            svg=figure_to_svg(
                figure,
                name="curves",
                title="Voltage over the charge taken",
                description="Measured discharges as lines, the chosen model dashed in the same colour.",
            ),
            caption="Measured voltage (lines) and the chosen model, fitted to all discharges (dashed), over the charge "
            "taken. The dotted line is the cut-off.",
        )
    context = {
        "title": "Fitted battery",
        "summary": text.summary,
        "discharge_head": DISCHARGE_HEAD,
        "discharges": text.discharges,
        "model_head": MODEL_HEAD,
        "models": text.models,
        "refusals": text.refusals,
        "model_words": [(name, MODEL_WORDS[name]) for name in (trial.model for trial in choice.trials)],
        "picture": picture,
        "parameters": _parameter_rows(table),
        "notes": notes,
    }
    return write_whole(path, render("battery_page.html.j2", context), overwrite=overwrite)


def _parameter_rows(table: Mapping[str, Any]) -> list[tuple[str, str]]:
    fitted = table["fitted"]
    rows = [
        (name, format_quantity(value, fitted["std"].get(name)))
        for name, value in table.items()
        if isinstance(value, int | float)
    ]
    ranges = [
        (f"fitted.{name}", " to ".join(f"{limit:.4g}" for limit in fitted[name]))
        for name in ("current_a", "temperature_c", "cycle", "soc")
        if name in fitted
    ]
    return [*rows, *ranges, ("fitted.runtime_rel_std", f"{fitted['runtime_rel_std']:.3g}")]


def draw_curves(choice: BatteryChoice) -> Figure:
    """Draw every measured discharge and the chosen model at its current over the charge taken."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots()
    for number, discharge in enumerate(choice.discharges):
        colour = SERIES_COLOURS[number % len(SERIES_COLOURS)]
        charge = discharge.charge_a_s
        label = f"{discharge.label}, {discharge.mean_current_a:.3g} A"
        even = np.linspace(0.0, charge[-1], 400)
        measured_v = np.interp(even, charge, discharge.voltage_v)
        axes.plot(even / 3600.0, measured_v, color=colour, label=label)
        modelled_v = choice.fit.voltage_v(even, np.interp(even, charge, discharge.current_a))
        is_near = modelled_v > 0.9 * choice.cutoff_voltage_v
        axes.plot(even[is_near] / 3600.0, modelled_v[is_near], color=colour, linestyle=(0, (4, 2)))
    axes.axhline(choice.cutoff_voltage_v, color=INK, linestyle=":", linewidth=1.0)
    axes.set_xlabel("charge taken / Ah")
    axes.set_ylabel("voltage / V")
    axes.legend(fontsize=8, loc="upper right", ncols=1 if len(choice.discharges) < 7 else 2)
    return figure
