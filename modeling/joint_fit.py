"""Cutting coefficients of one or several trials, with plant and sensors estimated along with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.correlated import covariance_of_means
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_observation import (
    SENSOR_NAMES,
    Drive,
    FeatureModel,
    FitMethod,
    TrialObservation,
    drive_of,
    observe,
)
from sawbench.modeling.map_estimate import Estimate, Parameters, most_probable
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.periodic_cycle import PLANT_NAMES, CuttingHalf
from sawbench.modeling.results import ParameterEstimates

if TYPE_CHECKING:
    from collections.abc import Mapping

Floats = NDArray[np.float64]

K_FC: Final = "k_fc_n_s_per_m"
DEFAULT_BOUNDS: Final = (0.0, 5000.0)
# Misfit of the mean stroke is called model error where noise explains it with less than this probability.
MISFIT_PROBABILITY: Final = 0.005


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorPriors:
    """What is known of the sensors beforehand, one standard deviation each.

    Attributes
    ----------
    force_gain_rel_std, current_gain_rel_std, voltage_gain_rel_std : float
    angle_zero_std_rad : float
        Zero of the crank angle.
    force_offset_std_n : float
        Zero of the load cell; the return stroke shows it.
    """

    force_gain_rel_std: float = 0.005
    current_gain_rel_std: float = 0.005
    voltage_gain_rel_std: float = 0.002
    angle_zero_std_rad: float = 0.01
    force_offset_std_n: float = 2.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value!r}, allowed is a number >= 0")


@dataclass(frozen=True, kw_only=True, slots=True)
class JointFit:
    """Per-trial k_Fc and the parameters all trials share.

    Attributes
    ----------
    k_fc_n_s_per_m, std_n_s_per_m, statistical_std_n_s_per_m : ndarray, shape (n_trials,)
    labels : tuple of str
    estimates : ParameterEstimates
        Names of per-trial parameters end in `[trial number]`.
    rmse_a, rmse_n : tuple of float or None
        Root mean square difference of the mean stroke between data and model, A and N.
    rms_a, rms_n : tuple of float or None
        Root mean square of the measured mean stroke, A and N.
    has_misfit : bool
        True where the mean strokes differ from the model by more than noise and priors explain.
    is_converged, is_valid : bool
        `is_valid` is false where the model stalls.
    is_at_bound : ndarray of bool, shape (n_trials,)
    n_simulations : int
    shares : tuple of Mapping
        Per trial, the share of each prior (and of "statistics", "model error") in the variance of k_Fc.
    pulls : mapping of str to float
        How far each estimate lies from its prior, in prior standard deviations (0 where there is no prior).
    notes : tuple of str
    """

    k_fc_n_s_per_m: Floats
    std_n_s_per_m: Floats
    statistical_std_n_s_per_m: Floats
    labels: tuple[str, ...]
    estimates: ParameterEstimates
    rmse_a: tuple[float | None, ...]
    rmse_n: tuple[float | None, ...]
    rms_a: tuple[float | None, ...]
    rms_n: tuple[float | None, ...]
    has_misfit: bool
    is_converged: bool
    is_valid: bool
    is_at_bound: NDArray[np.bool_]
    n_simulations: int
    shares: tuple[Mapping[str, float], ...]
    pulls: Mapping[str, float]
    notes: tuple[str, ...]

    def of_trial(self, trial: int) -> ParameterEstimates:
        """Joint estimates of one trial, its own parameters under their plain names."""
        own = f"[{trial}]"
        keep = [n for n, name in enumerate(self.estimates.names) if "[" not in name or name.endswith(own)]
        return ParameterEstimates(
            names=tuple(self.estimates.names[n].removesuffix(own) for n in keep),
            values=self.estimates.values[keep],
            prior_std=self.estimates.prior_std[keep],
            covariance=self.estimates.covariance[np.ix_(keep, keep)],
            by_stroke=tuple(series[:, keep] for series in self.estimates.by_stroke),
        )


def fit_jointly(
    trials: Sequence[MeasuredCycles],
    *,
    plant: PlantConfig,
    battery: BatteryConfig | None = None,
    converter: ConverterConfig | None = None,
    cutting_half: CuttingHalf = "pi_to_2pi",
    method: FitMethod = "current_and_force",
    sensors: SensorPriors | None = None,
    bounds: tuple[float, float] = DEFAULT_BOUNDS,
) -> JointFit:
    """Estimate one k_Fc a trial together with the shared plant constants and sensor gains.

    Least squares in the crank-angle domain on the periodic stroke: the phase of the strokes does not enter,
    so there is one minimum. The plant constants are held by their priors (`rel_std`), which the data may
    improve. The covariance holds the scatter from stroke to stroke with its autocorrelation, what the priors
    leave, and the misfit of the mean strokes where noise does not explain it (treated as model error).
    Bias: the mean stroke is compared with the periodic stroke at the mean k_Fc; with 5 % variation from
    stroke to stroke that is off by less than 0.1 %. Fails on trials that are not settled (spin-up inside).

    Parameters
    ----------
    trials : sequence of MeasuredCycles
    plant : PlantConfig
        Nominal values and their relative standard uncertainties.
    battery, converter : optional
        The supply; see `drive_of`.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    method : {"current_and_force", "current", "force"}
        Channels used. The stroke period is always used.
    sensors : SensorPriors, optional
    bounds : tuple of float
        Lowest and highest k_Fc allowed, N*s/m.

    Raises
    ------
    InputError
        If there is no trial, or one lacks what the method needs.
    """
    if not trials:
        raise InputError("there is no trial to fit")
    if not (np.isfinite(bounds).all() and 0.0 <= bounds[0] < bounds[1]):
        raise InputError(f"bounds are {bounds}, allowed is 0 <= lower < upper, N*s/m")
    drives = [drive_of(cycles, battery, converter) for cycles in trials]
    observations = [observe(cycles, method, drive) for cycles, drive in zip(trials, drives, strict=True)]
    parameters = _parameters(trials, drives, plant, sensors or SensorPriors(), bounds, method)
    model = FeatureModel(
        gear_ratio=plant.gear_ratio,
        cutting_half=cutting_half,
        rod_length_m=plant.rod_length_m if plant.mechanism == "slider_crank" else None,
        crank_radius_m=plant.crank_radius_m.nominal,
    )
    problem = _Problem(observations=observations, parameters=parameters, plant=plant, model=model)
    notes = tuple(dict.fromkeys(drive.note for drive in drives if drive.note))
    return _solve(problem, trials, notes)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Problem:
    observations: list[TrialObservation]
    parameters: Parameters
    plant: PlantConfig
    model: FeatureModel

    def predict(self, rows: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Features of all trials for parameter rows."""
        known = {name: getattr(self.plant, name).nominal for name in PLANT_NAMES}
        known |= dict.fromkeys(SENSOR_NAMES, 1.0) | {"angle_zero_rad": 0.0, "force_offset_n": 0.0}
        index = {name: n for n, name in enumerate(self.parameters.names)}
        blocks, valid = [], np.ones(len(rows), dtype=np.bool_)
        for trial, observation in enumerate(self.observations):
            values = {}
            for name in (*known, K_FC):
                column = index.get(f"{name}[{trial}]", index.get(name))
                values[name] = np.full(len(rows), known[name]) if column is None else rows[:, column]
            block, is_valid = self.model.predict(values, observation)
            blocks.append(block)
            valid &= is_valid
        return np.hstack(blocks), valid

    @property
    def data(self) -> Floats:
        """Features of all trials, one after the other."""
        return np.concatenate([observation.data for observation in self.observations])

    def slices(self) -> list[slice]:
        """Where each trial's features are."""
        ends = np.cumsum([len(observation.data) for observation in self.observations])
        return [slice(int(e) - len(o.data), int(e)) for e, o in zip(ends, self.observations, strict=True)]


