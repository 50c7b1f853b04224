"""From a recording to its results: process, fit, predict. What `process`, `fit`, `runtime`, `compare`, `demo` share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawbench.bench.errors import InputError
from sawbench.inputs import config_for

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.bench.recording import Recording
    from sawbench.modeling.cycle_observation import FitMethod
    from sawbench.modeling.measured_cycles import MeasuredCycles
    from sawbench.modeling.operating_point import OperatingPoint
    from sawbench.modeling.results import CuttingFit, ParameterEstimates, RuntimePrediction

# Steps of the fitted stroke: straight lines between them are good to 1e-4 of the current.
_FITTED_STEPS = 512
_DRIVE_CHANNELS = ("displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenedTrial:
    """A recording and the configuration it is read with.

    Attributes
    ----------
    recording : Recording
    loaded : LoadedConfig
    sha256 : str
        Of the file; empty where there is none.
    """

    recording: Recording
    loaded: LoadedConfig
    sha256: str = ""

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import recording_block

        return recording_block(self.recording)


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

    @property
    def where(self) -> str:
        """File, or name of the trial where there is none."""
        return self.recording.path or self.recording.trial.trial_id

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import processed_block

        return processed_block(self.processed)


def open_trial(path: Path, config_path: Path | None) -> OpenedTrial:
    """Read one recording.

    Raises
    ------
    InputError
        If the file is no recording or the configuration is not valid.
    """
    from sawbench.storage.reader import read_recording, sha256_of

    recording = read_recording(path)
    return OpenedTrial(recording=recording, loaded=config_for(recording, config_path), sha256=sha256_of(path))


def process_opened(trial: OpenedTrial) -> AnalysedTrial:
    """Process one recording; known effects change nothing that was measured, but a wrong table is refused."""
    from sawbench.processing.process import process_recording

    if trial.loaded.config.effects and trial.loaded.config.plant is not None:
        from sawbench.modeling.machines.known_effects import known_effects

        known_effects(trial.loaded.config, path=trial.loaded.path)

    processed = process_recording(trial.recording, trial.loaded.config, source_sha256=trial.sha256)
    return AnalysedTrial(recording=trial.recording, loaded=trial.loaded, processed=processed)


def load_and_process(path: Path, config_path: Path | None) -> AnalysedTrial:
    """Read one recording and process it; see `open_trial`."""
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
        If the trial is no cutting trial or lacks what the fit needs.
    """
    from sawbench.modeling.effect_fit import fit_with_effects
    from sawbench.modeling.fit import available_method, cutting_fits, fit_cutting_coefficient
    from sawbench.modeling.joint_fit import SensorPriors, first_guess, fit_jointly
    from sawbench.modeling.machines.known_effects import baseline_of
    from sawbench.processing.measured_cycles import measured_cycles

    processed, loaded = trial.processed, trial.loaded
    if processed.status != "cutting":
        raise InputError(
            f"is no cutting trial ({processed.status.replace('_', ' ')}), so it has no k_Fc",
            where=trial.where,
        )
    cycles = measured_cycles(processed)
    method = method or available_method(cycles)
    config = loaded.config
    if method != "force" and cycles.duty is None and config.converter.mode == "fixed_duty":
        raise InputError(
            "the duty of the trial is not known, so the motor voltage is not either",
            where=trial.where,
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

    def fitted(strokes: MeasuredCycles) -> tuple[CuttingFit, ParameterEstimates | None]:
        if method in {"force", "annealing"}:
            return fit_cutting_coefficient(strokes, **setting), None
        joint = fit_jointly([strokes], **setting)
        return cutting_fits(joint, method)[0], joint.of_trial(0)

    baseline = baseline_of(loaded)
    if not baseline.known:
        fit, estimates = fitted(cycles)
    else:
        k_fc = first_guess(cycles, baseline.plant, method)
        fit, estimates = fit_with_effects(cycles, fitted, baseline, measured_point(trial, k_fc))
    fit = doubted(fit, processed)
    return fit, estimates if fit.status == "ok" else None


def measured_point(trial: AnalysedTrial, k_fc_n_s_per_m: float) -> OperatingPoint:
    """Operating point of a trial, at the battery voltage that was measured."""
    import numpy as np
    from sawbench.modeling.operating_point import OperatingPoint

    setting, converter = trial.processed.trial, trial.loaded.config.converter
    voltage = trial.processed.mean_values.get("battery_voltage_v")
    held_v = converter.voltage_v if converter.mode == "held_voltage" else None
    duty = converter.default_duty if setting.duty is None else setting.duty
    return OperatingPoint(
        k_fc_n_s_per_m=k_fc_n_s_per_m,
        duty=None if held_v is not None else duty,
        held_voltage_v=held_v,
        battery_voltage_v=voltage if voltage is not None and np.isfinite(voltage) else None,
        feed_m_s=np.nan if setting.feed_mm_s is None else 1e-3 * setting.feed_mm_s,
        thickness_m=np.nan if setting.thickness_mm is None else 1e-3 * setting.thickness_mm,
    )


def fitted_cycle(trial: AnalysedTrial, fit: CuttingFit, *, n_points: int = 256) -> dict[str, Any]:
    """One settled stroke of the fitted model as the sensors would show it, to lay over the measured one.

    Plant constants, sensor gains, the force's zero and the angle's zero are those of the fit; the motor gets
    the measured battery voltage, as in the fit. What the fit did not estimate keeps its nominal value.

    Parameters
    ----------
    trial : AnalysedTrial
    fit : CuttingFit
    n_points : int

    Returns
    -------
    dict
        `angle_rad`, `force_n`, `motor_current_a`, each of shape (n_points,).
    """
    import numpy as np
    from sawbench.modeling.cycle_observation import drive_of
    from sawbench.modeling.effect_fit import effect_share
    from sawbench.modeling.machines.known_effects import baseline_of
    from sawbench.modeling.parts.linear import force, sign_of
    from sawbench.modeling.parts.mechanism import Mechanism
    from sawbench.modeling.periodic_cycle import COLUMNS, PLANT_NAMES, periodic_cycles
    from sawbench.processing.measured_cycles import measured_cycles

    config, plant = trial.loaded.config, trial.loaded.plant()
    known = {} if fit.estimates is None else dict(zip(fit.estimates.names, fit.estimates.values, strict=True))
    own = {name: float(known.get(name, getattr(plant, name).nominal)) for name in PLANT_NAMES}
    drive = drive_of(measured_cycles(trial.processed), config.battery, config.converter)
    own["resistance_ohm"] += drive.source_resistance_ohm
    own |= {"k_fc_n_s_per_m": fit.k_fc_n_s_per_m, "voltage_v": drive.voltage_v / known.get("voltage_gain", 1.0)}
    mechanism = Mechanism(radius_m=own["crank_radius_m"], rod_length_m=Mechanism.of(plant).rod_length_m)
    current, speed, _ = periodic_cycles(
        np.array([[own[name] for name in COLUMNS]]),
        gear_ratio=plant.gear_ratio,
        cutting_half=config.cutting.cutting_half,
        rod_length_m=mechanism.rod_length_m,
        n_steps=_FITTED_STEPS,
    )
    # As an angle sensor sees it whose zero is off by `angle_zero_rad`.
    nodes = 2.0 * np.pi * np.arange(_FITTED_STEPS) / _FITTED_STEPS
    angle = (np.arange(n_points) + 0.5) * 2.0 * np.pi / n_points
    at = angle - known.get("angle_zero_rad", 0.0)
    velocity = mechanism.lever(at) * np.interp(at, nodes, speed[0], period=2.0 * np.pi)
    force_n = force.py_func(fit.k_fc_n_s_per_m, np.maximum(sign_of(config.cutting.cutting_half) * velocity, 0.0))
    current_a = np.interp(at, nodes, current[0], period=2.0 * np.pi)
    baseline = baseline_of(trial.loaded)
    if baseline.known:
        share = effect_share(baseline, measured_point(trial, fit.k_fc_n_s_per_m), at)
        force_n, current_a = force_n + share.force_n, current_a + share.current_a
    return {
        "angle_rad": angle,
        "force_n": known.get("force_gain", 1.0) * force_n + known.get("force_offset_n", 0.0),
        "motor_current_a": known.get("current_gain", 1.0) * current_a,
    }


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
    feed_mm_s = trial.processed.trial.feed_mm_s
    return predict(
        trial.loaded,
        feed_m_s=None if feed_mm_s is None else 1e-3 * feed_mm_s,
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
    feed_m_s: float | None = None,
) -> RuntimePrediction:
    """Predict the battery runtime for a cutting coefficient; the feed matters to known effects alone."""
    from sawbench.model_setup import parameters_of, supply_of
    from sawbench.modeling.machines.known_effects import baseline_of
    from sawbench.modeling.operating_point import OperatingPoint
    from sawbench.modeling.runtime import predict_runtime, predict_runtime_with_effects

    battery, converter = loaded.battery(), loaded.config.converter
    baseline = baseline_of(loaded)
    if baseline.known:
        held_v = converter.voltage_v if converter.mode == "held_voltage" else None
        fixed = converter.default_duty if duty is None else duty
        return predict_runtime_with_effects(
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
