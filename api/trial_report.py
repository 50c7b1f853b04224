"""The page of a trial: from an analysed trial to everything the page shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sawbench.analysis import AnalysedTrial, Evaluation, evaluate, knows_drive

if TYPE_CHECKING:
    from sawbench.reporting.trial_page import TrialReport


def trial_report(trial: AnalysedTrial, found: Evaluation | None = None) -> TrialReport:
    """Collect what the page of a trial shows: results, the fitted model's stroke and discharge, spectra.

    Parameters
    ----------
    trial : AnalysedTrial
    found : Evaluation, optional
        Where fit and runtime are known already.
    """
    from sawbench.bench.units import FORCE
    from sawbench.model_cycles import LINEAR, MEASURED, discharges_of, fitted_cycle, measured_force_cycle
    from sawbench.processing.stroke_spectrum import stroke_spectrum
    from sawbench.reporting.trial_page import TrialReport

    found, processed = found or evaluate(trial), trial.processed
    fit, runtime = found.fit, found.runtime
    model, discharges = {}, {}
    if fit is not None and fit.status == "ok" and knows_drive(trial):
        model[LINEAR] = fitted_cycle(trial, fit)
        replayed = measured_force_cycle(trial, fit)
        if replayed is not None:
            model[MEASURED] = replayed
    if fit is not None and runtime is not None and runtime.status == "ok":
        discharges = discharges_of(trial, fit, found.estimates)
    spectra = {}
    if processed.period is not None:
        band_hz = trial.loaded.config.stroke_rates_hz
        for channel in dict.fromkeys((processed.period.channel, FORCE.name)):
            spectrum = stroke_spectrum(processed, channel, band_hz)
            if spectrum is not None:
                spectra[channel] = spectrum
    return TrialReport(
        processed=processed,
        fit=fit,
        runtime=runtime,
        note=found.note,
        model=model,
        discharges=discharges,
        spectra=spectra,
        recording=trial.recording,
    )
