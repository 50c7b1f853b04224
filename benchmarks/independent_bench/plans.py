"""Random plans of a campaign: which trials, in which order, with which rests; some operating points are missing."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np

from benchmarks.independent_bench.benches import Bench, draw_woods

_FIRST_DAY = datetime(2026, 3, 2, 9, tzinfo=UTC)
_MOST_TRIALS = 24
# Fastest stroke rate without load that a plan asks for, 1/s.
_TOP_STROKES_HZ = 24.0
# What an effect can ask of a plan, so that the campaign is one that shows it.
DUTIES: Final = "three duties"
FEEDS: Final = "two feeds"
HEAT: Final = "short rests"
STARTS: Final = "every run-up"

# Duty, material or None, feed in mm/s.
_Point = tuple[float, str | None, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedTrial:
    """One trial.

    Attributes
    ----------
    number : int
        From 1, in the order of the campaign.
    duty : float
        0 to 1.
    material : str or None
        None: the blade runs in air.
    feed_mm_s : float
    duration_s, rest_s : float
        Length of the recording, and of the rest after it.
    has_run_up : bool
        The recording starts before the machine is switched on; otherwise it runs already.
    crank_angle_rad : float
        At the start.
    on_s, ramp_s : float
        When it is switched on, and how long the switch takes.
    started_at : datetime
    """

    number: int
    duty: float
    material: str | None
    feed_mm_s: float
    duration_s: float
    rest_s: float
    has_run_up: bool
    crank_angle_rad: float
    on_s: float
    ramp_s: float
    started_at: datetime


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """Trials in their order, the materials with their coefficient over the reference's, and the feeds, mm/s."""

    trials: tuple[PlannedTrial, ...]
    woods: dict[str, float]
    feeds_mm_s: tuple[float, ...]

    @property
    def top_duty(self) -> float:
        """Highest duty of the campaign."""
        return max(trial.duty for trial in self.trials)


def draw_plan(rng: np.random.Generator, bench: Bench, asked: Collection[str] = ()) -> Plan:
    """Draw a plan of 10 to 24 trials.

    Parameters
    ----------
    rng : Generator
    bench : Bench
    asked : collection of str
        `DUTIES`, `FEEDS`, `HEAT`, `STARTS`: what the hidden effects need to be seen.
    """
    duties = _draw_duties(rng, bench, 3 if DUTIES in asked else 2)
    woods = draw_woods(rng)
    n_feeds = 2 if FEEDS in asked else int(rng.integers(1, 3))
    feeds = tuple((rng.uniform(2.5, 4.0) * np.array([1.0, rng.uniform(1.4, 1.8)])).round(1).tolist()[:n_feeds])
    points = _draw_points(rng, duties, tuple(woods), feeds)
    return Plan(trials=_draw_trials(rng, points, asked), woods=woods, feeds_mm_s=feeds)


def _draw_duties(rng: np.random.Generator, bench: Bench, least: int) -> list[float]:
    """Two to four duties, evenly spaced, none faster than a jigsaw."""
    n = max(int(rng.integers(2, 5)), least)
    low, high = rng.uniform(0.31, 0.38), rng.uniform(0.5, 0.62)
    high = min(high, _TOP_STROKES_HZ / bench.idle_strokes_hz(1.0))
    return np.linspace(low, max(high, low + 0.12), n).round(4).tolist()


def _draw_points(
    rng: np.random.Generator, duties: Sequence[float], materials: Sequence[str], feeds: Sequence[float]
) -> list[_Point]:
    """Operating points in the order of the trials: all idle ones, some of the cutting ones, repeats; idle first."""
    idle: list[_Point] = [(duty, None, 0.0) for duty in duties]
    cutting: list[_Point] = [(duty, name, feed) for duty in duties for name in materials for feed in feeds]
    cutting = [cutting[j] for j in rng.permutation(len(cutting))]
    n_wanted = int(rng.integers(10, 25))
    points = idle + [idle[int(rng.integers(len(idle)))] for _ in range(int(rng.integers(3)))]
    room = max(6, n_wanted - len(points))
    kept = cutting[: max(3, math.ceil(room / rng.uniform(1.2, 2.0)))]
    if len({feed for _, _, feed in kept}) < len(feeds):
        kept = cutting
    points += kept
    points += [kept[int(rng.integers(len(kept)))] for _ in range(room - len(kept))]
    points = [points[j] for j in rng.permutation(min(len(points), _MOST_TRIALS))]
    first = next(j for j, (_, material, _) in enumerate(points) if material is None)
    return [points.pop(first), *points]


def _draw_trials(
    rng: np.random.Generator, points: Sequence[_Point], asked: Collection[str]
) -> tuple[PlannedTrial, ...]:
    now = _FIRST_DAY + timedelta(days=int(rng.integers(200)), minutes=int(rng.integers(300)))
    trials = []
    for number, (duty, material, feed_mm_s) in enumerate(points, start=1):
        duration_s = round(rng.uniform(6.0, 12.0), 1)
        rest_s = rng.uniform(12.0, 35.0) if HEAT in asked else rng.uniform(20.0, 110.0)
        if rng.random() < 0.1:
            rest_s += rng.uniform(200.0, 400.0)
        trial = PlannedTrial(
            number=number, duty=duty, material=material, feed_mm_s=feed_mm_s, duration_s=duration_s, rest_s=rest_s,
            has_run_up=rng.random() < 0.55 or number == 1 or STARTS in asked,
            crank_angle_rad=rng.uniform(0.0, 2.0 * math.pi), on_s=rng.uniform(0.04, 0.3),
            ramp_s=rng.uniform(0.001, 0.004), started_at=now,
        )  # fmt: skip
        trials.append(trial)
        now += timedelta(seconds=duration_s + rest_s)
    return tuple(trials)
