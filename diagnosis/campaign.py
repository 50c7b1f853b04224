"""A campaign as the diagnosis sees it: every trial reduced to its states, with what it inherits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from bench.config import LoadedConfig
from bench.errors import InputError
from bench.processed import CrankAngle
from bench.recording import Floats, Recording
from bench.units import DISPLACEMENT
from diagnosis.equations import Baseline, residuals
from diagnosis.off_stroke import OffStroke, off_stroke
from diagnosis.plants.jigsaw import Jigsaw
from diagnosis.plants.plant import Plant
from diagnosis.reduction import (
    CHANNEL_OF_STATE,
    MOVING_RAD_S,
    first_motion_s,
    lock_to_angle,
    running_state,
    start_up_state,
    steady_part,
)
from diagnosis.screening import is_stock_stated, screen, summary
from diagnosis.slow_states import SlowTrack, slow_tracks
from diagnosis.state import TWO_PI, State, TrialSetting
from diagnosis.stroke_ripple import restore_ripple
from diagnosis.stroke_series import StrokeSeries, stroke_series

# The spin-up and the settling of the stroke rate after it stay out of the running part.
SETTLE_S = 0.8
# Agreement of the phases of a trial's strokes (measured: above 0.97), and how far a trial's phase may lie from that
# of the others (measured: 0.1 rad for the force, 0.4 rad for the current in air, at twice the usual effects).
_LOCKED = 0.8
_PHASE_SPREAD_RAD = MappingProxyType({"force": 0.6, "current": 1.0, "current in air": 1.0})
_FOREIGN_SHARE = 0.3
# Warn where dropouts cost more than this share of the strokes.
_LOST_STROKES = 0.2


@dataclass(frozen=True, kw_only=True, slots=True)
class Campaign:
    """Trials in their order, reduced.

    Attributes
    ----------
    plant : Plant
        The machine, with its nominal numbers.
    states : tuple of State
        Running and start-up states of all usable trials.
    k_guess_n_s_per_m : dict of str to float
        k_Fc of each stock by regression of force on speed.
    warnings : tuple of str
        What was left out or weakens the answer.
    angle_is_assumed : bool
        No trial has a displacement: the angle of every state is NaN and only means over whole strokes are known.
    strokes : tuple of StrokeSeries
        Hardness of every stroke of the cutting trials.
    off_stroke : tuple of OffStroke
        What every trial holds beside its strokes.
    """

    plant: Plant
    states: tuple[State, ...]
    k_guess_n_s_per_m: dict[str, float]
    warnings: tuple[str, ...]
    angle_is_assumed: bool = False
    strokes: tuple[StrokeSeries, ...] = ()
    off_stroke: tuple[OffStroke, ...] = ()

    @property
    def baseline(self) -> Any:
        """Numbers of the plant's model, as its effects take them: a `Baseline` for the jigsaw."""
        return self.plant.model

    @property
    def operating_points(self) -> tuple[str, ...]:
        """Names of the operating points, in order of their first trial."""
        return tuple(dict.fromkeys(s.setting.operating_point for s in self.states))


