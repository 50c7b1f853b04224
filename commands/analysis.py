"""From a recording to its results: process, fit, predict. What `process`, `fit`, `runtime`, `compare`, `demo` share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.errors import InputError
from commands.options import config_for

if TYPE_CHECKING:
    from bench.config import LoadedConfig
    from bench.processed import ProcessedTrial
    from bench.recording import Recording
    from modeling.cycle_observation import FitMethod
    from modeling.measured_cycles import MeasuredCycles
    from modeling.results import CuttingFit, ParameterEstimates, RuntimePrediction

FIT_BINS = 64
_DRIVE_CHANNELS = ("displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")


@dataclass(frozen=True, kw_only=True, slots=True)
class AnalysedTrial:
    """A recording with what was found in it.

    Attributes
    ----------
    recording : Recording
    loaded : LoadedConfig
    processed : ProcessedTrial
    """

    recording: Recording
    loaded: LoadedConfig
    processed: ProcessedTrial


def load_and_process(path: Path, config_path: Path | None) -> AnalysedTrial:
    """Read one recording and process it.

    Raises
    ------
    InputError
        If the file is no recording or the configuration is not valid.
    """
    from processing.process import process_recording
    from storage.reader import read_recording, sha256_of

    recording = read_recording(path)
    loaded = config_for(recording, config_path)
    processed = process_recording(recording, loaded.config, source_sha256=sha256_of(path))
    return AnalysedTrial(recording=recording, loaded=loaded, processed=processed)


def measured_cycles(trial: AnalysedTrial) -> MeasuredCycles:
    """Lay the settled strokes of a trial over the crank angle, for the fit.

    Raises
    ------
    InputError
        If the trial has no settled strokes or no crank angle with a known zero.
    """
    from bench.units import CHANNEL_BY_NAME
    from modeling.measured_cycles import cycles_from_samples

    processed, where = trial.processed, trial.recording.path
    if processed.angle is None or processed.period is None:
        raise InputError(f"holds no running strokes ({processed.status})", where=where)
    if not processed.angle.is_absolute:
        raise InputError(
            "has no displacement, so the zero of the crank angle is unknown and k_Fc cannot be fitted",
            where=where,
            remedy="record displacement_mm",
        )
    running = [phase for phase in processed.phases if phase.kind == "running"]
    if not running:
        raise InputError("never runs at a settled speed", where=where)
    longest = max(running, key=lambda phase: phase.end_s - phase.start_s)
    channels = {
        name: (signal.time_s, signal.values * CHANNEL_BY_NAME[name].si_factor)
        for name, signal in trial.recording.signals.items()
        if name in CHANNEL_BY_NAME
    }
    return cycles_from_samples(
        processed.angle.time_s,
        processed.angle.angle_rad,
        processed.angle.speed_rad_s,
        channels,
        n_bins=FIT_BINS,
        start_s=longest.start_s,
        end_s=longest.end_s,
        duty=trial.recording.trial.duty,
        label=trial.recording.trial.trial_id,
    )


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
        If the trial is no cutting trial or lacks what the fit needs.
    """
    from modeling.fit import available_method, cutting_fits, fit_cutting_coefficient
    from modeling.joint_fit import SensorPriors, fit_jointly

    processed, loaded = trial.processed, trial.loaded
    if processed.status != "cutting":
        raise InputError(
            f"is no cutting trial ({processed.status.replace('_', ' ')}), so it has no k_Fc",
            where=trial.recording.path or processed.trial.trial_id,
        )
    cycles = measured_cycles(trial)
    method = method or available_method(cycles)
    config = loaded.config
    if method != "force" and cycles.duty is None and config.converter.mode == "fixed_duty":
        raise InputError(
            "the duty of the trial is not known, so the motor voltage is not either",
            where=trial.recording.path or processed.trial.trial_id,
            remedy="import it again by a campaign.toml that states duty, fit with --method force, or set "
            "[converter] mode = 'held_voltage' with voltage_v",
        )
    sensors = SensorPriors(
        force_gain_rel_std=config.analysis.force_gain_rel_std,
        current_gain_rel_std=config.analysis.current_gain_rel_std,
    )
    setting: dict[str, Any] = {
        "plant": loaded.plant(),
        "battery": config.battery,
        "converter": config.converter,
        "cutting_half": config.cutting.cutting_half,
        "sensors": sensors,
        "method": method,
    }
    if method in {"force", "annealing"}:
        return doubted(fit_cutting_coefficient(cycles, **setting), processed), None
    joint = fit_jointly([cycles], **setting)
    fit = doubted(cutting_fits(joint, method)[0], processed)
    return fit, joint.of_trial(0) if fit.status == "ok" else None


def doubted(fit: CuttingFit, processed: ProcessedTrial) -> CuttingFit:
    """Mark a fit that rests on channels the processing found clipped, swapped, reversed or in another unit."""
    used = {"force": ("displacement_mm", "force_n"), "current_and_force": (*_DRIVE_CHANNELS, "force_n")}
    doubts = processed.doubts(*used.get(fit.method, _DRIVE_CHANNELS))
    if not doubts:
        return fit
    status = "contradicted" if fit.status == "ok" else fit.status
    return replace(fit, status=status, notes=(*doubts, *fit.notes))


def runtime_of(trial: AnalysedTrial, fit: CuttingFit, estimates: ParameterEstimates | None) -> RuntimePrediction:
    """Predict the battery runtime of a tool that goes on cutting like this trial."""
    return predict(
        trial.loaded,
        k_fc=fit.k_fc_n_s_per_m,
        k_fc_std=fit.std_n_s_per_m,
        estimates=estimates,
        duty=trial.recording.trial.duty,
        mean_battery_current_a=trial.processed.mean_values.get("battery_current_a"),
    )


def predict(
    loaded: LoadedConfig,
    *,
    k_fc: float,
    k_fc_std: float,
    duty: float | None,
    estimates: ParameterEstimates | None = None,
    mean_battery_current_a: float | None = None,
) -> RuntimePrediction:
    """Predict the battery runtime for a cutting coefficient."""
    from commands.model_setup import parameters_of, supply_of
    from modeling.runtime import predict_runtime

    battery = loaded.battery()
    return predict_runtime(
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
    )
