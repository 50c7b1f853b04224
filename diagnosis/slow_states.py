"""What a trial inherits and builds up: charge used, distance cut, heat and polarization filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.processed import CrankAngle
from bench.recording import Floats, Recording
from diagnosis.state import TWO_PI

HEAT_TIMES_S = (15, 40, 100, 170, 300, 520, 900)
POLARIZATION_TIMES_S = (1, 3, 6, 10, 18, 30, 60)
_STEP_S = 0.02


@dataclass(frozen=True, kw_only=True, slots=True)
class SlowTrack:
    """Slow states of one trial over its own time.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    session_s : float
        Start of the trial since the start of the campaign.
    values : dict of str to ndarray, shape (n,)
        `charge_used_as`, `cut_distance_m`, `heat_<tau>_a2`, `spin_<tau>_rad2_s2` (crank), `polarization_<tau>_a`.
    """

    time_s: Floats
    session_s: float
    values: dict[str, Floats]

    def at(self, time_s: Floats) -> dict[str, Floats]:
        """Slow states at given times, each of shape (n, 1)."""
        return {name: np.interp(time_s, self.time_s, track)[:, None] for name, track in self.values.items()}


def slow_tracks(recordings: Sequence[Recording], angles: Sequence[CrankAngle], *, stroke_m: float) -> list[SlowTrack]:
    """Carry charge, wear and heat through a campaign in its order.

    Parameters
    ----------
    recordings, angles : sequences of equal length
    stroke_m : float
        Blade travel a stroke, one way, m.

    Returns
    -------
    list of SlowTrack
    """
    from scipy.signal import lfilter

    charge: dict[str, float] = {}
    distance: dict[str, float] = {}
    heat: dict[int, float] = dict.fromkeys(HEAT_TIMES_S, 0.0)
    spin: dict[int, float] = dict.fromkeys(HEAT_TIMES_S, 0.0)
    polarization: dict[int, float] = dict.fromkeys(POLARIZATION_TIMES_S, 0.0)
    first = recordings[0].trial.started_at
    ended_s = 0.0
    tracks = []
    for recording, angle in zip(recordings, angles, strict=True):
        trial = recording.trial
        known = first is not None and trial.started_at is not None
        session_s = (trial.started_at - first).total_seconds() if known else ended_s  # type: ignore[operator]
        rest_s = max(session_s - ended_s, 0.0)
        edges = np.arange(angle.time_s[0], angle.time_s[-1] + _STEP_S, _STEP_S)
        middle = 0.5 * (edges[1:] + edges[:-1])
        motor_a, battery_a = _currents(recording, edges)
        values: dict[str, Floats] = {}
        for memory, kind, drive, unit in (
            (heat, "heat", motor_a**2, "a2"),
            (spin, "spin", (np.diff(np.interp(edges, angle.time_s, angle.angle_rad)) / _STEP_S) ** 2, "rad2_s2"),
            (polarization, "polarization", battery_a, "a"),
        ):
            for tau in memory:
                keep = np.exp(-_STEP_S / tau)
                start = memory[tau] * np.exp(-rest_s / tau)
                track, _ = lfilter([1.0 - keep], [1.0, -keep], drive, zi=[keep * start])
                memory[tau] = float(track[-1])
                values[f"{kind}_{tau}_{unit}"] = track
        battery, blade = trial.battery or "", trial.blade or ""
        used = charge.get(battery, 0.0) + np.cumsum(battery_a) * _STEP_S
        charge[battery] = float(used[-1])
        turns = np.interp(middle, angle.time_s, angle.angle_rad) / TWO_PI
        cut = distance.get(blade, 0.0) + (0.0 if trial.is_idle else stroke_m) * (turns - turns[0])
        distance[blade] = float(cut[-1])
        values |= {"charge_used_as": used, "cut_distance_m": cut}
        tracks.append(SlowTrack(time_s=middle, session_s=session_s, values=values))
        ended_s = session_s + float(angle.time_s[-1])
    return tracks


def _currents(recording: Recording, edges: Floats) -> tuple[Floats, Floats]:
    """Motor and battery current on a slow grid; one is inferred from the other by the duty where it is missing."""
    from diagnosis.reduction import bin_means

    duty = recording.trial.duty or 1.0
    motor, battery = recording.signals.get("motor_current_a"), recording.signals.get("battery_current_a")
    nothing = np.zeros(len(edges) - 1)
    motor_a = nothing if motor is None else bin_means(motor.time_s, motor.values, edges)
    battery_a = duty * motor_a if battery is None else bin_means(battery.time_s, battery.values, edges)
    if motor is None and battery is not None:
        motor_a = battery_a / duty
    return motor_a, battery_a
