"""What a tare or a calibration found, as rows of a page, from what the command printed or the book keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from sawbench.reporting.quantities import format_number, format_quantity

_S_PER_MIN: Final = 60.0


def rows_of(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return label and value of every number that a technician looks at.

    Parameters
    ----------
    entry : mapping
        An entry of the calibration book as JSON.
    """
    return _of_tare(entry) if entry["kind"] == "tare" else _of_calibration(entry)


def value_of(entry: Mapping[str, Any], unit: str) -> str:
    """Return the main number of an entry on one line: the zero of a tare, the gain of a calibration.

    Parameters
    ----------
    entry : mapping
        An entry of the calibration book as JSON.
    unit : str
        Of the channel.
    """
    if not entry["details"]:
        return "no details"
    label, value = rows_of({**entry, "unit": unit})[0]
    return f"{label.lower()} {value}"


def _of_tare(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    found = entry["details"]
    unit = found["unit"]
    return [
        ("Zero", format_quantity(found["offset"], found["offset_std"], unit)),
        ("Zero, raw", _raw_zero(entry)),
        ("Noise, one standard deviation", format_quantity(found["noise_std"], None, unit, digits=2)),
        ("Drift", format_quantity(_S_PER_MIN * found["drift_per_s"], _S_PER_MIN * found["drift_std_per_s"],
                                  f"{unit}/min")),
    ]  # fmt: skip


def _of_calibration(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    fit, raw = entry["details"]["fit"], entry["result"]["raw_unit"] or "raw"
    unit = f"{entry['unit']}/({raw})" if entry.get("unit") else ""
    hysteresis = fit.get("hysteresis")
    return [
        ("Gain", format_quantity(fit["gain"], abs(fit["gain"]) * fit["gain_rel_std"], unit)),
        ("Standard uncertainty of the gain", f"{format_number(100.0 * fit['gain_rel_std'], digits=2)} %"),
        ("Zero, raw", _raw_zero(entry)),
        ("Nonlinearity", f"{_percent(fit['nonlinearity'])} of the range"),
        ("Hysteresis", "not determined: no unloading" if hysteresis is None
         else f"{_percent(hysteresis)} of the range"),
        ("Points", str(len(_points(entry)))),
    ]  # fmt: skip


def _points(entry: Mapping[str, Any]) -> Sequence[Any]:
    return entry["details"].get("points", ())


def _raw_zero(entry: Mapping[str, Any]) -> str:
    return format_quantity(entry["result"]["zero_raw"], entry["zero_std_raw"], entry["result"]["raw_unit"] or "raw")


def _percent(share: float) -> str:
    return f"{100.0 * share:.3f} %"
