"""Trials that a bench could run next, as states on which signatures can be evaluated.

A candidate runs at an operating point of the campaign, or at a new combination of the duties, feeds and workpieces that
the campaign has used. Where the campaign has been, its mean stroke is that of the trial there; elsewhere it is the
periodic stroke of the model as configured. What warms, empties and wears continues from where the campaign ended.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.plants.plant import Plant
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, State, TrialSetting, angle_derivative
from sawbench.modeling.stroke import mean_stroke, predict

# Time and memory grow with them; operating points of the campaign come first.
MOST_POINTS: Final = 24
_CHANNELS: Final = ("force_n", "force_rate_n_s", "current_a", "current_rate_a_s", "battery_voltage_v",
                    "battery_current_a")  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Candidate:
    """A trial that could be run next.

    Attributes
    ----------
    material : str
        "none": in air.
    duty : float
    feed_mm_s, thickness_mm : float or None
    seconds, rest_s : float
        Duration, and how long the tool rests before.
    is_new : bool
        The campaign has no trial at this operating point.
    parts : tuple of Part
        Its running strokes, and its start where one of this duty was recorded; `place` counts from its own first row.
    """

    material: str
    duty: float
    feed_mm_s: float | None
    thickness_mm: float | None
    seconds: float
    rest_s: float
    is_new: bool
    parts: tuple[Part, ...]

    @property
    def n_rows(self) -> int:
        """Number of features."""
        return self.parts[-1].place.stop


@dataclass(frozen=True, kw_only=True, slots=True)
class _Point:
    """An operating point with its stroke, shape (n_blocks, n_points), and the part of the trial that is nearest."""

    setting: TrialSetting
    stroke: State
    nearest: Part
    is_new: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class _End:
    """What the campaign leaves behind: when it ended, and the last state of its last trial."""

    at_s: float
    last: State


def candidates(problem: LinearProblem, materials: Mapping[str, str]) -> list[Candidate]:
    """List the trials that the bench could run next.

    Parameters
    ----------
    problem : LinearProblem
        Of a saw whose crank angle is known.
    materials : mapping of str to str
        Label of a trial -> its material; trials without one are not repeated.

    Returns
    -------
    list of Candidate
        At most 24 operating points; each for the usual duration, for a long one, and after a rest.
    """
    numbers = problem.settings.planning
    running = [part for part in problem.parts if part.state.kind == "running"]
    known = [part for part in running if part.setting.is_idle or part.setting.label in materials]
    usual_s = float(f"{np.median([part.state.time_s[-1, 0] for part in running]):.2g}")
    variants = ((usual_s, 0.0), (numbers.longer * usual_s, 0.0), (usual_s, numbers.rest_s))
    latest = max(running, key=lambda part: part.setting.session_s).state
    end = _End(at_s=latest.setting.session_s + float(latest.time_s[-1, 0]), last=latest)
    found = []
    for number, point in enumerate(_points(problem.campaign.plant, known)):
        for variant, (seconds, rest_s) in enumerate(variants):
            after_s = end.at_s + numbers.handling_s + rest_s
            setting = replace(point.setting, label=f"candidate {number}.{variant}", session_s=after_s)
            parts = _parts(problem, replace(point, setting=setting), end, seconds)
            is_idle = setting.is_idle
            found.append(
                Candidate(
                    material="none" if is_idle else materials[point.nearest.setting.label], duty=setting.duty,
                    feed_mm_s=None if is_idle else _in_mm(setting.feed_m_s),
                    thickness_mm=None if is_idle else _in_mm(setting.thickness_m),
                    seconds=seconds, rest_s=rest_s, is_new=point.is_new, parts=parts,
                )
            )  # fmt: skip
    return found


def _in_mm(length_m: float) -> float | None:
    return round(1e3 * length_m, 6) if np.isfinite(length_m) else None


def _points(plant: Plant, parts: Sequence[Part]) -> Iterator[_Point]:
    """Operating points of the campaign, then new combinations of what it has used."""
    used: dict[tuple[Any, ...], Part] = {}
    for part in parts:
        used.setdefault(_key(part.setting), part)
    for part in list(used.values())[:MOST_POINTS]:
        yield _Point(setting=part.setting, stroke=part.smooth, nearest=part, is_new=False)
    room = MOST_POINTS - len(used)
    for setting, nearest in _combinations(parts):
        if room <= 0:
            return
        stroke = None if _key(setting) in used else _predicted(plant.model, nearest, setting)
        if stroke is not None:
            room -= 1
            yield _Point(setting=setting, stroke=stroke, nearest=nearest, is_new=True)


def _key(setting: TrialSetting) -> tuple[Any, ...]:
    """What repeats have in common; a feed that nobody stated is equal to itself."""
    return setting.stock, setting.duty, None if setting.is_idle else str(setting.feed_m_s)


def _combinations(parts: Sequence[Part]) -> Iterator[tuple[TrialSetting, Part]]:
    """Every duty in air, then every workpiece at every duty and feed, each with the trial that is nearest."""
    duties = sorted({part.setting.duty for part in parts})
    feeds = sorted({s.feed_m_s for part in parts if not (s := part.setting).is_idle and np.isfinite(s.feed_m_s)})
    by_stock: dict[str, list[Part]] = {}
    for part in parts:
        by_stock.setdefault("" if part.setting.is_idle else part.setting.stock, []).append(part)
    for stock, group in sorted(by_stock.items()):
        for duty, feed_m_s in product(duties, feeds if stock else [np.nan]):
            nearest = min(
                group, key=lambda p, d=duty, f=feed_m_s: (abs(p.setting.duty - d), abs(p.setting.feed_m_s - f))
            )
            words = f"{stock or 'idle'}, feed {1e3 * feed_m_s:g} mm/s, duty {duty:g}"
            yield replace(nearest.setting, duty=duty, feed_m_s=feed_m_s, operating_point=words), nearest


def _predicted(model: Baseline, nearest: Part, setting: TrialSetting) -> State | None:
    """Periodic stroke of the model at a new operating point; None where it finds none."""
    measured = replace(mean_stroke(nearest.state), hardness=1.0)
    ratio = setting.duty / nearest.setting.duty
    speed = ratio * measured.speed_rad_s
    start = replace(
        measured, setting=setting, speed_rad_s=speed, acceleration_rad_s2=speed * angle_derivative(speed),
        motor_voltage_v=ratio * measured.motor_voltage_v,
    )  # fmt: skip
    found = predict(model, start, (), wood_n_s_per_m=measured.k_guess_n_s_per_m)
    if not found.is_settled:
        return None
    shape = nearest.smooth.angle_rad.shape
    waves = {name: getattr(found.state, name) for name in ("speed_rad_s", "acceleration_rad_s2", "motor_voltage_v")}
    waves |= {name: getattr(found.state, name) for name in _CHANNELS if getattr(nearest.smooth, name) is not None}
    rows = {name: np.broadcast_to(wave, shape) for name, wave in waves.items()}
    return replace(nearest.smooth, setting=setting, hardness=1.0, blade_excess_m_s=None, **rows)


def _parts(problem: LinearProblem, point: _Point, end: _End, seconds: float) -> tuple[Part, ...]:
    """Features of a candidate: its running strokes, and the start of a trial of the same duty where there is one."""
    plant, nearest = problem.campaign.plant, point.nearest
    n_blocks = len(nearest.blocks)
    at_s = seconds * (np.arange(n_blocks)[:, None] + 0.5) / n_blocks
    state = _with_history(plant.model, point, end, at_s)
    rate_hz = float(point.stroke.speed_rad_s.mean()) / TWO_PI
    fewer = float(nearest.state.n_strokes.sum()) / (seconds * rate_hz)
    root = np.linalg.inv(nearest.whitener)
    noise = root @ root.T - plant.model_error(nearest.layout, nearest.state)
    covariance = plant.model_error(nearest.layout, state) + fewer * noise
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    size = n_blocks * nearest.layout.size
    running = replace(nearest, state=state, smooth=state, whitener=whitener, place=slice(0, size))
    known = _start_of(problem, point.setting)
    if known is None:
        return (running,)
    begun = _with_history(plant.model, point, end, np.zeros((1, 1)))
    started = replace(
        known.state, setting=point.setting, cut_distance_m=begun.cut_distance_m, charge_used_as=begun.charge_used_as,
        slow=begun.slow, k_guess_n_s_per_m=state.k_guess_n_s_per_m, hardness=state.hardness,
    )  # fmt: skip
    return running, replace(known, state=started, smooth=started, place=slice(size, size + known.layout.size))


def _start_of(problem: LinearProblem, setting: TrialSetting) -> Part | None:
    """Recorded start of the same duty, into the same stock where there is one."""
    starts = [
        part for part in problem.parts
        if part.state.kind == "start_up" and part.setting.duty == setting.duty
        and part.setting.is_idle == setting.is_idle
    ]  # fmt: skip
    return min(starts, key=lambda part: part.setting.stock != setting.stock, default=None)


def _with_history(model: Baseline, point: _Point, end: _End, at_s: Floats) -> State:
    """Stroke of a point at some times of a trial after the campaign, shape (n_blocks, 1), with its slow states."""
    stroke, last, setting = point.stroke, end.last, point.setting
    slowness = 1.0 / stroke.speed_rad_s[0]

    def mean(wave: Floats | None) -> float:
        return 0.0 if wave is None else float(np.average(wave[0], weights=slowness))

    battery_a = mean(stroke.battery_current_a)
    drives = {
        "motor_current_squared_a2": 0.0 if stroke.current_a is None else mean(stroke.current_a**2),
        "crank_speed_squared_rad2_s2": mean(stroke.speed_rad_s**2),
        "battery_current_a": battery_a,
    }
    rested_s = setting.session_s - end.at_s
    slow = {}
    for memory, track in last.slow.items():
        tau_s, drive = memory.time_constant_s, drives[memory.drive]
        begun = float(track[-1, 0]) * np.exp(-rested_s / tau_s)
        slow[memory] = drive + (begun - drive) * np.exp(-at_s / tau_s)
    turns = 0.0 if setting.is_idle else at_s / (TWO_PI * float(slowness.mean()))
    return replace(
        stroke, setting=setting, time_s=at_s, slow=slow,
        charge_used_as=float(last.charge_used_as[-1, 0]) + battery_a * at_s,
        cut_distance_m=float(last.cut_distance_m[-1, 0]) + 2.0 * model.radius_m * turns + 0.0 * at_s,
    )  # fmt: skip
