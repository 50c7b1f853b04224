"""What every benchmark measures with and hands on: one clock, one form of result."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

Work = Callable[[], object]
# Calls that take longer than this are not repeated, s.
_SLOW_S = 2.0


class Timing(NamedTuple):
    """Time of one call, s: the median and the quartiles of repeated calls."""

    median_s: float
    low_s: float
    high_s: float

    def __str__(self) -> str:
        if self.high_s - self.low_s < 0.02 * self.median_s:
            return time_words(self.median_s)
        return f"{time_words(self.median_s)} ({time_words(self.low_s)} to {time_words(self.high_s)})"


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Times calls in turns, so that what slows the machine down slows all of them.

    Attributes
    ----------
    busy : bool
        Others use the machine: processor time of this process in place of wall time.
    quick : bool
        A fifth of the time for everything.
    """

    busy: bool = False
    quick: bool = False

    def together(self, works: Mapping[str, Work], *, seconds: float = 0.5, least: int = 3) -> dict[str, Timing]:
        """Time the works alternately; returns a Timing by name.

        `seconds` are spent on each, at least `least` calls; short calls are repeated until a millisecond has passed,
        of calls over two seconds one counts.
        """
        now = time.process_time if self.busy else time.perf_counter
        inner, spent = {}, {name: [] for name in works}
        for name, work in works.items():
            start = now()
            work()  # compiles, and fills the caches
            if now() - start < _SLOW_S:
                start = now()
                work()
            took_s = now() - start
            inner[name] = max(1, math.ceil(1e-3 / max(took_s, 1e-9)))
            if took_s >= _SLOW_S:
                spent[name].append(took_s)
        budget_s, used_s = seconds * (0.2 if self.quick else 1.0), {name: sum(spent[name]) for name in works}
        while waiting := [n for n in works if used_s[n] < budget_s or (len(spent[n]) < least and used_s[n] < _SLOW_S)]:
            for name in waiting:
                n, work = inner[name], works[name]
                start = now()
                for _ in range(n):
                    work()
                took_s = now() - start
                spent[name].append(took_s / n)
                used_s[name] += max(took_s, 1e-6)
        return {name: _timing(times) for name, times in spent.items()}

    def __call__(self, work: Work, *, seconds: float = 0.5, least: int = 3) -> Timing:
        """Time of one work."""
        return self.together({"": work}, seconds=seconds, least=least)[""]

    def once(self, work: Work) -> float:
        """Seconds of a single call, for work of many seconds."""
        now = time.process_time if self.busy else time.perf_counter
        start = now()
        work()
        return now() - start


def _timing(times: list[float]) -> Timing:
    low, _, high = statistics.quantiles(times, n=4) if len(times) > 1 else [times[0]] * 3
    return Timing(statistics.median(times), low, high)


def time_words(seconds: float) -> str:
    """A time in three digits.

    Examples
    --------
    >>> time_words(0.00172)
    '1.72 ms'
    """
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


@dataclass(kw_only=True)
class Table:
    """Rows of text; `title` stands above it, if any."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    title: str = ""


@dataclass(kw_only=True)
class Goal:
    """A number and its bound."""

    what: str
    value: float | None
    bound: float
    at_least: bool = False
    unit: str = ""

    @property
    def is_met(self) -> bool | None:
        """None where it was not measured."""
        if self.value is None:
            return None
        return self.value >= self.bound if self.at_least else self.value <= self.bound


@dataclass(kw_only=True)
class Plot:
    """Curves over one logarithmic axis each (`lines`: label -> x, y), or bars (`bars`: label -> length)."""

    name: str
    title: str
    x_label: str
    y_label: str = ""
    lines: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)
    bars: dict[str, float] = field(default_factory=dict)


@dataclass(kw_only=True)
class Section:
    """What one benchmark found.

    Attributes
    ----------
    title : str
    words : list of str
        Paragraphs under the title.
    tables, goals, plots : list
    numbers : dict of str to float
        What other sections compute with.
    """

    title: str
    words: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    plots: list[Plot] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Section:
        """Section from what `dataclasses.asdict` made of it, through JSON or not."""
        kinds = {"tables": Table, "goals": Goal, "plots": Plot}
        rows = {name: [kind(**row) for row in values[name]] for name, kind in kinds.items()}
        return cls(**{**values, **rows})
