"""The instant verdict on one recorded trial of a series: processed and fitted, in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from sawbench.acquisition.series.plan import PlannedTrial
from sawbench.acquisition.series.verdict import TrialMeasures
from sawbench.bench.errors import SawbenchError
from sawbench.bench.recording import loss_in_words

if TYPE_CHECKING:
    from sawbench.analysis import AnalysedTrial
    from sawbench.bench.recording import Recording

_LEAST_SHARE: Final = 0.95
_STATUS_WORDS: Final = {
    "no_cutting": "no cutting was found",
    "stalled": "the saw stalled",
    "no_stroke": "no stroke was found",
    "cutting": "the blade cuts, although the plan states an idle run",
}


def measured(path: Path, planned: PlannedTrial, *, seconds: float) -> TrialMeasures:
    """Process and fit one recording of the series.

    Parameters
    ----------
    path : Path
    planned : PlannedTrial
    seconds : float
        How long it should be.

    Returns
    -------
    TrialMeasures
        Whatever makes it no good is in `faults`; nothing is raised for a bad recording.
    """
    from sawbench.analysis import load_and_process

    try:
        trial = load_and_process(path, None)
    except SawbenchError as error:
        return TrialMeasures(trial_id=planned.id, setting=planned.setting, blade="", faults=(error.what,))
    processed, recording = trial.processed, trial.recording
    k_fc, fit_faults = _fitted(trial, planned)
    expected = "no_cutting" if planned.is_idle else "cutting"
    status = [] if processed.status in (expected, "moving") else [_STATUS_WORDS[processed.status]]
    return TrialMeasures(
        trial_id=planned.id,
        setting=planned.setting,
        blade=recording.trial.blade or "",
        stroke_rate_hz=None if processed.period is None else processed.period.rate_hz,
        peak_force_n=None if planned.is_idle else processed.peak_force_n,
        rms_motor_current_a=processed.rms_values.get("motor_current_a"),
        **k_fc,
        faults=(
            *_not_as_planned(recording, planned),
            *_cut_short(recording, seconds),
            *status,
            *processed.doubts(*recording.signals),
            *fit_faults,
        ),
        remarks=tuple(f"{q.channel}: {text}" for q in processed.quality for text in q.problems if text not in q.doubts),
    )


def describe(measures: TrialMeasures) -> str:
    """The numbers of one trial, in one line."""
    from sawbench.reporting.quantities import format_quantity

    said = []
    if measures.stroke_rate_hz:
        said.append(f"period {1e3 / measures.stroke_rate_hz:.2f} ms ({measures.stroke_rate_hz:.2f} Hz)")
    if measures.peak_force_n is not None:
        said.append(f"peak force {measures.peak_force_n:.0f} N")
    if measures.k_fc_n_s_per_m is not None:
        said.append(f"k_Fc {format_quantity(measures.k_fc_n_s_per_m, measures.k_fc_std_n_s_per_m, 'N·s/m')}")
    if measures.rms_motor_current_a is not None:
        said.append(f"motor current {measures.rms_motor_current_a:.2f} A")
    return ", ".join(said) or "no result"


def _fitted(trial: AnalysedTrial, planned: PlannedTrial) -> tuple[dict[str, float], list[str]]:
    """Return k_Fc as keywords of `TrialMeasures`, and why there is none."""
    from sawbench.analysis import fit_trial
    from sawbench.reporting.compared import FIT_STATUS_WORDS

    if planned.is_idle or trial.processed.status != "cutting":
        return {}, []
    try:
        fit, _ = fit_trial(trial)
    except SawbenchError as error:
        return {}, [f"no k_Fc: {error.what}"]
    found = {
        "k_fc_n_s_per_m": fit.k_fc_n_s_per_m,
        "k_fc_std_n_s_per_m": fit.std_n_s_per_m,
        "k_fc_statistical_std_n_s_per_m": fit.statistical_std_n_s_per_m,
    }
    if fit.status == "ok":
        return found, []
    return {}, [f"no k_Fc: {'; '.join((FIT_STATUS_WORDS[fit.status], *fit.notes))}"]


def _cut_short(recording: Recording, seconds: float) -> list[str]:
    """Say what is missing of a recording."""
    found = list(recording.interruptions)
    for channel, signal in recording.signals.items():
        end_s = float(signal.time_s[-1]) if len(signal.time_s) else 0.0
        if end_s < _LEAST_SHARE * seconds:
            found.append(f"{channel} ends after {end_s:.1f} of {seconds:g} s")
        if lost := loss_in_words(channel, len(signal.time_s), signal.n_missing):
            found.append(lost)
    return found if recording.signals else [*found, "it contains no signal"]


def _not_as_planned(recording: Recording, planned: PlannedTrial) -> list[str]:
    names = ("material", "duty", "feed_mm_s", "thickness_mm")
    asked = {name: getattr(planned, name) for name in names}
    found = {name: getattr(recording.trial, name) for name in names}
    return [
        f"{name} is {found[name]!r}, the plan says {asked[name]!r}"
        for name in names
        if asked[name] is not None and found[name] != asked[name]
    ]
