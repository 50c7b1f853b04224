"""Whether recordings and configuration can be of the same machine at all: swapped channels, another unit or sign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from sawbench.bench.plain_digits import plain
from sawbench.diagnosis.inference.settings import SETTINGS

# Less than this share of a mean square is nothing.
_NOTHING: Final = 0.05
_ENDS: Final = 2.0


def contradiction(
    verdict: str, shifts: Mapping[str, Mapping[str, float]], gap: Mapping[str, Any], measured_rms: Mapping[str, float]
) -> str:
    """Say why recordings and configuration do not describe the same machine.

    Parameters
    ----------
    verdict : str
        Of the report.
    shifts : mapping of str to mapping
        Re-tuned parameters of the report; every one of them is positive on a real machine.
    gap : mapping
        Of the report.
    measured_rms : mapping of str to float
        See `Plant.measured_rms`.

    Returns
    -------
    str
        What is impossible and what to check; empty where nothing is. Parameters are judged only where the re-tuned
        model is the answer: a model that lacks a cause bends its parameters towards it.

    Examples
    --------
    >>> shift = {"moving_mass_kg": {"value": -0.1, "std": 1.0, "nominal": 95.0, "sigmas": -10.0}}
    >>> contradiction("parameters", shift, {"by_channel": {}}, {}).partition(":")[0]
    'recordings and configuration do not describe the same machine'
    """
    has_cause = verdict in ("effect", "effects")
    rung, model = ("with_effect", "with the cause") if has_cause else ("retuned", "re-tuned,")
    found = [
        f"{model} the model explains nothing of {name} (RMSE {plain(row[rung], row['unit'])}, its own"
        f" variation is {plain(measured_rms[name], row['unit'])} rms)"
        for name, row in gap["by_channel"].items()
        if name in measured_rms and row[rung] ** 2 > (1.0 - _NOTHING) * measured_rms[name] ** 2
    ]
    found += [
        f"{name} would have to be {plain(p['value'])} ± {plain(p['std'])}, {p['nominal']:g} is stated"
        for name, p in shifts.items()
        if verdict in ("parameters", "no_gap") and _is_of_another(p)
    ]
    if not found:
        return ""
    return (
        f"recordings and configuration do not describe the same machine: {'; '.join(found)}. Check which column is"
        " which channel, the unit and sign of each, the unit of the time, and the configuration"
    )


def _is_of_another(p: Mapping[str, float]) -> bool:
    """Whether the 95 % interval of a parameter lies beyond a factor, and outside of that of the stated value."""
    stated = _ENDS * abs((p["value"] - p["nominal"]) / p["sigmas"]) if p["sigmas"] else 0.0
    farthest = SETTINGS.screening.another_machine
    low, high = p["value"] - _ENDS * p["std"], p["value"] + _ENDS * p["std"]
    is_less = high < min(p["nominal"] / farthest, p["nominal"] - stated)
    return is_less or low > max(p["nominal"] * farthest, p["nominal"] + stated)
