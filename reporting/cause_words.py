"""Causes in the words of the workshop, as every effect of the catalogue states them."""

from __future__ import annotations

from collections.abc import Iterable

from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME


def name_of(effect: str) -> str:
    """Write an identifier as words.

    Examples
    --------
    >>> name_of("guide_friction")
    'guide friction'
    """
    return effect.replace("_", " ")


def what_happens(effect: str) -> str:
    """Say in plain words what an effect is; its name where the catalogue does not hold it."""
    known = EFFECT_BY_NAME.get(effect)
    return name_of(effect) if known is None or known.words is None else known.words.happens


def what_to_do(effect: str) -> str:
    """Say what to do about it, and what to measure first; empty where the catalogue does not hold it."""
    known = EFFECT_BY_NAME.get(effect)
    if known is None or known.words is None:
        return ""
    return f"{known.words.mend}. To make sure, measure {known.words.measure}"


def equations_of(effects: Iterable[str]) -> set[str]:
    """Return the equations of the report in which effects act; none for what the catalogue does not hold."""
    return {EFFECT_BY_NAME[effect].place for effect in effects if effect in EFFECT_BY_NAME}
