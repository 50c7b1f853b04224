"""The page of one trial: what was found, how far to trust it, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from sawbench.bench.processed import ChannelQuality, ProcessedTrial
from sawbench.bench.recording import Floats, Recording
from sawbench.bench.units import BATTERY_CURRENT, CHANNEL_BY_NAME, MOTOR_CURRENT
from sawbench.modeling.results import CuttingFit, RuntimePrediction
from sawbench.reporting.compared import FIT_STATUS_WORDS, RUNTIME_STATUS_WORDS
from sawbench.reporting.html import Picture, link_to, render, software_version, write_page
from sawbench.reporting.quantities import format_duration, format_number, format_quantity
from sawbench.reporting.trial_figures import cycle_picture, signals_picture


@dataclass(frozen=True, kw_only=True, slots=True)
class Tile:
    """A headline number."""

    label: str
    value: str
    detail: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Trust:
    """How far the results can be relied on: "good", "warn" or "bad", in words, with reasons."""

    level: str
    words: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A part of the page: pictures and paragraphs under one heading."""

    heading: str
    pictures: tuple[Picture, ...] = ()
    texts: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the provenance table."""

    label: str
    value: str
    href: str = ""
    is_hash: bool = False


_STATUS_WORDS: Final = {
    "cutting": "The saw cut",
    "no_cutting": "The blade ran without cutting",
    "stalled": "The saw stalled",
    "no_stroke": "No stroke was found",
}
_HALF_WORDS: Final = {"zero_to_pi": "0° to 180°", "pi_to_2pi": "180° to 360°"}


def write_trial_page(
    path: str | Path,
    *,
    processed: ProcessedTrial,
    fit: CuttingFit | None = None,
    runtime: RuntimePrediction | None = None,
    simulated: Mapping[str, Floats] | None = None,
    files: Mapping[str, str | Path] | None = None,
    recording: Recording | None = None,
    preview_s: float = 1.0,
    overwrite: bool = False,
) -> Path:
    """Write the page of one trial.

    Parameters
    ----------
    path : str or Path
        HTML file; its folder must exist.
    processed : ProcessedTrial
    fit, runtime : CuttingFit, RuntimePrediction, optional
    simulated : mapping of str to ndarray, optional
        The fitted model over one turn, drawn over the measurement: `angle_rad` and any of `force_n`,
        `motor_current_a`, shape (n,).
    files : mapping of str to path, optional
        Files to name on the page, by what they are ("Recording", "Rerun view", ...).
    recording : Recording, optional
        For the plot of the signals over time.
    preview_s : float
        How much of it is plotted, s.
    overwrite : bool

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    trial = processed.trial
    context = {
        "title": f"Trial {trial.trial_id}: {_material(processed)}",
        "heading": f"Trial {trial.trial_id}",
        "subtitle": _subtitle(processed),
        "is_simulated": "simulated" in trial.source,
        "verdict": verdict(processed, fit, runtime),
        "tiles": _tiles(processed, fit, runtime),
        "trust": _trust(processed, fit, runtime),
        "sections": _sections(
            processed, fit=fit, runtime=runtime, simulated=simulated, recording=recording, preview_s=preview_s
        ),
        "quality": [_quality_row(row) for row in processed.quality],
        "provenance": _provenance(processed, files or {}, path),
    }
    return write_page(path, render("trial_page.html.j2", context), overwrite=overwrite)


def verdict(processed: ProcessedTrial, fit: CuttingFit | None, runtime: RuntimePrediction | None) -> str:
    """Say in plain sentences what the trial showed.

    Parameters
    ----------
    processed : ProcessedTrial
    fit, runtime : CuttingFit, RuntimePrediction or None
        Results whose status is not "ok" are not quoted.

    Returns
    -------
    str
    """
    what = _STATUS_WORDS[processed.status]
    if processed.status == "cutting":
        what += f" {_material(processed)}"
    if processed.period is not None:
        what += f" at {_stroke_rate(processed)}"
    parts = [f"{what}."]
    if processed.peak_force_n is not None and processed.status == "cutting":
        peak = format_quantity(processed.peak_force_n, processed.peak_force_std_n, "N")
        parts.append(f"The force peaks at {peak}.")
    if fit is not None and fit.status == "ok":
        k_fc = format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m")
        parts.append(f"The linear cutting coefficient k_Fc is {k_fc}.")
    if runtime is not None and runtime.status == "ok":
        lasts = format_quantity(runtime.runtime_s, runtime.std_s, "s")
        parts.append(f"Cutting like this, a full battery lasts {lasts} ({format_duration(runtime.runtime_s)}).")
    return " ".join(parts)


def _short(value: float | None, unit: str) -> str:
    """Write a value that has no stated uncertainty and only describes."""
    return format_quantity(value, None, unit, digits=3)


def _material(processed: ProcessedTrial) -> str:
    if processed.trial.is_idle:
        return "blade in air"
    return processed.trial.material or "a material that is not stated"


