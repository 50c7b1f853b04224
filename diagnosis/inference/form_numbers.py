"""The numbers of a form: those that may be anything in a range, and those that are a choice.

A time constant is continuous; which device limits a current, or an order of the stroke, is a choice. A continuous
number that is 0 is a choice as well: a limiter without a time constant is another kind of limiter.
"""

from __future__ import annotations

from typing import Final

from sawbench.diagnosis.inference.columns import Column

# Larger than by rounding.
_ROUNDED: Final = 1.0 + 1e-9

Ranges = dict[str, tuple[float, float]]


def kind(form: Column) -> tuple[str, ...]:
    """Which continuous numbers a form has."""
    return tuple(name for name in form.effect.continuous if form.shape.get(name))


def _scalable(form: Column) -> tuple[str, ...]:
    """Those that may be anything in a range: they are above 0, and are looked for on a scale of factors."""
    return tuple(name for name in kind(form) if form.shape[name] > 0.0)


def choices(form: Column) -> frozenset[tuple[str, float]]:
    """Numbers of a form that are not continuous."""
    return frozenset((name, value) for name, value in form.shape.items() if name not in form.effect.continuous)


def of_same_choices(form: Column) -> list[dict[str, float]]:
    """A form and the shapes of the catalogue that differ from it in continuous numbers alone."""
    return [form.shape, *(other for other in form.effect.shapes if choices(form) <= other.items())]


def ranges(form: Column) -> Ranges:
    """Least and largest value of each continuous number that a form has, over the forms of the same choices."""
    found = {}
    for name in _scalable(form):
        values = [shape[name] for shape in of_same_choices(form) if shape.get(name, 0.0) > 0.0]
        if min(values) < max(values):
            found[name] = (min(values), max(values))
    return found


def neighbours(form: Column) -> Ranges:
    """Next smaller and next larger value in the catalogue of each such number, where all other numbers are the same."""
    found = {}
    for name in _scalable(form):
        here = form.shape[name]
        values = [other[name] for other in form.effect.shapes if other == {**form.shape, name: other.get(name)}]
        # A form at the edge of its range is that of the catalogue but for rounding.
        smaller = max((value for value in values if 0.0 < value < here / _ROUNDED), default=here)
        larger = min((value for value in values if value > here * _ROUNDED), default=here)
        if smaller < larger:
            found[name] = (smaller, larger)
    return found
