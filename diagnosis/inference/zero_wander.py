"""How far the zero of the load cell wanders, from the campaign's own return strokes.

A load cell's zero walks at random while it measures, forgets slowly where it was, and may stand elsewhere after every
restart. None of that is a gap of the model, and none of it is a drift: the drift of the catalogue is what remains
beyond. The blade cuts one way only, so the middle of the return stroke reads the zero, once for every few strokes:

    zero(t) = b . columns + a g(t) + u(trial) + w(t) + white,    dw = -w/tau dt + sqrt(q) dB

with u of standard deviation s, each restart on its own or a step from the one before, whichever is likelier. The
density q and the white noise come from what the zeros of one trial differ by (a
restricted likelihood: the trial's straight line is taken out), tau and s from all trials together. A lasting trend
a g(t), in each form that the catalogue knows or none, competes with them, so that a true drift is not taken for wander.
The density and the variance of restarts are posterior means over grids that are even in the logarithm, no size being
preferred, with the most likely tau. The grids reach from a hundredth of what a load cell resolves to what would be
called broken. 1/f noise is approximated by the sum of walk, restarts and white noise.

Such a wander interpolates the zero of a withheld trial as well as a drift does. A trend that is not likely enough is
taken up by the likeliest wander. So the evidence of a drift is that of all wanders, with a trend and without one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import State

# Of the lever's largest value: nearer to the dead centres the cutting force may still be felt.
_MIDDLE = 0.7
_LEAST_READINGS = 6
_STDS_N = np.geomspace(1e-3, 30.0, 40)
_RESTARTS_N = np.geomspace(0.01, 10.0, 16)
_MEMORIES_S = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
_DRIFT_S = 1000.0
_WARM_UPS_S = (100.0, 400.0)
# A trend is one effect of some thirty, in one of four forms.
_LOG_PRIOR_TREND = -float(np.log(30.0 * 4.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class ZeroReadings:
    """Zero of one channel in one trial, read many times.

    Attributes
    ----------
    at_s : ndarray, shape (n,)
        Since the start of the campaign.
    zero_n : ndarray, shape (n,)
    not_zero : ndarray, shape (k,)
        What of the trial's working point may also move its readings.
    """

    at_s: Floats
    zero_n: Floats
    not_zero: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class ZeroWander:
    """What the zero does beyond a constant and a trend.

    Attributes
    ----------
    density_n2_s : float
        Of the random walk, q: the variance grows by it every second.
    density_std_n2_s : float
    white_n : float
        Standard deviation of a single reading.
    memory_s : float
        Time in which the walk forgets.
    restart_n : float
        Standard deviation from restart to restart.
    restarts_add_up : bool
        Whether every restart is a step from where the zero stood before.
    of_drift : float
        Log evidence of a lasting trend against none, over all that the wander may be.
    level_n : float
        Mean zero of the trials in air; 0 where there are none.
    """

    density_n2_s: float
    density_std_n2_s: float
    white_n: float
    memory_s: float
    restart_n: float
    restarts_add_up: bool = False
    of_drift: float = 0.0
    level_n: float = 0.0

    def covariance(self, at_s: Floats, trial: np.ndarray) -> Floats:
        """Of the zero at some times of some trials, N^2, shape (n, n).

        Parameters
        ----------
        at_s : ndarray, shape (n,)
            Since the start of the campaign.
        trial : ndarray of int, shape (n,)
            In the order of the session, from 0.
        """
        apart_s = np.abs(at_s[:, None] - at_s)
        walked = 0.5 * self.density_n2_s * self.memory_s * np.exp(-apart_s / self.memory_s)
        # Restarts that two readings have in common.
        shared = 1.0 + np.minimum(trial[:, None], trial) if self.restarts_add_up else trial[:, None] == trial
        # A load cell that was not tared is off by any amount, in all trials alike: no step from trial to trial.
        return walked + self.restart_n**2 * shared + self.level_n**2


def zero_readings(baseline: Baseline, states: Sequence[State]) -> list[ZeroReadings]:
    """Read the zero of the force in the middle of the return strokes.

    Parameters
    ----------
    baseline : Baseline
    states : sequence of State
        Running ones with a force are read.

    Returns
    -------
    list of ZeroReadings
        One a trial.
    """
    found = []
    for state in states:
        if state.kind != "running" or state.force_n is None:
            continue
        lever = baseline.cutting_sign * baseline.mechanism.lever(state.angle_rad[0])
        is_back = lever < _MIDDLE * float(lever.min())
        if not is_back.any():
            continue
        cuts = 0.0 if state.setting.is_idle else 1.0
        speed_m_s = float(np.abs(lever * state.speed_rad_s)[:, is_back].mean())
        felt = float(state.force_n[:, lever > 0.0].mean()) / max(state.peak_force_n, 1.0)
        found.append(
            ZeroReadings(
                at_s=state.setting.session_s + state.time_s[:, 0],
                zero_n=state.force_n[:, is_back].mean(axis=1),
                not_zero=cuts * np.array([1.0, speed_m_s, felt]),
            )
        )
    return found


def zero_wander(trials: Sequence[ZeroReadings]) -> ZeroWander | None:
    """Estimate the wander.

    Parameters
    ----------
    trials : sequence of ZeroReadings

    Returns
    -------
    ZeroWander or None
        None where too few trials are long enough to tell.
    """
    long = [t for t in trials if len(t.at_s) >= _LEAST_READINGS and np.ptp(t.at_s) > 0.0]
    if len(long) < SETTINGS.noise.least_trials:
        return None
    density, density_std, white = _within(long)
    in_air = [float(t.zero_n.mean()) for t in trials if not t.not_zero.any()]
    level_n = float(np.mean(in_air)) if in_air else 0.0
    means = _Means.of(trials, density, white)
    walk = ZeroWander(
        density_n2_s=density, density_std_n2_s=density_std, white_n=white, memory_s=_MEMORIES_S[0], restart_n=0.0,
        level_n=level_n,
    )  # fmt: skip
    return _between(means, walk)


def _within(trials: Sequence[ZeroReadings]) -> tuple[float, float, float]:
    """Density of the walk and its uncertainty, and the white noise, from contrasts within trials, free of any line."""
    grows, squares = [], []
    for trial in trials:
        n = len(trial.at_s)
        times_s = trial.at_s - trial.at_s[0]
        # Whatever line the trial has is taken out, the mean and a lasting drift: what is left is independent of it.
        line, _ = np.linalg.qr(np.column_stack([np.ones(n), times_s]))
        contrasts = np.eye(n) - line @ line.T
        values, vectors = np.linalg.eigh(contrasts @ np.minimum(times_s[:, None], times_s) @ contrasts)
        grows.append(values[2:])
        squares.append((vectors[:, 2:].T @ trial.zero_n) ** 2)
    grown_s, square = np.concatenate(grows), np.concatenate(squares)
    usual_s = float(np.median([np.ptp(t.at_s) for t in trials]))

    def weighed(walked_n: Floats, white_n: Floats) -> tuple[Floats, Floats, Floats]:
        density, white = walked_n**2 / usual_s, white_n**2
        variance = density[:, None, None] * grown_s + white[:, None]
        log_likelihood = -0.5 * np.sum(np.log(variance) + square / variance, axis=-1)
        weight = np.exp(log_likelihood - log_likelihood.max())
        return density, white, weight / weight.sum()

    # Once to see where it lies, once to measure it.
    _, _, weight = weighed(_STDS_N, _STDS_N)
    density, white, weight = weighed(_around(_STDS_N, weight.sum(axis=1)), _around(_STDS_N, weight.sum(axis=0)))
    of_density = weight.sum(axis=1)
    mean = float(of_density @ density)
    return mean, float(np.sqrt(of_density @ (density - mean) ** 2)), float(np.sqrt(weight.sum(axis=0) @ white))


def _around(grid: Floats, weight: Floats) -> Floats:
    """Lay a grid as long where the weight is, with a step to spare on either side."""
    seen = np.flatnonzero(weight > 1e-4 * weight.max())
    return np.geomspace(grid[max(seen[0] - 1, 0)], grid[min(seen[-1] + 1, len(grid) - 1)], len(grid))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Means:
    """Mean zeros of the trials, in the order of the session; `known` is their covariance without walk and restarts."""

    at_s: Floats
    zero_n: Floats
    known: Floats

    @classmethod
    def of(cls, trials: Sequence[ZeroReadings], density: float, white: float) -> _Means:
        ordered = sorted(trials, key=lambda t: float(t.at_s.mean()))
        not_zero = np.array([t.not_zero for t in ordered])
        columns = SETTINGS.sensors.zero_std_n * np.column_stack([np.ones(len(ordered)), not_zero])
        # A mean over a walk is off its middle by that much.
        walked = density * np.array([float(np.ptp(t.at_s)) for t in ordered]) / 12.0
        read = white**2 / np.array([len(t.at_s) for t in ordered])
        return cls(
            at_s=np.array([float(t.at_s.mean()) for t in ordered]),
            zero_n=np.array([float(t.zero_n.mean()) for t in ordered]),
            known=columns @ columns.T + np.diag(read + walked),
        )

    def covariance(self, wander: ZeroWander) -> Floats:
        """Shape (n_trials, n_trials), N^2."""
        return self.known + wander.covariance(self.at_s, np.arange(len(self.at_s)))


def _between(means: _Means, walk: ZeroWander) -> ZeroWander:
    """Find whether restarts add up, the most likely memory, the scatter of restarts, and the evidence for a trend.

    From the trials' mean zeros; the wander is the likeliest, whatever lasting trend there is.
    """
    trends = _trends(means.at_s)
    kinds = [
        replace(walk, restarts_add_up=add_up, memory_s=memory_s)
        for add_up, memory_s in product((False, True), _MEMORIES_S)
    ]
    wanders = [[replace(kind, restart_n=float(n)) for n in _RESTARTS_N] for kind in kinds]
    found = np.array([[_log_likelihoods(means.covariance(w), trends, means.zero_n) for w in row] for row in wanders])
    none, with_trend = found[..., 0], found[..., 1:]
    of_drift = np.logaddexp.reduce(with_trend, axis=None) - np.log(len(trends)) - np.logaddexp.reduce(none, axis=None)
    logs = np.logaddexp(none, _LOG_PRIOR_TREND + np.logaddexp.reduce(with_trend, axis=-1))
    weights = np.exp(logs - logs.max())
    k = int(np.argmax(weights.sum(axis=1)))
    restart_n = float(np.sqrt(weights[k] @ _RESTARTS_N**2 / weights[k].sum()))
    return replace(kinds[k], restart_n=restart_n, of_drift=float(of_drift))


def _trends(at_s: Floats) -> Floats:
    """Lasting trends that are no wander, each times its standard deviation, of 1 after 1000 s; shape (k, n)."""
    since_s = np.maximum(at_s, 0.0)
    warm_ups = [np.expm1(-since_s / tau_s) / np.expm1(-_DRIFT_S / tau_s) for tau_s in _WARM_UPS_S]
    return SETTINGS.sensors.zero_std_n * np.array([since_s / _DRIFT_S, np.sqrt(since_s / _DRIFT_S), *warm_ups])


def _log_likelihoods(covariance: Floats, trends: Floats, values: Floats) -> Floats:
    """Of values without a trend and with each, of any size within its standard deviation, shape (1 + k,)."""
    root = np.linalg.cholesky(covariance)
    half = np.linalg.solve(root, np.column_stack([values, trends.T]))
    seen, of_trends = half[:, 0], half[:, 1:]
    spread = 1.0 + np.sum(of_trends**2, axis=0)
    gained = 0.5 * ((seen @ of_trends) ** 2 / spread - np.log(spread))
    none = -0.5 * float(seen @ seen) - float(np.log(np.diag(root)).sum())
    return none + np.concatenate([[0.0], gained])
