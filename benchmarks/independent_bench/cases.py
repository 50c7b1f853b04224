"""Which case hides what: the kinds in fixed shares, the effects at random for every seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from benchmarks.independent_bench.effects import CATALOGUE, EFFECTS, UNLISTED

Kind = Literal["single", "pair", "intact", "parameters", "unknown"]
# Of 44 cases.
SHARES: Final[Mapping[Kind, int]] = {"single": 24, "pair": 6, "intact": 5, "parameters": 4, "unknown": 5}
DEFAULT_CASES: Final = sum(SHARES.values())
# Nominal values that are wrong by so many stated standard deviations.
MISSET: Final[Mapping[str, float]] = {
    "resistance_ohm": 4.0, "back_emf_constant_v_s_per_rad": -4.0, "motor_damping_n_m_s_per_rad": 4.0,
    "torque_constant_n_m_per_a": 4.0,
}  # fmt: skip
_SINGLE_SEVERITY, _PAIR_SEVERITY, _UNLISTED_SEVERITY = (0.7, 2.0), (1.0, 2.0), (0.8, 1.6)


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """What a case hides.

    Attributes
    ----------
    number : int
        From 1.
    kind : str
    effects : mapping of str to float
        Severity of every hidden effect; of `parameters`, the error of the nominal value in its standard deviations.
    """

    number: int
    kind: Kind
    effects: Mapping[str, float]

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"case-{self.number:02d}"


def kind_of(number: int) -> tuple[Kind, int]:
    """Kind of a case, and how many of this kind come before it: at any number the shares are as even as they can be.

    Examples
    --------
    >>> [kind_of(number)[0] for number in range(1, 8)]
    ['single', 'pair', 'single', 'intact', 'single', 'unknown', 'single']
    """
    counts = dict.fromkeys(SHARES, 0)
    for done in range(1, number):
        counts[_most_missing(counts, done)] += 1
    kind = _most_missing(counts, number)
    return kind, counts[kind]


def _most_missing(counts: Mapping[Kind, int], number: int) -> Kind:
    return max(get_args(Kind), key=lambda kind: SHARES[kind] * number - DEFAULT_CASES * counts[kind])


def draw_case(seed: int, number: int) -> Case:
    """Draw what a case of a set hides; the same for the same seed and number, however many cases the set has."""
    kind, before = kind_of(number)
    rng = np.random.default_rng([seed, number])
    if kind == "intact":
        return Case(number=number, kind=kind, effects={})
    if kind == "parameters":
        name = _from_deck(seed, kind, list(MISSET), before)
        return Case(number=number, kind=kind, effects={name: MISSET[name]})
    if kind == "pair":
        return Case(number=number, kind=kind, effects=_with_severities(rng, _pair(seed, before), _PAIR_SEVERITY))
    names, severities = (CATALOGUE, _SINGLE_SEVERITY) if kind == "single" else (UNLISTED, _UNLISTED_SEVERITY)
    chosen = (_from_deck(seed, kind, list(names), before),)
    return Case(number=number, kind=kind, effects=_with_severities(rng, chosen, severities))


def _with_severities(
    rng: np.random.Generator, names: tuple[str, ...], ends: tuple[float, float]
) -> Mapping[str, float]:
    return {name: min(round(rng.uniform(*ends), 2), EFFECTS[name].highest) for name in names}


def _from_deck(seed: int, kind: Kind, names: list[str], place: int) -> str:
    """Names in a random order; once all were drawn, all of them again in another."""
    turn, place = divmod(place, len(names))
    rng = np.random.default_rng([seed, 0, get_args(Kind).index(kind), turn])
    return names[rng.permutation(len(names))[place]]


def _pair(seed: int, place: int) -> tuple[str, ...]:
    """Two effects of different equations, of which there are some 300 pairs; none comes twice among a hundred."""
    turn, place = divmod(place, 100)
    rng = np.random.default_rng([seed, 0, get_args(Kind).index("pair"), turn])
    by_equation: dict[str, list[str]] = {}
    for name, effect in CATALOGUE.items():
        by_equation.setdefault(effect.equation, []).append(name)
    equations = list(by_equation)
    drawn: dict[tuple[str, ...], None] = {}
    while len(drawn) <= place:
        chosen = rng.choice(len(equations), 2, replace=False)
        drawn[tuple(sorted(str(rng.choice(by_equation[equations[j]])) for j in chosen))] = None
    return list(drawn)[place]
