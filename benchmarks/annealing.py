"""Simulated annealing as in the paper's Appendix B: one parameter, bounds 100 to 500, start at 130 N*s/m.

Read from the MATLAB call `simulannealbnd(fun, d_init, d_l, d_u)` with its defaults: a step of the length
of the temperature in a random direction, wrapped into the bounds; a worse point is taken with probability
1 / (1 + exp(rise / T)); T = 100 * 0.95^k with a reannealing every 100 accepted points. It stops, as that
function does, when the best value has moved by less than 1e-6 on average over 500 iterations. Here to compare
with the paper: the methods of `fit` take a hundredth of the simulations and do not depend on luck.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError

APPENDIX_B_BOUNDS: Final = (100.0, 500.0)
APPENDIX_B_START: Final = 130.0
START_TEMPERATURE: Final = 100.0
COOLING: Final = 0.95
REANNEAL_EVERY: Final = 100
STALL_ITERATIONS: Final = 500
STALL_TOLERANCE: Final = 1e-6
MOST_EVALUATIONS: Final = 3000


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
