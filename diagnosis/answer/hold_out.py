"""Withhold groups of trials in turn and predict them from the others."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.answer.ladder import RUNGS, Fit, HeldOut, Ladder, Rungs
from sawbench.diagnosis.answer.withheld_group import WithheldGroup
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.marginal import Marginal, side_by_side
from sawbench.diagnosis.inference.retuning import Retuning
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Equation

_NUMBERS = SETTINGS.ladder


@dataclass(frozen=True, kw_only=True, slots=True)
class Alternatives:
    """Forms that a cause may have; what several of them share stands once.

    Attributes
    ----------
    columns : ndarray, shape (n, m)
        Whitened signatures, times a generous amplitude.
    places : ndarray of int, shape (k, q)
        Which of the columns each of the forms has.
    """

    columns: Floats
    places: np.ndarray

    @classmethod
    def of(cls, forms: Sequence[Sequence[Floats]], n: int) -> Alternatives:
        """Put forms together, each of parts of shape (n, columns): an array that is a part of several is one part."""
        parts = {id(part): part for form in forms for part in form}
        ends = np.cumsum([part.shape[1] for part in parts.values()])
        place = {key: np.arange(end - part.shape[1], end) for (key, part), end in zip(parts.items(), ends, strict=True)}
        places = [np.concatenate([place[id(part)] for part in form]) for form in forms]
        return cls(columns=side_by_side(list(parts.values()), n), places=np.array(places or [[]], dtype=int))

    def of_form(self, k: int, rows: np.ndarray) -> Floats:
        """Columns of one of the forms in some rows, shape (rows, q)."""
        return self.columns[np.ix_(rows, self.places[k])]


class HoldOut:
    """A problem divided into groups of trials, each of which can be withheld from a fit.

    Parameters
    ----------
    problem : LinearProblem
    best : ndarray, shape (n, q), optional
        Whitened signatures of the most likely cause, times a generous amplitude: what a fit with them leaves of trials
        without any repetition is taken for their noise.
    by_trial : bool
        Hold out trials although there are operating points enough: for an effect that one of them alone shows.
    freed : collection of str, optional
        Numbers of the plant that may move beyond what is stated of them; default: those that pay for it here.
    """

    def __init__(
        self,
        problem: LinearProblem,
        best: Floats | None = None,
        *,
        by_trial: bool = False,
        freed: Collection[str] | None = None,
    ) -> None:
        self.problem = problem
        self.scale = problem.scale_of(Retuning(problem, Marginal(problem)).freed if freed is None else freed)
        self.base = problem.nuisance * self.scale
        self.is_own = problem.is_of_trial
        self._high = np.where(
            self.is_own, np.inf, np.where(self.scale > 1.0, _NUMBERS.farthest, _NUMBERS.farthest_stated)
        )
        self.held_out: HeldOut
        self.held_out, self.group_of = grouping(problem, by_trial=by_trial)
        self.rows = rows_by_group(problem, self.group_of)
        self.groups = tuple(self.rows)
        group_of_trial = {part.setting.label: self.groups.index(self.group_of(part)) for part in problem.parts}
        self._trials, self._number_of_group = list(group_of_trial), np.array(list(group_of_trial.values()))
        self._kept = self._kept_without_each()
        self._own, self._open = {}, {}
        for group in self.groups:
            root = _root_of_inverse(self._kept[group])
            withheld = self.base[self.rows[group]]
            # Of some of the nuisances alone, as few columns have the same squares.
            own = np.linalg.qr(root[self.is_own].T, mode="r").T
            self._own[group], self._open[group] = withheld[:, self.is_own] @ own, withheld @ root
        self._to_features: list[Floats] = [
            np.asarray(np.linalg.inv(part.whitener), dtype=np.float64).T for part in problem.parts
        ]
        self._noise = self._noise_of(self.base if best is None else np.hstack([self.base, best]))

    def _kept_without_each(self) -> dict[str, Floats]:
        """Normal matrix of the nuisances by the trials kept beside each group, priors included, shape (p, p) each."""
        withheld = {group: rows & (self.held_out != "nothing") for group, rows in self.rows.items()}
        return {group: np.eye(len(gram)) + gram for group, gram in grams_without_each(self.base, withheld).items()}

    def _noise_of(self, design: Floats) -> Floats:
        """Whitened noise: the scatter of time blocks, that of strokes, or what a fit to the group itself leaves."""
        noise = _scatter(self.problem)
        for rows in self.rows.values():
            without = rows & np.isnan(noise)
            inside, data = design[without], self.problem.data[without]
            noise[without] = data - inside @ _ridge(inside, data)
        return noise

    def of(self, data: Floats) -> HoldOut:
        """The same groups, nuisances and noise with other data, shape (n,), of the same features."""
        found = copy(self)
        found.__dict__.pop("_withheld", None)
        found.problem = replace(self.problem, data=data)
        return found

    def climb(self, forms: Sequence[Sequence[Floats]]) -> Ladder:
        """Hold out each group in turn and predict it from the others.

        Parameters
        ----------
        forms : sequence of sequence of ndarray, shape (n, columns)
            Whitened signatures of the cause, times a generous amplitude: for each form that it may have those of each
            of its effects, as many columns for every form. Empty where there is no cause. A group is predicted by every
            likely form, as likely as the kept trials make it: what these leave open of the form is no error of the
            prediction, as of the amplitude.

        Returns
        -------
        Ladder
        """
        data = self.problem.data
        alternatives = Alternatives.of(forms, len(data))
        whole = self._products(np.ones(len(data), dtype=bool), alternatives.columns)
        residuals = {name: np.array(data) for name in RUNGS}
        residuals["noise_floor"] = self._noise
        beyond = {name: np.array(rest) for name, rest in residuals.items()}
        energy = {name: np.zeros(len(self.groups)) for name in RUNGS}
        fits = {}
        found = on_two_cores(lambda group: self._withheld_rungs(group, alternatives, whole), self.groups)
        for k, (group, (fit, rungs)) in enumerate(zip(self.groups, found, strict=True)):
            fits[group], held = fit, self.rows[group]
            for name, each in rungs.items():
                residuals[name][held], beyond[name][held], energy[name][k] = each
            energy["noise_floor"][k] = float(np.sum(self._noise[held] ** 2))
        return Ladder(
            whitened=Rungs(**{name: float(np.sqrt(values.sum() / len(data))) for name, values in energy.items()}),
            by_channel=_by_channel(self.problem, residuals, self._to_features),
            fits=fits,
            held_out=self.held_out,
            energy=energy,
            squares={name: self._squares(rest) for name, rest in beyond.items()},
            group_of=self._number_of_group,
            n_features={e: np.bincount(self._number_of_group, n) for e, n in self._squares(np.ones(len(data))).items()},
        )

    def _withheld_rungs(
        self, group: str, alternatives: Alternatives, whole: tuple[Floats, Floats, Floats, Floats]
    ) -> tuple[Fit, dict[str, tuple[Floats, Floats, float]]]:
        """Fit to the other groups; residual, the same in standard deviations, and energy of this one, by rung."""
        held, own = self.rows[group], self._own[group]
        likely = self._fits(group, alternatives, whole)
        rest = self.problem.data[held]
        left = rest - self.base[held] @ likely[0].retuned
        found = {
            "nominal": (rest, *_weighed(rest, own, own[:, :0], noise=1.0)),
            "retuned": (left, *_weighed(left, self._open[group], own[:, :0], noise=1.0)),
            "with_effect": self._predicted(group, likely, alternatives),
        }
        # The hardness of a workpiece cannot be predicted: it is fitted to the withheld trials, for all rungs, at the
        # price that the others say it has: the energy is that of the whole prediction.
        return likely[0], {
            name: (rest - own @ _ridge(own, rest), beyond, energy) for name, (rest, beyond, energy) in found.items()
        }

    def _predicted(self, group: str, likely: Sequence[Fit], alternatives: Alternatives) -> tuple[Floats, Floats, float]:
        """Residual of the likeliest form, that of the best one in standard deviations, and the energy of them all."""
        held, uncertain = self.rows[group], self._open[group]
        noise = float(np.mean(self._noise[held] ** 2))
        rests, beyond, energies = [], [], []
        for fit in likely:
            chosen = alternatives.of_form(fit.alternative, held)
            rests.append(self.problem.data[held] - self.base[held] @ fit.nuisances - chosen @ fit.amplitudes)
            beside = chosen - self.base[held] @ fit.following
            left, energy = _weighed(rests[-1], uncertain, beside @ fit.root, noise=noise)
            beyond.append(left)
            energies.append(energy + fit.behind)
        # Of kept and withheld trials together, less that of the kept ones.
        kept = _soft_minimum([fit.behind for fit in likely], 2.0 * noise)
        return rests[0], beyond[int(np.argmin(energies))], _soft_minimum(energies, 2.0 * noise) - kept

    def _squares(self, rest: Floats) -> dict[Equation, Floats]:
        """Sum of squares of a residual, shape (n,), in each trial by equation."""
        found: dict[Equation, Floats] = {}
        for part in self.problem.parts:
            squares = np.sum(rest[part.place].reshape(-1, part.layout.size) ** 2, axis=0)
            for equation, place in part.layout.slices.items():
                of_trials = found.setdefault(equation, np.zeros(len(self._trials)))
                of_trials[self._trials.index(part.setting.label)] += squares[place].sum()
        return found

    def _products(self, rows: np.ndarray, columns: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Inner products over some trials: of nuisances with columns, of these, and of both with the data."""
        base, data, shown = self.base[rows], self.problem.data[rows], columns[rows]
        return base.T @ shown, shown.T @ shown, base.T @ data, shown.T @ data

    def _fits(self, group: str, alternatives: Alternatives, whole: tuple[Floats, Floats, Floats, Floats]) -> list[Fit]:
        """Nuisances and cause from the trials that are kept, in the forms likeliest by their evidence there.

        With bounds on the nuisances the best form may be another one than without, and not every form can be solved
        with bounds: the best few are, as ranked with all nuisances free and with those held that re-tuning alone
        drives to a bound.
        """
        held = self.rows[group] if self.held_out != "nothing" else np.zeros(len(self.problem.data), dtype=bool)
        n, width = self.base.shape[1], alternatives.places.shape[1]
        # What all trials say, less what the withheld ones say.
        cross, own, pull_base, pull_forms = (
            a - b for a, b in zip(whole, self._products(held, alternatives.columns), strict=True)
        )
        least = self._kept[group]
        retuned = self._bounded(least, pull_base)
        if not width:
            return [
                Fit(
                    retuned=retuned, nuisances=retuned, amplitudes=np.zeros(0), alternative=0, root=np.zeros((0, 0)),
                    following=np.zeros((n, 0)),
                )
            ]  # fmt: skip
        own += np.eye(len(own))
        is_stuck = np.abs(retuned) >= self._high * (1.0 - 1e-9)
        gains = (
            _gains(
                (least, cross, own),
                (pull_base, pull_forms),
                alternatives.places,
                np.where(is_held, retuned, 0.0),
                is_held,
            )
            for is_held in (np.zeros(n, dtype=bool), is_stuck)
        )
        chosen = {int(k) for scores in gains for k in np.argsort(scores)[-_NUMBERS.solved_forms :]}
        kept = ~held
        noise, square = (float(np.sum(x[kept] ** 2)) for x in (self._noise, self.problem.data))
        found = []
        for k in chosen:
            place = alternatives.places[k]
            normal = np.block([[least, cross[:, place]], [cross[:, place].T, own[np.ix_(place, place)]]])
            pull = np.concatenate([pull_base, pull_forms[place]])
            solution = self._bounded(normal, pull)
            gain = float((2.0 * pull - normal @ solution) @ solution)
            found.append((gain - float(np.linalg.slogdet(normal)[1]), square - gain, k, solution, normal))
        found.sort(key=lambda one: -one[0])
        best, left, *_ = found[0]
        raised = max(left / noise, 1.0) if noise > 0.0 else 1.0
        return [
            Fit(
                retuned=retuned, nuisances=solution[:n], amplitudes=solution[n:], alternative=k, behind=best - score,
                root=np.sqrt(raised) * np.linalg.cholesky(np.linalg.inv(normal)[n:, n:]),
                following=np.linalg.solve(least, normal[:n, n:]),
            )
            for score, _, k, solution, normal in found
        ]  # fmt: skip

    def free_errors(self, columns: Floats) -> Floats:
        """Predict each group from the others without any bounds: quick, for many causes that are compared.

        Parameters
        ----------
        columns : ndarray, shape (n, m)
            Whitened, for one standard deviation each.

        Returns
        -------
        ndarray, shape (n_groups,)
            Sum of squares of the whitened residual in each group.
        """
        cross, gram, moment = self.base.T @ columns, columns.T @ columns, columns.T @ self.problem.data
        return np.array([one.error(columns[one.rows], cross, gram, moment) for one in self._withheld])

    @cached_property
    def _withheld(self) -> list[WithheldGroup]:
        moment = self.base.T @ self.problem.data
        return [
            WithheldGroup.of(rows, self.base[rows], self.problem.data[rows], self._kept[group], moment, self.is_own)
            for group, rows in self.rows.items()
        ]

    def _bounded(self, normal: Floats, moment: Floats) -> Floats:
        """Solve for all coefficients with plant parameters within their bounds, a single amplitude not below 0."""
        from scipy.optimize import lsq_linear

        n, size = len(self.scale), len(moment)
        high = np.full(size, np.inf)
        high[:n] = self._high
        low = -high
        if size == n + 1:
            low[n] = 0.0  # an effect has a sign
        solution = np.asarray(np.linalg.solve(normal, moment), dtype=np.float64)
        if np.all((solution >= low) & (solution <= high)):
            return solution
        # All that has no bounds follows: what is left is a small problem.
        bounded = np.isfinite(low)
        beside = np.column_stack([normal[np.ix_(~bounded, bounded)], moment[~bounded]])
        follows, free = np.split(np.linalg.solve(normal[np.ix_(~bounded, ~bounded)], beside), [-1], axis=1)
        root = np.linalg.cholesky(normal[np.ix_(bounded, bounded)] - normal[np.ix_(bounded, ~bounded)] @ follows)
        pull = np.linalg.solve(root, moment[bounded] - follows.T @ moment[~bounded])
        within = lsq_linear(root.T, pull, bounds=(low[bounded], high[bounded]), method="bvls").x
        solution[bounded], solution[~bounded] = within, free[:, 0] - follows @ within
        return solution


