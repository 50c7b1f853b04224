"""Simulated annealing as in the paper's Appendix B: one parameter, bounds 100 to 500, start at 130 N*s/m.

Read from the MATLAB call `simulannealbnd(fun, d_init, d_l, d_u)` with its defaults: a step of the length
of the temperature in a random direction, wrapped into the bounds; a worse point is taken with probability
1 / (1 + exp(rise / T)); T = 100 * 0.95^k with a reannealing every 100 accepted points. It stops, as that
function does, when the best value has moved by less than 1e-6 on average over 500 iterations. Kept to
compare with the paper; the other methods of `fit` take a hundredth of the simulations and do not depend on luck.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_observation import FeatureModel, TrialObservation, drive_of, observe
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.periodic_cycle import PLANT_NAMES, CuttingHalf
from sawbench.modeling.results import CuttingFit, FitStatus

Floats = NDArray[np.float64]

APPENDIX_B_BOUNDS: Final = (100.0, 500.0)
APPENDIX_B_START: Final = 130.0
START_TEMPERATURE: Final = 100.0
COOLING: Final = 0.95
REANNEAL_EVERY: Final = 100
STALL_ITERATIONS: Final = 500
STALL_TOLERANCE: Final = 1e-6
MOST_EVALUATIONS: Final = 3000
# Strokes between which the stroke of any k_Fc is interpolated.
N_GRID: Final = 256


@dataclass(frozen=True, kw_only=True, slots=True)
class Annealed:
    """Where the annealing ended.

    Attributes
    ----------
    value : float
        Best point found.
    cost : float
    n_evaluations : int
    is_settled : bool
        False where the evaluations ran out first.
    """

    value: float
    cost: float
    n_evaluations: int
    is_settled: bool


def anneal(
    cost: Callable[[float], float],
    *,
    bounds: tuple[float, float] = APPENDIX_B_BOUNDS,
    start: float = APPENDIX_B_START,
    seed: int = 0,
    most_evaluations: int = MOST_EVALUATIONS,
) -> Annealed:
    """Minimise a function of one variable by simulated annealing.

    Parameters
    ----------
    cost : callable
    bounds : tuple of float
    start : float
        Inside the bounds.
    seed : int
        Of the random steps: the same seed gives the same answer.
    most_evaluations : int

    Raises
    ------
    InputError
        If the start is outside of the bounds.

    Examples
    --------
    >>> found = anneal(lambda x: (x - 240.29) ** 2)
    >>> abs(found.value - 240.29) < 0.5, found.n_evaluations > 500
    (True, True)
    """
    low, high = bounds
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"bounds are {bounds}, allowed is lower < upper, N*s/m")
    if not low <= start <= high:
        raise InputError(f"start is {start!r}, allowed is {low:g} to {high:g} N*s/m")
    rng = np.random.default_rng(seed)
    current, current_cost = start, cost(start)
    best, best_cost = current, current_cost
    history = [best_cost]
    k, accepted = 0, 0
    while len(history) < most_evaluations:
        k += 1
        temperature = START_TEMPERATURE * COOLING**k
        trial = current + temperature * (1.0 if rng.random() < 0.5 else -1.0) * rng.random()
        if not low <= trial <= high:
            share = rng.random()
            trial = share * (high if trial > high else low) + (1.0 - share) * current
        trial_cost = cost(trial)
        rise = trial_cost - current_cost
        odds = math.exp(-min(max(rise / max(temperature, 1e-12), -700.0), 700.0))
        if rise < 0 or rng.random() < odds / (1.0 + odds):
            current, current_cost = trial, trial_cost
            accepted += 1
        if trial_cost < best_cost:
            best, best_cost = trial, trial_cost
        history.append(best_cost)
        if accepted >= REANNEAL_EVERY:
            k, accepted = max(k // 2, 1), 0
        if len(history) > STALL_ITERATIONS:
            moved = (history[-STALL_ITERATIONS] - best_cost) / STALL_ITERATIONS
            if moved < STALL_TOLERANCE * max(1.0, abs(best_cost)):
                break
    return Annealed(
        value=float(best),
        cost=float(best_cost),
        n_evaluations=len(history),
        is_settled=len(history) < most_evaluations,
    )


def anneal_cycles(
    cycles: MeasuredCycles,
    *,
    plant: PlantConfig,
    battery: BatteryConfig | None = None,
    converter: ConverterConfig | None = None,
    cutting_half: CuttingHalf = "pi_to_2pi",
    bounds: tuple[float, float] = APPENDIX_B_BOUNDS,
) -> CuttingFit:
    """Anneal k_Fc on the current of measured strokes, the plant at its nominal values.

    The squared error is that of the mean stroke over the crank angle, the model's stroke interpolated between a grid of
    k_Fc. The uncertainty is that of the least-squares fit on the current: annealing itself has none.

    Raises
    ------
    InputError
        If the current or the supply is not known.
    """
    from sawbench.modeling.joint_fit import fit_jointly

    observation = observe(cycles, "current", drive_of(cycles, battery, converter))
    cost = _stroke_cost(cycles, observation, plant, cutting_half, bounds)
    start = min(max(APPENDIX_B_START, bounds[0]), bounds[1])
    found = anneal(cost, bounds=bounds, start=start)
    joint = fit_jointly(
        [cycles],
        plant=plant,
        battery=battery,
        converter=converter,
        cutting_half=cutting_half,
        method="current",
        bounds=bounds,
    )
    width = 1e-3 * (bounds[1] - bounds[0])
    status: FitStatus = "ok" if found.is_settled else "not_converged"
    if not bounds[0] + width < found.value < bounds[1] - width:
        status = "at_bound"
    return CuttingFit(
        k_fc_n_s_per_m=found.value,
        std_n_s_per_m=float(joint.std_n_s_per_m[0]),
        statistical_std_n_s_per_m=float(joint.statistical_std_n_s_per_m[0]),
        method="annealing",
        status=status,
        rmse_a=float(np.sqrt(found.cost / observation.n_bins)),
        rmse_n=None,
        n_simulations=N_GRID + joint.n_simulations,
        identifiability=("annealing fits k_Fc only; errors of the plant constants go into k_Fc"),
        notes=("the uncertainty is that of the least-squares fit on the current",),
    )


def _stroke_cost(
    cycles: MeasuredCycles,
    observation: TrialObservation,
    plant: PlantConfig,
    cutting_half: CuttingHalf,
    bounds: tuple[float, float],
) -> Callable[[float], float]:
    """Squared error of the mean stroke's current over k_Fc, the model's interpolated between a grid of them."""
    from scipy.interpolate import CubicSpline

    model = FeatureModel(
        gear_ratio=plant.gear_ratio,
        cutting_half=cutting_half,
        rod_length_m=plant.rod_length_m if plant.mechanism == "slider_crank" else None,
        crank_radius_m=plant.crank_radius_m.nominal,
    )
    values = {name: np.array([getattr(plant, name).nominal]) for name in PLANT_NAMES}
    values |= {name: np.array([1.0]) for name in ("current_gain", "force_gain", "voltage_gain")}
    values |= {"angle_zero_rad": np.array([0.0]), "force_offset_n": np.array([0.0])}
    is_current = observation.channel == 0
    grid = np.linspace(*bounds, N_GRID)
    rows = {name: np.repeat(value, N_GRID) for name, value in values.items()} | {"k_fc_n_s_per_m": grid}
    features, is_valid = model.predict(rows, observation)
    stall_cost = float(np.sum(observation.data[is_current] ** 2)) * 1e6
    # Beyond the last k_Fc that the motor still turns there is nothing to interpolate.
    n_valid = N_GRID if is_valid.all() else int(np.argmin(is_valid))
    if n_valid < 4:
        raise InputError(
            f"the model stalls at k_Fc = {grid[n_valid]:.0f} N*s/m", where=cycles.label, remedy="lower the bounds"
        )
    curve = CubicSpline(grid[:n_valid], features[:n_valid, is_current])

    def cost(k_fc: float) -> float:
        if k_fc > grid[n_valid - 1]:
            return stall_cost
        return float(np.sum((curve(k_fc) - observation.data[is_current]) ** 2))

    return cost