def _stroke_rate(processed: ProcessedTrial) -> str:
    period = processed.period
    assert period is not None
    return format_quantity(period.rate_hz, period.period_std_s / period.period_s**2, "Hz")


def _subtitle(processed: ProcessedTrial) -> str:
    trial = processed.trial
    parts = [_material(processed)]
    if trial.repetition is not None:
        parts.append(f"repetition {trial.repetition}")
    if trial.started_at is not None:
        parts.append(f"{trial.started_at:%Y-%m-%d %H:%M} {trial.started_at:%Z}".strip())
    return ", ".join([*parts, trial.source])


def _tiles(processed: ProcessedTrial, fit: CuttingFit | None, runtime: RuntimePrediction | None) -> list[Tile]:
    tiles = []
    if processed.period is not None:
        period = processed.period
        detail = f"period {format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, 'ms')}"
        tiles.append(Tile(label="Stroke rate", value=_stroke_rate(processed), detail=detail))
    if processed.peak_force_n is not None:
        peak = format_quantity(processed.peak_force_n, processed.peak_force_std_n, "N")
        tiles.append(Tile(label="Peak force", value=peak, detail="mean over the strokes"))
    if fit is not None:
        k_fc = format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m")
        detail = f"from {fit.method.replace('_', ' ')}"
        if fit.status != "ok":
            k_fc, detail = "not reliable", f"{FIT_STATUS_WORDS[fit.status]}, at {k_fc}"
        tiles.append(Tile(label="Cutting coefficient k_Fc", value=k_fc, detail=detail))
    if runtime is not None:
        value = format_quantity(runtime.runtime_s, runtime.std_s, "s")
        detail = format_duration(runtime.runtime_s)
        if runtime.status != "ok":
            value, detail = "not known", RUNTIME_STATUS_WORDS[runtime.status]
        tiles.append(Tile(label="Battery runtime", value=value, detail=detail))
    for values, channel, label in (
        (processed.rms_values, MOTOR_CURRENT, "RMS motor current"),
        (processed.mean_values, BATTERY_CURRENT, "Mean battery current"),
    ):
        if channel.name in values:
            shown = format_quantity(values[channel.name], None, channel.unit)
            tiles.append(Tile(label=label, value=shown, detail="while running"))
    return tiles


def _trust(processed: ProcessedTrial, fit: CuttingFit | None, runtime: RuntimePrediction | None) -> Trust:
    bad, warn = [], list(processed.warnings)
    if processed.status in {"stalled", "no_stroke"}:
        bad.append(f"{_STATUS_WORDS[processed.status]}; there is no cycle to evaluate.")
    if processed.period is not None and processed.period.confidence != "high":
        sink = bad if processed.period.confidence == "low" else warn
        sink.append(f"Stroke period: {processed.period.confidence} confidence, {processed.period.reason}.")
    if processed.removed is not None and processed.removed.looks_swapped:
        bad.append(
            "The half that was zeroed carries more force than the half that was kept: "
            "cutting_half in the configuration is probably wrong."
        )
    if fit is not None and fit.status != "ok":
        bad.append(f"k_Fc is not to be relied on: {FIT_STATUS_WORDS[fit.status]}.")
    if runtime is not None and runtime.status != "ok":
        bad.append(f"No runtime: {RUNTIME_STATUS_WORDS[runtime.status]}.")
    warn += [f"{row.channel}: {problem}" for row in processed.quality for problem in row.problems]
    reasons = tuple(dict.fromkeys([*bad, *warn]))
    if bad:
        return Trust(level="bad", words="Do not rely on every result of this trial.", reasons=reasons)
    if warn:
        return Trust(level="warn", words="Usable, with remarks.", reasons=reasons)
    return Trust(level="good", words="No problem was found in this trial.", reasons=())


def _sections(
    processed: ProcessedTrial,
    *,
    fit: CuttingFit | None,
    runtime: RuntimePrediction | None,
    simulated: Mapping[str, Floats] | None,
    recording: Recording | None,
    preview_s: float,
) -> list[Section]:
    found = []
    cycle = cycle_picture(processed, simulated)
    if cycle is not None:
        texts = () if processed.removed is None else (_removed_words(processed),)
        found.append(Section(heading="One stroke", pictures=(cycle,), texts=texts))
    signals = None if recording is None else signals_picture(recording, processed.phases, seconds=preview_s)
    if signals is not None:
        found.append(Section(heading="Signals over time", pictures=(signals,)))
    if processed.period is not None:
        found.append(Section(heading="Stroke period", texts=_period_words(processed)))
    if fit is not None:
        found.append(Section(heading="Cutting coefficient", texts=_fit_words(fit)))
    if runtime is not None and runtime.status == "ok":
        found.append(Section(heading="Battery runtime", texts=_runtime_words(runtime)))
    return found


