"""The figures of the trial page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import Phase, ProcessedTrial
from sawbench.bench.recording import Floats, Recording, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, FORCE, MOTOR_CURRENT
from sawbench.modeling.machines.words import SAW, MachineWords, words_of
from sawbench.processing.spikes import find_overloads
from sawbench.reporting.charts import FINE_POINTS
from sawbench.reporting.figures import (
    CHANNEL_COLOURS,
    FORCE_COLOUR,
    INK,
    MODEL,
    QUIET,
    WIDTH_IN,
    cycle_axis,
    figure_style,
    thin_out,
)
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number, format_quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Of an axis above and below its curve.
_MARGIN: Final = 0.12


def signals_picture(
    recording: Recording,
    phases: Sequence[Phase] = (),
    words: MachineWords = SAW,
    *,
    seconds: float,
    start_s: float = -np.inf,
    name: str = "signals",
) -> Picture | None:
    """Draw a stretch of every channel over time, gaps left open.

    Parameters
    ----------
    recording : Recording
    phases : sequence of Phase
        Those that are not running are marked.
    words : MachineWords
    seconds : float
        How much of the trial.
    start_s : float
        From this time on, or from the first sample where that is later.
    name : str
        Of the figure, unique within the page.

    Returns
    -------
    Picture or None
        None where no channel has a sample in that stretch.
    """
    order = [name for name in CHANNEL_BY_NAME if name in recording.signals]
    order += [name for name in recording.signals if name not in CHANNEL_BY_NAME]
    starts = [signal.time_s[0] for signal in recording.signals.values() if len(signal.time_s)]
    if not starts:
        return None
    first_s = max(min(starts), start_s)
    last_s = first_s + seconds
    shown = {channel: _window(recording.signals[channel], first_s, last_s) for channel in order}
    shown = {channel: part for channel, part in shown.items() if len(part[0]) > 1}
    if not shown:
        return None
    last_s = min(last_s, max(part[0][-1] for part in shown.values()))
    figure = _signal_panels(recording, phases, words, shown, first_s, last_s)
    finer = {
        axes.lines[0]: _window(recording.signals[channel], first_s, last_s, n_points=FINE_POINTS)
        for axes, channel in zip(figure.axes, shown, strict=True)
    }
    names = [words.label(channel) for channel in shown]
    marked = [p for p in phases if p.kind != "running" and p.start_s < last_s and p.end_s > first_s]
    kinds = sorted({words.not_running[p.kind] for p in marked})
    grey = f" Grey: {', '.join(kinds)}." if kinds else ""
    beyond = [words.label(channel) for channel, (_, values) in shown.items() if _overloads(channel, values).any()]
    overloads = f" Triangles: overloads of {', '.join(beyond)}, beyond the axis." if beyond else ""
    svg = figure_to_svg(
        figure,
        name=name,
        title="Measured signals over time",
        description=f"{', '.join(names)} from {first_s:.2f} to {last_s:.2f} s, one panel each.",
        finer=finer,
    )
    stretch = f"{first_s:.2f} to {last_s:.2f} s as recorded."
    caption = f"{stretch} Interruptions of a line are gaps in the recording.{grey}{overloads}"
    return Picture(svg=svg, caption=caption)


def _signal_panels(
    recording: Recording,
    phases: Sequence[Phase],
    words: MachineWords,
    shown: Mapping[str, tuple[Floats, Floats]],
    first_s: float,
    last_s: float,
) -> Figure:
    from matplotlib.figure import Figure

    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.55 + 1.15 * len(shown)), layout="constrained")
        axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (name, (time_s, values)) in zip(axes, shown.items(), strict=True):
            unit = recording.signals[name].unit
            axis.plot(time_s, values, color=CHANNEL_COLOURS.get(name, QUIET), linewidth=0.9)
            axis.set_ylabel(unit, rotation=0, ha="right", va="center")
            axis.set_title(_title(words, name), fontsize=9.5, color=INK, pad=3)
            axis.margins(y=_MARGIN)
            _mark_overloads(axis, name, time_s, values)
            axis.yaxis.set_major_locator(_few_ticks())
            for phase in phases:
                start_s, end_s = max(phase.start_s, first_s), min(phase.end_s, last_s)
                if phase.kind != "running" and start_s < end_s:
                    axis.axvspan(start_s, end_s, color="#eceff1", linewidth=0)
        axes[-1].set_xlim(first_s, last_s)
        axes[-1].set_xlabel("time / s")
        figure.align_ylabels(axes)
    return figure


def _mark_overloads(axis: Axes, channel: str, time_s: Floats, values: Floats) -> None:
    """Scale an axis to what its channel can have, and put a triangle where the instrument wrote beyond its range."""
    is_overload = _overloads(channel, values)
    if not is_overload.any():
        return
    kept = values[np.isfinite(values) & ~is_overload]
    margin = _MARGIN * float(np.ptp(kept))
    low, high = float(kept.min()) - margin, float(kept.max()) + margin
    axis.set_ylim(low, high)
    for edge, marker, is_beyond in ((high, "^", values > high), (low, "v", values < low)):
        at = time_s[is_overload & is_beyond]
        axis.plot(at, np.full(len(at), edge), marker, color=INK, markersize=5, clip_on=False, zorder=3)


def _overloads(channel: str, values: Floats) -> NDArray[np.bool_]:
    """Overloads of a drawn line, whose gaps are not finite."""
    found = np.isfinite(values)
    found[found] = find_overloads(values[found], channel)
    return found


def _title(words: MachineWords, channel: str) -> str:
    """Words of a channel as a title; a name that is no words stays as it is."""
    label = words.label(channel)
    return label if label == channel else label.capitalize()


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4, min_n_ticks=2)


def _window(signal: Signal, first_s: float, last_s: float, n_points: int = 1600) -> tuple[Floats, Floats]:
    inside = slice(*np.searchsorted(signal.time_s, [first_s, np.nextafter(last_s, np.inf)]))
    time_s, values = thin_out(signal.time_s[inside], signal.values[inside], n_points=n_points)
    inner = [gap for gap in signal.gaps if first_s <= gap.start_s and gap.end_s <= last_s]
    middle_s = np.array([0.5 * (gap.start_s + gap.end_s) for gap in inner])
    at = np.searchsorted(time_s, middle_s)
    return np.insert(time_s, at, middle_s), np.insert(values, at, np.nan)


def cycle_picture(processed: ProcessedTrial, simulated: Mapping[str, Floats] | None) -> Picture | None:
    """Draw the folded cycle: force with what was removed, and motor current, each with the fitted model.

    Parameters
    ----------
    processed : ProcessedTrial
    simulated : mapping of str to ndarray, optional
        `angle_rad` and any of `force_n`, `motor_current_a`, all shape (n,), over one turn.

    Returns
    -------
    Picture or None
        None where neither force nor motor current was folded.
    """
    from matplotlib.figure import Figure

    names = [name for name in (FORCE.name, MOTOR_CURRENT.name) if name in processed.folded]
    if not names:
        return None
    words = words_of(processed.frame)
    heights = [{FORCE.name: 3.3, MOTOR_CURRENT.name: 2.3}[name] for name in names]
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.5 + sum(heights)), layout="constrained")
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        for axis, name in zip(axes, names, strict=True):
            channel = CHANNEL_BY_NAME[name]
            if name == FORCE.name:
                _draw_force(axis, processed)
            else:
                _draw_band(axis, processed.folded[name], CHANNEL_COLOURS[name], "measured, mean ± 1 std")
            if simulated is not None and name in simulated:
                angle_deg, values = _one_turn(simulated["angle_rad"], simulated[name])
                axis.plot(angle_deg, values, color=MODEL, dashes=(5, 2), linewidth=1.3, label="fitted model")
            axis.set_title(words.label(name).capitalize())
            axis.set_ylabel(f"{channel.label.split()[-1]} / {channel.unit}")
            axis.margins(y=0.1)
            # The current never returns to zero, so its curve may fill the corner that the force leaves free.
            axis.legend(loc=_emptier_corner(processed) if name == FORCE.name else "best")
            cycle_axis(axis, words)
        for axis in axes[:-1]:
            axis.set_xlabel("")
    svg = figure_to_svg(
        figure,
        name="cycle",
        title=f"Folded {words.cycle}",
        description=_describe_cycle(processed, simulated),
    )
    n_cycles = processed.folded[names[0]].n_cycles
    caption = _folded_words(n_cycles, words)
    if processed.removed is not None:
        caption += " Grey: force on the return stroke, shown as measured and set to zero in the results."
    return Picture(svg=svg, caption=caption)


def zeroed_picture(processed: ProcessedTrial) -> Picture | None:
    """Draw the folded force as measured, and beside it with the return stroke set to zero.

    Returns
    -------
    Picture or None
        None where no return stroke was zeroed.
    """
    from matplotlib.figure import Figure

    cutting, words = processed.cutting_force, words_of(processed.frame)
    if cutting is None or processed.removed is None:
        return None
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
        before, after = figure.subplots(1, 2, sharey=True)
        _draw_force(before, processed)
        _draw_band(after, cutting, FORCE_COLOUR, "cutting force, mean ± 1 std")
        after.axhline(0.0, color=QUIET, linewidth=0.7)
        before.set_title("As measured")
        after.set_title("Return stroke set to zero")
        before.set_ylabel("force / N")
        for axis in (before, after):
            axis.legend(loc=_emptier_corner(processed), fontsize=8.5)
            axis.margins(y=0.1)
            cycle_axis(axis, words)
            axis.set_xticks([0, 90, 180, 270, 360])
    svg = figure_to_svg(
        figure,
        name="zeroed",
        title="Folded force before and after zeroing the return stroke",
        description=_describe_cycle(processed, None),
    )
    caption = f"{_folded_words(cutting.n_cycles, words)} Grey: force on the return stroke, set to zero in the results."
    return Picture(svg=svg, caption=caption)


def _folded_words(n_cycles: int, words: MachineWords) -> str:
    return f"{n_cycles} {words.cycle}s {words.folded}; {words.zero}."


def _emptier_corner(processed: ProcessedTrial) -> str:
    """Return the corner over the return stroke, where the curves are low."""
    is_second = processed.removed is not None and processed.removed.half == "pi_to_2pi"
    return "upper right" if is_second else "upper left"


def _draw_force(axis: Axes, processed: ProcessedTrial) -> None:
    measured = processed.folded[FORCE.name]
    if processed.cutting_force is None or processed.removed is None:
        _draw_band(axis, measured, FORCE_COLOUR, "measured, mean ± 1 std")
        return
    first_half = measured.angle_rad < np.pi
    is_removed = first_half if processed.removed.half == "zero_to_pi" else ~first_half
    angle_deg = np.degrees(measured.angle_rad)
    kept, removed = np.where(is_removed, np.nan, measured.mean), np.where(is_removed, measured.mean, np.nan)
    _draw_band(axis, measured, FORCE_COLOUR, "cutting, mean ± 1 std", mean=kept)
    axis.plot(angle_deg, removed, color=QUIET, linewidth=1.0)
    axis.fill_between(
        angle_deg,
        0.0,
        removed,
        facecolor="none",
        edgecolor=QUIET,
        hatch="////",
        linewidth=0.0,
        label="removed",
    )
    axis.axhline(0.0, color=QUIET, linewidth=0.7)


def _draw_band(axis: Axes, cycle: FoldedCycle, colour: str, label: str, *, mean: Floats | None = None) -> None:
    mean = cycle.mean if mean is None else mean
    angle_deg = np.degrees(cycle.angle_rad)
    axis.fill_between(angle_deg, mean - cycle.std, mean + cycle.std, color=colour, alpha=0.22, linewidth=0.0)
    axis.plot(angle_deg, mean, color=colour, label=label)


def _one_turn(angle_rad: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return one turn in order of the crank angle, in degrees."""
    angle_deg = np.degrees(np.mod(angle_rad, 2.0 * np.pi))
    order = np.argsort(angle_deg, kind="stable")
    return angle_deg[order], np.asarray(values)[order]


def _describe_cycle(processed: ProcessedTrial, simulated: Mapping[str, Floats] | None) -> str:
    parts = []
    if FORCE.name in processed.folded:
        cycle = processed.folded[FORCE.name]
        top = int(np.nanargmax(cycle.mean))
        angle_deg = format_number(float(np.degrees(cycle.angle_rad[top])), digits=3)
        parts.append(f"Peak of the mean force: {format_number(float(cycle.mean[top]))} N near {angle_deg}°.")
    if processed.removed is not None:
        parts.append(f"Removed return stroke:  {format_quantity(processed.removed.rms_n, None, 'N')} RMS.")
    if MOTOR_CURRENT.name in processed.folded:
        cycle = processed.folded[MOTOR_CURRENT.name]
        low, high = float(np.nanmin(cycle.mean)), float(np.nanmax(cycle.mean))
        parts.append(f"Motor current from {format_number(low)} to {format_number(high)} A.")
    if simulated is not None:
        parts.append("The fitted model is dashed.")
    return " ".join(parts)
