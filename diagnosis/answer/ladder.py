"""How far the gap shrinks on operating points that no fit has seen: nominal, re-tuned, with the effect, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.closed_share import closed_share
from sawbench.modeling.residuals import Equation

HeldOut = Literal["operating points", "trials", "nothing"]
Rung = Literal["nominal", "retuned", "with_effect", "noise_floor"]
RUNGS: tuple[Rung, ...] = ("nominal", "retuned", "with_effect", "noise_floor")


@dataclass(frozen=True, kw_only=True, slots=True)
class Rungs:
    """One quantity on the four rungs of the ladder."""

    nominal: float
    retuned: float
    with_effect: float
    noise_floor: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """What was fitted without one group of trials, in one form of the cause.

    Attributes
    ----------
    retuned, nuisances : ndarray, shape (p,)
        Nuisances alone, and beside the cause, in units of their widened prior standard deviation.
    amplitudes : ndarray, shape (q,)
        Of the cause's columns.
    alternative : int
        Which of the alternative columns it is.
    root : ndarray, shape (q, q)
        Of the covariance of the amplitudes, by the misfit that the kept trials are left with.
    following : ndarray, shape (p, q)
        How far the nuisances go back where an amplitude goes up.
    behind : float
        Minus twice its log evidence by the kept trials, less that of the likeliest form: 0 or more.
    """

    retuned: Floats
    nuisances: Floats
    amplitudes: Floats
    alternative: int
    root: Floats
    following: Floats
    behind: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Ladder:
    """Withheld gap.

    Attributes
    ----------
    whitened : Rungs
        Root mean square of the residual over its noise.
    by_channel : dict of str to (Rungs, unit)
        Of the equations that are a channel's misprediction, in its unit.
    fits : dict of str to Fit
        The likeliest by the kept trials, by the group of trials that was withheld.
    held_out : HeldOut
        What was withheld, each in turn.
    energy : dict of str to ndarray, shape (n_groups,)
        Sum of squares in each group, by rung, of the whitened residual in standard deviations of the prediction.
    squares : dict of str to dict of str to ndarray, shape (n_trials,)
        Sum of squares in each trial, by rung and equation, of the residual in standard deviations of the prediction:
        what the kept trials leave open of the parameters and of the cause is no error of it.
    group_of : ndarray, shape (n_trials,)
        Number of the group that each trial is withheld with.
    n_features : dict of str to ndarray, shape (n_groups,)
        By equation: how many squares these are.
    """

    whitened: Rungs
    by_channel: dict[str, tuple[Rungs, str]]
    fits: dict[str, Fit]
    held_out: HeldOut
    energy: dict[str, Floats]
    squares: dict[str, dict[Equation, Floats]]
    group_of: np.ndarray
    n_features: dict[Equation, Floats]

    def squares_in(self, equations: Sequence[Equation]) -> dict[str, Floats]:
        """Sum of squares in each group over some equations, by rung, shape (n_groups,)."""
        return {name: self.by_group(values) for name, values in self._of_trials(equations).items()}

    def energy_in(self, equations: Sequence[Equation]) -> dict[str, Floats]:
        """`energy` in each trial over some equations, shape (n_trials,): those where the cause acts.

        What the cause spreads the prediction of a group by is shared out to its trials.
        """
        found = self._of_trials(equations)
        spread = self.energy["with_effect"] - self.by_group(np.sum(list(self.squares["with_effect"].values()), axis=0))
        of_trial = (spread / self.by_group(np.ones(len(self.group_of))))[self.group_of]
        return found | {"with_effect": found["with_effect"] + of_trial}

    def closed_in(self, equations: Sequence[Equation]) -> tuple[float, tuple[float, float]]:
        """`gap_closed` over some equations, those where the cause acts, and its 95 % interval; see `closed_share`.

        The interval is (-1, 1) where there is nothing to close, or nothing to hold out.
        """
        closed, interval = closed_share(self.energy_in(equations))
        return closed, interval if self.held_out != "nothing" else (-1.0, 1.0)

    @property
    def closed(self) -> tuple[float, tuple[float, float]]:
        """`closed_in` over all equations."""
        return self.closed_in(list(self.n_features))

    def by_group(self, values: Floats) -> Floats:
        """Sums over the trials of each group, shape (n_groups,), of one value per trial, shape (n_trials,)."""
        return np.bincount(self.group_of, values)

    def _of_trials(self, equations: Sequence[Equation]) -> dict[str, Floats]:
        return {
            name: np.sum([found[equation] for equation in equations if equation in found], axis=0)
            for name, found in self.squares.items()
        }

    def left_in(self, equations: Sequence[Equation], *, rung: Rung) -> float:
        """Sum of squares above the noise that one rung leaves in some equations, each at least 0."""
        model, floor = (self.squares[name] for name in (rung, "noise_floor"))
        return sum(max(float(np.sum(model[e] - floor[e])), 0.0) for e in equations)
