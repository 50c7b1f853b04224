"""The runtime over k_Fc, duty and capacity: what a harder wood, another duty or another battery would change."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BatteryConfig
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.battery_range import BatteryUse, outside_range
from sawbench.modeling.configured_battery import AnyBattery, with_capacity
from sawbench.modeling.discharge import Discharge, discharge
from sawbench.modeling.effect_discharge import N_NODES
from sawbench.modeling.operating_point import OperatingPoint
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.linear import CuttingHalf, LinearCutting
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.runtime import STEPS_PER_TURN, effect_runs, runtime_slope
from sawbench.modeling.supplies import FixedDuty

# A sweep of more cells than this is worth compiling; below, the interpreter is through first.
MOST_INTERPRETED: Final = 300
Place = tuple[int, ...]
# Goes through the cases, and may show how far it is.
Steps = Callable[[Sequence[Place]], Iterable[Place]]


@dataclass(frozen=True, kw_only=True, slots=True)
class RuntimeSweep:
    """Runtime over cutting coefficient, duty and capacity.

    Attributes
    ----------
    k_fc_n_s_per_m : ndarray, shape (n_k,)
    duty : ndarray, shape (n_duty,)
    capacity_ah : ndarray, shape (n_capacity,)
    runtime_s, mean_battery_current_a : ndarray, shape (n_k, n_duty, n_capacity)
        nan where the status is not "ok".
    status : ndarray of str, shape (n_k, n_duty, n_capacity)
    effects_std_s, battery_std_s : ndarray, shape (n_k, n_duty, n_capacity), optional
        Standard uncertainty of the runtime that comes from the known effects, and from the fit of the battery; None
        where none is stated. That of k_Fc and of the plant is not among them.
    notes : mapping of (int, int, int) to tuple of str
        Where a case lies outside of what the battery or a learned term was fitted to: its place -> what to know.
    """

    k_fc_n_s_per_m: Floats
    duty: Floats
    capacity_ah: Floats
    runtime_s: Floats
    mean_battery_current_a: Floats
    status: NDArray[np.str_]
    effects_std_s: Floats | None = None
    battery_std_s: Floats | None = None
    notes: Mapping[Place, tuple[str, ...]] = field(default_factory=dict)


# Size: options by name: three ranges, and when each run ends.
def sweep_runtime(
    parameters: JigsawParameters,
    *,
    battery: AnyBattery,
    k_fc_values: Sequence[float],
    duties: Sequence[float],
    capacities_ah: Sequence[float],
    cutting_half: CuttingHalf = "pi_to_2pi",
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    steps: Steps = iter,
) -> RuntimeSweep:
    """Runtime for every combination of k_Fc, duty and capacity.

    Parameters
    ----------
    parameters : JigsawParameters
    battery : Eq16Battery or TableBattery
        Its capacity is replaced by each of `capacities_ah`.
    k_fc_values, duties, capacities_ah : sequence of float
    cutting_half, cutoff_soc, cutoff_voltage_v
        As in `predict_runtime`.
    steps : callable
        Goes through the cases, such as with a progress bar.

    Raises
    ------
    InputError
        If a list is empty or a value out of its range.
    """
    n_cases = len(k_fc_values) * len(duties) * len(capacities_ah)

    def run(k_fc: float, duty: float, capacity_ah: float) -> tuple[Discharge, float]:
        found = discharge(
            parameters,
            supply=FixedDuty(duty=duty, battery=with_capacity(battery, capacity_ah)),
            cutting=LinearCutting(k_fc_n_s_per_m=k_fc, cutting_half=cutting_half),
            cutoff_soc=cutoff_soc,
            cutoff_voltage_v=cutoff_voltage_v,
            steps_per_turn=STEPS_PER_TURN,
            compiles=n_cases > MOST_INTERPRETED,
        )
        return found, math.nan

    return _swept(run, k_fc_values, duties, capacities_ah, steps)


def sweep_runtime_with_effects(
    baseline: Baseline,
    *,
    k_fc_values: Sequence[float],
    duties: Sequence[float],
    capacities_ah: Sequence[float],
    steps: Steps = iter,
) -> RuntimeSweep:
    """Runtime of a saw with known effects for every combination of k_Fc, duty and capacity.

    Parameters
    ----------
    baseline : Baseline
        With a battery, whose cut-offs end the runs; its capacity is replaced by each of `capacities_ah`.
    k_fc_values, duties, capacities_ah : sequence of float
    steps : callable
        As in `sweep_runtime`.

    Returns
    -------
    RuntimeSweep
        With `effects_std_s` where the effects state an uncertainty.

    Raises
    ------
    InputError
        If a list is empty or a value out of its range, or an effect cannot be predicted without a campaign.
    """
    battery = baseline.battery
    if battery is None:
        raise InputError("a runtime needs a battery", remedy="fill in [battery]")
    uncertain = [known for known in baseline.known if known.std > 0.0]

    def run(k_fc: float, duty: float, capacity_ah: float) -> tuple[Discharge, float]:
        cells = battery.model_copy(update={"capacity_ah": capacity_ah})
        point = OperatingPoint(k_fc_n_s_per_m=k_fc, duty=duty)
        run_down, centre = effect_runs(dataclasses.replace(baseline, battery=cells), point)
        found = run_down({}, N_NODES)
        if found.status != "ok" or not uncertain:
            return found, math.nan
        slopes = (runtime_slope(run_down, known.name, centre[known.name], known.std) for known in uncertain)
        shares = (slope * known.std for slope, known in zip(slopes, uncertain, strict=True))
        return found, math.hypot(*shares)

    return _swept(run, k_fc_values, duties, capacities_ah, steps)


def with_battery_range(sweep: RuntimeSweep, battery: BatteryConfig, use: BatteryUse | None = None) -> RuntimeSweep:
    """Add what a fitted battery states of its own uncertainty, and the cases that lie outside its range.

    Parameters
    ----------
    sweep : RuntimeSweep
    battery : BatteryConfig
        Without `fitted` the sweep stays as it is.
    use : BatteryUse, optional
    """
    if battery.fitted is None:
        return sweep
    notes = dict(sweep.notes)
    for place in np.ndindex(*sweep.status.shape):
        if sweep.status[place] == "ok":
            drawn_a, capacity_ah = float(sweep.mean_battery_current_a[place]), float(sweep.capacity_ah[place[2]])
            found = (*notes.get(place, ()), *outside_range(drawn_a, battery, use, capacity_ah=capacity_ah))
            notes |= {place: found} if found else {}
    return dataclasses.replace(sweep, battery_std_s=battery.fitted.runtime_rel_std * sweep.runtime_s, notes=notes)


def _swept(
    run: Callable[[float, float, float], tuple[Discharge, float]],
    k_fc_values: Sequence[float],
    duties: Sequence[float],
    capacities_ah: Sequence[float],
    steps: Steps,
) -> RuntimeSweep:
    """Go through the cases; `run` gives a discharge, and its uncertainty by the effects or nan."""
    for name, values in (("k_fc_values", k_fc_values), ("duties", duties), ("capacities_ah", capacities_ah)):
        if not len(values):
            raise InputError(f"{name} is empty")
    shape = (len(k_fc_values), len(duties), len(capacities_ah))
    runtime_s, current_a, std_s = (np.full(shape, np.nan) for _ in range(3))
    status = np.full(shape, "never_reached", dtype="U16")
    notes: dict[Place, tuple[str, ...]] = {}
    for place in steps(list(np.ndindex(*shape))):
        found, own_s = run(k_fc_values[place[0]], duties[place[1]], capacities_ah[place[2]])
        status[place] = found.status
        if found.status == "ok":
            runtime_s[place], current_a[place], std_s[place] = found.runtime_s, found.mean_battery_current_a, own_s
            notes |= {place: found.notes} if found.notes else {}
    return RuntimeSweep(
        k_fc_n_s_per_m=np.array(k_fc_values, dtype=np.float64),
        duty=np.array(duties, dtype=np.float64),
        capacity_ah=np.array(capacities_ah, dtype=np.float64),
        runtime_s=runtime_s,
        mean_battery_current_a=current_a,
        status=status,
        effects_std_s=std_s if np.isfinite(std_s).any() else None,
        notes=notes,
    )