def reduce_campaign(
    recordings: Sequence[Recording],
    loaded: LoadedConfig,
    *,
    on_trial: Callable[[int, int, str], None] | None = None,
) -> Campaign:
    """Reduce the recordings of a campaign.

    Parameters
    ----------
    recordings : sequence of Recording
        In any order; sorted by start time where every trial has one.
    loaded : LoadedConfig
    on_trial : callable, optional
        (done, total, name).

    Returns
    -------
    Campaign

    Raises
    ------
    InputError
        If no trial can be used, or if most of them hold the same mistake (`diagnosis.screening`).
    """
    baseline = Baseline(
        plant=loaded.plant(),
        battery=loaded.config.battery,
        cutting_sign=-1 if loaded.config.cutting.cutting_half == "pi_to_2pi" else 1,
    )
    ordered, warnings = screen(_in_order(recordings), baseline)
    if not any(DISPLACEMENT.name in recording.signals for recording in ordered):
        return _without_displacement(ordered, baseline, warnings)
    usable: list[Recording] = []
    angles: list[CrankAngle] = []
    ripples: dict[str, Floats] = {}
    for number, recording in enumerate(ordered):
        found, reason = _angle(recording, baseline)
        if found is None:
            warnings.append(f"{recording.trial.trial_id} left out: {reason}")
        else:
            usable.append(recording)
            angles.append(found[0])
            ripples[recording.trial.trial_id] = found[1]
        if on_trial is not None:
            on_trial(number + 1, len(ordered), recording.trial.trial_id)
    if not usable:
        raise InputError(f"no trial can be diagnosed: {summary(warnings)}")
    tracks = slow_tracks(usable, angles, stroke_m=2.0 * baseline.radius_m)
    states: list[State] = []
    series: list[StrokeSeries | None] = []
    beside: list[OffStroke | None] = []
    for index, (recording, angle, track) in enumerate(zip(usable, angles, tracks, strict=True)):
        moving_s = first_motion_s(angle)
        steady_s = steady_part(angle, moving_s)
        states += _states(baseline, recording, angle, track, index, moving_s, steady_s, warnings)
        series.append(_strokes(baseline, recording, angle, steady_s))
        beside.append(off_stroke(recording, angle, steady_s[0] + SETTLE_S, steady_s[1]))
    states = [replace(state, ripple_std_rad=ripples[state.setting.label]) for state in states]
    _refuse_foreign_angles(states, warnings)
    if not states:
        raise InputError(f"no trial runs long enough to be diagnosed: {summary(warnings)}")
    _refuse_without_equation(baseline, states)
    guesses = _with_guesses(baseline, states)
    plant = Jigsaw(baseline=baseline)
    kept = {state.setting.label for state in states}
    return Campaign(
        plant=plant,
        states=tuple(states),
        k_guess_n_s_per_m=guesses,
        warnings=tuple(warnings),
        strokes=tuple(s for s in series if s is not None and s.label in kept),
        off_stroke=tuple(s for s in beside if s is not None and s.label in kept),
    )


def _refuse_without_equation(baseline: Baseline, states: Sequence[State]) -> None:
    if not any(residuals(baseline, state) for state in states):
        raise InputError(
            "the channels at hand allow no balance equation: displacement alone says nothing of the model",
            remedy="measure force, or motor current with battery voltage",
        )


def _in_order(recordings: Sequence[Recording]) -> list[Recording]:
    if all(r.trial.started_at is not None for r in recordings):
        return sorted(recordings, key=lambda r: r.trial.started_at)  # type: ignore[arg-type, return-value]
    return list(recordings)


def _angle(recording: Recording, baseline: Baseline) -> tuple[tuple[CrankAngle, Floats] | None, str]:
    from processing.crank_angle import track_crank_angle

    if recording.trial.duty is None:
        return None, "its duty is not stated"
    signal = recording.signals.get(DISPLACEMENT.name)
    if signal is None:
        return None, "it has no displacement, so neither crank angle nor speed is known"
    stroke_m = signal.values * DISPLACEMENT.si_factor
    angle = track_crank_angle(signal.time_s, stroke_m, nominal_radius_m=baseline.radius_m)
    if angle is None:
        return None, "its displacement shows no strokes"
    return restore_ripple(angle, signal.time_s, stroke_m), ""