def _root_of_inverse(normal: Floats) -> Floats:
    """Matrix that times its transpose is the inverse of a normal matrix, shape (p, p).

    Without inverting it: gains, their drifts and the curve of a battery may be alike to a part in 10^7.
    """
    from scipy.linalg import solve_triangular

    return solve_triangular(np.linalg.cholesky(normal), np.eye(len(normal)), lower=True).T


def _weighed(rest: Floats, common: Floats, uncertain: Floats, *, noise: float) -> tuple[Floats, float]:
    """What a prediction leaves in standard deviations of what it knows, and its energy.

    The energy is minus twice the log probability of what is left, less that of nothing left, times the noise. Of
    `common` and `uncertain` every column is a standard deviation of what the prediction does not know. `common` is the
    same for all that is compared; how far the probability is spread by `uncertain` counts. `noise` is the mean square
    of the whitened noise: 1 where that is what it is stated to be.
    """
    unknown = np.hstack([common, uncertain])
    gram = unknown.T @ unknown
    variances, waves = np.linalg.eigh(gram)
    stds = np.sqrt(1.0 + np.maximum(variances, 0.0))
    # The root of the inverse covariance, 1 plus the squares of the columns, is symmetric: no equation takes another's.
    beyond = rest - unknown @ (waves @ ((waves.T @ (unknown.T @ rest)) / (stds * (1.0 + stds))))
    n = common.shape[1]
    spread = noise * (2.0 * float(np.log(stds).sum()) - _log_spread(gram[:n, :n])) if uncertain.size else 0.0
    return beyond, float(beyond @ beyond) + spread


