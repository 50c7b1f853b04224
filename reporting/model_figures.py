"""The fitted model on the trial page: against the measured stroke, and over a discharge of the battery."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.units import CHANNEL_BY_NAME, FORCE, MOTOR_CURRENT
from sawbench.modeling.discharge import DischargeCurves
from sawbench.modeling.machines.words import words_of
from sawbench.modeling.results import RuntimePrediction
from sawbench.reporting.figures import CHANNEL_COLOURS, QUIET, WIDTH_IN, cycle_axis, figure_style
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number
from sawbench.reporting.spectrum_figures import MODEL_COLOURS, Cycle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DASHES = ((0, (5, 2)), "-")
_NARROW_TICKS = [0, 90, 180, 270, 360]


@dataclass(frozen=True, kw_only=True, slots=True)
class Deviation:
    """How far a model's stroke is from the measured mean stroke, in the unit of the channel.

    Attributes
    ----------
    channel, unit, model : str
    peak_measured, peak_model : float
        Largest values over the stroke.
    rms, largest : float
        Of measured minus model.
    """

    channel: str
    unit: str
    model: str
    peak_measured: float
    peak_model: float
    rms: float
    largest: float


def deviations_of(processed: ProcessedTrial, model: Mapping[str, Cycle]) -> tuple[Deviation, ...]:
    """Compare the folded force and motor current with each model (Eqs. 17 and 18 over the crank angle).

    Parameters
    ----------
    processed : ProcessedTrial
    model : mapping of str to mapping
        By name of the model: `angle_rad`, `force_n`, `motor_current_a`, shape (n,) each.
    """
    found = []
    for name in _shown(processed):
        cycle = processed.folded[name]
        for words, curves in model.items():
            values = np.interp(cycle.angle_rad, curves["angle_rad"], curves[name], period=2.0 * np.pi)
            left = cycle.mean - values
            found.append(
                Deviation(
                    channel=CHANNEL_BY_NAME[name].label,
                    unit=cycle.unit,
                    model=words,
                    peak_measured=float(np.nanmax(cycle.mean)),
                    peak_model=float(values.max()),
                    rms=float(np.sqrt(np.nanmean(left**2))),
                    largest=float(np.nanmax(np.abs(left))),
                )
            )
    return tuple(found)


def _shown(processed: ProcessedTrial) -> list[str]:
    return [name for name in (FORCE.name, MOTOR_CURRENT.name) if name in processed.folded]


def model_picture(processed: ProcessedTrial, model: Mapping[str, Cycle]) -> Picture | None:
    """Draw the measured stroke with each model, and below it measured minus model.

    Parameters
    ----------
    processed : ProcessedTrial
    model : mapping of str to mapping
        As in `deviations_of`.

    Returns
    -------
    Picture or None
        None where there is no model, or neither force nor motor current was folded.
    """
    from matplotlib.figure import Figure

    names = _shown(processed)
    if not names or not model:
        return None
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 5.0), layout="constrained")
        grid = figure.subplots(2, len(names), squeeze=False, sharex=True, height_ratios=[1.6, 1.0])
        for column, name in enumerate(names):
            _draw_channel(grid[0][column], grid[1][column], processed, name, model)
        grid[0][0].legend(loc="best", fontsize=8.5)
        svg = figure_to_svg(
            figure,
            name="model",
            title="Measured stroke against the fitted model",
            description=" ".join(
                f"{d.channel}, {d.model}: {format_number(d.rms, digits=3)} {d.unit} RMS deviation."
                for d in deviations_of(processed, model)
            ),
        )
    return Picture(
        svg=svg,
        caption="Mean stroke with its standard deviation between strokes, and the fitted model: with the linear"
        " force, and with the measured force replayed over the crank angle. Below: measured minus model; the band is"
        " the standard uncertainty of the measured mean.",
    )


def _draw_channel(curves: Axes, left: Axes, processed: ProcessedTrial, name: str, model: Mapping[str, Cycle]) -> None:
    cycle, channel = processed.folded[name], CHANNEL_BY_NAME[name]
    angle_deg = np.degrees(cycle.angle_rad)
    colour = CHANNEL_COLOURS[name]
    curves.fill_between(
        angle_deg, cycle.mean - cycle.std, cycle.mean + cycle.std, color=colour, alpha=0.22, linewidth=0
    )
    curves.plot(angle_deg, cycle.mean, color=colour, linewidth=2.2, alpha=0.7, label="measured")
    u = cycle.std / np.sqrt(np.maximum(cycle.count, 1))
    left.fill_between(angle_deg, -u, u, color=colour, alpha=0.22, linewidth=0)
    left.axhline(0.0, color=QUIET, linewidth=0.7)
    for place, (words, found) in enumerate(model.items()):
        values = np.interp(cycle.angle_rad, found["angle_rad"], found[name], period=2.0 * np.pi)
        style = {"color": MODEL_COLOURS[place], "linestyle": _DASHES[place], "linewidth": 1.1}
        curves.plot(angle_deg, values, **style, label=f"model, {words}")
        left.plot(angle_deg, cycle.mean - values, **style)
    curves.set_title(channel.label.capitalize())
    curves.set_ylabel(f"{channel.label.split()[-1]} / {channel.unit}")
    left.set_ylabel(f"measured − model / {channel.unit}")
    cycle_axis(left, words_of(processed.frame))
    left.set_xticks(_NARROW_TICKS)


def discharge_picture(curves: Mapping[str, DischargeCurves], runtime: RuntimePrediction | None) -> Picture | None:
    """Draw state of charge, battery voltage and battery current over a whole discharge.

    Parameters
    ----------
    curves : mapping of str to DischargeCurves
        By name of the force.
    runtime : RuntimePrediction or None
        Its standard uncertainty is drawn at the end.

    Returns
    -------
    Picture or None
        None without a stroke on any curve.
    """
    from matplotlib.figure import Figure

    curves = {words: run for words, run in curves.items() if len(run.time_s)}
    if not curves:
        return None
    panels = (
        ("State of charge", "charge / %", lambda c: 100.0 * c.soc),
        ("Battery voltage", "voltage / V", lambda c: c.battery_voltage_v),
        ("Battery current", "current / A", lambda c: c.battery_current_a),
    )
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 2.7), layout="constrained")
        axes = figure.subplots(1, 3)
        for axis, (title, label, values) in zip(axes, panels, strict=True):
            for place, (words, run) in enumerate(curves.items()):
                style = {"color": MODEL_COLOURS[place], "linestyle": _DASHES[place], "linewidth": 1.2}
                axis.plot(run.time_s / 60.0, values(run), **style, label=words)
            if runtime is not None and runtime.status == "ok" and runtime.std_s > 0.0:
                ends = ((runtime.runtime_s + sign * runtime.std_s) / 60.0 for sign in (-1, 1))
                axis.axvspan(*ends, color=QUIET, alpha=0.2, linewidth=0)
            axis.set_title(title)
            axis.set_ylabel(label)
            axis.set_xlabel("time / min")
        axes[0].set_ylim(0.0, 102.0)
        axes[0].legend(loc="lower left", fontsize=8.5)
        ends_s = ", ".join(f"{words} {format_number(float(run.time_s[-1]))} s" for words, run in curves.items())
        svg = figure_to_svg(
            figure, name="discharge", title="Discharge of a full battery", description=f"Until the cut-off: {ends_s}."
        )
    return Picture(
        svg=svg,
        caption=f"Discharge of a full battery at this load, simulated to the cut-off: {ends_s}."
        " Grey: the runtime ± its standard uncertainty.",
    )
