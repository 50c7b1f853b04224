"""The page of one trial: what was found, how far to trust it, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.bench.processed import ChannelQuality, ProcessedTrial
from sawbench.bench.recording import Recording
from sawbench.bench.units import BATTERY_CURRENT, CHANNEL_BY_NAME, MOTOR_CURRENT
from sawbench.modeling.discharge import DischargeCurves
from sawbench.modeling.machines.words import words_of
from sawbench.modeling.results import CuttingFit, RuntimePrediction
from sawbench.processing.spectrum import Spectrum
from sawbench.reporting.compared import FIT_STATUS_WORDS, RUNTIME_STATUS_WORDS
from sawbench.reporting.html import Picture, link_to, render, software_version
from sawbench.reporting.model_figures import Deviation, deviations_of, discharge_picture, model_picture
from sawbench.reporting.quantities import correlation_words, format_duration, format_number, format_quantity
from sawbench.reporting.rejections import wrong_duty
from sawbench.reporting.spectrum_figures import Cycle, harmonics_picture, period_picture
from sawbench.reporting.trial_figures import cycle_picture, signals_picture, zeroed_picture
from sawbench.storage.output import write_whole


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
    """A part of the page: pictures, the table of deviations and paragraphs under one heading."""

    heading: str
    pictures: tuple[Picture, ...] = ()
    texts: tuple[str, ...] = ()
    table: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the provenance table."""

    label: str
    value: str
    href: str = ""
    is_hash: bool = False


# The plot in detail is so long, and begins so much of its length before the first motion.
_DETAIL_S: Final = 1.0
_BEFORE_MOTION: Final = 0.05
# The whole trial is plotted where it is so many times longer than the plot in detail.
_LONGER: Final = 1.5
_HALF_WORDS: Final = {"zero_to_pi": "0° to 180°", "pi_to_2pi": "180° to 360°"}


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialReport:
    """Everything the page of a trial shows.

    Attributes
    ----------
    processed : ProcessedTrial
    fit, runtime : CuttingFit, RuntimePrediction or None
    note : str
        Why there is no fit or runtime.
    model : mapping of str to mapping
        One settled stroke of the fitted model by name of its force: `angle_rad` and any of `force_n`,
        `motor_current_a`, shape (n,) each.
    discharges : mapping of str to DischargeCurves
        By name of the force.
    spectra : mapping of str to Spectrum
        Of the running part, by channel.
    recording : Recording or None
        For the plots of the signals over time.
    """

    processed: ProcessedTrial
    fit: CuttingFit | None = None
    runtime: RuntimePrediction | None = None
    note: str = ""
    model: Mapping[str, Cycle] = field(default_factory=dict)
    discharges: Mapping[str, DischargeCurves] = field(default_factory=dict)
    spectra: Mapping[str, Spectrum] = field(default_factory=dict)
    recording: Recording | None = None