def _soft_minimum(values: Sequence[float], scale: float) -> float:
    """Minus `scale` times the logarithm of the sum of exp(-values / scale)."""
    least = min(values)
    return least if scale <= 0.0 else least - scale * float(np.log(np.sum(np.exp((least - np.array(values)) / scale))))


def _log_spread(gram: Floats) -> float:
    return float(np.linalg.slogdet(np.eye(len(gram)) + gram)[1])


def _gains(
    grams: tuple[Floats, Floats, Floats], pulls: tuple[Floats, Floats], places: np.ndarray, held: Floats,
    is_held: np.ndarray,
) -> Floats:  # fmt: skip
    """Twice the log evidence of each of k forms, less a constant, with some nuisances held at given values.

    A single amplitude is not below 0: a form that explains most with the other sign explains nothing.

    Parameters
    ----------
    grams : tuple of ndarray, shape (p, p), (p, m), (m, m)
        Inner products of the nuisances, of nuisances with columns, and of these, priors included.
    pulls : tuple of ndarray, shape (p,), (m,)
        Of nuisances and columns with the data.
    places : ndarray of int, shape (k, q)
        Which of the columns each of the forms has.
    held : ndarray, shape (p,)
        The values; 0 elsewhere.
    is_held : ndarray of bool, shape (p,)
    """
    from scipy.linalg import solve_triangular

    least, cross, own = grams
    root = np.linalg.cholesky(least[np.ix_(~is_held, ~is_held)])
    seen = solve_triangular(root, (pulls[0] - least @ held)[~is_held], lower=True)
    half = solve_triangular(root, cross[~is_held], lower=True)
    pull = (pulls[1] - cross.T @ held - half.T @ seen)[places]
    inner = (own - half.T @ half)[places[:, :, None], places[:, None, :]]
    solution = np.linalg.solve(inner, pull[:, :, None])[:, :, 0]
    gain = np.einsum("ij,ij->i", pull, solution)
    if places.shape[1] == 1:
        gain = np.where(solution[:, 0] < 0.0, 0.0, gain)
    return gain - np.linalg.slogdet(inner)[1]


