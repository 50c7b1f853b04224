"""How probable it makes a cause outside the catalogue that a claim leaves a part of the gap it should close.

The nearest entry of a catalogue explains a good part of what is not in it: a spring at the end of the stroke looks
like an eccentric gear until the speed changes. The right cause leaves little at withheld operating points, however
strong the gap is: what its form misses is a small share of it. The nearest wrong one leaves anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.spread import jackknife_std
from sawbench.diagnosis.answer.ladder import Ladder, Rung
from sawbench.diagnosis.inference.left_over import log_density_of_left
from sawbench.diagnosis.inference.settings import SETTINGS, Weights
from sawbench.modeling.residuals import Equation

_LEAST_SHARE = 1e-4
# Of a normal distribution, over which the uncertain share is averaged.
_DEVIATES = np.linspace(-4.0, 4.0, 81)
_LIKELY = np.exp(-0.5 * _DEVIATES**2) / np.exp(-0.5 * _DEVIATES**2).sum()


def odds_of_unlisted(
    ladder: Ladder, equations: Sequence[Equation], *, quiet: float, weights: Weights = SETTINGS.weights
) -> float:
    """Odds of a cause outside the catalogue against a claim, by the equation that the claim explains worst.

    A cause that is not listed acts in one equation as a rule: what the claim closes elsewhere says nothing against it.

    Parameters
    ----------
    ladder : Ladder
        Of the claim.
    equations : sequence of Equation
        In which it acts: what stays unexplained elsewhere is not its.
    quiet : float
        Whitened misfit over features that an intact machine leaves on this bench.
    weights : Weights

    Returns
    -------
    float
        Prior odds times the likelihood of the share that is left: exponential for the right cause, even for a wrong
        one.
    """
    named = 1.0 - weights.prior_no_gap - weights.prior_parameters - weights.prior_unknown
    likelihoods = [
        _likelihood_of_the_right(*left_share(ladder, [equation], quiet=quiet, weights=weights))
        for equation in equations
        if equation in ladder.n_features
    ]
    return weights.prior_unknown / (named * max(min(likelihoods, default=1.0), 1e-12))


def _likelihood_of_the_right(share: float, std: float) -> float:
    """Density of the share that a correct claim leaves, averaged over what is not known of it."""
    shares = np.clip(share * np.exp(std * _DEVIATES), _LEAST_SHARE, 1.0)
    return float(_LIKELY @ np.exp(log_density_of_left(shares)))


def leaves_a_gap(
    ladder: Ladder, equations: Sequence[Equation], *, rung: Rung, quiet: float, weights: Weights = SETTINGS.weights
) -> bool:
    """Whether one rung leaves more of one of some equations, in one withheld group, than an intact machine.

    Parameters
    ----------
    ladder : Ladder
    equations : sequence of Equation
    rung : {"retuned", "with_effect"}
    quiet : float
    weights : Weights
    """
    each = _left_beside_an_intact(ladder, equations, rung, quiet, weights)
    return any(np.any(left > intact) for left, intact in each)


def times_an_intact(
    ladder: Ladder, equations: Sequence[Equation], *, rung: Rung, quiet: float, weights: Weights = SETTINGS.weights
) -> float:
    """What one rung leaves over all withheld groups in the worst of some equations, over what an intact machine leaves.

    Parameters
    ----------
    ladder : Ladder
    equations : sequence of Equation
    rung : {"retuned", "with_effect"}
    quiet : float
    weights : Weights
    """
    each = _left_beside_an_intact(ladder, equations, rung, quiet, weights)
    return max((float(left.sum() / intact.sum()) for left, intact in each), default=0.0)


def left_share(
    ladder: Ladder, equations: Sequence[Equation], *, quiet: float, weights: Weights = SETTINGS.weights
) -> tuple[float, float]:
    """Share of what re-tuned parameters leave at withheld groups that the claim leaves too, beyond an intact machine.

    A machine without a fault leaves there what its noise and its model are stated to leave, or up to twice as much as
    the noise in addition: that is no share of a gap.

    Parameters
    ----------
    ladder : Ladder
    equations : sequence of Equation
    quiet : float
    weights : Weights

    Returns
    -------
    share : float
        `_LEAST_SHARE` to 1.
    std : float
        Standard error of its logarithm, by leaving out each group in turn; 1 where there is a single one.
    """
    squares = ladder.squares_in(equations)
    retuned, effect = squares["retuned"], squares["with_effect"]
    intact = np.sum(
        [_left_by_an_intact(ladder, e, quiet, weights) for e in equations if e in ladder.n_features], axis=0
    )

    def share(kept: np.ndarray) -> float:
        left = float(effect[kept].sum() - intact[kept].sum())
        return float(np.clip(left / max(float(retuned[kept].sum()), 1e-300), _LEAST_SHARE, 1.0))

    everything = np.arange(len(retuned))
    if len(everything) < 2:
        return share(everything), 1.0
    logs: Floats = np.log([share(np.delete(everything, k)) for k in everything])
    return share(everything), float(jackknife_std(logs))


def _left_beside_an_intact(
    ladder: Ladder, equations: Sequence[Equation], rung: Rung, quiet: float, weights: Weights
) -> Iterator[tuple[Floats, Floats]]:
    """Sums of squares in each group, (n_groups,) each, of one rung and of an intact machine, by equation."""
    for equation in equations:
        if equation in ladder.n_features:
            yield ladder.squares_in([equation])[rung], _left_by_an_intact(ladder, equation, quiet, weights)


def _left_by_an_intact(ladder: Ladder, equation: Equation, quiet: float, weights: Weights) -> Floats:
    """Sum of squares in each group of one equation, shape (n_groups,)."""
    noise = (1.0 + SETTINGS.ladder.left_by_an_intact) * ladder.squares_in([equation])["noise_floor"]
    return np.maximum(noise, quiet * ladder.n_features[equation])
