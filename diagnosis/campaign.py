"""A campaign as the diagnosis sees it: every trial reduced to its states, with what it inherits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from sawbench.bench.config import BenchConfig, LoadedConfig
from sawbench.bench.errors import InputError
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats, Recording, Trial
from sawbench.bench.second_core import on_two_cores
from sawbench.bench.true_values import with_true_values
from sawbench.bench.units import DISPLACEMENT
from sawbench.bench.unusual_numbers import unusual_numbers
from sawbench.diagnosis.hardness import with_guesses
from sawbench.diagnosis.inference.off_stroke import OffStroke, off_stroke
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.stroke_series import StrokeSeries, stroke_series
from sawbench.diagnosis.instrument_rates import with_samples
from sawbench.diagnosis.late_clock import without_common_delay
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.plants.plant import Plant
from sawbench.diagnosis.reduction import CHANNEL_OF_STATE, START_UP_S, lock_to_angle, running_state, start_up_state
from sawbench.diagnosis.screening import NOT_A_SAW, is_stock_stated, screen, summary
from sawbench.diagnosis.signal_health import ChannelHealth, channel_health
from sawbench.diagnosis.slow_states import SlowTrack, slow_tracks
from sawbench.diagnosis.unusual_numbers import naming, slow_channels, unusual_settings
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.load import load_of
from sawbench.modeling.machines.saw_baseline import baseline_of
from sawbench.modeling.residuals import Baseline, residuals
from sawbench.modeling.state import TWO_PI, State, TrialSetting
from sawbench.processing.held_values import alignment_of_rows
from sawbench.processing.settled import LOADED_S

_NUMBERS = SETTINGS.screening
# What a blade in air cuts.
_AIR = "air"
# Trials of which a part is used: so many are named one by one.
_MOST_PARTS = 3


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
    health : tuple of ChannelHealth
        Of every channel of every trial.
    read : mapping of str to (float, float)
        Numbers of the plant that a channel reads by itself: value and standard uncertainty.
    """

    plant: Plant
    states: tuple[State, ...]
    k_guess_n_s_per_m: dict[str, float]
    warnings: tuple[str, ...]
    angle_is_assumed: bool = False
    strokes: tuple[StrokeSeries, ...] = ()
    off_stroke: tuple[OffStroke, ...] = ()
    health: tuple[ChannelHealth, ...] = ()
    read: Mapping[str, tuple[float, float]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def baseline(self) -> Any:
        """Numbers of the plant's model, as its effects take them: a `Baseline` for the jigsaw."""
        return self.plant.model


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

    Raises
    ------
    InputError
        If no trial can be used, or if most of them hold the same mistake (`diagnosis.screening`).
    """
    baseline = baseline_of(loaded)
    true = [with_true_values(recording, loaded.config) for recording in recordings]
    unusual = [*unusual_numbers(loaded.config), *unusual_settings([recording.trial for recording in true])]
    with naming(unusual):
        ordered, warnings = screen(_in_order(true), baseline)
    warnings[:0] = [*unusual, *slow_channels(ordered, baseline)]
    # Taken back already: the screening judges true values too.
    config = loaded.config.model_copy(update={"sensors": {}})
    if not any(DISPLACEMENT.name in recording.signals for recording in ordered):
        return _without_displacement(_tracked(ordered, config), baseline, warnings)
    usable: list[TrackedTrial] = []
    for number, tracked in enumerate(_tracked(ordered, config)):
        reason = _unusable(tracked)
        if reason:
            warnings.append(f"{tracked.trial.trial_id} left out: {reason}")
        else:
            usable.append(tracked)
        if on_trial is not None:
            on_trial(number + 1, len(ordered), tracked.trial.trial_id)
    if not usable:
        raise InputError(f"no trial can be diagnosed: {summary(warnings)}", remedy=NOT_A_SAW)
    return campaign_of(usable, baseline, warnings)


def campaign_of(trials: Sequence[TrackedTrial], baseline: Baseline, warnings: list[str]) -> Campaign:
    """Put tracked trials on one grid, each with what it inherits from those before it.

    Parameters
    ----------
    trials : sequence of TrackedTrial
        In their order, each with a crank angle from its displacement.
    baseline : Baseline
    warnings : list of str
        What was said before; what is left out here is added.

    Raises
    ------
    InputError
        If no trial runs long enough, or the channels allow no balance equation.
    """
    warnings += used_in_part(trials)
    tracks = slow_tracks(trials, stroke_m=2.0 * baseline.radius_m)
    states: list[State] = []
    numbered = [(index, trial, track) for index, (trial, track) in enumerate(zip(trials, tracks, strict=True))]
    for of_trial, said in on_two_cores(lambda one: _states(baseline, *one), numbered):
        states += of_trial
        warnings += said
    states = _of_their_angles(states, warnings)
    if not states:
        raise InputError(f"no trial is long enough to be diagnosed: {summary(warnings)}")
    _refuse_without_equation(baseline, states)
    states, guesses = with_guesses(baseline, _with_shared_steps(states))
    session_s = max(state.setting.session_s + float(state.time_s.max()) for state in states)
    baseline = replace(baseline, load=load_of(baseline, states), session_s=max(session_s, 1.0))
    labels = {state.setting.label for state in states}
    kept = [trial for trial in trials if trial.trial.trial_id in labels]

    def of_strokes(trial: TrackedTrial) -> tuple[StrokeSeries | None, OffStroke | None, list[ChannelHealth]]:
        series = stroke_series(trial, mechanism=baseline.mechanism, cutting_sign=baseline.cutting_sign)
        return series, off_stroke(trial), list(channel_health(trial))

    found = on_two_cores(of_strokes, kept)
    return Campaign(
        plant=Jigsaw(baseline=baseline),
        states=tuple(states),
        k_guess_n_s_per_m=guesses,
        warnings=tuple(warnings),
        strokes=tuple(series for series, _, _ in found if series is not None),
        off_stroke=tuple(beside for _, beside, _ in found if beside is not None),
        health=tuple(one for _, _, health in found for one in health),
        read=_read(kept),
    )


def _read(trials: Sequence[TrackedTrial]) -> dict[str, tuple[float, float]]:
    radius_m = float(np.median([trial.angle.radius_m for trial in trials if trial.angle is not None]))
    return {"crank_radius_m": (radius_m, SETTINGS.sensors.displacement_gain * radius_m)}


def _tracked(recordings: Sequence[Recording], config: BenchConfig) -> list[TrackedTrial]:
    from sawbench.processing.process import track_strokes

    def tracked(some: Sequence[Recording]) -> list[TrackedTrial]:
        signals = [signal for recording in some for signal in recording.signals.values()]
        return on_two_cores(lambda recording: track_strokes(recording, config), some, known=signals)

    trials = tracked(recordings)
    changed = with_samples(recordings, trials)
    for at, trial in zip(changed, tracked(list(changed.values())), strict=True):
        trials[at] = trial
    return trials


def _unusable(trial: TrackedTrial) -> str:
    """Why a trial cannot be laid over the crank angle; empty where it can."""
    if DISPLACEMENT.name not in trial.channels:
        return "it has no displacement, so crank angle and speed are unknown"
    return "" if trial.angle is not None and trial.angle.is_absolute else "its displacement shows no strokes"


def _refuse_without_equation(baseline: Baseline, states: Sequence[State]) -> None:
    if not any(residuals(baseline, state) for state in states):
        raise InputError(
            "the available channels allow no balance equation: displacement alone does not test the model",
            remedy="measure force, or motor current with battery voltage",
        )


def _in_order(recordings: Sequence[Recording]) -> list[Recording]:
    if all(r.trial.started_at is not None for r in recordings):
        return sorted(recordings, key=lambda r: r.trial.started_at)  # type: ignore[arg-type, return-value]
    return list(recordings)


def used_in_part(trials: Sequence[TrackedTrial]) -> list[str]:
    """Say of which trials a part is used only; of many of them in one line."""
    said, used = [], []
    for trial in trials:
        angle, steady = trial.angle, trial.steady
        assert angle is not None and steady is not None
        last_s = float(angle.time_s[-1])
        left_s = np.inf if steady.cut is None or steady.cut.end_s is None else steady.cut.end_s
        words = []
        if steady.start_s > steady.first_motion_s or steady.end_s < min(last_s, left_s):
            words.append(f"the blade stops or runs down; only {steady.start_s:.2f} s to {steady.end_s:.2f} s is used")
        if steady.cut is not None:
            words.append(steady.cut.words)
        if words:
            said += [f"{trial.trial.trial_id}: {text}" for text in words]
            begins_s = max(steady.start_s, 0.0 if steady.cut is None else steady.cut.start_s or 0.0)
            used.append(f"{trial.trial.trial_id} {begins_s:.2f} to {steady.end_s:.2f} s")
    if len(used) <= _MOST_PARTS:
        return said
    return [
        f"of {len(used)} of the {len(trials)} trials only a part is used, because the blade stops, runs down or is not"
        f" in the wood all along: {', '.join(used[:_MOST_PARTS])} and {len(used) - _MOST_PARTS} more"
    ]


def _states(
    baseline: Baseline, index: int, trial: TrackedTrial, track: SlowTrack
) -> tuple[list[State], list[str]]:  # fmt: skip
    """States of one trial, in which place it is, and warnings."""
    warnings: list[str] = []
    name, angle, steady = trial.trial.trial_id, trial.angle, trial.steady
    assert angle is not None and steady is not None
    setting = _setting(trial, index, track)
    running = running_state(trial, setting)
    if running is None:
        return [], [*warnings, f"{name} left out: it has less than two steady strokes"]
    if not np.all(running.speed_rad_s > 0.0):
        return [], [*warnings, f"{name} left out: the crank stands still or turns back within its strokes"]
    for channel, attribute in CHANNEL_OF_STATE.items():
        if channel in trial.channels and getattr(running, attribute) is None:
            warnings.append(f"{name}: {channel} left out: it is missing in most of the strokes")
    turned = np.interp([steady.settled_s, steady.end_s], angle.time_s, angle.angle_rad)
    strokes = float(np.diff(turned)[0]) / TWO_PI
    if running.n_strokes.sum() < (1.0 - _NUMBERS.lost_strokes) * strokes - 2.0 * running.n_strokes[0]:
        warnings.append(f"{name}: dropouts leave {running.n_strokes.sum():.0f} of {strokes:.0f} strokes")
    start_up = _start_up(trial, setting)
    return [_with_history(baseline, state, track) for state in (running, start_up) if state is not None], warnings


def _start_up(trial: TrackedTrial, setting: TrialSetting) -> State | None:
    """Spin-up of a trial, in air where the blade goes into the wood later; None where it goes in meanwhile."""
    steady = trial.steady
    assert steady is not None
    if steady.cut is None or steady.cut.start_s is None:
        return start_up_state(trial, setting)
    is_in_air = steady.cut.start_s > steady.first_motion_s + START_UP_S + LOADED_S
    return start_up_state(trial, replace(setting, is_idle=True, stock=_AIR)) if is_in_air else None


def _with_history(baseline: Baseline, state: State, track: SlowTrack) -> State:
    """Return the state with what the trial inherited, and with the motor's voltage."""
    time_s = state.time_s[:, 0]
    charge_used_as = track.at(track.charge_used_as, time_s)
    return replace(
        state,
        charge_used_as=charge_used_as,
        cut_distance_m=track.at(track.cut_distance_m, time_s),
        slow={memory: track.at(held, time_s) for memory, held in track.memories.items()},
        motor_voltage_v=_motor_voltage(baseline, state, charge_used_as),
    )


def _setting(tracked: TrackedTrial, index: int, track: SlowTrack) -> TrialSetting:
    trial, signals = tracked.trial, tracked.channels
    return TrialSetting(
        label=trial.trial_id,
        index=index,
        duty=trial.duty or 0.0,
        is_idle=trial.is_idle,
        stock=_stock(trial),
        feed_m_s=math.nan if trial.feed_mm_s is None else 1e-3 * trial.feed_mm_s,
        thickness_m=math.nan if trial.thickness_mm is None else 1e-3 * trial.thickness_mm,
        operating_point=_operating_point(trial),
        session_s=track.session_s,
        alignments={name: signal.alignment or alignment_of_rows(signal.time_s) for name, signal in signals.items()},
        battery=track.battery,
    )


def _of_their_angles(states: Sequence[State], warnings: list[str]) -> list[State]:
    """Return trials whose force or current follows the measured crank angle as in the other trials."""
    locks: dict[str, dict[str, tuple[complex, float]]] = {}
    for state in states:
        lock = lock_to_angle(state) if state.kind == "running" else None
        if lock is not None:
            locks.setdefault(lock[0], {})[state.setting.label] = lock[1:]
    remedy = "the displacement belongs to another trial, or the clocks of the devices differ"
    foreign: dict[str, str] = {}
    n_judged = 0
    for name, found in locks.items():
        spread_rad = _NUMBERS.phase_spread_rad[name]
        phases, rad_s = map(np.array, zip(*found.values(), strict=True))
        is_off = _is_off(phases, spread_rad)
        # One trial alone is no matter of clocks.
        is_off = _is_off(without_common_delay(phases, rad_s), spread_rad) if is_off.sum() > 1 else is_off
        off = [label for label, one in zip(found, is_off.tolist(), strict=True) if one]
        reason = f"the {name} is not synchronous with the strokes of the displacement"
        if name == "current in air" and len(off) > _NUMBERS.foreign_share * len(found):
            warnings.append(f"in most trials {reason}: it has another source")
            continue
        n_judged += len(found)
        foreign |= dict.fromkeys(off, reason)
    if len(foreign) > _NUMBERS.foreign_share * n_judged:
        first, reason = next(iter(foreign.items()))
        raise InputError(f"in {len(foreign)} of {n_judged} trials {reason}", where=first, remedy=remedy)
    warnings += [f"{label} left out: {reason}; {remedy}" for label, reason in foreign.items()]
    return [s for s in states if s.setting.label not in foreign]


def _is_off(locks: Floats, spread_rad: float) -> np.ndarray:
    """Which of the trials repeat badly with the angle, or at another phase than most."""
    usual = (locks / np.abs(locks)).sum() if len(locks) > 2 else 0.0
    badly = np.abs(locks) < _NUMBERS.locked
    return badly | (np.abs(np.angle(locks / usual)) > spread_rad) if abs(usual) > 0 else badly


def _with_shared_steps(states: Sequence[State]) -> list[State]:
    """Return states whose uncertainty by the steps of the displacement says that averaging trials does not lower it.

    Every trial reads the same strokes in the same steps.
    """
    n_alike = sum(len(state.stroke_std_m) > 0 for state in states)
    return [replace(state, stroke_std_m=np.sqrt(n_alike) * state.stroke_std_m) for state in states]


def _without_displacement(trials: Sequence[TrackedTrial], baseline: Baseline, warnings: list[str]) -> Campaign:
    """Means over whole strokes, whose rate is read from the ripple of force or current."""
    from sawbench.diagnosis.stroke_means import stroke_means

    means = {trial.trial.trial_id: stroke_means(trial, baseline) for trial in trials}
    for name, found in means.items():
        if found is None:
            warnings.append(f"{name} left out: neither force nor current shows a clear stroke rate")
    usable = [
        (replace(trial, angle=found.angle), found)
        for trial in trials
        if (found := means[trial.trial.trial_id]) is not None
    ]
    if not usable:
        raise InputError(f"no trial can be diagnosed without displacement: {summary(warnings)}")
    tracks = slow_tracks([trial for trial, _ in usable], stroke_m=2.0 * baseline.radius_m)
    states = [
        _with_history(baseline, found.state(_setting(trial, index, track)), track)
        for index, ((trial, found), track) in enumerate(zip(usable, tracks, strict=True))
    ]
    _refuse_without_equation(baseline, states)
    states, guesses = with_guesses(baseline, states)
    warnings.append(
        "no displacement in any trial: the stroke rate is read from the ripple of force or current, and only means over"
        " whole strokes are compared; no statement on friction, mechanism, cutting law or force sensor is possible"
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


def _stock(trial: Trial) -> str:
    """Trials of one stock share a cutting coefficient: only where it is stated what was cut."""
    if trial.is_idle:
        return _AIR
    if not is_stock_stated(trial):
        return f"what {trial.trial_id} cut"
    return f"{trial.material}, {trial.thickness_mm:g} mm"


def _operating_point(trial: Trial) -> str:
    if trial.is_idle:
        return f"idle, duty {trial.duty:g}"
    thickness = "thickness not stated" if trial.thickness_mm is None else f"{trial.thickness_mm:g} mm"
    feed = "feed not stated" if trial.feed_mm_s is None else f"feed {trial.feed_mm_s:g} mm/s"
    return f"{trial.material or 'material not stated'}, {thickness}, {feed}, duty {trial.duty:g}"


def with_known(campaign: Campaign, known: Sequence[KnownEffect]) -> Campaign:
    """Return a reduced campaign whose model holds other effects; nothing is read or reduced again.

    Parameters
    ----------
    campaign : Campaign
    known : sequence of KnownEffect
        All that the model is to hold.

    Returns
    -------
    Campaign
        With the cutting coefficients that follow.
    """
    plant = campaign.plant.with_known(known)
    if not isinstance(plant, Jigsaw):
        return replace(campaign, plant=plant)
    states, guesses = with_guesses(plant.baseline, campaign.states)
    return replace(campaign, plant=plant, states=tuple(states), k_guess_n_s_per_m=guesses)
