"""Units that tables of others use, and the factor to the unit that sawbench stores."""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import Final

from sawbench.bench.units import CHANNEL_BY_NAME, TIME_COLUMN

_MICRO: Final = ("u", "µ", "μ")

# Stored unit -> what else it is stated in -> factor to the stored unit.
FACTORS: Final = MappingProxyType(
    {
        "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, **{f"{m}s": 1e-6 for m in _MICRO}, "ns": 1e-9, "min": 60.0},
        "N": {
            "N": 1.0,
            "kN": 1e3,
            "mN": 1e-3,
            "lbf": 4.4482216152605,
            "kip": 4448.2216152605,
            "kgf": 9.80665,
            "Newton": 1.0,
        },
        "mm": {"mm": 1.0, "m": 1e3, "cm": 10.0, **{f"{m}m": 1e-3 for m in _MICRO}, "in": 25.4, "inch": 25.4},
        "A": {"A": 1.0, "Amp": 1.0, "Amps": 1.0, "mA": 1e-3, **{f"{m}A": 1e-6 for m in _MICRO}},
        "V": {"V": 1.0, "Volt": 1.0, "Volts": 1.0, "mV": 1e-3, **{f"{m}V": 1e-6 for m in _MICRO}, "kV": 1e3},
    }
)
# In capitals, M may stand for milli or mega.
_AMBIGUOUS: Final = frozenset({"MN", "MV", "MA"})
_SUFFIX_UNIT: Final = MappingProxyType({"s": "s", "n": "N", "mm": "mm", "a": "A", "v": "V"})
_BRACKETED: Final = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*)\s*[\])]\s*$")
# "Force / kN" as DIN 461 has it, "Force in kN", and "force_kn" of a quantity that has a channel.
_UNBRACKETED: Final = re.compile(r"^(.*\S)(?:\s+/\s+|\s+in\s+)([^\s/]+)$")
# "Motor current [mA]" is motor_current_a: the words without the unit, where the header states one.
NAME_OF_STEM: Final = MappingProxyType({name.rpartition("_")[0]: name for name in (TIME_COLUMN, *CHANNEL_BY_NAME)})


def stored_unit(channel: str) -> str:
    """Return the unit in which a channel is stored, by its name; "" where the name does not end in one.

    Examples
    --------
    >>> stored_unit("force_n"), stored_unit("guide_travel_mm"), stored_unit("oil_temperature")
    ('N', 'mm', '')
    """
    if channel == TIME_COLUMN:
        return "s"
    known = CHANNEL_BY_NAME.get(channel)
    if known is not None:
        return known.unit
    stem, _, suffix = channel.rpartition("_")
    return _SUFFIX_UNIT.get(suffix, "") if stem else ""


def factor_between(stated: str, stored: str) -> float | None:
    """Return what a value in `stated` is multiplied by to be in `stored`; None where that is not known.

    Examples
    --------
    >>> factor_between("kN", "N"), factor_between("KN", "N"), factor_between("counts", "N")
    (1000.0, 1000.0, None)
    >>> factor_between("m/s", "mm/s"), factor_between("mm", "mm/s")
    (1000.0, None)
    """
    if stated == stored:
        return 1.0
    if stated.count("/") == stored.count("/") == 1:
        above, below = (
            factor_between(one.strip(), other) for one, other in zip(stated.split("/"), stored.split("/"), strict=True)
        )
        return None if above is None or below is None else above / below
    known = FACTORS.get(stored, {})
    if stated in known or stated in _AMBIGUOUS:
        return known.get(stated)
    return next((factor for unit, factor in known.items() if unit.lower() == stated.lower()), None)


def is_unit(text: str) -> bool:
    """Whether a text, with or without brackets, is a unit of the table above."""
    bare = bare_unit(text)
    return any(factor_between(bare, stored) is not None for stored in FACTORS)


def bare_unit(text: str) -> str:
    """Return a unit without the brackets around it.

    Examples
    --------
    >>> bare_unit("[kN]"), bare_unit(" mm ")
    ('kN', 'mm')
    """
    text = text.strip()
    found = _BRACKETED.match(text)
    return found[2].strip() if found and not found[1] else text


def split_unit(header: str) -> tuple[str, str]:
    """Return the name in a header and the unit that stands behind it: in brackets, or known.

    Examples
    --------
    >>> split_unit("Force Z [kN]"), split_unit("Time / ms"), split_unit("time_ms"), split_unit("time_s")
    (('Force Z', 'kN'), ('Time', 'ms'), ('time', 'ms'), ('time_s', ''))
    """
    header = header.strip()
    found = _BRACKETED.match(header)
    if found and found[1]:
        return found[1], found[2].strip()
    found = _UNBRACKETED.match(header)
    if found and is_unit(found[2]):
        return found[1], found[2]
    stem, _, suffix = header.rpartition("_")
    is_channel = header.lower() == TIME_COLUMN or header.lower() in CHANNEL_BY_NAME
    return (stem, suffix) if stem.lower() in NAME_OF_STEM and is_unit(suffix) and not is_channel else (header, "")
