"""What a trial inherits and builds up: charge used, distance cut, and the memories that effects declare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.catalogue import MEMORIES
from sawbench.modeling.state import TWO_PI, Memory
from sawbench.processing.binning import time_cell_means

_STEP_S = 0.02


@dataclass(frozen=True, kw_only=True, slots=True)
class SlowTrack:
    """Slow states of one trial over its own time.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    session_s : float
        Start of the trial since the start of the campaign.
    battery : int
        Number of its battery in the order of the campaign, 0 for the first.
    charge_used_as, cut_distance_m : ndarray, shape (n,)
        Of its battery and its blade.
    memories : dict of Memory to ndarray, shape (n,)
    """

    time_s: Floats
    session_s: float
    battery: int
    charge_used_as: Floats
    cut_distance_m: Floats
    memories: dict[Memory, Floats]

    def at(self, track: Floats, time_s: Floats) -> Floats:
        """One of the tracks at given times, shape (len(time_s), 1)."""
        return np.interp(time_s, self.time_s, track)[:, None]


def slow_tracks(trials: Sequence[TrackedTrial], *, stroke_m: float) -> list[SlowTrack]:
    """Carry charge, wear and heat through a campaign in its order.

    Parameters
    ----------
    trials : sequence of TrackedTrial
        With a crank angle each.
    stroke_m : float
        Blade travel a stroke, one way, m.
    """
    charge: dict[str, float] = {}
    distance: dict[str, float] = {}
    # Each with the time it is of: a battery that is swapped rests meanwhile.
    held: dict[tuple[Memory, str], tuple[float, float]] = {}
    first = trials[0].trial.started_at
    ended_s = 0.0
    tracks = []
    for tracked in trials:
        trial, angle = tracked.trial, tracked.angle
        assert angle is not None
        known = first is not None and trial.started_at is not None
        session_s = (trial.started_at - first).total_seconds() if known else ended_s  # type: ignore[operator]
        battery, blade = trial.battery or "", trial.blade or ""
        started_s, ended_s = max(session_s, ended_s), session_s + float(angle.time_s[-1])
        edges = np.arange(angle.time_s[0], angle.time_s[-1] + _STEP_S, _STEP_S)
        middle = 0.5 * (edges[1:] + edges[:-1])
        motor_a, battery_a = _currents(tracked, edges)
        crank_rad_s = np.diff(np.interp(edges, angle.time_s, angle.angle_rad)) / _STEP_S
        drives = {
            "motor_current_squared_a2": motor_a**2,
            "crank_speed_squared_rad2_s2": crank_rad_s**2,
            "battery_current_a": battery_a,
        }
        memories: dict[Memory, Floats] = {}
        for memory in MEMORIES:
            tau = memory.time_constant_s
            keep = float(np.exp(-_STEP_S / tau))
            owner = (memory, battery if memory.drive == "battery_current_a" else "")
            value, left_s = held.get(owner, (0.0, started_s))
            value *= float(np.exp(-(started_s - left_s) / tau))
            track = np.empty(len(middle))
            for k, drive in enumerate(drives[memory.drive].tolist()):
                value = keep * value + (1.0 - keep) * drive
                track[k] = value
            held[owner] = (value, ended_s)
            memories[memory] = track
        used = charge.get(battery, 0.0) + np.cumsum(battery_a) * _STEP_S
        charge[battery] = float(used[-1])
        turns = np.interp(middle, angle.time_s, angle.angle_rad) / TWO_PI
        cut = distance.get(blade, 0.0) + (0.0 if trial.is_idle else stroke_m) * (turns - turns[0])
        distance[blade] = float(cut[-1])
        tracks.append(
            SlowTrack(
                time_s=middle, session_s=session_s, battery=list(charge).index(battery), charge_used_as=used,
                cut_distance_m=cut, memories=memories,
            )
        )  # fmt: skip
    return tracks


def _currents(tracked: TrackedTrial, edges: Floats) -> tuple[Floats, Floats]:
    """Motor and battery current on a slow grid; one is inferred from the other by the duty where it is missing."""
    duty = tracked.trial.duty or 1.0
    motor, battery = tracked.channels.get("motor_current_a"), tracked.channels.get("battery_current_a")
    nothing = np.zeros(len(edges) - 1)
    motor_a = nothing if motor is None else time_cell_means(motor.time_s, motor.values, edges)
    battery_a = duty * motor_a if battery is None else time_cell_means(battery.time_s, battery.values, edges)
    if motor is None and battery is not None:
        motor_a = battery_a / duty
    return motor_a, battery_a