def _parameters(
    trials: Sequence[MeasuredCycles],
    drives: list[Drive],
    plant: PlantConfig,
    sensors: SensorPriors,
    bounds: tuple[float, float],
    method: FitMethod,
) -> Parameters:
    """Everything uncertain, with its prior; what is exactly known is left out."""
    rows: list[tuple[str, float, float, float, float]] = []
    for trial, cycles in enumerate(trials):
        start = first_guess(cycles, plant, method)
        rows.append((f"{K_FC}[{trial}]", float(np.clip(start, *bounds)), np.inf, *bounds))
    for name in PLANT_NAMES:
        value = getattr(plant, name)
        rows.append((name, value.nominal, value.std, 0.05 * value.nominal, 20.0 * value.nominal))
    rows.append(("current_gain", 1.0, sensors.current_gain_rel_std if method != "force" else 0.0, 0.5, 2.0))
    rows.append(("force_gain", 1.0, sensors.force_gain_rel_std if method != "current" else 0.0, 0.5, 2.0))
    voltage_std = max(np.hypot(sensors.voltage_gain_rel_std, d.extra_voltage_rel_std) for d in drives)
    rows.append(("voltage_gain", 1.0, float(voltage_std), 0.5, 2.0))
    rows.append(("angle_zero_rad", 0.0, sensors.angle_zero_std_rad, -1.0, 1.0))
    for trial in range(len(trials)):
        std = sensors.force_offset_std_n if method != "current" else 0.0
        rows.append((f"force_offset_n[{trial}]", 0.0, std, -1e4, 1e4))
    rows = [row for row in rows if row[2] > 0.0]
    mean, std = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
    return Parameters(
        names=tuple(row[0] for row in rows),
        start=mean,
        prior_mean=mean,
        prior_std=std,
        step=np.where(np.isfinite(std), 0.02 * np.where(np.isfinite(std), std, 1.0), 1e-3 * (mean + 100.0)),
        lower=np.array([row[3] for row in rows]),
        upper=np.array([row[4] for row in rows]),
    )


