"""The page that compares materials over their repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from sawbench.bench.wear_rule import BLADE_GROWTH_LIMIT
from sawbench.reporting.compared import (
    QUANTITIES,
    Block,
    ComparedTrial,
    Comparison,
    LeftOut,
    Quantity,
    Series,
    compare,
    estimates_of,
)
from sawbench.reporting.comparison_figures import cycles_picture, dots_picture
from sawbench.reporting.html import render
from sawbench.reporting.quantities import decimals_of, format_interval, format_quantity, format_to
from sawbench.reporting.repetitions import Difference, Estimate, GroupMean
from sawbench.reporting.trial_page import trial_facts
from sawbench.reporting.wear import WornTrial, wear_picture
from sawbench.storage.output import write_whole
from sawbench.storage.places import Place

FORMULA: Final = (
    "mean = Σ xᵢ / n\nu²   = max(s², mean(aᵢ²)) / n + mean(bᵢ)²\nh²   = t² · max(s², mean(aᵢ²)) / n + 1.96² · mean(bᵢ)²"
)
FORMULA_WORDS: Final = (
    "xᵢ are the n repetitions and s their standard deviation. aᵢ is the part of a trial's own "
    "uncertainty that differs from trial to trial (it is already part of s and is used only where s is "
    "smaller by chance); bᵢ is the part common to all trials, from the plant constants and the sensor "
    "gains, which repetition does not reduce. u is the standard uncertainty of the mean, h "
    "half its 95 % interval, with Student's t for n − 1 degrees of freedom: 12.7 for two repetitions, "
    "4.3 for three. With a single repetition the scatter is unknown: u is that trial's own "
    "uncertainty and t is 1.96."
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """A number with smaller lines under it."""

    value: str
    details: tuple[str, ...] = ()


def write_comparison_page(
    path: str | Place,
    rows: Sequence[ComparedTrial],
    *,
    left_out: Sequence[LeftOut] = (),
    title: str = "Material comparison",
    overwrite: bool = False,
) -> Place:
    """Write the comparison of materials.

    Parameters
    ----------
    path : str or Path
        HTML file; its folder must exist.
    rows : sequence of ComparedTrial
        Idle trials and trials that cannot be compared are shown apart, with the reason.
    left_out : sequence of LeftOut
        Recordings that did not get as far as a `ComparedTrial`.
    title : str
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    found = compare(rows, left_out)
    columns = [q for q in QUANTITIES if any(q.key in one.means for one in found.series)]
    context = {
        "title": title,
        "is_simulated": found.is_simulated,
        "summary": _summary(found),
        "remarks": found.remarks,
        "columns": columns,
        "blocks": [_block(block, place, columns) for place, block in enumerate(found.blocks)],
        "formula": FORMULA,
        "formula_words": FORMULA_WORDS,
        "wear": [_wear_row(one) for one in found.wear],
        "wear_picture": wear_picture(found.wear),
        "wear_words": _wear_words(found.wear),
        "trials": [_trial_row(row, one.material, columns) for one in found.series for row in one.trials],
        "fact_names": _FACTS,
        "facts": [_facts_row(row) for row in (*(t for one in found.series for t in one.trials), *found.idle)],
        "idle_columns": (idle_columns := _idle_columns(found)),
        "idle": [_trial_row(row, "blade in air", idle_columns) for row in found.idle],
        "left_out": found.left_out,
    }
    return write_whole(path, render("comparison_page.html.j2", context), overwrite=overwrite)


def _block(block: Block, place: int, columns: Sequence[Quantity]) -> dict[str, Any]:
    """One setting; its series go by their materials alone."""
    series = tuple(replace(one, label=one.material) for one in block.series)
    pictures = [cycles_picture(series, name=f"cycles-{place}")]
    if sum(len(one.trials) for one in series) > 1:
        pictures.append(dots_picture(series, name=f"dots-{place}"))
    material = {one.label: one.material for one in block.series}
    return {
        "setting": block.setting.label,
        "statements": _statements(block, material),
        "series": [_series_row(one, columns) for one in series],
        "pictures": [picture for picture in pictures if picture],
        "differences": [
            _difference_row(pair, quantity, material)
            for quantity in QUANTITIES
            for pair in block.differences.get(quantity.key, ())
        ],
    }


def _wear_row(one: WornTrial) -> dict[str, str | bool]:
    return {
        "blade": one.blade,
        "material": one.material,
        "setting": one.setting.label,
        "name": one.name,
        "cut": "feed not stated" if one.cut_m is None else format_quantity(one.cut_m, None, "m", digits=3),
        "growth": format_quantity(100.0 * one.growth, 100.0 * one.growth_std, "%", digits=2)
        if one.growth_std
        else "first trial",
        "is_worn": one.is_worn,
    }


def _wear_words(found: Sequence[WornTrial]) -> str:
    worn = list(dict.fromkeys(one.blade for one in found if one.is_worn))
    limit = f"{100.0 * BLADE_GROWTH_LIMIT:.0f} %"
    if worn:
        return f"Change the blade: k_Fc has grown by {limit} or more with {', '.join(worn)}."
    return f"No blade needs to be changed: k_Fc has grown by less than {limit} with each of them."


