"""From factors to a plan: materials x duties x feeds x thicknesses x repetitions, randomised in blocks."""

from __future__ import annotations

import csv
import io
import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

from pydantic import ValidationError
from sawbench.acquisition.series.plan import PlannedTrial, SeriesPlan, Setting, trial_name
from sawbench.bench.errors import InputError
from sawbench.bench.toml_writing import toml_text
from sawbench.bench.validation_text import describe_validation

_HEAD = (
    "A plan for `sawbench series run`: one line per trial, in recording order. Edit it freely until",
    "the first trial is recorded; later, add lines.",
    "The paper's rule: a new blade for every setting, three repetitions, the blade changed when the specific force has",
    "grown by 20 %. A recharged battery gets a new identifier, because the state of charge is tracked per identifier.",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesDesign:
    """What is varied, and how.

    Attributes
    ----------
    materials : tuple of str
    duties, feeds_mm_s, thicknesses_mm : tuple of float
        Empty: not stated.
    repetitions : int
    block : {"setting", "repetition"}
        "setting": a block is one setting with all its repetitions, as in the paper. "repetition": a block is every
        setting once, so that what drifts over the series cannot look like a difference between materials. A block
        begins with a new blade.
    has_idle : bool
        One trial in air at each duty comes first.
    seed : int
    seconds : float
        Duration of a trial.
    battery_seconds : float
        A battery is changed before it has run longer.
    batches : mapping of str to str
        Material -> identity of its lot.
    """

    materials: tuple[str, ...]
    duties: tuple[float, ...] = ()
    feeds_mm_s: tuple[float, ...] = ()
    thicknesses_mm: tuple[float, ...] = ()
    repetitions: int = 3
    block: Literal["setting", "repetition"] = "setting"
    has_idle: bool = False
    seed: int = 0
    seconds: float = 10.0
    battery_seconds: float = 600.0
    batches: Mapping[str, str] = field(default_factory=dict)


def designed_trials(design: SeriesDesign) -> tuple[PlannedTrial, ...]:
    """Return the trials of a design in random order; the same seed gives the same order.

    Examples
    --------
    >>> trials = designed_trials(SeriesDesign(materials=("oak", "nylon"), repetitions=2, seed=1))
    >>> [(t.block, t.material, t.repetition, t.blade) for t in trials]
    [(1, 'nylon', 1, 'B1'), (1, 'nylon', 2, 'B1'), (2, 'oak', 1, 'B2'), (2, 'oak', 2, 'B2')]
    """
    trials: list[PlannedTrial] = []
    n_of_setting: Counter[Setting] = Counter()
    for number, (block, setting) in enumerate(_in_order(design), start=1):
        material, duty, feed, thickness = setting
        n_of_setting[setting] += 1
        trials.append(
            PlannedTrial(
                id=trial_name(number, material),
                block=block,
                material=material,
                duty=duty,
                feed_mm_s=feed,
                thickness_mm=thickness,
                repetition=n_of_setting[setting],
                blade=f"B{max(block, 1)}",
                battery=f"P{1 + int((number - 1) // max(1.0, design.battery_seconds // design.seconds))}",
                batch=design.batches.get(material),
            )
        )
    return tuple(trials)


def designed_plan(design: SeriesDesign, **stated: Any) -> SeriesPlan:
    """Return the plan of a design; `stated` are other keys of the plan.

    Raises
    ------
    InputError
        If a value is not allowed in a plan.
    """
    try:
        trials = designed_trials(design)
        return SeriesPlan(seed=design.seed, seconds=design.seconds, trial=trials, **stated)
    except ValidationError as error:
        raise InputError(f"not valid in a plan: {describe_validation(error, PlannedTrial)}") from error


def plan_text(plan: SeriesPlan) -> str:
    """Write a plan as TOML, one line per trial."""
    tables = plan.model_dump(exclude_none=True, exclude={"trial"})
    tables["required"] = list(tables["required"])
    tables["trial"] = [trial.model_dump(exclude_none=True) for trial in plan.trial]
    comments = {
        (): _HEAD,
        ("recordings",): ["Folder of the recordings, relative to this file."],
        ("required",): ["Required metadata: operator, blade, battery, material, batch."],
        ("tare",): ["The load cell is tared before every: trial, block, never."],
        ("check_seconds",): ["Duration of the instrument check before every trial, s; 0: no check."],
        ("blade_growth_limit",): ["Growth of the specific force at which the blade is changed."],
        ("repeatability",): [
            "Relative standard deviation expected between repetitions, until the series itself provides it."
        ],
    }
    return toml_text(tables, comments)


def plan_table(trials: Sequence[PlannedTrial]) -> str:
    """Write trials as a table that is a plan as well, a row per trial.

    Examples
    --------
    >>> print(plan_table([PlannedTrial(id="a", material="oak", duty=0.5, feed_mm_s=4.0, rest_s=900.0)]), end="")
    id,material,idle,duty,feed,thickness,length,rest,blade,battery
    a,oak,no,0.5,4,,,900,,
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["id", "material", "idle", "duty", "feed", "thickness", "length", "rest", "blade", "battery"])
    for trial in trials:
        numbers = (trial.duty, trial.feed_mm_s, trial.thickness_mm, trial.seconds, trial.rest_s)
        cells = ["" if number is None else f"{number:.10g}" for number in numbers]
        idle = "yes" if trial.is_idle else "no"
        table.writerow([trial.id, trial.material, idle, *cells, trial.blade or "", trial.battery or ""])
    return text.getvalue()


def _in_order(design: SeriesDesign) -> Iterator[tuple[int, Setting]]:
    """Give block and setting of each trial in turn."""
    order = random.Random(design.seed)
    duties = design.duties or (None,)
    if design.has_idle:
        for duty in duties:
            yield 0, ("none", duty, None, None)
    settings = list(product(design.materials, duties, design.feeds_mm_s or (None,), design.thicknesses_mm or (None,)))
    if design.block == "setting":
        order.shuffle(settings)
        for block, setting in enumerate(settings, start=1):
            for _ in range(design.repetitions):
                yield block, setting
        return
    for block in range(1, design.repetitions + 1):
        order.shuffle(settings)
        for setting in settings:
            yield block, setting