def climb(problem: LinearProblem, columns: Floats | None) -> Ladder:
    """Climb the ladder once, with one form of the cause; see `HoldOut`."""
    return HoldOut(problem, columns).climb([] if columns is None else [[columns]])


def grouping(problem: LinearProblem, *, by_trial: bool) -> tuple[HeldOut, Callable[[Part], str]]:
    """Name what is withheld, and say which group a part belongs to: trials where there are few operating points.

    Or where one of them alone cuts: without it, a model is fitted to a saw that never cuts.
    """
    n_points = len({part.setting.operating_point for part in problem.parts})
    n_cutting = len({part.setting.operating_point for part in problem.parts if not part.setting.is_idle})
    n_trials = len({part.setting.label for part in problem.parts})
    if n_points >= min(_NUMBERS.least_groups, n_trials) > 1 and n_cutting != 1 and not by_trial:
        return "operating points", lambda part: part.setting.operating_point
    return "trials" if n_trials > 1 else "nothing", lambda part: part.setting.label


def rows_by_group(problem: LinearProblem, group_of: Callable[[Part], str]) -> dict[str, np.ndarray]:
    """Masks of the features of each group of trials, of bool, shape (n,), in the order of the trials."""
    found: dict[str, np.ndarray] = {}
    for part in problem.parts:
        found.setdefault(group_of(part), np.zeros(len(problem.data), dtype=bool))[part.place] = True
    return found


