"""Which battery model predicts discharges that it was not fitted to, and how far it is off then.

Every discharge is withheld once; the model fitted to the others predicts its runtime at its measured current, and the
mean of its voltage. A tool at a fixed duty draws a current in proportion to the voltage, so both errors are errors of
a runtime, of the same size:

    u = t_n sqrt(mean(e_runtime^2 + e_voltage^2)) / 1.96

over the n withheld discharges, with Student's t for n of them, so that 1.96 u is half a 95 % interval however few they
are. The smallest u is chosen among the models that do not contradict their own discharges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np
from sawbench.bench.config import BatteryConfig
from sawbench.bench.correlated import student_factor
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.bench.plain_digits import rounded
from sawbench.bench.spread import jackknife_std
from sawbench.modeling.battery_fit import BatteryFit, BatteryModel, charge_left, fit_battery
from sawbench.modeling.measured_discharge import MeasuredDischarge, common_cutoff

MODELS: Final[tuple[BatteryModel, ...]] = get_args(BatteryModel)
# A fit that misses the runtime of a discharge of its own by more is refused.
LARGEST_OWN_MISS: Final = 0.05
# A model whose withheld runtimes have a larger relative standard uncertainty predicts none of them.
_LARGEST_REL_STD: Final = 1.0
# A model that runs on for longer than this many measured runtimes is as wrong as one that does so by this factor.
_LONGEST_RUN: Final = 3.0
_A_S_PER_AH: Final = 3600.0
_CURVE_POINTS, _TABLE_POINTS, _LEAST_SLOPE = 400, 41, 1e-5
# Significant digits of what goes into a configuration.
_DIGITS: Final = 6
# The state of charge at which the voltage alone ends a run: 0, but for the limit of the configuration.
_EMPTY_SOC: Final = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Miss:
    """How far a model is off on one discharge.

    Attributes
    ----------
    label : str
    measured_s, predicted_s : float
        Runtime at the measured current to the cut-off voltage.
    voltage_error : float
        Relative, of the mean voltage over the measured discharge.
    """

    label: str
    measured_s: float
    predicted_s: float
    voltage_error: float

    @property
    def runtime_error(self) -> float:
        """Predicted over measured runtime, less 1."""
        return self.predicted_s / self.measured_s - 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelTrial:
    """One model on all discharges.

    Attributes
    ----------
    model : BatteryModel
    fit : BatteryFit or None
        To all discharges; None where the model cannot be fitted.
    own : tuple of Miss
        Of that fit.
    withheld : tuple of Miss
        Of the fits to all discharges but this one.
    rel_std : float
        Standard uncertainty of a runtime, relative: u of the module.
    parameter_std : dict of str to float
        By the jackknife over the withheld discharges.
    refusal : str
        Why the model cannot be taken; empty where it can.
    """

    model: BatteryModel
    fit: BatteryFit | None = None
    own: tuple[Miss, ...] = ()
    withheld: tuple[Miss, ...] = ()
    rel_std: float = math.inf
    parameter_std: dict[str, float] | None = None
    refusal: str = ""

    @property
    def largest_own_miss(self) -> float:
        """Largest relative runtime error on a discharge that it was fitted to."""
        return max((abs(miss.runtime_error) for miss in self.own), default=math.inf)


@dataclass(frozen=True, kw_only=True, slots=True)
class BatteryChoice:
    """The model that was chosen, and what it was chosen from.

    Attributes
    ----------
    chosen : ModelTrial
    trials : tuple of ModelTrial
        Every model that was tried, best first; those that cannot be taken at the end.
    discharges : tuple of MeasuredDischarge
        Until the cut-off.
    cutoff_voltage_v : float
    """

    chosen: ModelTrial
    trials: tuple[ModelTrial, ...]
    discharges: tuple[MeasuredDischarge, ...]
    cutoff_voltage_v: float

    @property
    def fit(self) -> BatteryFit:
        """The chosen model, fitted to all discharges."""
        assert self.chosen.fit is not None
        return self.chosen.fit


def choose_battery(
    discharges: Sequence[MeasuredDischarge],
    *,
    cutoff_voltage_v: float | None = None,
    models: Sequence[BatteryModel] = MODELS,
    largest_own_miss: float = LARGEST_OWN_MISS,
    on_model: Callable[[int, int, str], None] | None = None,
) -> BatteryChoice:
    """Fit every model, withhold every discharge once, and choose by the runtime of the withheld ones.

    Parameters
    ----------
    discharges : sequence of MeasuredDischarge
        Two or more, each from full charge.
    cutoff_voltage_v : float, optional
        Where a discharge ends; default: the highest voltage that each of them falls to.
    models : sequence of BatteryModel
    largest_own_miss : float
        A model that misses the runtime of a discharge it was fitted to by more than this share is not taken.
    on_model : callable, optional
        Called with models done, models in all and the name of the next one.

    Raises
    ------
    InputError
        If there are fewer than two discharges, or one does not fall to the cut-off.
    UntrustedResult
        If every model contradicts the discharges it was fitted to, or predicts none of the withheld ones.
    """
    if len(discharges) < 2:
        raise InputError(
            f"{len(discharges)} discharge is not enough: a withheld discharge is needed to estimate the error",
            where=discharges[0].label if discharges else None,
            remedy="give two discharges or more, at currents below and above those of the tool",
        )
    cutoff_v = common_cutoff(discharges) if cutoff_voltage_v is None else cutoff_voltage_v
    ended = tuple(discharge.ended_at(cutoff_v) for discharge in discharges)
    trials = []
    for number, model in enumerate(models):
        if on_model is not None:
            on_model(number, len(models), model)
        trials.append(_tried(model, ended, cutoff_v, largest_own_miss))
    trials.sort(key=lambda trial: (bool(trial.refusal), trial.rel_std))
    if trials[0].refusal:
        raise _nothing_holds(trials, largest_own_miss)
    return BatteryChoice(chosen=trials[0], trials=tuple(trials), discharges=ended, cutoff_voltage_v=cutoff_v)


def _tried(
    model: BatteryModel, discharges: Sequence[MeasuredDischarge], cutoff_v: float, largest_own_miss: float
) -> ModelTrial:
    try:
        fit = fit_battery(discharges, model=model)
        folds = [fit_battery([d for d in discharges if d is not left], model=model) for left in discharges]
    except InputError as error:
        return ModelTrial(model=model, refusal=f"cannot be fitted with one discharge withheld: {error.what}")
    own = tuple(miss_of(fit, discharge, cutoff_v) for discharge in discharges)
    withheld = tuple(miss_of(fold, left, cutoff_v) for fold, left in zip(folds, discharges, strict=True))
    rel_std = _rel_std(withheld)
    return ModelTrial(
        model=model,
        fit=fit,
        own=own,
        withheld=withheld,
        rel_std=rel_std,
        parameter_std=_jackknife(folds, cutoff_v),
        refusal=_refusal(own, rel_std, largest_own_miss),
    )


def _refusal(own: Sequence[Miss], rel_std: float, largest_own_miss: float) -> str:
    worst = max(own, key=lambda miss: abs(miss.runtime_error))
    if abs(worst.runtime_error) > largest_own_miss:
        return f"does not reproduce its own data: runtime error of {worst.label} {worst.runtime_error:+.0%}"
    if rel_std > _LARGEST_REL_STD:
        return f"predicts no withheld discharge: u(runtime) {rel_std:.0%}"
    return ""


def miss_of(fit: BatteryFit, discharge: MeasuredDischarge, cutoff_voltage_v: float) -> Miss:
    """Compare a fit with a discharge that ends at the cut-off voltage."""
    charge = discharge.charge_a_s
    even = np.linspace(0.0, charge[-1], _CURVE_POINTS)
    modelled_v = fit.voltage_v(even, np.interp(even, charge, discharge.current_a))
    return Miss(
        label=discharge.label,
        measured_s=discharge.duration_s,
        predicted_s=predicted_runtime_s(fit, discharge, cutoff_voltage_v),
        voltage_error=float(modelled_v.mean() / np.interp(even, charge, discharge.voltage_v).mean() - 1.0),
    )


def predicted_runtime_s(fit: BatteryFit, discharge: MeasuredDischarge, cutoff_voltage_v: float) -> float:
    """Time until the model falls to the cut-off at the measured current, which goes on at its mean after the end, s."""
    mean_a = discharge.mean_current_a
    later_s = np.linspace(0.0, (_LONGEST_RUN - 1.0) * discharge.duration_s, 2001)[1:]
    time_s = np.concatenate([discharge.time_s - discharge.time_s[0], discharge.duration_s + later_s])
    charge = np.concatenate([discharge.charge_a_s, discharge.charge_a_s[-1] + mean_a * later_s])
    current_a = np.concatenate([discharge.current_a, np.full(len(later_s), mean_a)])
    voltage_v = fit.voltage_v(charge, current_a)
    below = np.flatnonzero(voltage_v <= cutoff_voltage_v)
    if not len(below):
        return float(time_s[-1])
    k = int(below[0])
    if k == 0:
        return 0.0
    share = (voltage_v[k - 1] - cutoff_voltage_v) / (voltage_v[k - 1] - voltage_v[k])
    return float(time_s[k - 1] + share * (time_s[k] - time_s[k - 1]))


def _rel_std(withheld: Sequence[Miss]) -> float:
    mean_square = float(np.mean([miss.runtime_error**2 + miss.voltage_error**2 for miss in withheld]))
    return math.sqrt(mean_square) * student_factor(len(withheld))


def _jackknife(folds: Sequence[BatteryFit], cutoff_v: float) -> dict[str, float]:
    tables = [battery_table(fold, cutoff_v) for fold in folds]
    names = [name for name, value in tables[0].items() if isinstance(value, float) and name != "cutoff_voltage_v"]
    values = np.array([[table[name] for name in names] for table in tables])
    return {name: rounded(std, 2) for name, std in zip(names, jackknife_std(values), strict=True) if std > 0}


def battery_table(fit: BatteryFit, cutoff_voltage_v: float) -> dict[str, Any]:
    """Write a fit as the entries of a `[battery]` table: full at a state of charge of 1, empty at 0.

    It is empty where the open-circuit voltage is at the cut-off, or where the slowest discharge of a table ended.
    """
    if fit.table_charge_a_s is not None and fit.table_voltage_v is not None:
        soc = np.concatenate([np.linspace(0.0, 0.2, 21), np.linspace(0.2, 1.0, 25)[1:]])
        voltage_v = fit.voltage_v((1.0 - soc) * fit.table_charge_a_s[-1], 0.0)
        # A pause or a wave in a measured curve must not let the voltage rise while charge is taken.
        rising_v = np.maximum.accumulate(voltage_v) + _LEAST_SLOPE * voltage_v[-1] * (soc - 1.0)
        full_v, curve = float(rising_v[-1]), {"soc": [round(float(s), 4) for s in soc]}
        curve["share"] = [round(float(v / full_v), 7) for v in rising_v]
        own: dict[str, Any] = {
            "nominal_voltage_v": rounded(full_v, _DIGITS),
            "capacity_ah": rounded(fit.capacity_ah, _DIGITS),
        }
        own["open_circuit"] = curve
    else:
        assert fit.nominal_voltage_v is not None and fit.beta is not None
        left = charge_left(cutoff_voltage_v, fit.nominal_voltage_v, fit.beta)
        own = {
            "nominal_voltage_v": rounded(fit.nominal_voltage_v, _DIGITS),
            "capacity_ah": rounded(fit.capacity_ah * (1.0 - left), _DIGITS),
            # The end of a flat curve lies in 1 - beta: rounded itself, beta could become 1.
            "beta": round(1.0 - rounded(1.0 - fit.beta, _DIGITS), 15),
            "shape_ratio": rounded(1.0 / (1.0 - left), _DIGITS),
        }
    own["internal_resistance_ohm"] = rounded(fit.internal_resistance_ohm, _DIGITS)
    return own | {"cutoff_voltage_v": rounded(cutoff_voltage_v, _DIGITS)}


def battery_config(choice: BatteryChoice, *, cutoff_soc: float | None = None) -> dict[str, Any]:
    """Write a choice as a whole `[battery]` table.

    Parameters
    ----------
    choice : BatteryChoice
    cutoff_soc : float, optional
        Of the tool; default: the voltage alone ends a run.

    Returns
    -------
    dict
        Valid for `BatteryConfig`.
    """
    discharges = choice.discharges
    table = battery_table(choice.fit, choice.cutoff_voltage_v)
    most_ah = max(float(d.charge_a_s[-1]) for d in discharges) / _A_S_PER_AH
    fitted: dict[str, Any] = {
        "variant": choice.fit.model,
        "n_discharges": len(discharges),
        "runtime_rel_std": rounded(choice.chosen.rel_std, 3),
        "current_a": _range([d.mean_current_a for d in discharges]),
        "soc": [max(0.0, round(1.0 - most_ah / table["capacity_ah"], 3)), 1.0],
    }
    for name, values in (
        ("temperature_c", [d.start_temperature_c for d in discharges]),
        ("cycle", [d.cycle for d in discharges]),
    ):
        known = [value for value in values if value is not None]
        if len(known) == len(discharges):
            fitted[name] = _range(known)
    fitted["std"] = choice.chosen.parameter_std or {}
    table |= {"cutoff_soc": _EMPTY_SOC if cutoff_soc is None else cutoff_soc, "fitted": fitted}
    BatteryConfig.model_validate(table)
    return table


def _range(values: Sequence[float]) -> list[float]:
    return [rounded(min(values), 4), rounded(max(values), 4)]


def _nothing_holds(trials: Sequence[ModelTrial], largest_own_miss: float) -> UntrustedResult:
    lines = [f"\n  {trial.model}: {trial.refusal}" for trial in trials]
    other = "try the other models; " if len(trials) == 1 else ""
    return UntrustedResult(
        f"no battery model reproduces the runtimes of its own discharges within {largest_own_miss:.0%} and predicts"
        " withheld "
        f"ones:{''.join(lines)}",
        remedy=f"{other}fit discharges of one kind of cell, from full charge, at temperatures and currents that lie "
        "closer together; check time and current of the failed one; or allow more with --most-miss",
    )