def write_trial_page(
    path: str | Path,
    report: TrialReport,
    *,
    files: Mapping[str, str | Path] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page of one trial.

    Parameters
    ----------
    path : str or Path
        HTML file; its folder must exist.
    report : TrialReport
    files : mapping of str to path, optional
        Files to name on the page, by what they are ("Recording", "Rerun view", ...).
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    processed = report.processed
    trial = processed.trial
    context = {
        "title": f"Trial {trial.trial_id}: {_material(processed)}",
        "heading": f"Trial {trial.trial_id}",
        "facts": trial_facts(processed),
        "is_simulated": "simulated" in trial.source,
        "verdict": verdict(processed, report.fit, report.runtime),
        "tiles": _tiles(processed, report.fit, report.runtime),
        "trust": trust_in(report),
        "is_complete": is_complete(report),
        "sections": _sections(report),
        "quality": [_quality_row(row) for row in sorted(processed.quality, key=_place)],
        "provenance": _provenance(processed, files or {}, path),
    }
    return write_whole(path, render("trial_page.html.j2", context), overwrite=overwrite)


def verdict(processed: ProcessedTrial, fit: CuttingFit | None, runtime: RuntimePrediction | None) -> str:
    """Say in plain sentences what the trial showed.

    Parameters
    ----------
    processed : ProcessedTrial
    fit, runtime : CuttingFit, RuntimePrediction or None
        Results whose status is not "ok" are not quoted.
    """
    what = words_of(processed.frame).statuses[processed.status]
    if processed.status == "cutting":
        what += f" {_material(processed)}"
    if processed.period is not None:
        what += f" at {_stroke_rate(processed)}"
    parts = [f"{what}."]
    if processed.peak_force_n is not None and processed.status == "cutting":
        peak = format_quantity(processed.peak_force_n, processed.peak_force_std_n, "N")
        parts.append(f"Peak force: {peak}.")
    if fit is not None and fit.status == "ok":
        k_fc = format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m")
        parts.append(f"The linear cutting coefficient k_Fc is {k_fc}.")
    if runtime is not None and runtime.status == "ok":
        lasts = format_quantity(runtime.runtime_s, runtime.std_s, "s")
        parts.append(f"At this load a full battery lasts {lasts} ({format_duration(runtime.runtime_s)}).")
    return " ".join(parts)


def _short(value: float | None, unit: str) -> str:
    """Write a value that has no stated uncertainty and only describes."""
    return format_quantity(value, None, unit, digits=3)


def _material(processed: ProcessedTrial) -> str:
    words = words_of(processed.frame)
    return words.idle if processed.trial.is_idle else processed.trial.material or f"an unknown {words.load}"


def _stroke_rate(processed: ProcessedTrial) -> str:
    period = processed.period
    assert period is not None
    return format_quantity(period.rate_hz, period.period_std_s / period.period_s**2, "Hz")


def trial_facts(processed: ProcessedTrial) -> list[Row]:
    """Return what was done in a trial, fact by fact; what nobody stated is said so, if such a machine has it."""
    trial, words = processed.trial, words_of(processed.frame)
    date = None if trial.started_at is None else f"{trial.started_at:%Y-%m-%d %H:%M %Z}".strip()
    settings = {
        "thickness": None if trial.thickness_mm is None else f"{trial.thickness_mm:g} mm",
        "duty": None if trial.duty is None else f"{trial.duty:.4g}",
        "feed": None if trial.feed_mm_s is None else f"{trial.feed_mm_s:g} mm/s",
        "repetition": None if trial.repetition is None else str(trial.repetition),
        "blade": trial.blade,
        "battery": trial.battery,
    }
    facts: list[tuple[str, str | None]] = [
        (words.load.capitalize(), _material(processed)),
        *((name.capitalize(), value) for name, value in settings.items() if value or name in words.settings),
        ("Operator", trial.operator),
        ("Date", date),
        ("File", Path(processed.source_path).name or None),
        ("Source", trial.source),
        ("Software", software_version()),
    ]
    facts += [("Corrected", said) for said in trial.amendments]
    return [Row(label=label, value=value or "not stated") for label, value in facts]


def _tiles(processed: ProcessedTrial, fit: CuttingFit | None, runtime: RuntimePrediction | None) -> list[Tile]:
    tiles, words = [], words_of(processed.frame)
    if processed.period is not None:
        period = processed.period
        detail = f"period {format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, 'ms')}"
        tiles.append(Tile(label=words.rate.capitalize(), value=_stroke_rate(processed), detail=detail))
    if processed.peak_force_n is not None:
        peak = format_quantity(processed.peak_force_n, processed.peak_force_std_n, "N")
        tiles.append(Tile(label="Peak force", value=peak, detail="mean over the strokes; ± without the sensor's gain"))
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
            tiles.append(Tile(label=label, value=shown, detail="measured, while running"))
    return tiles


def trust_in(report: TrialReport) -> Trust:
    """Judge how far the results of a trial can be relied on.

    Returns
    -------
    Trust
        "bad" where a result is not reliable or a channel lost more than 1 % of its samples.
    """
    processed, fit, runtime = report.processed, report.fit, report.runtime
    words, bad, warn = words_of(processed.frame), [], list(processed.warnings)
    if processed.status in {"stalled", "no_stroke"}:
        bad.append(f"{words.statuses[processed.status]}; there is no cycle to evaluate.")
    if processed.period is not None and processed.period.confidence != "high":
        sink = bad if processed.period.confidence == "low" else warn
        sink.append(
            f"{words.period.capitalize()}: {processed.period.confidence} confidence, {processed.period.reason}."
        )
    if processed.losses:
        bad.append(f"Too many samples were lost: {', '.join(processed.losses)}.")
    if processed.removed is not None and processed.removed.looks_swapped:
        bad.append(
            "The half set to zero has more force than the other half: "
            "cutting_half in the configuration is probably wrong."
        )
    if fit is not None and fit.status != "ok":
        bad.append(f"k_Fc is not reliable: {FIT_STATUS_WORDS[fit.status]}.")
        duty = wrong_duty(processed)
        bad += [] if duty is None else [f"Likely cause: {'; '.join(duty)}."]
    if runtime is not None and runtime.status != "ok":
        bad.append(f"No runtime: {RUNTIME_STATUS_WORDS[runtime.status]}.")
    if processed.status == "cutting" and report.note and (fit is None or fit.status == "ok"):
        warn.append(f"No {'k_Fc' if fit is None else 'runtime'}: {report.note}.")
    warn += runtime.notes if runtime is not None else ()
    warn += [f"{row.channel}: {problem}" for row in processed.quality for problem in row.problems]
    warn += [f"{offset.problem}." for offset in processed.offsets if offset.problem]
    reasons = tuple(words.told(text) for text in dict.fromkeys([*bad, *warn]))
    if bad:
        return Trust(level="bad", words="Not every result of this trial is reliable.", reasons=reasons)
    if warn:
        return Trust(level="warn", words="Usable, with remarks.", reasons=reasons)
    return Trust(level="good", words="No problem found in this trial.", reasons=())


def is_complete(report: TrialReport) -> bool:
    """Whether every sample of a trial is there, up to the end of its recording."""
    is_cut = report.recording is not None and not report.recording.is_complete
    return not is_cut and not any(row.n_missing for row in report.processed.quality)


def _sections(report: TrialReport) -> list[Section]:
    processed, fit, runtime = report.processed, report.fit, report.runtime
    words = words_of(processed.frame)
    found = [Section(heading="Signals over time", pictures=_signal_pictures(report))]
    if processed.period is not None:
        spectrum = period_picture(report.spectra, processed.period, words)
        found.append(
            Section(heading=words.period.capitalize(), pictures=_drawn(spectrum), texts=_period_words(processed))
        )
    if processed.offsets:
        said = tuple(f"{offset.words()}." for offset in processed.offsets)
        found.append(Section(heading=f"Alignment of the instruments, checked on the {words.cycle}s", texts=said))
    texts = () if processed.removed is None else (_removed_words(processed),)
    found.append(Section(heading=f"One {words.cycle}", pictures=_stroke_pictures(report), texts=texts))
    if report.model:
        pictures = _drawn(model_picture(processed, report.model), harmonics_picture(processed, report.model))
        found.append(
            Section(
                heading="Model and measurement",
                pictures=pictures,
                table=tuple(_deviation_row(row) for row in deviations_of(processed, report.model)),
            )
        )
    if processed.status != "moving":
        reason = (f"None: {report.note}.",) if fit is None and report.note else ()
        found.append(Section(heading="Cutting coefficient", texts=reason if fit is None else _fit_words(fit)))
    drawn = _drawn(discharge_picture(report.discharges, runtime))
    if runtime is not None and runtime.status == "ok":
        found.append(Section(heading="Battery runtime", pictures=drawn, texts=_runtime_words(runtime)))
    return [section for section in found if section.pictures or section.texts]


def _drawn(*pictures: Picture | None) -> tuple[Picture, ...]:
    return tuple(picture for picture in pictures if picture is not None)


def _signal_pictures(report: TrialReport) -> tuple[Picture, ...]:
    """A stretch that begins at the first motion, and the whole trial where that is longer."""
    recording, phases, steady = report.recording, report.processed.phases, report.processed.steady
    if recording is None:
        return ()
    start_s = -np.inf if steady is None else steady.first_motion_s - _BEFORE_MOTION * _DETAIL_S
    words = words_of(report.processed.frame)
    detail = signals_picture(recording, phases, words, seconds=_DETAIL_S, start_s=start_s)
    longest_s = max((signal.duration_s for signal in recording.signals.values()), default=0.0)
    if longest_s <= _LONGER * _DETAIL_S:
        return _drawn(detail)
    return _drawn(detail, signals_picture(recording, phases, words, seconds=np.inf, name="whole"))


def _stroke_pictures(report: TrialReport) -> tuple[Picture, ...]:
    """The force before and after zeroing; the whole cycle where no model shows it further down."""
    zeroed = zeroed_picture(report.processed)
    if report.model and zeroed is not None:
        return (zeroed,)
    return _drawn(zeroed, cycle_picture(report.processed, None))


def _deviation_row(row: Deviation) -> tuple[str, ...]:
    return (
        f"{row.channel}, {row.model}",
        _short(row.peak_measured, row.unit),
        _short(row.peak_model, row.unit),
        _short(row.rms, row.unit),
        _short(row.largest, row.unit),
    )


def _removed_words(processed: ProcessedTrial) -> str:
    removed = processed.removed
    assert removed is not None
    return (
        f"Zeroing the return stroke ({_HALF_WORDS.get(removed.half, removed.half)}) removed a force of "
        f"{_short(removed.mean_n, 'N')} mean, {_short(removed.rms_n, 'N')} RMS "
        f"and {_short(removed.peak_n, 'N')} peak: "
        f"{format_number(100.0 * removed.share_of_impulse, digits=2)} % of the whole cycle's impulse."
    )


def _period_words(processed: ProcessedTrial) -> tuple[str, ...]:
    period, words = processed.period, words_of(processed.frame)
    assert period is not None
    texts = [
        f"{format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, 'ms')} over {period.n_cycles} "
        f"whole {words.cycle}s of the {words.label(period.channel)}; standard deviation between "
        f"{words.cycle}s {_short(1e3 * period.spread_s, 'ms')}. Confidence: {period.confidence} "
        f"({words.told(period.reason)})."
    ]
    for rival in period.rivals:
        texts.append(
            f"Also possible: {_short(1e3 * rival.period_s, 'ms')} with "
            f"{format_number(100.0 * rival.relative_power, digits=2)} % of the power ({words.told(rival.reason)})."
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
        "decreases with more strokes; the rest is due to the plant constants, the sensor gains and what the model "
        "leaves out."
    ]
    if residuals:
        texts.append(f"RMS residual of the fit: {' and '.join(residuals)}.")
    return (*texts, fit.identifiability, *fit.notes)


def _runtime_words(runtime: RuntimePrediction) -> tuple[str, ...]:
    end = {"soc": "the cut-off state of charge", "voltage": "the cut-off voltage"}[runtime.ended_by]
    texts = [
        f"{format_quantity(runtime.runtime_s, runtime.std_s, 's')} from full charge to {end}. Over this discharge the "
        f"model has a mean battery current of {_short(runtime.mean_battery_current_a, 'A')} and a mean motor current "
        f"of {_short(runtime.mean_motor_current_a, 'A')}. The numerical error is below "
        f"{_short(runtime.numerical_error_s, 's')}."
    ]
    if runtime.appendix_a_runtime_s is not None:
        shown = format_quantity(runtime.appendix_a_runtime_s, None, "s")
        texts.append(f"Usable charge divided by the measured mean battery current: {shown}.")
    largest = sorted(runtime.contributions_s.items(), key=lambda item: -item[1])[:3]
    if largest:
        words = [f"{name} {_short(std, 's')}" for name, std in largest]
        correlation = correlation_words(runtime.std_s, runtime.contributions_s.values())
        texts.append(f"Largest contributions to its uncertainty: {', '.join(words)}.")
        texts += [f"{correlation}."] if correlation else []
    if runtime.battery_basis:
        texts.append(f"{runtime.battery_basis[:1].upper()}{runtime.battery_basis[1:]}.")
    return tuple(texts)


def _place(row: ChannelQuality) -> tuple[int, str]:
    """Sort by the order of the bench's channels, others after them."""
    order = list(CHANNEL_BY_NAME)
    return (order.index(row.channel) if row.channel in order else len(order), row.channel)


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
    rows = [Row(label="Notes", value=processed.trial.notes)] if processed.trial.notes else []
    for label, target in files.items():
        href, text = link_to(target, page)
        rows.append(Row(label=label, value=text, href=href))
    if processed.source_sha256:
        rows.append(Row(label="SHA-256 of the recording", value=processed.source_sha256, is_hash=True))
    return rows
