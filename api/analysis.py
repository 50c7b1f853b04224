"""From a recording to its results: process, fit, predict. What `process`, `fit`, `runtime`, `compare`, `demo` share."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawbench.analysed_trial import AnalysedTrial, OpenedTrial
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.bench.units import FORCE
from sawbench.inputs import config_for

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.modeling.battery_range import BatteryUse
    from sawbench.modeling.cycle_observation import FitMethod
    from sawbench.modeling.measured_cycles import MeasuredCycles
    from sawbench.modeling.operating_point import OperatingPoint
    from sawbench.modeling.results import CuttingFit, ParameterEstimates, RuntimePrediction
    from sawbench.storage.places import Place

_NO_FIT = {
    "no_cutting": "idle run, so there is no cutting force to fit",
    "moving": "the machine is a linear axis, which has no cutting coefficient",
    "stalled": "the saw stalled, so there is no steady stroke to fit",
    "no_stroke": "no stroke was found, so there is nothing to fit",
}
_DRIVE_CHANNELS = ("displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")


def open_trial(
    path: Place, config_path: Path | LoadedConfig | None, span_s: tuple[float, float] | None = None
) -> OpenedTrial:
    """Read one recording, or a part of it, on the disk or in an object store.

    Raises
    ------
    InputError
        If the file is not a recording, is too long to be in memory at once, or the configuration is not valid.
    """
    from sawbench.storage.digest import sha256_of
    from sawbench.storage.pieces import MOST_AT_ONCE, is_long, read_span
    from sawbench.storage.places import on_disk
    from sawbench.storage.reader import read_recording

    with on_disk(path) as local:
        if span_s is None and is_long(local, MOST_AT_ONCE):
            raise InputError(
                f"holds more than {MOST_AT_ONCE / 1e6:.0f} million samples, too many to be in memory at once",
                where=path,
                remedy="`sawbench process` takes all of it; in Python sawbench.read(path, span_s=(0, 60)) reads a part",
            )
        read = read_recording(local) if span_s is None else read_span(local, *span_s)
        recording = replace(read, path=str(path))
        return OpenedTrial(recording=recording, loaded=config_for(recording, config_path), sha256=sha256_of(local))


def process_opened(trial: OpenedTrial) -> AnalysedTrial:
    """Process one recording; known effects change nothing that was measured, but a wrong table is refused."""
    from sawbench.processing.process import process_recording

    refuse_wrong_effects(trial.loaded)
    processed = process_recording(trial.recording, trial.loaded.config, source_sha256=trial.sha256)
    return AnalysedTrial(recording=trial.recording, loaded=trial.loaded, processed=processed)


def refuse_wrong_effects(loaded: LoadedConfig) -> None:
    """Raise where the configuration's table of known effects is wrong.

    Raises
    ------
    ConfigError
    """
    if loaded.config.effects and loaded.config.plant is not None:
        from sawbench.modeling.machines.known_effects import known_effects

        known_effects(loaded.config, path=loaded.path)


def load_and_process(path: Place, config_path: Path | LoadedConfig | None) -> AnalysedTrial:
    """Read one recording and process it, a long one piece by piece; see `open_trial`."""
    from sawbench.storage.digest import sha256_of
    from sawbench.storage.pieces import is_long
    from sawbench.storage.places import on_disk

    with on_disk(path) as local:
        if is_long(local):
            from sawbench.long_trials import process_long

            return process_long(local, config_path, path=str(path), sha256=sha256_of(local))
    return process_opened(open_trial(path, config_path))


def fit_trial(trial: AnalysedTrial, method: FitMethod | None = None) -> tuple[CuttingFit, ParameterEstimates | None]:
    """Fit k_Fc of one trial; by default with every channel it has.

    Returns
    -------
    fit : CuttingFit
    estimates : ParameterEstimates or None
        Plant and k_Fc together with their covariance, for the runtime; None for methods that fit k_Fc alone.

    Raises
    ------
    InputError
        If the trial is no cutting trial or lacks what the fit needs, or the configuration describes no saw.
    """
    from sawbench.modeling.fit import available_method, cutting_fits, fit_cutting_coefficient
    from sawbench.modeling.joint_fit import SensorPriors, first_guess, fit_jointly
    from sawbench.modeling.machines.saw_baseline import baseline_of

    processed, loaded = trial.processed, trial.loaded
    plant = loaded.plant()
    if processed.status != "cutting":
        reasons = processed.doubts(*(row.channel for row in processed.quality)) or processed.warnings
        raise InputError(
            "; ".join([f"is not a cutting trial ({processed.status.replace('_', ' ')}), so it has no k_Fc", *reasons]),
            where=trial.where,
            remedy="`sawbench report` shows its signals",
        )
    cycles = trial.fitted_strokes
    method = method or available_method(cycles)
    config = loaded.config
    if method != "force" and not knows_drive(trial):
        raise InputError(
            "the duty of the trial is unknown, so the motor voltage is unknown too",
            where=trial.where,
            remedy="import it again with a campaign.toml that states duty, fit with --method force, or set "
            "[converter] mode = 'held_voltage' with voltage_v",
        )
    sensors = SensorPriors(
        force_gain_rel_std=config.analysis.force_gain_rel_std,
        current_gain_rel_std=config.analysis.current_gain_rel_std,
    )
    setting: dict[str, Any] = {
        "plant": plant,
        "battery": config.battery,
        "converter": config.converter,
        "cutting_half": config.cutting.cutting_half,
        "sensors": sensors,
        "method": method,
    }

    def fitted(strokes: MeasuredCycles) -> tuple[CuttingFit, ParameterEstimates | None]:
        if method == "force":
            return fit_cutting_coefficient(strokes, **setting), None
        joint = fit_jointly([strokes], **setting)
        return cutting_fits(joint, method)[0], joint.of_trial(0)

    baseline = baseline_of(loaded)
    if not baseline.known:
        fit, estimates = fitted(cycles)
    else:
        from sawbench.modeling.effect_fit import fit_with_effects

        k_fc = first_guess(cycles, baseline.plant, method)
        fit, estimates = fit_with_effects(cycles, fitted, baseline, measured_point(trial, k_fc))
    fit = doubted(fit, trial)
    return fit, estimates if fit.status == "ok" else None


@dataclass(frozen=True, kw_only=True, slots=True)
class Evaluation:
    """Fit and runtime of a trial, as far as it allows them.

    Attributes
    ----------
    fit : CuttingFit or None
    estimates : ParameterEstimates or None
        As `fit_trial` returns them.
    runtime : RuntimePrediction or None
        None where the fit is missing or not reliable.
    note : str
        Why there is no fit or runtime; empty where nothing went wrong.
    """

    fit: CuttingFit | None = None
    estimates: ParameterEstimates | None = None
    runtime: RuntimePrediction | None = None
    note: str = ""


def evaluate(trial: AnalysedTrial, *, compiles: bool = False) -> Evaluation:
    """Fit k_Fc and predict the runtime as far as the trial allows; what it does not allow is said in the note.

    `compiles` is worth its seconds where some thirty trials are evaluated: a runtime then takes 2 ms, not 450.
    """
    if trial.processed.status != "cutting":
        return Evaluation(note=_NO_FIT[trial.processed.status])
    try:
        fit, estimates = fit_trial(trial)
    except SawbenchError as error:
        return Evaluation(note=error.what)
    if fit.status != "ok":
        return Evaluation(fit=fit, note="k_Fc is not reliable")
    try:
        runtime = runtime_of(trial, fit, estimates, compiles=compiles)
    except SawbenchError as error:
        return Evaluation(fit=fit, estimates=estimates, note=error.what)
    return Evaluation(fit=fit, estimates=estimates, runtime=runtime)


def measured_point(trial: AnalysedTrial, k_fc_n_s_per_m: float) -> OperatingPoint:
    """Operating point of a trial, at the battery voltage that was measured."""
    import numpy as np
    from sawbench.modeling.operating_point import OperatingPoint

    setting, converter = trial.processed.trial, trial.loaded.config.converter
    voltage = trial.processed.mean_values.get("battery_voltage_v")
    held_v = converter.voltage_v if converter.mode == "held_voltage" else None
    duty = converter.default_duty if setting.duty is None else setting.duty
    angle = trial.processed.angle
    return OperatingPoint(
        time_s=0.0 if angle is None else 0.5 * float(angle.time_s[0] + angle.time_s[-1]),
        k_fc_n_s_per_m=k_fc_n_s_per_m,
        duty=None if held_v is not None else duty,
        held_voltage_v=held_v,
        battery_voltage_v=voltage if voltage is not None and np.isfinite(voltage) else None,
        feed_m_s=np.nan if setting.feed_mm_s is None else 1e-3 * setting.feed_mm_s,
        thickness_m=np.nan if setting.thickness_mm is None else 1e-3 * setting.thickness_mm,
    )


def doubted(fit: CuttingFit, trial: AnalysedTrial) -> CuttingFit:
    """Mark a fit that rests on channels the processing found clipped, swapped, reversed or in another unit.

    Where samples of them are missing, or the recording is cut off, the rest is fitted and keeps its status; the notes
    say so.
    """
    from sawbench.reporting.rejections import wrong_duty

    processed = trial.processed
    used = {"force": ("displacement_mm", "force_n"), "current_and_force": (*_DRIVE_CHANNELS, "force_n")}
    channels = used.get(fit.method, _DRIVE_CHANNELS)
    doubts = processed.doubts(*channels)
    losses = tuple(text for text in processed.losses if text.partition(":")[0] in channels)
    status = "contradicted" if doubts and fit.status == "ok" else fit.status
    duty = None if status == "ok" else wrong_duty(processed)
    cause = () if duty is None else (f"likely cause: {'; '.join(duty)}",)
    gain = _doubtful_gain(trial) if FORCE.name in channels else ()
    notes = (*cause, *doubts, *losses, *trial.recording.interruptions, *gain, *fit.notes)
    return replace(fit, status=status, notes=notes)


def _doubtful_gain(trial: AnalysedTrial) -> tuple[str, ...]:
    """Say where the force was recorded with a gain that is less certain than the fit takes it to be."""
    stated = trial.recording.provenance.get(f"calibration values {FORCE.name}")
    recorded = 0.0 if stated is None else float(json.loads(stated).get("rel_std", 0.0))
    taken = trial.loaded.config.analysis.force_gain_rel_std
    if recorded <= taken:
        return ()
    return (
        f"the calibration of the force states its gain to {recorded:.2%}, the uncertainty of k_Fc holds {taken:.2%}: "
        f"set [analysis] force_gain_rel_std = {recorded:.2g}",
    )


def knows_drive(trial: AnalysedTrial) -> bool:
    """Whether anything says what share of the battery's voltage the motor gets."""
    return trial.recording.trial.duty is not None or trial.loaded.config.converter.mode != "fixed_duty"


