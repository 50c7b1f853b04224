"""One answer among which the evidence decides: effects that act together, or none of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

if TYPE_CHECKING:
    from sawbench.diagnosis.inference.evidence import Explanation

Other = Literal["no_gap", "parameters", "unknown"]
Verdict = Literal["effect", "effects", "parameters", "no_gap", "unknown"]
# Answers that name no effect.
OTHERS: Final[tuple[Other, ...]] = ("no_gap", "parameters", "unknown")
# Between the effects of a name.
AND: Final = " + "


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hypothesis:
    """Effects that act together, or one of the answers that name none.

    Attributes
    ----------
    effects : tuple of str
        Ids in alphabetical order; none where `other` says what else it is.
    other : {"no_gap", "parameters", "unknown"}, optional
    log_evidence : float
        Against "no_gap".
    left_over : float
        Whitened misfit over the number of features that it leaves; inf where nobody fitted it.
    shared : float
        How much of the effect that was added last lies in the equations that the others move, 0 to 1: there, what
        their forms miss can be taken for it.
    members : tuple of Explanation
        One an effect, in the order of `effects`, each with its form beside the others.
    of_strokes : float
        The part of the log evidence that single strokes give: what the form of another effect misses does not look like
        it. The rest is of mean strokes.
    is_fitted_together : bool
        The members were found beside each other; else each stands as it was found alone.
    probability : float
        NaN before the weighing.

    Examples
    --------
    >>> both = Hypothesis(effects=("blade_wear", "edge_force"), log_evidence=12.0)
    >>> both.name, both.verdict, both.without("edge_force")
    ('blade_wear + edge_force', 'effects', ('blade_wear',))
    """

    effects: tuple[str, ...] = ()
    other: Other | None = None
    log_evidence: float
    left_over: float = np.inf
    shared: float = 1.0
    members: tuple[Explanation, ...] = ()
    of_strokes: float = 0.0
    is_fitted_together: bool = False
    probability: float = np.nan

    def __post_init__(self) -> None:
        if bool(self.effects) == (self.other is not None):
            raise ValueError(f"a hypothesis holds effects or is one of {OTHERS}: got {self.effects} and {self.other}")
        if list(self.effects) != sorted(set(self.effects)):
            raise ValueError(f"effects of a hypothesis stand once and in alphabetical order: got {self.effects}")

    @property
    def name(self) -> str:
        """As the report's detail has it: "first + second", or what else it is."""
        return self.other or AND.join(self.effects)

    @property
    def of_means(self) -> float:
        """The part of the log evidence that mean strokes give."""
        return self.log_evidence - self.of_strokes

    @property
    def verdict(self) -> Verdict:
        """As the report has it."""
        if self.other is not None:
            return self.other
        return "effect" if len(self.effects) == 1 else "effects"

    def without(self, effect: str) -> tuple[str, ...]:
        """Its effects but one."""
        return tuple(name for name in self.effects if name != effect)


def named(name: str, log_evidence: float, *, left_over: float = np.inf, shared: float = 1.0) -> Hypothesis:
    """Hypothesis of a name as `Hypothesis.name` writes it, without members.

    Parameters
    ----------
    name : str
    log_evidence, left_over, shared : float
        See `Hypothesis`.
    """
    for other in OTHERS:
        if name == other:
            return Hypothesis(other=other, log_evidence=log_evidence, left_over=left_over)
    return Hypothesis(effects=tuple(name.split(AND)), log_evidence=log_evidence, left_over=left_over, shared=shared)
