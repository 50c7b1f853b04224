"""How well the stated size of a rightly named effect, and its uncertainty, hold against the true one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sawbench.blindcheck.score_statistics import Z95, Estimate, Proportion, median_of, wilson


@dataclass(frozen=True, kw_only=True, slots=True)
class StatedParameter:
    """One number of a report beside its true value.

    Attributes
    ----------
    effect, name, unit : str
    value, std : float
        As stated, in `unit`.
    true_value : float
        In `unit`.
    """

    effect: str
    name: str
    unit: str
    value: float
    std: float
    true_value: float

    @property
    def is_inside(self) -> bool:
        """Whether the truth lies within 1.96 stated standard deviations."""
        return abs(self.value - self.true_value) <= Z95 * self.std

    @property
    def relative_error(self) -> float:
        """Distance from the truth, relative to it."""
        return abs(self.value - self.true_value) / abs(self.true_value)


@dataclass(frozen=True, kw_only=True, slots=True)
class EffectParameter:
    """The reported number of one effect over all cases in which it was rightly named.

    Attributes
    ----------
    effect, name, unit : str
    coverage : Proportion
        How often the stated 95 % interval holds the truth.
    relative_error : Estimate
        Median distance from the truth, relative to it.
    ratio : float
        Median of stated over true value.
    stated_rel_std : float
        Median of the stated standard deviation over the true value.
    """

    effect: str
    name: str
    unit: str
    coverage: Proportion
    relative_error: Estimate
    ratio: float
    stated_rel_std: float


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterScore:
    """Reported numbers of correct claims against the truth.

    Attributes
    ----------
    coverage : Proportion
    relative_error : Estimate
        Median.
    effects : tuple of EffectParameter
        In the order of their names.
    """

    coverage: Proportion
    relative_error: Estimate
    effects: tuple[EffectParameter, ...]


def stated_parameters(truth: Mapping[str, Any], cause: Mapping[str, Any]) -> tuple[StatedParameter, ...]:
    """Return the numbers of one cause of a report that can be compared with the truth.

    Parameters
    ----------
    truth : mapping
        Of the label; sets that were sealed before it held `reported_parameters` have nothing to compare with.
    cause : mapping
        With `effects` and `parameters`.

    Returns
    -------
    tuple of StatedParameter
        Only effects that are hidden and named. Two effects with a number of the same name state it as
        "effect.number"; empty where fewer numbers are stated than effects named, which then cannot be told apart. A
        number in another unit is left out.

    Raises
    ------
    KeyError, TypeError, ValueError
        If a stated number is not a number.
    """
    stated = cause.get("parameters", {})
    if len(stated) < len(cause["effects"]):
        return ()
    found = []
    for effect, true in truth.get("reported_parameters", {}).items():
        told = stated.get(f"{effect}.{true['name']}", stated.get(true["name"])) if effect in cause["effects"] else None
        if told is None or told["unit"] != true["unit"]:
            continue
        value, std = float(told["value"]), float(told["std"])
        if not (math.isfinite(value) and math.isfinite(std) and std >= 0.0):
            raise ValueError(f"{true['name']} is {value!r} with standard deviation {std!r}")
        found.append(
            StatedParameter(
                effect=effect, name=true["name"], unit=true["unit"], value=value, std=std, true_value=true["value"]
            )
        )
    return tuple(found)


def parameter_score(stated: Sequence[StatedParameter]) -> ParameterScore:
    """Count intervals that hold the truth, overall and by effect.

    Examples
    --------
    >>> told = {"effect": "yoke_backlash", "name": "gap_m", "unit": "m", "value": 3e-4}
    >>> near = StatedParameter(**told, std=1e-4, true_value=2.5e-4)
    >>> far = StatedParameter(**told, std=1e-6, true_value=2.5e-4)
    >>> parameter_score([near, far]).coverage.hits
    1
    """
    return ParameterScore(
        coverage=_coverage(stated),
        relative_error=_relative_error(stated),
        effects=tuple(
            _of_effect([one for one in stated if one.effect == effect])
            for effect in sorted({one.effect for one in stated})
        ),
    )


def _of_effect(stated: Sequence[StatedParameter]) -> EffectParameter:
    return EffectParameter(
        effect=stated[0].effect,
        name=stated[0].name,
        unit=stated[0].unit,
        coverage=_coverage(stated),
        relative_error=_relative_error(stated),
        ratio=float(np.median([one.value / one.true_value for one in stated])),
        stated_rel_std=float(np.median([one.std / abs(one.true_value) for one in stated])),
    )


def _coverage(stated: Sequence[StatedParameter]) -> Proportion:
    return wilson(sum(one.is_inside for one in stated), len(stated))


def _relative_error(stated: Sequence[StatedParameter]) -> Estimate:
    return median_of(np.array([one.relative_error for one in stated], dtype=np.float64))
