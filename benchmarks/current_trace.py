"""The paper's identification: the k_Fc whose current over time has the smallest squared error (Eqs. 14, 15).

The error over time has several minima, because a wrong k_Fc makes the strokes slip in phase. The search
starts on a window so short that every basin is caught by the scan, then lengthens the window, and finally
looks into the neighbouring basins, one stroke of slip to each side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.linear import CuttingHalf, LinearCutting
from sawbench.modeling.results import FitStatus
from sawbench.modeling.supplies import Supply
from sawbench.modeling.transient import AT_REST, NO_TABLE, InitialState, run_vector

from benchmarks.annealing import APPENDIX_B_BOUNDS, APPENDIX_B_START, Annealed, anneal

Floats = NDArray[np.float64]

FIRST_WINDOW_S: Final = 1.0
# Strokes that two neighbouring scan points slip against each other over the window; a basin is about one
# wide.
SCAN_SLIP: Final = 0.5
K_TOLERANCE: Final = 1e-4


@dataclass(kw_only=True, slots=True)
class CurrentTrace:
    """A measured (or simulated) current over time and the model that is compared with it.

    Attributes
    ----------
    time_s, current_a : ndarray, shape (n,)
    vector : ndarray, shape (N_SLOTS,)
        Everything but k_Fc.
    initial : InitialState
    ocv : ndarray, shape (n, 4)
        Spline of the open-circuit voltage; no rows where there is none.
    spent_s : float
        Simulated time so far; over the trace's length it counts simulations.
    n_calls : int
    """

    time_s: Floats
    current_a: Floats
    vector: Floats
    initial: InitialState
    ocv: Floats
    spent_s: float = field(default=0.0)
    n_calls: int = field(default=0)

    def simulate(self, k_fc: float, n_samples: int | None = None) -> Floats:
        """Model current at the first `n_samples` times, A."""
        time_s = self.time_s if n_samples is None else self.time_s[:n_samples]
        self.vector[slots.K_FC] = k_fc
        self.spent_s += float(time_s[-1])
        self.n_calls += 1
        return run_vector(self.vector, NO_TABLE, self.ocv, time_s, self.initial).motor_current_a

    def ise(self, k_fc: float, n_samples: int | None = None) -> float:
        """Sum of squared errors (Eq. 15), A^2."""
        difference = self.simulate(k_fc, n_samples) - self.current_a[:n_samples]
        return float(difference @ difference)


def current_trace(
    time_s: ArrayLike,
    current_a: ArrayLike,
    *,
    parameters: JigsawParameters,
    supply: Supply,
    cutting_half: CuttingHalf = "pi_to_2pi",
    initial: InitialState = AT_REST,
) -> CurrentTrace:
    """Put a current and a model together.

    Raises
    ------
    InputError
        If times and currents do not fit together, are not finite, or the times do not increase from 0 on.
    """
    time, current = np.array(time_s, dtype=np.float64), np.array(current_a, dtype=np.float64)
    if time.ndim != 1 or time.shape != current.shape or len(time) < 3:
        raise InputError(f"current_a has shape {current.shape} for times of shape {time.shape}")
    if not (np.isfinite(time).all() and np.isfinite(current).all()):
        raise InputError("time_s and current_a must be finite")
    if time[0] < 0 or np.diff(time).min() <= 0:
        raise InputError("time_s must increase from 0 on")
    vector = parameters.to_vector()
    supply.fill(vector)
    LinearCutting(k_fc_n_s_per_m=0.0, cutting_half=cutting_half).fill(vector)
    ocv = None if supply.battery is None else supply.battery.ocv_table()
    return CurrentTrace(
        time_s=time, current_a=current, vector=vector, initial=initial, ocv=NO_TABLE if ocv is None else ocv
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class TraceFit:
    """The k_Fc with the smallest squared error over time.

    Attributes
    ----------
    k_fc_n_s_per_m : float
    ise_a2 : float
        Eq. 15.
    rmse_a : float
    n_calls : int
        Simulations run, short ones counted as one.
    simulation_times : float
        Simulated time over the length of the trace: the cost in whole simulations.
    other_minima : tuple of (k_fc, ise)
        Neighbouring minima that were looked into; none for a trace no longer than `FIRST_WINDOW_S`.
    status : {"ok", "at_bound"}
    """

    k_fc_n_s_per_m: float
    ise_a2: float
    rmse_a: float
    n_calls: int
    simulation_times: float
    other_minima: tuple[tuple[float, float], ...]
    status: FitStatus


def fit_current_trace(
    time_s: ArrayLike,
    current_a: ArrayLike,
    *,
    parameters: JigsawParameters,
    supply: Supply,
    cutting_half: CuttingHalf = "pi_to_2pi",
    initial: InitialState = AT_REST,
    bounds: tuple[float, float] = APPENDIX_B_BOUNDS,
) -> TraceFit:
    """Minimise the squared error of the current over time, globally.

    Failure cases: a supply or plant so wrong that the strokes of the first second slip by more than half a
    stroke against the data at every k_Fc; the trace must begin in the state `initial`.

    Parameters
    ----------
    time_s, current_a : array_like, shape (n,), s and A
        Times from 0 on, where the machine is in the state `initial`.
    parameters : JigsawParameters
    supply : FixedVoltage, FixedDuty or HeldVoltage
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    initial : InitialState
    bounds : tuple of float
        Lowest and highest k_Fc, N*s/m.

    Returns
    -------
    TraceFit

    Raises
    ------
    InputError
        If the arrays do not fit together or the bounds are not 0 <= lower < upper.
    """
    if not (np.isfinite(bounds).all() and 0.0 <= bounds[0] < bounds[1]):
        raise InputError(f"bounds are {bounds}, allowed is 0 <= lower < upper, N*s/m")
    trace = current_trace(
        time_s, current_a, parameters=parameters, supply=supply, cutting_half=cutting_half, initial=initial
    )
    total_s = float(trace.time_s[-1])
    window_s = min(FIRST_WINDOW_S, total_s)
    grid = _scan_grid(trace, window_s, bounds)
    low, best, high = _bracket(lambda k: trace.ise(k, _samples(trace, window_s)), grid)
    while True:
        n_samples = _samples(trace, window_s)
        tolerance = K_TOLERANCE if window_s >= total_s else 0.02
        best, ise = _minimise(lambda k, n=n_samples: trace.ise(k, n), (low, best, high), bounds, tolerance)
        if window_s >= total_s:
            break
        window_s = min(2.0 * window_s, total_s)
        width = 0.25 * _basin_width(trace, best, window_s)
        low, high = max(best - width, bounds[0]), min(best + width, bounds[1])
    # Over the first window the scan has seen every basin; only longer ones can hide a better neighbour.
    others = _neighbours(trace, best, total_s, bounds) if total_s > FIRST_WINDOW_S else ()
    for k_fc, value in others:
        if value < ise:
            others = (*((k, v) for k, v in others if k != k_fc), (best, ise))
            best, ise = k_fc, value
    is_inside = bounds[0] + 10 * K_TOLERANCE < best < bounds[1] - 10 * K_TOLERANCE
    return TraceFit(
        k_fc_n_s_per_m=best,
        ise_a2=ise,
        rmse_a=float(np.sqrt(ise / len(trace.time_s))),
        n_calls=trace.n_calls,
        simulation_times=trace.spent_s / total_s,
        other_minima=others,
        status="ok" if is_inside else "at_bound",
    )


def _samples(trace: CurrentTrace, window_s: float) -> int:
    return max(int(np.searchsorted(trace.time_s, window_s, side="right")), 3)


def _stroke_rate_hz(trace: CurrentTrace, k_fc: Floats | float) -> Floats | float:
    """Stroke rate that the mean torques balance at; good to a few percent, which is enough for a scan."""
    p = trace.vector
    voltage_v = p[slots.VOLTAGE]
    if p[slots.MODE] == slots.FIXED_DUTY:
        voltage_v = p[slots.DUTY] * p[slots.NOMINAL_VOLTAGE]
    drag = 0.25 * k_fc * p[slots.RADIUS] ** 2 + p[slots.DAMPING] * p[slots.GEAR] ** 2
    per_volt = p[slots.BACK_EMF] * p[slots.GEAR] + p[slots.RESISTANCE] * drag / (
        p[slots.GEAR] * p[slots.TORQUE_CONSTANT]
    )
    return voltage_v / per_volt / (2.0 * np.pi)


def _scan_grid(trace: CurrentTrace, window_s: float, bounds: tuple[float, float]) -> Floats:
    """k_Fc values that slip by `SCAN_SLIP` strokes from one to the next over the window."""
    fine = np.linspace(*bounds, 401)
    strokes = window_s * np.asarray(_stroke_rate_hz(trace, fine))
    n_points = max(int(np.ceil((strokes[0] - strokes[-1]) / SCAN_SLIP)) + 1, 5)
    return np.interp(np.linspace(strokes[0], strokes[-1], n_points), strokes[::-1], fine[::-1])


def _basin_width(trace: CurrentTrace, k_fc: float, window_s: float) -> float:
    """Change of k_Fc that makes the strokes slip by one over the window."""
    step = 1e-3 * (k_fc + 1.0)
    slope = (_stroke_rate_hz(trace, k_fc + step) - _stroke_rate_hz(trace, max(k_fc - step, 0.0))) / (2 * step)
    return float(1.0 / max(abs(slope) * window_s, 1e-12))


def _bracket(cost: Callable[[float], float], grid: Floats) -> tuple[float, float, float]:
    values = np.array([cost(float(k)) for k in grid])
    n = int(np.argmin(values))
    return float(grid[max(n - 1, 0)]), float(grid[n]), float(grid[min(n + 1, len(grid) - 1)])


def _neighbours(
    trace: CurrentTrace, best: float, total_s: float, bounds: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """Minima one stroke of slip to either side; no pair of strokes is skipped without a look."""
    width = _basin_width(trace, best, total_s)
    found = []
    for side in (-1.0, 1.0):
        centre = best + side * width
        if not bounds[0] < centre < bounds[1] or width > bounds[1] - bounds[0]:
            continue
        span = (max(centre - 0.3 * width, bounds[0]), centre, min(centre + 0.3 * width, bounds[1]))
        found.append(_minimise(trace.ise, span, bounds, 0.02 * width, most_calls=2))
    return tuple(found)


def _minimise(
    cost: Callable[[float], float],
    span: tuple[float, float, float],
    bounds: tuple[float, float],
    tolerance: float,
    most_calls: int = 12,
) -> tuple[float, float]:
    """Parabolas through the three best points, a golden section where one fails; stays in the bounds."""
    points = sorted({(float(k), cost(float(k))) for k in dict.fromkeys(span)}, key=lambda point: point[1])
    for _ in range(most_calls):
        k, value = points[0]
        below = [p for p in points if p[0] < k]
        above = [p for p in points if p[0] > k]
        left = max(below, default=(max(bounds[0], k - 0.5 * (above[0][0] - k) if above else bounds[0]), np.nan))
        right = min(above, default=(min(bounds[1], k + 0.5 * (k - below[-1][0]) if below else bounds[1]), np.nan))
        guess = _vertex(left, (k, value), right)
        if guess is None or not left[0] < guess < right[0]:
            wide = right[0] - k > k - left[0]
            guess = k + 0.382 * ((right[0] - k) if wide else (left[0] - k))
        if abs(guess - k) < tolerance:
            break
        points = sorted([*points, (guess, cost(guess))], key=lambda point: point[1])
    return points[0]


def _vertex(left: tuple[float, float], middle: tuple[float, float], right: tuple[float, float]) -> float | None:
    if not (np.isfinite(left[1]) and np.isfinite(right[1])):
        return None
    a, b = middle[0] - left[0], middle[0] - right[0]
    fa, fb = middle[1] - right[1], middle[1] - left[1]
    below = a * fa - b * fb
    if below == 0.0:
        return None
    return float(middle[0] - 0.5 * (a * a * fa - b * b * fb) / below)


def anneal_current_trace(
    time_s: ArrayLike,
    current_a: ArrayLike,
    *,
    parameters: JigsawParameters,
    supply: Supply,
    cutting_half: CuttingHalf = "pi_to_2pi",
    initial: InitialState = AT_REST,
    seed: int = 0,
) -> Annealed:
    """Appendix B: the squared error of the current over time (Eq. 15), minimised by annealing.

    Parameters
    ----------
    time_s, current_a : array_like, shape (n,), s and A
        The paper uses 1 s from rest at 1 kHz.
    parameters, supply, cutting_half, initial
        The model, as in `fit_current_trace`.
    seed : int
        As in `anneal`; bounds and start are those of Appendix B.

    Returns
    -------
    Annealed
    """
    trace = current_trace(
        time_s, current_a, parameters=parameters, supply=supply, cutting_half=cutting_half, initial=initial
    )
    return anneal(trace.ise, bounds=APPENDIX_B_BOUNDS, start=APPENDIX_B_START, seed=seed)