def _facts_row(row: ComparedTrial) -> dict[str, str]:
    return {fact.label: fact.value for fact in trial_facts(row.processed)} | {"Trial": row.name}


def _summary(found: Comparison) -> str:
    n_trials = sum(len(one.trials) for one in found.series)
    if not n_trials:
        if found.idle and not found.left_out:
            return "There is no cutting trial, so nothing is compared."
        return "No trial can be compared; the reasons are listed below."
    parts = [f"{_count(n_trials, 'cutting trial')} in {_count(len(found.series), 'series')}"]
    if found.idle:
        parts.append(_count(len(found.idle), "idle trial"))
    if found.left_out:
        names = len({item.name for item in found.left_out})
        parts.append(f"{_count(names, 'recording')} left out completely or in part")
    settings = _count(len(found.blocks), "setting")
    rule = "A series is one material at one setting; materials are compared at equal settings only."
    return f"{', '.join(parts)}; {settings}. {rule}"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 or noun.endswith("s") else f"{n} {noun}s"


def _statements(block: Block, material: Mapping[str, str]) -> list[str]:
    """Say in words what the differences come to, one sentence a tested quantity."""
    said = []
    for quantity in QUANTITIES:
        pairs = block.differences.get(quantity.key)
        if not pairs:
            continue
        ranked = sorted(
            (one for one in block.series if quantity.key in one.means),
            key=lambda one: -one.means[quantity.key].mean,
        )
        ends = [
            f"{material[one.label]} ({quantity.written(one.means[quantity.key])})" for one in (ranked[0], ranked[-1])
        ]
        n_yes = sum(pair.is_significant is True for pair in pairs)
        n_unknown = sum(pair.is_significant is None for pair in pairs)
        words = f"{quantity.label}: highest for {ends[0]}, lowest for {ends[1]}."
        if n_unknown == len(pairs):
            words += " The significance of the differences cannot be determined."
        else:
            verb = "differs" if n_yes == 1 else "differ"
            words += f" {n_yes} of {_count(len(pairs), 'pair')} {verb} significantly"
            words += f"; not determined for {n_unknown}." if n_unknown else "."
        said.append(words)
    return said


def _series_row(one: Series, columns: Sequence[Quantity]) -> dict[str, Any]:
    return {
        "label": one.label,
        "n": len(one.trials),
        "cells": [_mean_cell(one.means.get(quantity.key)) for quantity in columns],
    }


def _mean_cell(mean: GroupMean | None) -> Cell:
    if mean is None:
        return Cell(value="no value")
    value = format_quantity(mean.mean, mean.std)
    if mean.low is None or mean.high is None:
        return Cell(value=value, details=("uncertainty not known",))
    details = (format_interval(mean.low, mean.high),)
    return Cell(value=value, details=details if mean.rests_on_repetitions else (*details, "one trial only"))


def _difference_row(pair: Difference, quantity: Quantity, material: Mapping[str, str]) -> dict[str, str]:
    first, second = material[pair.first], material[pair.second]
    statement = f"not determined: {pair.reason}"
    interval = p_value = "not known"
    difference = format_quantity(pair.difference, None, quantity.unit, digits=3)
    if pair.p_holm is not None and pair.low is not None and pair.high is not None:
        difference = format_to(pair.difference, decimals_of(0.5 * (pair.high - pair.low)), quantity.unit)
        interval = format_interval(pair.low, pair.high, quantity.unit)
        p_value = "< 0.001" if pair.p_holm < 0.001 else f"{pair.p_holm:.3f}"
        higher = first if pair.difference > 0.0 else second
        statement = f"significant: {higher} is higher" if pair.is_significant else "not significant"
    return {
        "quantity": quantity.label,
        "pair": f"{first} − {second}",
        "difference": difference,
        "interval": interval,
        "p_holm": p_value,
        "statement": statement,
    }


def _idle_columns(found: Comparison) -> list[Quantity]:
    known = {key for row in found.idle for key in estimates_of(row)}
    return [q for q in QUANTITIES if q.key in known and q.key in _IDLE_KEYS]


_FACTS: Final = (
    "Trial", "Material", "Duty", "Feed", "Thickness", "Blade", "Battery", "Operator", "Date", "File",
)  # fmt: skip
_IDLE_KEYS: Final = ("stroke_rate_hz", "rms_motor_current_a", "mean_battery_current_a")


def _trial_row(row: ComparedTrial, label: str, columns: Sequence[Quantity]) -> dict[str, Any]:
    estimates, trial = estimates_of(row), row.processed.trial
    n_remarks = len(row.processed.warnings) + sum(len(channel.problems) for channel in row.processed.quality)
    return {
        "name": row.name,
        "label": label,
        "repetition": "" if trial.repetition is None else str(trial.repetition),
        "cells": [_trial_value(estimates.get(quantity.key)) for quantity in columns],
        "remarks": "; ".join(row.processed.warnings)
        or (f"{n_remarks} on the page of the trial" if n_remarks else "none"),
    }


def _trial_value(estimate: Estimate | None) -> str:
    if estimate is None:
        return "no value"
    std = (estimate.statistical_std**2 + estimate.common_std**2) ** 0.5
    return format_quantity(estimate.value, std)
