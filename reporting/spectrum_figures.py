"""Spectra on the trial page: the line that was taken for the stroke, and the harmonics of force and current."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.processed import PeriodEstimate, ProcessedTrial
from sawbench.bench.recording import Floats
from sawbench.bench.units import CHANNEL_BY_NAME, FORCE, MOTOR_CURRENT
from sawbench.modeling.machines.words import MachineWords
from sawbench.processing.spectrum import Spectrum
from sawbench.reporting.figures import (
    CHANNEL_COLOURS,
    INK,
    QUIET,
    SERIES_COLOURS,
    SERIES_MARKERS,
    WIDTH_IN,
    figure_style,
    thin_out,
)
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Cycle = Mapping[str, Floats]
_SHOWN_RATES: Final = 6.5
"""The spectrum is shown up to so many stroke rates."""
_MOST_RIVALS: Final = 3
_MOST_HARMONICS: Final = 16
_DECADES: Final = 1e-5


def period_picture(spectra: Mapping[str, Spectrum], period: PeriodEstimate, words: MachineWords) -> Picture | None:
    """Draw the spectra of the running part, with the line taken for the stroke and its rivals.

    Parameters
    ----------
    spectra : mapping of str to Spectrum
        By channel.
    period : PeriodEstimate
    words : MachineWords

    Returns
    -------
    Picture or None
        None where there is no spectrum.
    """
    from matplotlib.figure import Figure

    if not spectra:
        return None
    last_hz = _SHOWN_RATES * max([period.rate_hz, *(1.0 / rival.period_s for rival in period.rivals[:1])])
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.6 + 1.75 * len(spectra)), layout="constrained")
        axes = figure.subplots(len(spectra), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (name, spectrum) in zip(axes, spectra.items(), strict=True):
            _draw_spectrum(axis, name, spectrum, last_hz, words)
            _mark_lines(axis, period, words)
        axes[0].legend(loc="upper right", ncols=2, fontsize=8.5)
        axes[-1].set_xlim(0.0, last_hz)
        axes[-1].set_xlabel("frequency / Hz")
        svg = figure_to_svg(
            figure,
            name="period",
            title=f"Spectrum with the line of the {words.cycle}",
            description=_describe(spectra, period, words),
        )
    return Picture(
        svg=svg,
        caption="Amplitude spectrum of the longest running stretch without a gap (Hann window)."
        f" Solid line: the {words.cycle}, {format_number(period.rate_hz)} Hz, found in the"
        f" {words.label(period.channel)}; dotted: its harmonics."
        + (f" Dashed: alternatives, other possible {words.rate}s." if period.rivals else " There is no alternative."),
    )


def _draw_spectrum(axis: Axes, name: str, spectrum: Spectrum, last_hz: float, words: MachineWords) -> None:
    is_shown = (spectrum.frequency_hz > 0.0) & (spectrum.frequency_hz <= last_hz)
    frequency_hz, amplitude = thin_out(spectrum.frequency_hz[is_shown], np.sqrt(spectrum.power[is_shown]), n_points=900)
    axis.semilogy(frequency_hz, amplitude, color=CHANNEL_COLOURS.get(name, QUIET), linewidth=0.9)
    top = float(amplitude.max())
    axis.set_ylim(max(_DECADES * top, 0.5 * float(amplitude.min())), 3.0 * top)
    channel = CHANNEL_BY_NAME.get(name)
    axis.set_title(words.label(name).capitalize())
    axis.set_ylabel(f"amplitude / {channel.unit if channel else ''}")


def _mark_lines(axis: Axes, period: PeriodEstimate, words: MachineWords) -> None:
    axis.axvline(period.rate_hz, color=INK, linewidth=1.4, label=f"{words.cycle}, {period.rate_hz:.4g} Hz", zorder=0)
    for order in range(2, int(_SHOWN_RATES) + 1):
        axis.axvline(order * period.rate_hz, color=QUIET, linewidth=0.8, linestyle=":", zorder=0)
    for rank, rival in enumerate(period.rivals[:_MOST_RIVALS]):
        rate_hz = 1.0 / rival.period_s
        axis.axvline(
            rate_hz,
            color=SERIES_COLOURS[3 + rank],
            linestyle="--",
            linewidth=1.1,
            label=f"alternative, {rate_hz:.4g} Hz",
        )


def _describe(spectra: Mapping[str, Spectrum], period: PeriodEstimate, words: MachineWords) -> str:
    names = " and ".join(words.label(name) for name in spectra)
    rivals = ", ".join(f"{1.0 / rival.period_s:.4g} Hz" for rival in period.rivals[:_MOST_RIVALS]) or "none"
    return f"Spectrum of {names}; the {words.cycle} is the line at {period.rate_hz:.4g} Hz; alternatives: {rivals}."


def harmonics_picture(processed: ProcessedTrial, model: Mapping[str, Cycle]) -> Picture | None:
    """Draw amplitudes of the harmonics of the stroke, measured and modelled, and those of the deviations.

    Parameters
    ----------
    processed : ProcessedTrial
    model : mapping of str to mapping
        By name of the model: `angle_rad`, `force_n`, `motor_current_a`, shape (n,) each.

    Returns
    -------
    Picture or None
        None where neither force nor motor current was folded.
    """
    from matplotlib.figure import Figure

    folded = {name: processed.folded[name] for name in (FORCE.name, MOTOR_CURRENT.name) if name in processed.folded}
    if not folded or not model:
        return None
    orders = np.arange(1, _MOST_HARMONICS + 1)
    said = []
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.5 + 2.1 * len(folded)), layout="constrained")
        grid = figure.subplots(len(folded), 2, squeeze=False, sharex=True)
        for row, (name, cycle) in zip(grid, folded.items(), strict=True):
            channel = CHANNEL_BY_NAME[name]
            measured = _harmonics(cycle.mean)
            row[0].semilogy(orders, measured, "o-", color=CHANNEL_COLOURS[name], linewidth=0.8, label="measured")
            for place, (words, curves) in enumerate(model.items()):
                values = np.interp(cycle.angle_rad, curves["angle_rad"], curves[name], period=2.0 * np.pi)
                style = {"color": MODEL_COLOURS[place], "marker": SERIES_MARKERS[place + 1], "linewidth": 0.8}
                row[0].semilogy(orders, _harmonics(values), **style, markersize=4, label=f"model, {words}")
                row[1].semilogy(orders, _harmonics(cycle.mean - values), **style, markersize=4, label=f"minus {words}")
            for axis in row:
                axis.set_ylim(bottom=max(axis.get_ylim()[0], 1e-4 * float(measured.max())))
            row[0].set_title(channel.label.capitalize())
            row[1].set_title("Measured minus model")
            for axis in row:
                axis.set_ylabel(f"amplitude / {channel.unit}")
            said.append(f"{channel.label}: first harmonic {format_number(float(measured[0]))} {channel.unit}")
        for axis in grid[-1]:
            axis.set_xlabel("harmonic of the stroke")
            axis.set_xticks(orders[::3])
        grid[0][0].legend(loc="upper right", fontsize=8.5)
        svg = figure_to_svg(
            figure,
            name="harmonics",
            title="Spectra over the harmonics of the stroke",
            description="; ".join(said) + ".",
        )
    return Picture(
        svg=svg,
        caption="Amplitudes of the harmonics of the folded cycle: first measured and modelled, then the deviations.",
    )


MODEL_COLOURS: Final = ("#000000", "#0072b2")
"""Of the linear and of the measured-force model."""


def _harmonics(values: Floats) -> Floats:
    """Amplitudes of harmonics 1.. of one turn; angles without a stroke are taken at the mean."""
    known = np.where(np.isfinite(values), values, np.nanmean(values))
    return 2.0 * np.abs(np.fft.rfft(known))[1 : _MOST_HARMONICS + 1] / len(known)
