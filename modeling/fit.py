"""Fit the linear cutting coefficient k_Fc of one trial, with an uncertainty that is meant."""

from __future__ import annotations

import math

from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_observation import FitMethod
from sawbench.modeling.force_fit import fit_force
from sawbench.modeling.joint_fit import DEFAULT_BOUNDS, K_FC, JointFit, SensorPriors, fit_jointly
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.periodic_cycle import CuttingHalf
from sawbench.modeling.results import CuttingFit, FitStatus

# A standard uncertainty above this share of k_Fc says that the data do not hold it.
UNIDENTIFIED_SHARE = 0.5
# A constant this many prior standard deviations off was not found but bent to make up for something else.
CONTRADICTING_PULL = 5.0
# A mean stroke that misses the measured one by more than this share of its rms is no description of it.
LARGEST_MISS = 0.25
# Zeros of the sensors are set again for each trial and may lie anywhere.
FREE_SENSOR_ZEROS = ("force_offset_n", "angle_zero_rad")


def available_method(cycles: MeasuredCycles) -> FitMethod:
    """Return the method that uses every channel the trial has.

    Raises
    ------
    InputError
        If there is neither current nor force.
    """
    if cycles.current_a is not None:
        return "current" if cycles.force_n is None else "current_and_force"
    if cycles.force_n is not None:
        return "force"
    raise InputError("has neither motor current nor force, so k_Fc cannot be fitted", where=cycles.label)


def fit_cutting_coefficient(
    cycles: MeasuredCycles,
    *,
    plant: PlantConfig,
    battery: BatteryConfig | None = None,
    converter: ConverterConfig | None = None,
    cutting_half: CuttingHalf = "pi_to_2pi",
    sensors: SensorPriors = SensorPriors(),  # noqa: B008 - frozen
    method: FitMethod = "current_and_force",
    bounds: tuple[float, float] = DEFAULT_BOUNDS,
) -> CuttingFit:
    """Fit k_Fc on the strokes of one trial.

    "current_and_force" and "current" compare the mean stroke with the model's periodic stroke by least
    squares with sensitivities (`fit_jointly`); "force" regresses the force on the measured blade speed and
    needs no motor model.

    Parameters
    ----------
    cycles : MeasuredCycles
        Settled strokes: no spin-up inside.
    plant : PlantConfig
        Nominal values with `rel_std`.
    battery, converter : optional
        The supply; the battery voltage is taken as measured where it was.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    sensors : SensorPriors
        Standard uncertainty of gains, offsets and the angle's zero.
    method : {"current_and_force", "current", "force"}
    bounds : tuple of float
        Lowest and highest k_Fc, N*s/m.

    Returns
    -------
    CuttingFit
        `k_fc_n_s_per_m` +- 1.96 * `std_n_s_per_m` is meant to hold the mean k_Fc in 95 % of trials.

    Raises
    ------
    InputError
        If a channel or the duty is missing, or the strokes are too few.
    """
    if method == "force":
        return _force_only(cycles, plant, sensors, cutting_half, bounds)
    joint = fit_jointly(
        [cycles],
        plant=plant,
        battery=battery,
        converter=converter,
        cutting_half=cutting_half,
        method=method,
        sensors=sensors,
        bounds=bounds,
    )
    return cutting_fits(joint, method)[0]


def cutting_fits(joint: JointFit, method: FitMethod) -> tuple[CuttingFit, ...]:
    """Return the trials of a joint fit, one `CuttingFit` each."""
    fits = []
    contradictions = _contradictions(joint) if joint.is_valid else []
    for trial in range(len(joint.labels)):
        k_fc, std = float(joint.k_fc_n_s_per_m[trial]), float(joint.std_n_s_per_m[trial])
        status: FitStatus = "ok"
        if not joint.is_valid:
            status, k_fc, std = "stalled", math.nan, math.nan
        elif not joint.is_converged:
            status = "not_converged"
        elif joint.is_at_bound[trial]:
            status = "at_bound"
        elif std > UNIDENTIFIED_SHARE * k_fc:
            status = "not_identifiable"
        # Noise alone may be as large as a weak force.
        misses = joint.has_misfit * [
            *_misses("force", "N", joint.rmse_n[trial], joint.rms_n[trial]),
            *_misses("motor current", "A", joint.rmse_a[trial], joint.rms_a[trial]),
        ]
        if status == "ok" and (contradictions or misses):
            status = "contradicted"
        notes = [*joint.notes, *contradictions, *misses]
        if joint.has_misfit:
            notes.append(
                "the mean stroke differs from the model by more than noise explains; the uncertainty "
                "includes the misfit as model error"
            )
        fits.append(
            CuttingFit(
                k_fc_n_s_per_m=k_fc,
                std_n_s_per_m=std,
                statistical_std_n_s_per_m=float(joint.statistical_std_n_s_per_m[trial]),
                method=method,
                status=status,
                rmse_a=joint.rmse_a[trial],
                rmse_n=joint.rmse_n[trial],
                n_simulations=joint.n_simulations,
                identifiability=_identifiability(joint, trial),
                notes=tuple(notes),
                estimates=joint.of_trial(trial),
            )
        )
    return tuple(fits)


