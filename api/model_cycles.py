"""The fitted model of a trial: one settled stroke and one discharge, with the linear and with the measured force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from sawbench.analysis import AnalysedTrial
    from sawbench.bench.recording import Floats
    from sawbench.modeling.discharge import Discharge, DischargeCurves
    from sawbench.modeling.effect_fit import EffectShare
    from sawbench.modeling.parameters import JigsawParameters
    from sawbench.modeling.parts.measured import MeasuredForce
    from sawbench.modeling.results import CuttingFit, ParameterEstimates

LINEAR: Final = "linear force"
MEASURED: Final = "measured force"
# Steps of the fitted stroke: straight lines between them are good to 1e-4 of the current.
_FITTED_STEPS: Final = 512
# Nodes of the replayed force: 5.6 degrees, finer than the bins of the fit.
_FORCE_NODES: Final = 64


@dataclass(frozen=True, kw_only=True, slots=True)
class _FittedModel:
    """Constants and sensor errors of a fit, and the angles at which its stroke is asked for.

    Attributes
    ----------
    constants : mapping of str to float
        Plant constants by name; the resistance holds that of the source.
    known : mapping of str to float
        Everything that was estimated.
    voltage_v : float
        At the motor, free of the gain of its sensor.
    sensor_angle_rad, angle_rad : ndarray, shape (n,)
        As the sensor shows the angle, and as it is.
    share : EffectShare or None
        What known effects add.
    """

    constants: Mapping[str, float]
    known: Mapping[str, float]
    voltage_v: float
    sensor_angle_rad: Floats
    angle_rad: Floats
    share: EffectShare | None

    def as_measured(self, force_n: Floats, current_a: Floats) -> dict[str, Floats]:
        """Force and current of the model as the sensors would show them."""
        if self.share is not None:
            force_n, current_a = force_n + self.share.force_n, current_a + self.share.current_a
        return {
            "angle_rad": self.sensor_angle_rad,
            "force_n": self.known.get("force_gain", 1.0) * force_n + self.known.get("force_offset_n", 0.0),
            "motor_current_a": self.known.get("current_gain", 1.0) * current_a,
        }


def fitted_cycle(trial: AnalysedTrial, fit: CuttingFit, *, n_points: int = 256) -> dict[str, Floats]:
    """One settled stroke of the fitted model as the sensors would show it, to lay over the measured one.

    Plant constants, sensor gains, the force's zero and the angle's zero are those of the fit; the motor gets
    the measured battery voltage, as in the fit. What the fit did not estimate keeps its nominal value.

    Returns
    -------
    dict
        `angle_rad`, `force_n`, `motor_current_a`, each of shape (n_points,).
    """
    from sawbench.modeling.parts.linear import force, sign_of
    from sawbench.modeling.parts.mechanism import Mechanism
    from sawbench.modeling.periodic_cycle import COLUMNS, periodic_cycles

    config, plant = trial.loaded.config, trial.loaded.plant()
    model = _fitted_model(trial, fit, _middles(n_points))
    own = {**model.constants, "k_fc_n_s_per_m": fit.k_fc_n_s_per_m, "voltage_v": model.voltage_v}
    mechanism = Mechanism(radius_m=own["crank_radius_m"], rod_length_m=Mechanism.of(plant).rod_length_m)
    current, speed, _ = periodic_cycles(
        np.array([[own[name] for name in COLUMNS]]),
        gear_ratio=plant.gear_ratio,
        cutting_half=config.cutting.cutting_half,
        rod_length_m=mechanism.rod_length_m,
        n_steps=_FITTED_STEPS,
    )
    nodes = 2.0 * np.pi * np.arange(_FITTED_STEPS) / _FITTED_STEPS
    velocity = mechanism.lever(model.angle_rad) * _at(model.angle_rad, nodes, speed[0])
    force_n = force.py_func(fit.k_fc_n_s_per_m, np.maximum(sign_of(config.cutting.cutting_half) * velocity, 0.0))
    return model.as_measured(force_n, _at(model.angle_rad, nodes, current[0]))


def measured_force_cycle(trial: AnalysedTrial, fit: CuttingFit, *, n_points: int = 256) -> dict[str, Floats] | None:
    """The same stroke with the measured force replayed over the crank angle (section 4.1 of the paper).

    Returns
    -------
    dict or None
        As `fitted_cycle`; None where no force was folded all around the stroke, or the motor cannot overcome it.
    """
    from sawbench.modeling.steady_state import steady_state
    from sawbench.modeling.supplies import FixedVoltage

    model = _fitted_model(trial, fit, _middles(n_points))
    cutting = _replayed(trial, fit)
    if cutting is None:
        return None
    supply = FixedVoltage(voltage_v=model.voltage_v)
    state = steady_state(_parameters(trial, model.constants), supply=supply, cutting=cutting, compiles=False)
    if state.status != "ok":
        return None
    wave = state.waveform(_FITTED_STEPS)
    current_a = _at(model.angle_rad, wave.crank_angle_rad, wave.motor_current_a)
    return model.as_measured(cutting.force_at(model.angle_rad), current_a)


def discharges_of(
    trial: AnalysedTrial, fit: CuttingFit, estimates: ParameterEstimates | None
) -> dict[str, DischargeCurves]:
    """Charge and voltage over a discharge that goes on cutting like this trial.

    Parameters
    ----------
    trial : AnalysedTrial
        Its configuration must hold a battery.
    fit : CuttingFit
    estimates : ParameterEstimates or None
        As `fit_trial` returned them.

    Returns
    -------
    dict
        Curves by name of the force, those that reach the cut-off; only the linear one where the model holds known
        effects.
    """
    from sawbench.model_setup import supply_of
    from sawbench.modeling.discharge import discharge
    from sawbench.modeling.machines.saw_baseline import baseline_of
    from sawbench.modeling.parts.linear import LinearCutting

    if baseline_of(trial.loaded).known:
        runs = {LINEAR: _discharge_with_effects(trial, fit, estimates)}
    else:
        half, battery = trial.loaded.config.cutting.cutting_half, trial.loaded.battery()
        linear = LinearCutting(k_fc_n_s_per_m=fit.k_fc_n_s_per_m, cutting_half=half)
        runs = {
            name: discharge(
                _parameters(trial, _constants(trial, _known(estimates))),
                supply=supply_of(trial.loaded, trial.recording.trial.duty),
                cutting=cutting,
                cutoff_soc=battery.cutoff_soc,
                cutoff_voltage_v=battery.cutoff_voltage_v,
                compiles=False,
            )
            for name, cutting in ((LINEAR, linear), (MEASURED, _replayed(trial, fit)))
            if cutting is not None
        }
    return {name: run.curves for name, run in runs.items() if run.status == "ok"}


def _discharge_with_effects(trial: AnalysedTrial, fit: CuttingFit, estimates: ParameterEstimates | None) -> Discharge:
    from dataclasses import replace

    from sawbench.analysis import measured_point
    from sawbench.bench.config import Uncertain
    from sawbench.modeling.effect_discharge import discharge_with_effects
    from sawbench.modeling.machines.saw_baseline import baseline_of

    baseline, battery = baseline_of(trial.loaded), trial.loaded.battery()
    changed = {name: Uncertain(nominal=value) for name, value in _constants(trial, _known(estimates)).items()}
    return discharge_with_effects(
        replace(baseline, plant=baseline.plant.model_copy(update=changed)),
        replace(measured_point(trial, fit.k_fc_n_s_per_m), battery_voltage_v=None),
        cutoff_soc=battery.cutoff_soc,
        cutoff_voltage_v=battery.cutoff_voltage_v,
    )


def _known(estimates: ParameterEstimates | None) -> dict[str, float]:
    if estimates is None:
        return {}
    return {name: float(value) for name, value in zip(estimates.names, estimates.values, strict=True)}


def _constants(trial: AnalysedTrial, known: Mapping[str, float]) -> dict[str, float]:
    from sawbench.modeling.periodic_cycle import PLANT_NAMES

    plant = trial.loaded.plant()
    return {name: known.get(name, getattr(plant, name).nominal) for name in PLANT_NAMES}


def _fitted_model(trial: AnalysedTrial, fit: CuttingFit, sensor_angle_rad: Floats) -> _FittedModel:
    from sawbench.analysis import measured_point
    from sawbench.modeling.cycle_observation import drive_of
    from sawbench.modeling.effect_fit import effect_share
    from sawbench.modeling.machines.saw_baseline import baseline_of

    config, known = trial.loaded.config, _known(fit.estimates)
    drive = drive_of(trial.fitted_strokes, config.battery, config.converter)
    constants = _constants(trial, known)
    constants["resistance_ohm"] += drive.source_resistance_ohm
    # An angle sensor whose zero is off by `angle_zero_rad` shows so much more than the crank's angle.
    angle = sensor_angle_rad - known.get("angle_zero_rad", 0.0)
    baseline = baseline_of(trial.loaded)
    point = measured_point(trial, fit.k_fc_n_s_per_m)
    return _FittedModel(
        constants=constants,
        known=known,
        voltage_v=drive.voltage_v / known.get("voltage_gain", 1.0),
        sensor_angle_rad=sensor_angle_rad,
        angle_rad=angle,
        share=effect_share(baseline, point, angle) if baseline.known else None,
    )


def _replayed(trial: AnalysedTrial, fit: CuttingFit) -> MeasuredForce | None:
    """The folded cutting force without the errors of its sensor and without known effects; None where it has holes."""
    from sawbench.modeling.parts.measured import MeasuredForce

    cycle = trial.processed.cutting_force
    if cycle is None or not np.isfinite(cycle.mean).all():
        return None
    model = _fitted_model(trial, fit, cycle.angle_rad)
    force_n = (cycle.mean - model.known.get("force_offset_n", 0.0)) / model.known.get("force_gain", 1.0)
    if model.share is not None:
        force_n = force_n - model.share.force_n
    turn = np.mod(model.angle_rad, 2.0 * np.pi)
    order = np.argsort(turn)
    half = trial.loaded.config.cutting.cutting_half
    return MeasuredForce.from_samples(turn[order], force_n[order], n_nodes=_FORCE_NODES, cutting_half=half)


def _parameters(trial: AnalysedTrial, constants: Mapping[str, float]) -> JigsawParameters:
    from sawbench.model_setup import parameters_of

    return parameters_of(trial.loaded).replace(**constants)


def _middles(n_points: int) -> Floats:
    return (np.arange(n_points) + 0.5) * 2.0 * np.pi / n_points


def _at(angle_rad: Floats, nodes_rad: Floats, values: Floats) -> Floats:
    return np.interp(angle_rad, nodes_rad, values, period=2.0 * np.pi)
