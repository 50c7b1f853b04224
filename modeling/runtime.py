"""How long the battery lasts, how sure that is, and what would change it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np
from sawbench.bench.config import PlantConfig, Uncertain
from sawbench.bench.errors import InputError
from sawbench.modeling.discharge import Discharge, discharge
from sawbench.modeling.effect_discharge import N_NODES, discharge_with_effects
from sawbench.modeling.operating_point import OperatingPoint, periodic_stroke
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.linear import CuttingHalf, LinearCutting
from sawbench.modeling.periodic_cycle import PLANT_NAMES
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.results import ParameterEstimates, RuntimePrediction
from sawbench.modeling.supplies import FixedDuty, HeldVoltage
from sawbench.modeling.transient import InitialState

BatterySupply = FixedDuty | HeldVoltage

K_FC: Final = "k_fc_n_s_per_m"
# Finite differences over this share of a standard deviation.
STEP_SHARE: Final = 0.5
# Finer than the discharge's default: the start-up at a high k_Fc needs it.
STEPS_PER_TURN: Final = 32
# Of the runs whose difference is a derivative: what few steps and nodes miss is the same in both.
SLOPE_STEPS_PER_TURN: Final = 16
# States of charge at which strokes with effects are solved for a derivative.
SLOPE_NODES: Final = 3


# Size: options by name: what is cut, how well that is known, when it ends.
def predict_runtime(
    parameters: JigsawParameters,
    *,
    supply: BatterySupply,
    k_fc: float,
    k_fc_std: float = 0.0,
    plant: PlantConfig | None = None,
    estimates: ParameterEstimates | None = None,
    cutting_half: CuttingHalf = "pi_to_2pi",
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    start_soc: float = 1.0,
    measured_mean_battery_current_a: float | None = None,
    compiles: bool = False,
) -> RuntimePrediction:
    """Predict the runtime to the cut-off with its standard uncertainty.

    Parameters
    ----------
    parameters : JigsawParameters
    supply : FixedDuty or HeldVoltage
        Holds the battery.
    k_fc, k_fc_std : float
        Cutting coefficient and its standard uncertainty, N*s/m.
    plant : PlantConfig, optional
        Its `rel_std` are the uncertainties of the plant constants, taken as independent of k_Fc.
    estimates : ParameterEstimates, optional
        Of the fit that gave k_Fc. Replaces `parameters`' values and the two uncertainties above: a k_Fc
        fitted to the current with a wrong torque constant is wrong in the direction that keeps the current
        right, so the errors cancel and the independent sum would overstate the interval.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    cutoff_soc, start_soc : float
    cutoff_voltage_v : float, optional
        Whichever cut-off comes first ends the run.
    measured_mean_battery_current_a : float, optional
        For the mean-current method of Appendix A.
    compiles : bool
        Worth it from some thirty predictions on; see `discharge`.

    Returns
    -------
    RuntimePrediction
        `contributions_s` holds each parameter's own share; with `estimates` they do not add up in squares,
        because the errors are correlated.

    Raises
    ------
    InputError
        If a value is out of its range.
    """
    if not (math.isfinite(k_fc) and k_fc >= 0.0):
        raise InputError(f"k_fc is {k_fc!r}, allowed is a number >= 0, N*s/m")
    if not (math.isfinite(k_fc_std) and k_fc_std >= 0.0):
        raise InputError(f"k_fc_std is {k_fc_std!r}, allowed is a number >= 0, N*s/m")
    centre = {name: float(getattr(parameters, name)) for name in PLANT_NAMES} | {K_FC: k_fc}
    if estimates is None:
        estimates = _independent(centre, _plant_stds(plant) | {K_FC: k_fc_std})
    centre = _at_estimates(centre, estimates)

    def run(changes: Mapping[str, float], **accuracy: Any) -> Discharge:
        values = centre | dict(changes)
        return discharge(
            parameters.replace(**{name: values[name] for name in PLANT_NAMES}),
            supply=supply,
            cutting=LinearCutting(k_fc_n_s_per_m=values[K_FC], cutting_half=cutting_half),
            cutoff_soc=cutoff_soc,
            cutoff_voltage_v=cutoff_voltage_v,
            initial=InitialState(soc=start_soc),
            compiles=compiles,
            **accuracy,
        )

    usable_a_s = 3600.0 * supply.battery.capacity_ah * (start_soc - cutoff_soc)
    appendix_a_s = _appendix_a(usable_a_s, measured_mean_battery_current_a)
    nominal = run({}, steps_per_turn=STEPS_PER_TURN)
    quick = partial(run, steps_per_turn=SLOPE_STEPS_PER_TURN, target=math.inf)
    return _with_uncertainty(nominal, quick, centre, estimates, appendix_a_s)


def predict_runtime_with_effects(
    baseline: Baseline,
    point: OperatingPoint,
    *,
    k_fc_std: float = 0.0,
    estimates: ParameterEstimates | None = None,
    measured_mean_battery_current_a: float | None = None,
) -> RuntimePrediction:
    """Predict the runtime of a saw with known effects, their uncertainty among those of the plant.

    Parameters
    ----------
    baseline : Baseline
        With a battery, whose cut-offs end the run.
    point : OperatingPoint
        At the start.
    k_fc_std : float
        Standard uncertainty of its cutting coefficient, N*s/m.
    estimates : ParameterEstimates, optional
        As in `predict_runtime`; magnitudes of effects may be among them.
    measured_mean_battery_current_a : float, optional

    Raises
    ------
    InputError
        If a value is out of its range, or an effect cannot be predicted without a campaign.
    """
    run, centre = effect_runs(baseline, point)
    if estimates is None:
        effects = {known.name: known.std for known in baseline.known}
        estimates = _independent(centre, _plant_stds(baseline.plant) | {K_FC: k_fc_std} | effects)
    centre = _at_estimates(centre, estimates)
    nominal = run(centre, N_NODES)
    battery = baseline.battery
    assert battery is not None
    usable_a_s = 3600.0 * battery.capacity_ah * (1.0 - battery.cutoff_soc) - point.charge_used_as
    appendix_a_s = _appendix_a(usable_a_s, measured_mean_battery_current_a)
    return _with_uncertainty(nominal, lambda changes: run(centre | dict(changes)), centre, estimates, appendix_a_s)


def effect_runs(baseline: Baseline, point: OperatingPoint) -> tuple[Callable[..., Discharge], dict[str, float]]:
    """Give a function (values, n_nodes) that runs the battery down, and the nominal values of what it takes.

    Parameters
    ----------
    baseline : Baseline
        With a battery, whose cut-offs end the run.
    point : OperatingPoint
        At the start.

    Returns
    -------
    run : callable
        Values by name -> Discharge; those it is not given are nominal.
    centre : dict of str to float
        Plant constants, k_Fc and the magnitudes of the effects (`KnownEffect.name`).

    Raises
    ------
    InputError
        Without a battery, or where an effect needs what the point does not say.
    """
    battery = baseline.battery
    if battery is None:
        raise InputError("a runtime needs a battery", remedy="fill in [battery]")
    plant = baseline.plant
    sizes = {known.name: known for known in baseline.known}
    centre = {name: getattr(plant, name).nominal for name in PLANT_NAMES}
    centre |= {K_FC: point.k_fc_n_s_per_m, **{name: known.value for name, known in sizes.items()}}
    near = periodic_stroke(baseline, point)

    def run(values: Mapping[str, float], n_nodes: int = SLOPE_NODES) -> Discharge:
        values = centre | dict(values)
        changed = {name: Uncertain(nominal=values[name]) for name in PLANT_NAMES}
        return discharge_with_effects(
            dataclasses.replace(
                baseline,
                plant=plant.model_copy(update=changed),
                known=tuple(known.at(values[name]) for name, known in sizes.items()),
            ),
            dataclasses.replace(point, k_fc_n_s_per_m=values[K_FC]),
            cutoff_soc=battery.cutoff_soc,
            cutoff_voltage_v=battery.cutoff_voltage_v,
            n_nodes=n_nodes,
            start=near if near.is_settled else None,
        )

    return run, centre


def _with_uncertainty(
    nominal: Discharge,
    run: Callable[[Mapping[str, float]], Discharge],
    centre: Mapping[str, float],
    estimates: ParameterEstimates,
    appendix_a_s: float | None,
) -> RuntimePrediction:
    """Carry the uncertainty of the parameters to the runtime, by differences of runs."""
    if nominal.status != "ok":
        return _prediction(nominal, 0.0, {}, appendix_a_s)
    stds = {name: estimates.std(name) for name in centre if name in estimates.names}
    slopes = {name: runtime_slope(run, name, centre[name], std) for name, std in stds.items() if std > 0.0}
    shares = {name: abs(slope) * stds[name] for name, slope in slopes.items()}
    return _prediction(nominal, estimates.std_along(slopes), shares, appendix_a_s)


def _prediction(
    nominal: Discharge, std_s: float, shares: Mapping[str, float], appendix_a_s: float | None
) -> RuntimePrediction:
    return RuntimePrediction(
        runtime_s=nominal.runtime_s if nominal.status == "ok" else math.nan,
        std_s=std_s,
        mean_battery_current_a=nominal.mean_battery_current_a,
        mean_motor_current_a=nominal.mean_motor_current_a,
        appendix_a_runtime_s=appendix_a_s,
        ended_by="voltage" if nominal.ended_by == "voltage" else "soc",
        numerical_error_s=nominal.numerical_error_s,
        status=nominal.status,
        contributions_s=shares,
        notes=nominal.notes,
    )


def _plant_stds(plant: PlantConfig | None) -> dict[str, float]:
    return {} if plant is None else {name: getattr(plant, name).std for name in PLANT_NAMES}


def _independent(centre: Mapping[str, float], stds: Mapping[str, float]) -> ParameterEstimates:
    std = np.array(list(stds.values()))
    values = np.array([centre[name] for name in stds])
    return ParameterEstimates(names=tuple(stds), values=values, prior_std=std, covariance=np.diag(std**2))


def _at_estimates(centre: Mapping[str, float], estimates: ParameterEstimates) -> dict[str, float]:
    if K_FC not in estimates.names:
        raise InputError(
            f"the estimates do not contain {K_FC}", remedy="give the estimates of one trial: JointFit.of_trial"
        )
    return {name: estimates.value(name) if name in estimates.names else value for name, value in centre.items()}


def runtime_slope(run: Callable[[Mapping[str, float]], Discharge], name: str, value: float, std: float) -> float:
    """d(runtime)/d(parameter) across a good part of its uncertainty; one-sided at a boundary or a stall."""
    step = min(STEP_SHARE * std, 0.5 * value) if value > 0 else STEP_SHARE * std
    up, down = run({name: value + step}), run({name: max(value - step, 0.0)})
    low = max(value - step, 0.0)
    if up.status == "ok" and down.status == "ok":
        return (up.runtime_s - down.runtime_s) / (value + step - low)
    middle = run({})
    if up.status == "ok":
        return (up.runtime_s - middle.runtime_s) / step
    if down.status == "ok":
        return (middle.runtime_s - down.runtime_s) / (value - low)
    raise InputError(f"the run fails within the uncertainty of {name}", remedy="check the plant, k_Fc and the supply")


def _appendix_a(usable_a_s: float, current_a: float | None) -> float | None:
    """Eq. A.2: usable charge over the measured mean battery current."""
    if current_a is None:
        return None
    if not (math.isfinite(current_a) and current_a > 0):
        raise InputError(
            f"measured_mean_battery_current_a is {current_a!r}, allowed is a number above 0 A",
            remedy="give the battery's current, not the motor's, positive on discharge",
        )
    return usable_a_s / current_a