def grams_without_each(columns: Floats, groups: Mapping[str, np.ndarray]) -> dict[str, Floats]:
    """Inner products of columns, shape (n, q), over all rows but those of each group, (q, q).

    Summed over the other groups: what all rows say less what the group says would lose digits.

    Parameters
    ----------
    columns : ndarray, shape (n, q)
    groups : mapping of str to ndarray of bool, shape (n,)
        No row is in two of them.
    """
    always = columns[~np.any(list(groups.values()), axis=0)]
    of_each = {group: own.T @ own for group, own in ((group, columns[rows]) for group, rows in groups.items())}
    return {
        group: sum((own for name, own in of_each.items() if name != group), start=always.T @ always)
        for group in of_each
    }


def _scatter(problem: LinearProblem) -> Floats:
    """Whitened deviation of the time blocks of a trial from a straight line, unbiased.

    Where there are too few blocks (a start-up is one) what single strokes scatter; NaN where there are too few of them.
    """
    out = np.ones(len(problem.data))  # of what is read of a number, a row of no state
    for part in problem.parts:
        blocks = problem.data[part.place].reshape(-1, part.layout.size)
        n = len(blocks)
        if n >= _NUMBERS.least_blocks:
            time = np.arange(n) - 0.5 * (n - 1)
            rest = blocks - blocks.mean(axis=0) - np.outer(time, time @ blocks) / (time @ time)
            out[part.place] = (rest * np.sqrt(n / (n - 2.0))).ravel()
        elif part.scatter.any():
            out[part.place] = np.tile(part.scatter, n)
        else:
            out[part.place] = np.nan
    return out


def _ridge(design: Floats, data: Floats) -> Floats:
    """Posterior mean of coefficients with unit normal priors."""
    if design.shape[1] == 0:
        return np.zeros(0)
    normal = np.eye(design.shape[1]) + design.T @ design
    return np.asarray(np.linalg.solve(normal, design.T @ data), dtype=np.float64)


def _by_channel(
    problem: LinearProblem, residuals: dict[str, Floats], to_features: Sequence[Floats]
) -> dict[str, tuple[Rungs, str]]:
    forms = problem.campaign.plant.equations
    squares: dict[Equation, dict[str, list[float]]] = {}
    for part, back in zip(problem.parts, to_features, strict=True):
        if part.state.kind != "running":
            continue
        for name, whole in residuals.items():
            features = whole[part.place].reshape(-1, part.layout.size) @ back
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