def _states(
    baseline: Baseline,
    recording: Recording,
    angle: CrankAngle,
    track: SlowTrack,
    index: int,
    moving_s: float,
    steady_s: tuple[float, float],
    warnings: list[str],
) -> list[State]:
    trial = recording.trial
    setting = _setting(recording, index, track)
    start_s, end_s = steady_s
    if start_s > moving_s or end_s < angle.time_s[-1]:
        warnings.append(
            f"{trial.trial_id}: the blade stops or slows to less than two thirds of its speed; only"
            f" {start_s:.2f} s to {end_s:.2f} s is used"
        )
    running = running_state(recording, angle, setting, start_s + SETTLE_S, end_s)
    if running is None:
        warnings.append(f"{trial.trial_id} left out: it runs for less than two settled strokes")
        return []
    for name, attribute in CHANNEL_OF_STATE.items():
        if name in recording.signals and getattr(running, attribute) is None:
            warnings.append(f"{trial.trial_id}: {name} left out: it is missing in most of the strokes")
    strokes = float(np.diff(np.interp([start_s + SETTLE_S, end_s], angle.time_s, angle.angle_rad))[0]) / TWO_PI
    if running.n_strokes.sum() < (1.0 - _LOST_STROKES) * strokes - 2.0 * running.n_strokes[0]:
        warnings.append(f"{trial.trial_id}: dropouts leave {running.n_strokes.sum():.0f} of {strokes:.0f} strokes")
    started_at_rest = moving_s > angle.time_s[0] or angle.speed_rad_s[0] < MOVING_RAD_S
    start_up = start_up_state(recording, angle, setting, moving_s) if started_at_rest else None
    found = []
    for state in (running, start_up):
        if state is not None:
            found.append(_with_history(baseline, state, track))
    return found


def _strokes(
    baseline: Baseline, recording: Recording, angle: CrankAngle, steady_s: tuple[float, float]
) -> StrokeSeries | None:
    return stroke_series(
        recording,
        angle,
        cutting_sign=baseline.cutting_sign,
        radius_m=baseline.radius_m,
        start_s=steady_s[0] + SETTLE_S,
        end_s=steady_s[1],
    )


def _with_history(baseline: Baseline, state: State, track: SlowTrack) -> State:
    """Return the state with what the trial inherited, and with the motor's voltage."""
    slow = track.at(state.time_s[:, 0])
    charge_used_as = slow.pop("charge_used_as")
    return replace(
        state,
        charge_used_as=charge_used_as,
        cut_distance_m=slow.pop("cut_distance_m"),
        slow=slow,
        motor_voltage_v=_motor_voltage(baseline, state, charge_used_as),
    )


def _setting(recording: Recording, index: int, track: SlowTrack) -> TrialSetting:
    trial = recording.trial
    return TrialSetting(
        label=trial.trial_id,
        index=index,
        duty=trial.duty or 0.0,
        is_idle=trial.is_idle,
        stock=_stock(recording),
        feed_m_s=math.nan if trial.feed_mm_s is None else 1e-3 * trial.feed_mm_s,
        thickness_m=math.nan if trial.thickness_mm is None else 1e-3 * trial.thickness_mm,
        operating_point=_operating_point(recording),
        session_s=track.session_s,
    )


def _refuse_foreign_angles(states: list[State], warnings: list[str]) -> None:
    """Take out trials whose force or current does not follow the measured crank angle as in the other trials."""
    locks: dict[str, dict[str, complex]] = {}
    for state in states:
        lock = lock_to_angle(state) if state.kind == "running" else None
        if lock is not None:
            locks.setdefault(lock[0], {})[state.setting.label] = lock[1]
    foreign: list[str] = []
    for name, found in locks.items():
        usual = sum(lock / abs(lock) for lock in found.values()) if len(found) > 2 else 0.0
        off = [
            label
            for label, lock in found.items()
            if abs(lock) < _LOCKED or (abs(usual) > 0 and abs(np.angle(lock / usual)) > _PHASE_SPREAD_RAD[name])
        ]
        reason = f"the {name} does not follow the strokes of the displacement as it should"
        remedy = "the displacement belongs to another trial, or the clocks of the devices differ"
        if name == "current in air" and len(off) > _FOREIGN_SHARE * len(found):
            warnings.append(f"in most trials {reason}: something else moves it")
            continue
        if len(off) > _FOREIGN_SHARE * len(found):
            raise InputError(f"in {len(off)} of {len(found)} trials {reason}", where=off[0], remedy=remedy)
        foreign += off
        warnings += [f"{label} left out: {reason}; {remedy}" for label in off]
    states[:] = [s for s in states if s.setting.label not in foreign]


