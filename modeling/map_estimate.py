"""Gauss-Newton to the most probable parameters, and an honest covariance of where it ends.

The estimate weighs data and prior with a *working* covariance. Its own covariance is then computed from
what the data actually did (the sandwich form), so a wrong working covariance costs efficiency, not honesty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Predict = Callable[[Floats], tuple[Floats, NDArray[np.bool_]]]
# A model that misses far more than the noise converges slowly: a yoke fitted to a slider crank takes about 80.
MOST_ITERATIONS = 400


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameters:
    """What is estimated.

    Attributes
    ----------
    names : tuple of str
    start, prior_mean, prior_std : ndarray, shape (p,)
        An infinite `prior_std` says that nothing is known beforehand.
    step : ndarray, shape (p,)
        Step of the numerical derivatives.
    lower, upper : ndarray, shape (p,)
    """

    names: tuple[str, ...]
    start: Floats
    prior_mean: Floats
    prior_std: Floats
    step: Floats
    lower: Floats
    upper: Floats

    @property
    def precision(self) -> Floats:
        """Inverse prior variances, 0 where nothing is known."""
        return 1.0 / self.prior_std**2


@dataclass(frozen=True, kw_only=True, slots=True)
class Estimate:
    """Where Gauss-Newton ended.

    Attributes
    ----------
    values : ndarray, shape (p,)
    residual : ndarray, shape (m,)
        Data minus prediction at `values`.
    jacobian : ndarray, shape (m, p)
    gain : ndarray, shape (p, m)
        d(values) / d(data).
    prior_gain : ndarray, shape (p, p)
        d(values) / d(prior mean).
    is_converged, is_valid : bool
        `is_valid` is false where the model has no solution at the start, or nothing depends on one of the parameters.
    n_predictions : int
    """

    values: Floats
    residual: Floats
    jacobian: Floats
    gain: Floats
    prior_gain: Floats
    is_converged: bool
    is_valid: bool
    n_predictions: int


def most_probable(predict: Predict, data: Floats, covariance: Floats, parameters: Parameters) -> Estimate:
    """Maximise likelihood times prior by damped Gauss-Newton with projected bounds.

    Parameters
    ----------
    predict : callable
        (n_cases, p) parameter rows to ((n_cases, m) predictions, (n_cases,) validity).
    data : ndarray, shape (m,)
    covariance : ndarray, shape (m, m)
        Working covariance of `data`.
    parameters : Parameters
    """
    weight: Floats = np.linalg.inv(covariance).astype(np.float64)
    values = np.clip(parameters.start, parameters.lower, parameters.upper)
    prediction, is_valid = predict(values[None])
    n_predictions, damping, is_converged = 1, 0.0, False
    if not is_valid[0]:
        return _no_solution(values, data)
    residual = data - prediction[0]
    jacobian, n = _jacobian(predict, values, parameters)
    n_predictions += n
    cost = _cost(residual, values, weight, parameters)
    for _ in range(MOST_ITERATIONS):
        try:
            move = _step(residual, jacobian, values, weight, parameters, damping)
        except np.linalg.LinAlgError:
            return _no_solution(values, data)
        trial = np.clip(values + move, parameters.lower, parameters.upper)
        prediction, is_valid = predict(trial[None])
        n_predictions += 1
        new_residual = data - prediction[0]
        new_cost = _cost(new_residual, trial, weight, parameters) if is_valid[0] else np.inf
        if new_cost > cost + 1e-9 * abs(cost) + 1e-12:
            damping = max(10.0 * damping, 1e-2)
            if damping > 1e9:
                break
            continue
        fell = cost - new_cost
        values, residual, cost, damping = trial, new_residual, new_cost, 0.2 * damping
        jacobian, n = _jacobian(predict, values, parameters)
        n_predictions += n
        if fell < 1e-6 + 1e-9 * cost:
            is_converged = True
            break
    normal = jacobian.T @ weight @ jacobian + np.diag(parameters.precision)
    inverse = np.linalg.inv(normal)
    return Estimate(
        values=values,
        residual=residual,
        jacobian=jacobian,
        gain=inverse @ jacobian.T @ weight,
        prior_gain=inverse * parameters.precision,
        is_converged=is_converged,
        is_valid=True,
        n_predictions=n_predictions,
    )


def _no_solution(values: Floats, data: Floats) -> Estimate:
    """Where the model has no solution at the start, nothing is estimated."""
    nothing = np.zeros((len(values), len(data)))
    return Estimate(
        values=values,
        residual=data,
        jacobian=nothing.T,
        gain=nothing,
        prior_gain=np.eye(len(values)),
        is_converged=False,
        is_valid=False,
        n_predictions=1,
    )


def _step(
    residual: Floats,
    jacobian: Floats,
    values: Floats,
    weight: Floats,
    parameters: Parameters,
    damping: float,
) -> Floats:
    """Damped Gauss-Newton step; a parameter at a bound that it wants to cross stays."""
    normal = jacobian.T @ weight @ jacobian + np.diag(parameters.precision)
    downhill = jacobian.T @ weight @ residual + parameters.precision * (parameters.prior_mean - values)
    is_held_low = (values <= parameters.lower) & (downhill < 0)
    is_held_high = (values >= parameters.upper) & (downhill > 0)
    is_free = ~(is_held_low | is_held_high)
    free = np.ix_(is_free, is_free)
    move = np.zeros_like(values)
    damped = normal[free] + damping * np.diag(np.diag(normal)[is_free])
    move[is_free] = np.linalg.solve(damped, downhill[is_free])
    return move


def _cost(residual: Floats, values: Floats, weight: Floats, parameters: Parameters) -> float:
    miss = values - parameters.prior_mean
    return float(residual @ weight @ residual + miss @ (parameters.precision * miss))


def _jacobian(predict: Predict, values: Floats, parameters: Parameters) -> tuple[Floats, int]:
    """Central differences in one batch; one-sided where one side is out of bounds or has no solution."""
    p = len(values)
    step = np.diag(parameters.step)
    rows = np.clip(np.vstack([values + step, values - step]), parameters.lower, parameters.upper)
    predictions, is_valid = predict(np.vstack([rows, values[None]]))
    columns = []
    for j in range(p):
        up = j if is_valid[j] else -1
        down = p + j if is_valid[p + j] else -1
        width = (rows[up, j] if up >= 0 else values[j]) - (rows[down, j] if down >= 0 else values[j])
        columns.append((predictions[up] - predictions[down]) / width if width else np.zeros(predictions.shape[1]))
    return np.array(columns).T, 2 * p + 1
