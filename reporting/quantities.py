"""Numbers as people write them: rounded where their uncertainty begins."""

from __future__ import annotations

import math
from collections.abc import Iterable

_NBSP = "\N{NO-BREAK SPACE}"
_MINUS = "\N{MINUS SIGN}"
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def decimals_of(std: float) -> int:
    """Return the decimal places that show two significant digits of an uncertainty.

    Parameters
    ----------
    std : float
        Finite, greater than 0.

    Returns
    -------
    int
        Negative where even the ones are uncertain.

    Examples
    --------
    >>> decimals_of(1.234), decimals_of(0.0996), decimals_of(230.0)
    (1, 2, -1)
    """
    return 1 - int(f"{std:.1e}".partition("e")[2])


def format_number(value: float | None, *, digits: int = 4) -> str:
    """Write a number without a stated uncertainty, to so many significant digits.

    Examples
    --------
    >>> format_number(14.00638), format_number(None), format_number(5000.0)
    ('14.01', 'not known', '5000')
    """
    if value is None or not math.isfinite(value):
        return "not known"
    if value == 0.0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if not -4 <= exponent < 6:
        return _scientific(f"{value / 10.0**exponent:.{digits - 1}f}", exponent)
    return _signed(_fixed(value, digits - 1 - exponent))


def format_quantity(value: float | None, std: float | None = None, unit: str = "", *, digits: int = 4) -> str:
    r"""Write a value with its standard uncertainty, to two significant digits of the uncertainty.

    Parameters
    ----------
    value : float or None
        None or not finite: "not known".
    std : float or None
        Standard uncertainty in the unit of the value; None, 0 or not finite where none is stated.
    unit : str
    digits : int
        Significant digits of a value without a stated uncertainty; it has no "±".

    Returns
    -------
    str
        Number and unit are held together by no-break spaces.

    Examples
    --------
    >>> format_quantity(240.2871, 1.2345, "N·s/m")
    '240.3\xa0±\xa01.2\xa0N·s/m'
    >>> format_quantity(927.4, 48.0, "s")
    '927\xa0±\xa048\xa0s'
    >>> format_quantity(75.4716964, 2.3e-7, "ms")
    '75.47169640\xa0±\xa00.00000023\xa0ms'
    """
    if value is None or not math.isfinite(value):
        return "not known"
    tail = f"{_NBSP}{unit}" if unit else ""
    if std is None or not math.isfinite(std) or std <= 0.0:
        return format_number(value, digits=digits) + tail
    decimals = decimals_of(std)
    exponent = 1 - decimals if value == 0.0 else math.floor(math.log10(abs(value)))
    if (decimals > 6 or decimals < -4) and not -4 <= exponent < 6:
        shift = max(exponent, 1 - decimals)
        scaled = [f"{number / 10.0**shift:.{decimals + shift}f}" for number in (value, std)]
        inner = f"({_signed(scaled[0])}{_NBSP}±{_NBSP}{scaled[1]})"
        return f"{inner}{_NBSP}×{_NBSP}10{str(shift).translate(_SUPERSCRIPTS)}{tail}"
    return f"{_signed(_fixed(value, decimals))}{_NBSP}±{_NBSP}{_fixed(std, decimals)}{tail}"


def correlation_words(std_s: float, contributions_s: Iterable[float]) -> str:
    """Say why the parts of an uncertainty do not add up to the whole in squares; empty where they do.

    Examples
    --------
    >>> correlation_words(5.0, [3.0, 4.0])
    ''
    >>> correlation_words(2.0, [3.0, 4.0])
    'Their errors are correlated and partly cancel: 2.0 s together, 5.0 s if independent'
    """
    independent_s = math.hypot(*contributions_s)
    if abs(independent_s - std_s) <= 0.05 * std_s:
        return ""
    way = "partly cancel" if std_s < independent_s else "reinforce each other"
    return f"Their errors are correlated and {way}: {std_s:.1f} s together, {independent_s:.1f} s if independent"


def format_to(value: float, decimals: int, unit: str = "") -> str:
    r"""Write a number to given decimal places.

    Examples
    --------
    >>> format_to(-5.6249, 1, "N")
    '−5.6\xa0N'
    """
    return _signed(_fixed(value, decimals)) + (f"{_NBSP}{unit}" if unit else "")


def format_share(share: float) -> str:
    """Write a probability or a share in whole per cent, without claiming certainty.

    Examples
    --------
    >>> format_share(0.911), format_share(0.9991), format_share(0.004)
    ('91 %', 'over 99 %', 'under 1 %')
    """
    if share > 0.995:
        return "over 99 %"
    return f"{100 * share:.0f} %" if share >= 0.01 else "under 1 %"


def format_interval(low: float, high: float, unit: str = "") -> str:
    r"""Write an interval, its ends to two significant digits of its half-width.

    Examples
    --------
    >>> format_interval(237.31, 243.38, "N")
    '237.3\xa0to\xa0243.4\xa0N'
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    tail = f"{_NBSP}{unit}" if unit else ""
    half = 0.5 * (high - low)
    if half <= 0.0:
        return f"{format_number(low)}{tail}"
    decimals = decimals_of(half)
    return f"{_signed(_fixed(low, decimals))}{_NBSP}to{_NBSP}{_signed(_fixed(high, decimals))}{tail}"


def format_duration(seconds: float | None) -> str:
    r"""Write a time of minutes and hours in words.

    Examples
    --------
    >>> format_duration(927.4), format_duration(48.2), format_duration(7325.0)
    ('15\xa0min 27\xa0s', '48\xa0s', '2\xa0h 2\xa0min')
    """
    if seconds is None or not math.isfinite(seconds):
        return "not known"
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole % 3600 // 60, whole % 60
    if hours:
        return f"{hours}{_NBSP}h {minutes}{_NBSP}min"
    return f"{minutes}{_NBSP}min {rest}{_NBSP}s" if minutes else f"{rest}{_NBSP}s"


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def _signed(text: str) -> str:
    return text.replace("-", _MINUS)


def _scientific(mantissa: str, exponent: int) -> str:
    return f"{_signed(mantissa)}{_NBSP}×{_NBSP}10{str(exponent).translate(_SUPERSCRIPTS)}"
