"""How far the gap shrinks on operating points that no fit has seen: nominal, re-tuned, with the effect, noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.recording import Floats
from diagnosis.equations import Equation
from diagnosis.linear_problem import LinearProblem, Part
from diagnosis.posterior import wide_scale

RUNGS = ("nominal", "retuned", "with_effect", "noise_floor")
# A cause cannot be shown to leave less than this share of the noise energy.
_LEAST_REST = 0.02
_LEAST_BLOCKS = 3
# Re-tuned parameters stay within this many widened standard deviations: farther off it is not the same machine.
_FARTHEST, _FARTHEST_SENSOR = 2.0, 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Rungs:
    """One quantity on the four rungs of the ladder."""

    nominal: float
    retuned: float
    with_effect: float
    noise_floor: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """What was fitted without one group of trials.

    Attributes
    ----------
    retuned, nuisances : ndarray, shape (p,)
        Nuisances alone, and beside the cause, in units of their widened prior standard deviation.
    amplitudes : ndarray, shape (q,)
        Of the cause's columns.
    alternative : int
        Which of the alternative columns fits the kept trials best.
    """

    retuned: Floats
    nuisances: Floats
    amplitudes: Floats
    alternative: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Ladder:
    """Held-out gap.

    Attributes
    ----------
    whitened : Rungs
        Root mean square of the residual over its noise.
    by_channel : dict of str to (Rungs, unit)
        Of the equations that are a channel's misprediction, in its unit.
    gap_closed : float
        Share of the mean square that re-tuning leaves above the noise and the cause takes away, -1 to 1; 0 where
        there is nothing to close.
    gap_closed_ci95 : tuple of float
        95 % interval; (-1, 1) where there is nothing to close, or nothing to hold out.
    fits : dict of str to Fit
        By the group of trials that was held out.
    held_out : {"operating points", "trials", "nothing"}
        What was held out, each in turn: trials where there is only one operating point.
    """

    whitened: Rungs
    by_channel: dict[str, tuple[Rungs, str]]
    gap_closed: float
    gap_closed_ci95: tuple[float, float]
    fits: dict[str, Fit]
    held_out: str


class HoldOut:
    """A problem divided into groups of trials, each of which can be held out of a fit.

    Parameters
    ----------
    problem : LinearProblem
    best : ndarray, shape (n, q), optional
        Whitened signatures of the most likely cause, times a generous amplitude: what a fit with them leaves of the
        start-ups is taken for their noise, as a start-up has no time blocks that could be compared.
    """

    def __init__(self, problem: LinearProblem, best: Floats | None = None) -> None:
        self.problem = problem
        self.base = problem.nuisance * wide_scale(problem)
        plant = problem.campaign.plant
        own = {nuisance.name for nuisance in plant.trial_nuisances(problem.campaign.states)}
        numbers = {nuisance.name for nuisance in plant.nuisances() if nuisance.is_plant}
        self.is_plant = np.array([name in numbers for name in problem.names], dtype=bool)
        self.is_own = np.array([name in own for name in problem.names], dtype=bool)
        self.held_out, self.group_of = _grouping(problem)
        self.groups = tuple(dict.fromkeys(self.group_of(part) for part in problem.parts))
        self.rows = {group: self._rows(group) for group in self.groups}
        self._normal = self.base.T @ self.base
        self._moment = self.base.T @ problem.data
        self._noise = self._noise_of(self.base if best is None else np.hstack([self.base, best]))

    def _rows(self, group: str) -> np.ndarray:
        rows = np.zeros(len(self.problem.data), dtype=bool)
        for part in self.problem.parts:
            rows[part.place] = self.group_of(part) == group
        return rows

    def _noise_of(self, design: Floats) -> Floats:
        """Whitened noise: the scatter of the time blocks, or what a fit to the group itself leaves."""
        noise = _block_scatter(self.problem)
        for rows in self.rows.values():
            without = rows & np.isnan(noise)
            inside, data = design[without], self.problem.data[without]
            noise[without] = data - inside @ _ridge(inside, data)
        return noise

    def climb(self, alternatives: Sequence[Floats]) -> Ladder:
        """Hold out each group in turn and predict it from the others.

        Parameters
        ----------
        alternatives : sequence of ndarray, shape (n, q)
            Whitened signatures of the cause, times a generous amplitude, one for each form it may have; the form is
            chosen without the group that is held out. Empty where there is no cause.

        Returns
        -------
        Ladder
        """
        data = self.problem.data
        columns = list(alternatives) or [np.zeros((len(data), 0))]
        shared = [self.base.T @ c for c in columns]
        residuals = {name: np.array(data) for name in RUNGS}
        residuals["noise_floor"] = self._noise
        fits = {}
        for group in self.groups:
            fit = self._fit(group, columns, shared)
            fits[group] = fit
            held = self.rows[group]
            chosen = columns[fit.alternative][held]
            own = self.base[held][:, self.is_own]
            with_effect = self.base[held] @ fit.nuisances + chosen @ fit.amplitudes
            for name, known in (
                ("nominal", 0.0),
                ("retuned", self.base[held] @ fit.retuned),
                ("with_effect", with_effect),
            ):
                rest = data[held] - known
                # How hard this piece of wood is, no model predicts: fitted on the held-out trials, for all rungs.
                residuals[name][held] = rest - own @ _ridge(own, rest)
        energy = {n: np.array([float(np.sum(r[self.rows[g]] ** 2)) for g in self.groups]) for n, r in residuals.items()}
        closed, interval = closed_share(energy)
        return Ladder(
            whitened=Rungs(**{name: float(np.sqrt(values.sum() / len(data))) for name, values in energy.items()}),
            by_channel=_by_channel(self.problem, residuals),
            gap_closed=closed,
            gap_closed_ci95=interval if self.held_out != "nothing" else (-1.0, 1.0),
            fits=fits,
            held_out=self.held_out,
        )

    def _fit(self, group: str, columns: Sequence[Floats], shared: Sequence[Floats]) -> Fit:
        """Nuisances and cause from the trials that are kept; the form of the cause by its evidence there."""
        from scipy.linalg import cho_factor, cho_solve

        held = self.rows[group] if self.held_out != "nothing" else np.zeros(len(self.problem.data), dtype=bool)
        base, data = self.base[held], self.problem.data[held]
        root = cho_factor(np.eye(self.base.shape[1]) + self._normal - base.T @ base)
        moment = self._moment - base.T @ data
        retuned = cho_solve(root, moment)
        best = (-np.inf, 0, np.zeros(0), np.zeros_like(moment))
        for k, (column, cross) in enumerate(zip(columns, shared, strict=True)):
            kept_cross = cross - base.T @ column[held]
            through = cho_solve(root, kept_cross)
            gram = np.eye(column.shape[1]) + column.T @ column - column[held].T @ column[held] - kept_cross.T @ through
            pull = column.T @ self.problem.data - column[held].T @ data - through.T @ moment
            amplitudes = np.linalg.solve(gram, pull)
            score = 0.5 * float(pull @ amplitudes) - 0.5 * float(np.linalg.slogdet(gram)[1])
            if score > best[0]:
                best = (score, k, amplitudes, through)
        _, k, amplitudes, through = best
        n = len(retuned)
        if len(amplitudes):
            joint = np.hstack([self.base, columns[k]])
            seen = joint[held]
            normal = np.eye(joint.shape[1])
            normal[:n, :n] += self._normal
            normal[:n, n:] += shared[k]
            normal[n:, :n] += shared[k].T
            normal[n:, n:] += columns[k].T @ columns[k]
            both = np.concatenate([self._moment, columns[k].T @ self.problem.data]) - seen.T @ data
            solution = self._bounded(normal - seen.T @ seen, both)
        else:
            solution = self._bounded(np.eye(n) + self._normal - base.T @ base, moment)
        retuned = self._bounded(np.eye(n) + self._normal - base.T @ base, moment)
        return Fit(retuned=retuned, nuisances=solution[:n], amplitudes=solution[n:], alternative=k)

    def _bounded(self, normal: Floats, moment: Floats) -> Floats:
        """Solve for all coefficients with plant parameters within their bounds, a single amplitude not below 0."""
        from scipy.optimize import lsq_linear

        n, size = len(self.is_plant), len(moment)
        high = np.full(size, np.inf)
        high[:n] = np.where(self.is_own, np.inf, np.where(self.is_plant, _FARTHEST, _FARTHEST_SENSOR))
        low = -high
        if size == n + 1:
            low[n] = 0.0  # an effect has a sign
        solution = np.asarray(np.linalg.solve(normal, moment), dtype=np.float64)
        if np.all((solution >= low) & (solution <= high)):
            return solution
        root = np.linalg.cholesky(normal)
        return lsq_linear(root.T, np.linalg.solve(root, moment), bounds=(low, high), method="bvls").x


def climb(problem: LinearProblem, columns: Floats | None) -> Ladder:
    """Climb the ladder once, with one form of the cause; see `HoldOut`."""
    return HoldOut(problem, columns).climb([] if columns is None else [columns])


def _grouping(problem: LinearProblem) -> tuple[str, Callable[[Part], str]]:
    """Name what is held out, and say which group a part belongs to."""
    if len({part.setting.operating_point for part in problem.parts}) > 1:
        return "operating points", lambda part: part.setting.operating_point
    if len({part.setting.label for part in problem.parts}) > 1:
        return "trials", lambda part: part.setting.label
    return "nothing", lambda part: part.setting.label


def _block_scatter(problem: LinearProblem) -> Floats:
    """Whitened deviation of the time blocks of a trial from a straight line, unbiased; NaN where there are too few."""
    out = np.full(len(problem.data), np.nan)
    for part in problem.parts:
        blocks = problem.data[part.place].reshape(-1, part.layout.size)
        n = len(blocks)
        if n < _LEAST_BLOCKS:
            continue
        time = np.arange(n) - 0.5 * (n - 1)
        rest = blocks - blocks.mean(axis=0) - np.outer(time, time @ blocks) / (time @ time)
        out[part.place] = (rest * np.sqrt(n / (n - 2.0))).ravel()
    return out


def _ridge(design: Floats, data: Floats) -> Floats:
    """Posterior mean of coefficients with unit normal priors."""
    if design.shape[1] == 0:
        return np.zeros(0)
    normal = np.eye(design.shape[1]) + design.T @ design
    return np.asarray(np.linalg.solve(normal, design.T @ data), dtype=np.float64)


def closed_share(energy: dict[str, Floats]) -> tuple[float, tuple[float, float]]:
    """Share of the gap that is closed, and its 95 % interval, from sums of squares by group.

    The interval is Student's t on the logarithm of what is left, its standard error from leaving out one group at a
    time. With five to ten groups of unequal size it covers in 85 to 93 % of simulated campaigns, a percentile
    bootstrap in 69 to 86 % (docs/decisions/channel-prediction.md).

    Parameters
    ----------
    energy : dict of str to ndarray, shape (n_groups,)
        "retuned", "with_effect" and "noise_floor".

    Returns
    -------
    closed : float
    interval : tuple of float

    Examples
    --------
    >>> rest = np.array([10.0, 12.0, 9.0, 11.0])
    >>> energy = {"retuned": rest, "with_effect": 0.1 * rest + 0.9, "noise_floor": np.ones(4)}
    >>> closed, (low, high) = closed_share(energy)
    >>> bool(0.85 < low < closed < high < 0.95)
    True
    """
    from scipy.special import stdtrit

    def left(chosen: np.ndarray) -> float:
        retuned, effect, floor = (float(energy[k][chosen].sum()) for k in ("retuned", "with_effect", "noise_floor"))
        room = retuned - floor
        if room <= _LEAST_REST * floor:
            return 1.0
        return max(effect - floor, _LEAST_REST * floor) / room

    n = len(energy["retuned"])
    everything = np.arange(n)
    if energy["retuned"].sum() <= (1.0 + _LEAST_REST) * energy["noise_floor"].sum():
        return 0.0, (-1.0, 1.0)
    whole = left(everything)
    closed = float(np.clip(1.0 - whole, -1.0, 1.0))
    if n <= 2:
        return closed, (-1.0, 1.0)
    logs = np.log([left(np.delete(everything, k)) for k in range(n)])
    spread = float(np.sqrt((n - 1) / n * np.sum((logs - logs.mean()) ** 2)))
    reach = float(stdtrit(n - 2, 0.975)) * spread
    low, high = (float(np.clip(1.0 - whole * np.exp(sign * min(reach, 50.0)), -1.0, 1.0)) for sign in (1.0, -1.0))
    return closed, (low, high)


def _by_channel(problem: LinearProblem, residuals: dict[str, Floats]) -> dict[str, tuple[Rungs, str]]:
    forms = problem.campaign.plant.equations
    squares: dict[Equation, dict[str, list[float]]] = {}
    for part in problem.parts:
        if part.state.kind != "running":
            continue
        for name, whole in residuals.items():
            features = part.unwhiten(whole)
            for equation, place in part.layout.slices.items():
                factor = forms[equation].to_channel
                if factor is None:
                    continue
                block = factor * features[:, place]
                # Mean square over the turn of a Fourier series: c0^2 + half the squares of the others.
                square = float(np.mean(block[:, 0] ** 2 + 0.5 * np.sum(block[:, 1:] ** 2, axis=1)))
                squares.setdefault(equation, {}).setdefault(name, []).append(square)
    return {
        forms[equation].channel: (
            Rungs(**{name: float(np.sqrt(np.mean(values))) for name, values in found.items()}),
            forms[equation].channel_unit,
        )
        for equation, found in squares.items()
    }