def first_guess(cycles: MeasuredCycles, plant: PlantConfig, method: FitMethod) -> float:
    """k_Fc from the mean power: what drives the crank on average is what damping and cutting take."""
    speed = cycles.mean_speed_rad_s
    radius = plant.crank_radius_m.nominal
    if method == "force":
        mean_torque = float(np.mean(cycles.mean("force_n") * np.abs(np.sin(cycles.angle_rad)))) * radius
    else:
        motor_torque = plant.torque_constant_n_m_per_a.nominal * float(np.mean(cycles.mean("current_a")))
        loss = plant.motor_damping_n_m_s_per_rad.nominal * plant.gear_ratio * speed
        mean_torque = plant.gear_ratio * (motor_torque - loss)
    return 4.0 * mean_torque / (radius**2 * speed)


def _solve(problem: _Problem, trials: Sequence[MeasuredCycles], notes: tuple[str, ...]) -> JointFit:
    # Only the variances: correlations estimated from a few dozen strokes would be used to cancel scatter that
    # cannot be cancelled, and the uncertainty would come out too small.
    noise = np.concatenate([o.scatter.var(axis=0, ddof=1) / len(o.scatter) for o in problem.observations])
    model_error = np.concatenate([o.floor_variance for o in problem.observations])
    misfit = np.zeros(len(model_error))
    n_simulations = 0
    while True:
        covariance = np.diag(noise + model_error + misfit)
        estimate = most_probable(problem.predict, problem.data, covariance, problem.parameters)
        n_simulations += estimate.n_predictions * len(trials)
        if misfit.any() or not estimate.is_valid or not estimate.is_converged:
            break
        found = _misfit(problem, estimate, covariance, misfit)
        if found is None or not found.any():
            # Either noise explains the mean strokes, or only the priors object, which no model error can mend.
            break
        misfit = found
    return _result(problem, estimate, misfit + model_error, trials, notes, n_simulations, bool(misfit.any()))


