"""Numbers in texts as engineers write them: plain digits and a unit of fitting size."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

# Unit -> (least value, name, factor), largest first; the last one holds for all that is smaller.
_UNITS: Final[Mapping[str, tuple[tuple[float, str, float], ...]]] = MappingProxyType(
    {
        "m": ((1.0, "m", 1.0), (1e-4, "mm", 1e3), (0.0, "\N{GREEK SMALL LETTER MU}m", 1e6)),
        "N": ((1e4, "kN", 1e-3), (0.0, "N", 1.0)),
        "s": ((0.1, "s", 1.0), (0.0, "ms", 1e3)),
    }
)


def fitting_unit(value: float, unit: str) -> tuple[str, float]:
    """Choose the unit in which a quantity has few digits, and the factor from the given unit to it.

    Parameters
    ----------
    value : float
    unit : str
        "m", "N" and "s" have others; any other unit stays.

    Examples
    --------
    >>> fitting_unit(0.0057, "m"), fitting_unit(-11700.0, "N"), fitting_unit(3.0, "Hz")
    (('mm', 1000.0), ('kN', 0.001), ('Hz', 1.0))
    """
    steps = _UNITS.get(unit, ((0.0, unit, 1.0),))
    return next((name, factor) for least, name, factor in steps if abs(value) >= least or least == 0.0)


def rounded(value: float, digits: int = 5) -> float:
    """Round to so many significant digits.

    Examples
    --------
    >>> rounded(742.123456), rounded(0.000123456, 2), rounded(0.0)
    (742.12, 0.00012, 0.0)
    """
    return float(f"{value:.{digits}g}")


def plain(value: float, unit: str = "", *, digits: int = 2) -> str:
    """Write a number to so many significant digits, without an exponent, in a unit of fitting size.

    Examples
    --------
    >>> plain(0.2464, "m"), plain(11742.0, "N", digits=3), plain(0.9996, "Hz"), plain(-3.27, "N"), plain(0.0)
    ('250 mm', '11.7 kN', '1.0 Hz', '-3.3 N', '0.0')
    """
    name, factor = fitting_unit(value, unit)
    number = factor * value
    # Of the rounded number: 0.9996 is written as 1.0 is.
    decimals = digits - 1 - int(f"{number:.{digits - 1}e}".partition("e")[2])
    return f"{round(number, decimals):.{max(decimals, 0)}f} {name}".rstrip()