def _contradictions(joint: JointFit) -> list[str]:
    """Name the plant constants and gains that the measurement pulls further off than their priors can mean."""
    far = [
        f"{name} ({abs(sigmas):.0f})"
        for name, sigmas in sorted(joint.pulls.items(), key=lambda item: -abs(item[1]))
        if abs(sigmas) > CONTRADICTING_PULL and not name.startswith(FREE_SENSOR_ZEROS)
    ]
    if not far:
        return []
    more = f" and {len(far) - 3} more" if len(far) > 3 else ""
    return [
        f"these would have to lie many standard deviations from their nominal values: {', '.join(far[:3])}{more}; "
        "a sensor gain, a unit, the configuration or the model is wrong"
    ]


def _identifiability(joint: JointFit, trial: int) -> str:
    """Say where the variance of k_Fc comes from and what it cannot be told from."""
    if not joint.is_valid:
        return "the model stalls at the starting point, so no result is possible"
    shares = joint.shares[trial]
    first, second = sorted(shares, key=lambda name: -shares[name])[:2]
    estimates = joint.of_trial(trial)
    others = [name for name in estimates.names if name != K_FC]
    nearest = max(others, key=lambda name: abs(estimates.correlation(K_FC, name)), default=None)
    text = f"{shares[first]:.0%} of the variance of k_Fc comes from {_words(first)}, {shares[second]:.0%} from "
    text += _words(second)
    if nearest is not None:
        correlation = estimates.correlation(K_FC, nearest)
        if abs(correlation) > 0.7:
            text += (
                f"; the data cannot separate k_Fc from {nearest} (correlation {correlation:+.2f}), only its prior does"
            )
        elif abs(correlation) > 0.5:
            text += f"; k_Fc is only partly separated from {nearest} (correlation {correlation:+.2f})"
        else:
            text += f"; no parameter is confused with k_Fc (largest correlation {correlation:+.2f}, {nearest})"
    return text


def _words(share: str) -> str:
    return {"statistics": "the scatter of the strokes", "model error": "model error"}.get(
        share, f"the prior of {share.split('[', maxsplit=1)[0]}"
    )


def _misses(name: str, unit: str, rmse: float | None, rms: float | None) -> tuple[str, ...]:
    """Say that a fitted stroke does not describe the measured one, where that is so."""
    if rmse is None or rms is None or not rmse > LARGEST_MISS * rms:
        return ()
    return (
        f"the {name} of the fitted stroke has an RMSE of {rmse:.3g} {unit}, RMS {rms:.3g} {unit}: check "
        "the time alignment of the channels, the sign and the zero",
    )


def _force_only(
    cycles: MeasuredCycles,
    plant: PlantConfig,
    sensors: SensorPriors,
    cutting_half: CuttingHalf,
    bounds: tuple[float, float],
) -> CuttingFit:
    found = fit_force(cycles, plant=plant, cutting_half=cutting_half)
    k_fc = min(max(found.k_fc_n_s_per_m, bounds[0]), bounds[1])
    radius_rel_std = plant.crank_radius_m.rel_std
    # The mean speed hides the dip where the blade cuts; half of the usual 4 % counts as uncertain.
    speed_rel_std = 0.04 if found.uses_mean_speed else 0.0
    angle_rel_std = sensors.angle_zero_std_rad**2
    systematic = abs(k_fc) * math.hypot(sensors.force_gain_rel_std, radius_rel_std, speed_rel_std, angle_rel_std)
    std = math.hypot(found.statistical_std_n_s_per_m, systematic)
    status: FitStatus = "ok"
    if k_fc != found.k_fc_n_s_per_m:
        status = "at_bound"
    elif std > UNIDENTIFIED_SHARE * k_fc:
        status = "not_identifiable"
    misses = _misses("force", "N", found.rmse_n, found.rms_n)
    if status == "ok" and misses:
        status = "contradicted"
    shares = {
        "the scatter of the strokes": found.statistical_std_n_s_per_m**2,
        "the gain of the load cell": (k_fc * sensors.force_gain_rel_std) ** 2,
        "the crank radius": (k_fc * radius_rel_std) ** 2,
    }
    largest = max(shares, key=lambda name: shares[name])
    note = ("crank speed not measured within the stroke: its mean was used",) if found.uses_mean_speed else ()
    return CuttingFit(
        k_fc_n_s_per_m=k_fc,
        std_n_s_per_m=std,
        statistical_std_n_s_per_m=found.statistical_std_n_s_per_m,
        method="force",
        status=status,
        rmse_a=None,
        rmse_n=found.rmse_n,
        n_simulations=0,
        identifiability=(
            "force and blade speed give k_Fc without the motor; "
            f"{shares[largest] / max(std**2, 1e-300):.0%} of its variance comes from {largest}; "
            "it is confounded with the gain of the load cell"
        ),
        notes=(*note, *misses),
    )
