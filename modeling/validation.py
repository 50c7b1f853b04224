"""Checks of single numbers, with a message that names the parameter."""

from __future__ import annotations

import math

from sawbench.bench.errors import InputError


def finite(name: str, value: float, unit: str) -> None:
    """Raise InputError unless the value is a finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise InputError(f"{name} must be a finite number, got {value!r} {unit}")


def positive(name: str, value: float, unit: str) -> None:
    """Raise InputError unless the value is finite and greater than 0.

    Examples
    --------
    >>> positive("inductance_h", -1.0, "H")
    Traceback (most recent call last):
    sawbench.bench.errors.InputError: inductance_h must be greater than 0, got -1.0 H
    """
    finite(name, value, unit)
    if value <= 0:
        raise InputError(f"{name} must be greater than 0, got {value!r} {unit}")


def not_negative(name: str, value: float, unit: str) -> None:
    """Raise InputError unless the value is finite and at least 0."""
    finite(name, value, unit)
    if value < 0:
        raise InputError(f"{name} must not be negative, got {value!r} {unit}")


def below_one(name: str, value: float) -> None:
    """Raise InputError unless the value is in [0, 1)."""
    finite(name, value, "")
    if not 0 <= value < 1:
        raise InputError(f"{name} must be in [0, 1), got {value!r}")


def fraction(name: str, value: float) -> None:
    """Raise InputError unless the value is in (0, 1]."""
    finite(name, value, "")
    if not 0 < value <= 1:
        raise InputError(f"{name} must be in (0, 1], got {value!r}")