def runtime_of(
    trial: AnalysedTrial,
    fit: CuttingFit,
    estimates: ParameterEstimates | None,
    use: BatteryUse | None = None,
    *,
    compiles: bool = False,
) -> RuntimePrediction:
    """Predict the battery runtime of a tool that goes on cutting like this trial.

    Raises
    ------
    InputError
        If the duty of the trial is unknown, and with it how fast the battery empties.
    """
    if not knows_drive(trial):
        raise InputError(
            "the duty of the trial is unknown, so its battery runtime is unknown too",
            where=trial.where,
            remedy=f"state it with `sawbench amend {trial.where} --duty 0.5`, or predict with `--k-fc` and `--duty`",
        )
    feed_mm_s = trial.processed.trial.feed_mm_s
    return predict(
        trial.loaded,
        feed_m_s=None if feed_mm_s is None else 1e-3 * feed_mm_s,
        k_fc=fit.k_fc_n_s_per_m,
        k_fc_std=fit.std_n_s_per_m,
        estimates=estimates,
        duty=trial.recording.trial.duty,
        mean_battery_current_a=trial.processed.mean_values.get("battery_current_a"),
        use=use,
        compiles=compiles,
    )


# Size: options by name: what is cut, how well that is known, how it is computed.
def predict(
    loaded: LoadedConfig,
    *,
    k_fc: float,
    k_fc_std: float,
    duty: float | None,
    estimates: ParameterEstimates | None = None,
    mean_battery_current_a: float | None = None,
    feed_m_s: float | None = None,
    use: BatteryUse | None = None,
    compiles: bool = False,
) -> RuntimePrediction:
    """Predict the battery runtime for a cutting coefficient; the feed matters to known effects alone.

    What a fitted battery states of its own uncertainty and range is part of the result.
    """
    from sawbench.model_setup import parameters_of, supply_of
    from sawbench.modeling.battery_range import with_battery_fit
    from sawbench.modeling.machines.saw_baseline import baseline_of
    from sawbench.modeling.operating_point import OperatingPoint
    from sawbench.modeling.runtime import predict_runtime, predict_runtime_with_effects

    battery, converter = loaded.battery(), loaded.config.converter
    baseline = baseline_of(loaded)
    if baseline.known:
        held_v = converter.voltage_v if converter.mode == "held_voltage" else None
        fixed = converter.default_duty if duty is None else duty
        found = predict_runtime_with_effects(
            baseline,
            OperatingPoint(
                k_fc_n_s_per_m=k_fc,
                duty=None if held_v is not None else fixed,
                held_voltage_v=held_v,
                feed_m_s=float("nan") if feed_m_s is None else feed_m_s,
            ),
            k_fc_std=k_fc_std,
            estimates=estimates,
            measured_mean_battery_current_a=mean_battery_current_a,
        )
        return with_battery_fit(found, battery, use)
    found = predict_runtime(
        parameters_of(loaded),
        supply=supply_of(loaded, duty),
        k_fc=k_fc,
        k_fc_std=k_fc_std,
        plant=loaded.plant(),
        estimates=estimates,
        cutting_half=loaded.config.cutting.cutting_half,
        cutoff_soc=battery.cutoff_soc,
        cutoff_voltage_v=battery.cutoff_voltage_v,
        measured_mean_battery_current_a=mean_battery_current_a,
        compiles=compiles,
    )
    return with_battery_fit(found, battery, use)
