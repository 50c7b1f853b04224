"""What a gap report says beside its probabilities: where the gap lies, and whether its claim agrees with itself."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sawbench.blindcheck.effects.table import ACTS_IN
from sawbench.blindcheck.score_statistics import Z95, Estimate, median_of
from sawbench.blindcheck.true_parameters import REPORTED

RUNTIMES = ("nominal", "retuned", "with_effect")


def place_of(report: Mapping[str, Any]) -> str | None:
    """Return the equation with the largest share of `where`; None where the report states no place.

    Examples
    --------
    >>> place_of({"where": [{"equation": "supply", "share": 0.2}, {"equation": "cutting", "share": 0.7}]})
    'cutting'
    """
    spots = report.get("where", [])
    return str(max(spots, key=lambda spot: float(spot["share"]))["equation"]) if spots else None


def acts_in(place: str | None, effects: Collection[str]) -> bool:
    """Whether one of the effects acts in an equation."""
    return any(place in ACTS_IN[name] for name in effects if name in ACTS_IN)


def is_coherent(cause: Mapping[str, Any]) -> bool:
    """Whether a declared cause agrees with itself.

    Either every number that it states differs from the value at which the effect would be absent (0; of an exponent
    of the speed 1) by 1.96 standard deviations, and the interval of what it closes on withheld operating points lies
    above 0; or the report says that single strokes carry it (`carried_by_strokes` of the cause).

    Examples
    --------
    >>> gap = {"gap_closed_ci95": [0.2, 0.4]}
    >>> size = {"force_n": {"value": 0.7, "std": 2.2, "unit": "N"}}
    >>> is_coherent({"effects": ["edge_force"], "parameters": size} | gap)
    False
    """
    if cause.get("carried_by_strokes"):
        return True
    reported = {name: one for name in cause["effects"] if (one := REPORTED.get(name)) is not None}
    absent = {key: one.absent for name, one in reported.items() for key in (one.name, f"{name}.{one.name}")}
    stated = cause.get("parameters", {})
    is_there = all(abs(one["value"] - absent.get(name, 0.0)) > Z95 * one["std"] for name, one in stated.items())
    return bool(stated) and is_there and float(cause["gap_closed_ci95"][0]) > 0.0


def is_detectable(report: Mapping[str, Any], truth: Mapping[str, Any]) -> bool | None:
    """Whether each of the hidden effects lies above the detection limit that a report states of it.

    In the unit of its magnitude where report and truth have it; else by the log odds that the report states of an
    effect of typical size, which grow with the square of its severity.

    Examples
    --------
    >>> detail = {"log_odds_at_typical_size": {"edge_force": 8.0}, "detection_limit_log_odds": 10.0}
    >>> truth = {"effects": {"edge_force": 2.0}}
    >>> is_detectable({"detail": detail}, {"effects": {"edge_force": 1.0}}), is_detectable({"detail": detail}, truth)
    (False, True)
    >>> detail["detection_limits"] = {"edge_force": {"unit": "N", "change": 12.0, "without_effect": 0.0}}
    >>> truth["reported_parameters"] = {"edge_force": {"value": 9.0, "unit": "N"}}
    >>> is_detectable({"detail": detail}, truth)
    False
    >>> is_detectable({"detail": detail}, {"effects": {"grain_variation": 1.0}}) is None
    True
    """
    detail, effects = report.get("detail", {}), truth["effects"]
    least, stated = detail.get("detection_limit_log_odds"), detail.get("log_odds_at_typical_size", {})
    if least is None or not effects or not effects.keys() <= stated.keys():
        return None
    limits, magnitudes = detail.get("detection_limits", {}), truth.get("reported_parameters", {})
    return all(
        _is_above(limits[effect], magnitudes[effect]["value"])
        if effect in limits and magnitudes.get(effect, {}).get("unit") == limits[effect]["unit"]
        else float(stated[effect]) * severity**2 >= float(least)
        for effect, severity in effects.items()
    )


def _is_above(limit: Mapping[str, Any], magnitude: float) -> bool:
    without = limit["without_effect"]
    return magnitude <= limit["change"] if without is None else abs(magnitude - without) >= limit["change"]


def runtime_misses(report: Mapping[str, Any]) -> dict[str, float]:
    """Return how far each runtime of the report is from the measured one, relative to it; empty where none is told."""
    told = report.get("gap", {}).get("runtime_s", {})
    measured = float(told.get("measured") or 0.0)
    if not measured > 0.0:
        return {}
    return {name: abs(float(told[name]) / measured - 1.0) for name in RUNTIMES if told.get(name) is not None}


@dataclass(frozen=True, kw_only=True, slots=True)
class RuntimeScore:
    """Median distance of the runtime from the measured one, relative to it, of correct claims of an effect.

    Attributes
    ----------
    nominal, retuned, with_effect : Estimate
        Of the model as configured, with parameters re-tuned, and with the claimed effect.
    """

    nominal: Estimate
    retuned: Estimate
    with_effect: Estimate


def runtime_score(misses: Sequence[Mapping[str, float]]) -> RuntimeScore:
    """Take the medians over cases, of those that state the number."""
    return RuntimeScore(
        **{name: median_of(np.array([one[name] for one in misses if name in one])) for name in RUNTIMES}
    )