def _removed_words(processed: ProcessedTrial) -> str:
    removed = processed.removed
    assert removed is not None
    return (
        f"Zeroing the return stroke ({_HALF_WORDS.get(removed.half, removed.half)}) took away a force of "
        f"{_short(removed.mean_n, 'N')} mean, {_short(removed.rms_n, 'N')} RMS "
        f"and {_short(removed.peak_n, 'N')} peak: "
        f"{format_number(100.0 * removed.share_of_impulse, digits=2)} % of the whole cycle's impulse."
    )


def _period_words(processed: ProcessedTrial) -> tuple[str, ...]:
    period = processed.period
    assert period is not None
    channel = CHANNEL_BY_NAME.get(period.channel)
    texts = [
        f"{format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, 'ms')} over {period.n_cycles} "
        f"whole strokes of the {channel.label if channel else period.channel}, varying from stroke to "
        f"stroke by {_short(1e3 * period.spread_s, 'ms')}. Confidence: {period.confidence} ({period.reason})."
    ]
    for rival in period.rivals:
        texts.append(
            f"Also possible: {_short(1e3 * rival.period_s, 'ms')} with "
            f"{format_number(100.0 * rival.relative_power, digits=2)} % of the power ({rival.reason})."
        )
    return tuple(texts)


def _fit_words(fit: CuttingFit) -> tuple[str, ...]:
    k_fc = format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m")
    statistical = _short(fit.statistical_std_n_s_per_m, "N·s/m")
    residuals = [
        f"{_short(rmse, unit)} in the {name}"
        for rmse, unit, name in ((fit.rmse_a, "A", "motor current"), (fit.rmse_n, "N", "force"))
        if rmse is not None
    ]
    texts = [
        f"k_Fc = {k_fc}, fitted to the {fit.method.replace('_', ' ')}. Of the uncertainty, {statistical} "
        "would shrink with more strokes; the rest comes from the plant's constants and the sensors' gains."
    ]
    if residuals:
        texts.append(f"What the fit leaves (RMS): {' and '.join(residuals)}.")
    return (*texts, fit.identifiability, *fit.notes)


def _runtime_words(runtime: RuntimePrediction) -> tuple[str, ...]:
    end = {"soc": "the cut-off state of charge", "voltage": "the cut-off voltage"}[runtime.ended_by]
    texts = [
        f"{format_quantity(runtime.runtime_s, runtime.std_s, 's')} from full charge to {end}, at a mean "
        f"battery current of {_short(runtime.mean_battery_current_a, 'A')} and a mean motor current of "
        f"{_short(runtime.mean_motor_current_a, 'A')}. The numerical error is below "
        f"{_short(runtime.numerical_error_s, 's')}."
    ]
    if runtime.appendix_a_runtime_s is not None:
        shown = format_quantity(runtime.appendix_a_runtime_s, None, "s")
        texts.append(f"Usable charge over the measured mean battery current gives {shown}.")
    largest = sorted(runtime.contributions_s.items(), key=lambda item: -item[1])[:3]
    if largest:
        words = [f"{name} {_short(std, 's')}" for name, std in largest]
        texts.append(f"The largest parts of its uncertainty: {', '.join(words)}.")
    return tuple(texts)


def _quality_row(row: ChannelQuality) -> dict[str, Any]:
    return {
        "channel": row.channel,
        "rate": format_quantity(row.rate_hz, None, "Hz"),
        "n_samples": row.n_samples,
        "n_missing": row.n_missing,
        "noise": _short(row.noise_std, row.unit),
        "jitter": _short(1e6 * row.jitter_std_s, "µs"),
        "n_spikes": row.n_spikes,
        "n_clipped": row.n_clipped,
        "problems": "; ".join(row.problems) or "none",
    }


def _provenance(processed: ProcessedTrial, files: Mapping[str, str | Path], page: str | Path) -> list[Row]:
    trial = processed.trial
    settings: list[tuple[str, str | None]] = [
        ("Material", _material(processed)),
        ("Thickness", None if trial.thickness_mm is None else f"{trial.thickness_mm:g} mm"),
        ("Feed", None if trial.feed_mm_s is None else f"{trial.feed_mm_s:g} mm/s"),
        ("Duty", None if trial.duty is None else f"{100.0 * trial.duty:.4g} %"),
        ("Blade", trial.blade),
        ("Battery", trial.battery),
        ("Operator", trial.operator),
        ("Started", None if trial.started_at is None else trial.started_at.isoformat(sep=" ")),
        ("Notes", trial.notes or None),
        ("Source", trial.source),
    ]
    rows = [Row(label=label, value=value) for label, value in settings if value]
    for label, target in files.items():
        href, text = link_to(target, page)
        rows.append(Row(label=label, value=text, href=href))
    if processed.source_path and "Recording" not in files:
        rows.append(Row(label="Recording", value=Path(processed.source_path).name))
    if processed.source_sha256:
        rows.append(Row(label="SHA-256 of the recording", value=processed.source_sha256, is_hash=True))
    return [*rows, Row(label="Software", value=software_version())]