def _misfit(problem: _Problem, estimate: Estimate, covariance: Floats, misfit: Floats) -> Floats | None:
    """Variance of model error per feature, or None where noise and priors explain the mean strokes."""
    from scipy.special import chdtrc

    residual = estimate.residual
    prior = problem.parameters
    miss = estimate.values - prior.prior_mean
    chi2 = residual @ np.linalg.solve(covariance, residual) + miss @ (prior.precision * miss)
    n_free = len(residual) - int(np.isinf(prior.prior_std).sum())
    if chdtrc(n_free, chi2) > MISFIT_PROBABILITY:
        return None
    grown = misfit.copy()
    for part, observation in zip(problem.slices(), problem.observations, strict=True):
        for channel in (0, 1, 2):
            chosen = np.flatnonzero(observation.channel == channel) + part.start
            if len(chosen):
                expected = float(np.mean(np.diag(covariance)[chosen])) - float(np.mean(misfit[chosen]))
                excess = float(np.mean(residual[chosen] ** 2)) * chi2 / max(chi2 - n_free, 1.0) - expected
                grown[chosen] = max(excess, float(misfit[chosen].max()), 0.0)
    return grown


def _result(
    problem: _Problem,
    estimate: Estimate,
    model_error: Floats,
    trials: Sequence[MeasuredCycles],
    notes: tuple[str, ...],
    n_simulations: int,
    has_misfit: bool,
) -> JointFit:
    parameters, slices = problem.parameters, problem.slices()
    parts = list(zip(slices, problem.observations, strict=True))
    by_stroke = tuple(observation.scatter @ estimate.gain[:, part].T for part, observation in parts)
    statistical = np.sum([covariance_of_means(series) for series in by_stroke], axis=0)
    prior_std = np.where(np.isfinite(parameters.prior_std), parameters.prior_std, 0.0)
    from_priors = estimate.prior_gain * prior_std
    from_model = (estimate.gain * model_error) @ estimate.gain.T
    covariance = statistical + from_priors @ from_priors.T + from_model
    own = [parameters.names.index(f"{K_FC}[{trial}]") for trial in range(len(trials))]
    variance = np.diag(covariance)[own]
    shares = []
    # A fit that is not valid has no variance to share.
    for n, total in zip(own, np.where(variance > 0, variance, np.inf), strict=True):
        share = {name: from_priors[n, j] ** 2 / total for j, name in enumerate(parameters.names) if prior_std[j]}
        shares.append({"statistics": statistical[n, n] / total, "model error": from_model[n, n] / total} | share)
    values = estimate.values
    pull = np.divide(values - parameters.prior_mean, prior_std, out=np.zeros_like(values), where=prior_std > 0)
    at_bound = (values[own] <= parameters.lower[own]) | (values[own] >= parameters.upper[own])
    return JointFit(
        k_fc_n_s_per_m=values[own],
        std_n_s_per_m=np.sqrt(variance),
        statistical_std_n_s_per_m=np.sqrt(np.diag(statistical)[own]),
        labels=tuple(cycles.label for cycles in trials),
        estimates=ParameterEstimates(
            names=parameters.names,
            values=values,
            prior_std=parameters.prior_std,
            covariance=covariance,
            by_stroke=by_stroke,
        ),
        rmse_a=tuple(_rms(estimate.residual[part], o, 0) for part, o in parts),
        rmse_n=tuple(_rms(estimate.residual[part], o, 1) for part, o in parts),
        rms_a=tuple(_rms(o.data, o, 0) for _, o in parts),
        rms_n=tuple(_rms(o.data, o, 1) for _, o in parts),
        has_misfit=has_misfit,
        is_converged=estimate.is_converged,
        is_valid=estimate.is_valid,
        is_at_bound=at_bound,
        n_simulations=n_simulations,
        shares=tuple(shares),
        pulls={name: float(sigmas) for name, sigmas in zip(parameters.names, pull, strict=True)},
        notes=notes,
    )


def _rms(features: Floats, observation: TrialObservation, channel: int) -> float | None:
    """Root mean square over the stroke of one channel's features."""
    chosen = np.flatnonzero(observation.channel == channel)
    if not len(chosen):
        return None
    return float(np.sqrt(np.sum(features[chosen] ** 2) / observation.n_bins))