def _without_displacement(recordings: list[Recording], baseline: Baseline, warnings: list[str]) -> Campaign:
    """Means over whole strokes, whose rate is read from the ripple of force or current."""
    from diagnosis.stroke_means import stroke_means

    means = {r.trial.trial_id: stroke_means(r, baseline) for r in recordings}
    for name, found in means.items():
        if found is None:
            warnings.append(f"{name} left out: neither force nor current shows a clear stroke rate")
    usable = [r for r in recordings if means[r.trial.trial_id] is not None]
    if not usable:
        raise InputError(f"no trial can be diagnosed without displacement: {summary(warnings)}")
    angles = [means[r.trial.trial_id].angle for r in usable]  # type: ignore[union-attr]
    tracks = slow_tracks(usable, angles, stroke_m=2.0 * baseline.radius_m)
    states = [
        _with_history(baseline, means[r.trial.trial_id].state(_setting(r, index, track)), track)  # type: ignore[union-attr]
        for index, (r, track) in enumerate(zip(usable, tracks, strict=True))
    ]
    _refuse_without_equation(baseline, states)
    guesses = _with_guesses(baseline, states)
    warnings.append(
        "no displacement in any trial: the stroke rate is read from the ripple of force or current, and only means over"
        " whole strokes are compared; nothing can be said of friction, mechanism, cutting law or force sensor"
    )
    return Campaign(
        plant=Jigsaw(baseline=baseline), states=tuple(states), k_guess_n_s_per_m=guesses, warnings=tuple(warnings),
        angle_is_assumed=True,
    )  # fmt: skip


def _motor_voltage(baseline: Baseline, state: State, charge_used_as: Floats) -> Floats:
    """Duty times the battery voltage as measured, else as the battery model gives it."""
    if state.battery_voltage_v is not None or baseline.battery is None:
        return state.motor_voltage_v
    current_a = state.battery_current_a
    if current_a is None:
        current_a = 0.0 if state.current_a is None else state.setting.duty * state.current_a
    voltage_v = baseline.open_circuit_voltage(charge_used_as) - baseline.battery.internal_resistance_ohm * current_a
    return np.broadcast_to(state.setting.duty * voltage_v, state.speed_rad_s.shape)


def _stock(recording: Recording) -> str:
    """Trials of one stock share a cutting coefficient: only where it is stated what was cut."""
    trial = recording.trial
    if trial.is_idle:
        return "air"
    if not is_stock_stated(recording):
        return f"what {trial.trial_id} cut"
    return f"{trial.material}, {trial.thickness_mm} mm"


def _operating_point(recording: Recording) -> str:
    trial = recording.trial
    if trial.is_idle:
        return f"idle, duty {trial.duty:g}"
    return f"{trial.material}, {trial.thickness_mm} mm, feed {trial.feed_mm_s} mm/s, duty {trial.duty:g}"


def _with_guesses(baseline: Baseline, states: list[State]) -> dict[str, float]:
    """Regress k_Fc of each stock and write it, with the campaign's extremes, into the slow states."""
    sums: dict[str, list[float]] = {}
    peak_n = top_a = 0.0
    for state in states:
        if state.kind == "running" and not state.setting.is_idle and state.force_n is not None:
            speed = baseline.cutting_speed(state)
            total = sums.setdefault(state.setting.stock, [0.0, 0.0])
            total[0] += float(np.sum(state.force_n * speed))
            total[1] += float(np.sum(speed * speed))
            peak_n = max(peak_n, float(state.force_n.mean(axis=0).max()))
        if state.kind == "start_up" and state.current_a is not None:
            top_a = max(top_a, float(state.current_a.max()))
    guesses = {stock: max(up / max(down, 1e-12), 0.0) for stock, (up, down) in sums.items()}
    for state in states:
        k_guess = 0.0 if state.setting.is_idle else guesses.get(state.setting.stock, 0.0)
        ones = np.ones_like(state.time_s)
        state.slow["k_guess_n_s_per_m"] = k_guess * ones
        state.slow["peak_force_n"] = peak_n * ones
        state.slow["top_current_a"] = top_a * ones
    return guesses
