"""One trial in a few numbers, from its raw channels: what a plausibility check compares with the nominal model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats, Recording
from sawbench.bench.second_core import on_two_cores
from sawbench.bench.spread import robust_std
from sawbench.bench.units import CHANNEL_BY_NAME, DISPLACEMENT, FORCE
from sawbench.diagnosis.inference.settings import SETTINGS

# One signal: times in s and values in the unit of its channel.
Track = tuple[Floats, Floats]
_SETTLE_S = 0.8
_HYSTERESIS = 0.25
# The last strokes of a trial, each longer (or shorter) by that than the one before: the trigger was let go, or the
# blade has left the wood. What the motor takes is then no match for what the blade takes.
_CHANGED = 0.01
_STROKES_OF_A_RATE = 5


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """What the channels of one trial say, averaged over whole running strokes; None where a channel is missing.

    Attributes
    ----------
    travel_m : float or None
        Peak to peak of the displacement.
    n_strokes : int
        Complete strokes; 0 where the displacement does not swing.
    rate_hz : float or None
        Median stroke rate.
    rate_gain_hz_s : float
        By what the stroke rate grows in a second, on average.
    motor_current_a, battery_current_a, battery_voltage_v : float or None
    voltage_ripple : float or None
        Spread of the battery voltage, without spikes, over its median.
    top_current_a : float or None
        99.9 percent of the samples of the whole trial stay below, start-up included.
    blade_power_w : float or None
        Mean of force times blade velocity, positive where the force acts while the displacement falls. None also where
        the speed changes in nearly all strokes.
    falling_force_n, rising_force_n : float or None
        Mean force while the displacement falls and rises.
    """

    travel_m: float | None
    n_strokes: int
    rate_hz: float | None
    motor_current_a: float | None
    top_current_a: float | None
    battery_current_a: float | None
    battery_voltage_v: float | None
    voltage_ripple: float | None
    blade_power_w: float | None
    falling_force_n: float | None
    rising_force_n: float | None
    rate_gain_hz_s: float = 0.0


def tracks_of(recording: Recording) -> dict[str, Track]:
    """Known channels of a recording, as plain arrays."""
    return {n: (s.time_s, s.values) for n, s in recording.signals.items() if n in CHANNEL_BY_NAME and len(s.values) > 1}


def read_trial(tracks: Mapping[str, Track]) -> Reading:
    """Reduce raw channels to a `Reading`.

    Parameters
    ----------
    tracks : mapping of str to (time_s, values)
        By channel name; nothing is assumed of their plausibility.
    """
    displacement = tracks.get(DISPLACEMENT.name)
    bulk = None if displacement is None else bulk_of(displacement[1])
    starts_s = np.zeros(0) if displacement is None or bulk is None else stroke_starts(*displacement, bulk)
    travel_m = None if bulk is None else DISPLACEMENT.si_factor * float(np.ptp(bulk))
    starts_s = starts_s[starts_s > starts_s[0] + _SETTLE_S] if len(starts_s) else starts_s
    driven_s = starts_s if displacement is None else _driven(starts_s, displacement[0])
    is_driven = len(driven_s) == len(starts_s) or len(driven_s) > SETTINGS.screening.least_strokes
    starts_s = driven_s if is_driven else starts_s
    window = (float(starts_s[0]), float(starts_s[-1])) if len(starts_s) >= 2 else _late_part(tracks)
    means = {name: _mean(track, window) for name, track in tracks.items()}
    motor = tracks.get("motor_current_a")
    power, falling, rising = _force_on_blade(tracks, window)
    return Reading(
        travel_m=travel_m,
        n_strokes=max(len(starts_s) - 1, 0),
        rate_hz=1.0 / float(np.median(np.diff(starts_s))) if len(starts_s) >= 2 else None,
        motor_current_a=means.get("motor_current_a"),
        top_current_a=None if motor is None else float(np.quantile(motor[1], 0.999)),
        battery_current_a=means.get("battery_current_a"),
        battery_voltage_v=means.get("battery_voltage_v"),
        voltage_ripple=_ripple(tracks.get("battery_voltage_v"), window),
        blade_power_w=power if is_driven else None,
        falling_force_n=falling,
        rising_force_n=rising,
        rate_gain_hz_s=_rate_gain_hz_s(starts_s),
    )


class Readings:
    """Readings of the trials of a campaign, each made once for the channels that it has.

    Parameters
    ----------
    recordings : sequence of Recording
        Each with a `trial_id` of its own, by which it is known: later it may have fewer channels, not other ones.
    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        made = on_two_cores(lambda recording: read_trial(tracks_of(recording)), recordings)
        self._made = dict(zip(map(_key, recordings), made, strict=True))

    def of(self, recording: Recording) -> Reading:
        """`Reading` of a trial with the channels that it has now."""
        key = _key(recording)
        if key not in self._made:
            self._made[key] = read_trial(tracks_of(recording))
        return self._made[key]


def _key(recording: Recording) -> tuple[str, ...]:
    return (recording.trial.trial_id, *recording.signals)


def bulk_of(values: Floats) -> Floats:
    """Range of the values without the few at either end, shape (2,)."""
    return np.quantile(values, (0.003, 0.997))


def stroke_starts(time_s: Floats, values: Floats, bulk: Floats) -> Floats:
    """Times at which the signal rises through its middle, with hysteresis; empty where it does not swing."""
    low, high = bulk
    middle, swing = 0.5 * (low + high), 0.5 * (high - low)
    if swing <= 0:
        return np.zeros(0)
    side = np.where(values > middle + _HYSTERESIS * swing, 1, np.where(values < middle - _HYSTERESIS * swing, -1, 0))
    outside = np.flatnonzero(side)
    rises = np.flatnonzero(np.diff(side[outside]) > 0) + 1
    starts_s = time_s[outside[rises]]
    if len(starts_s) < 3:
        return starts_s
    first, middle, third = np.quantile(np.diff(starts_s), (0.25, 0.5, 0.75))
    return starts_s if third - first < SETTINGS.reading.irregular * middle else np.zeros(0)


def _driven(starts_s: Floats, time_s: Floats) -> Floats:
    """Starts of strokes without the last ones that change one after the other, and the one in which it began."""
    if len(starts_s) < 3:
        return starts_s
    periods_s = np.diff(starts_s)
    least = max(_CHANGED, 2.0 * float(np.median(np.diff(time_s)) / np.median(periods_s)))
    changes = periods_s[1:] / periods_s[:-1] - 1.0
    changing = np.sign(changes) * (np.abs(changes) > least)
    is_other = changing[::-1] != changing[-1]
    n_changing = int(np.argmax(is_other)) if is_other.any() else len(changing)
    return starts_s if changing[-1] == 0.0 else starts_s[: -(n_changing + 1)]


def _rate_gain_hz_s(starts_s: Floats) -> float:
    """From the first strokes to the last ones."""
    n = min(_STROKES_OF_A_RATE, (len(starts_s) - 1) // 4)
    if n < 1:
        return 0.0
    first_hz, last_hz = n / (starts_s[n] - starts_s[0]), n / (starts_s[-1] - starts_s[-1 - n])
    return float((last_hz - first_hz) / (starts_s[-1] - starts_s[0]))


def _late_part(tracks: Mapping[str, Track]) -> tuple[float, float]:
    first = min((float(t[0]) for t, _ in tracks.values()), default=0.0)
    last = max((float(t[-1]) for t, _ in tracks.values()), default=0.0)
    return min(first + _SETTLE_S, 0.5 * (first + last)), last


def _mean(track: Track, window: tuple[float, float]) -> float | None:
    inside = (track[0] >= window[0]) & (track[0] < window[1])
    return float(track[1][inside].mean()) if inside.any() else None


def _ripple(track: Track | None, window: tuple[float, float]) -> float | None:
    if track is None:
        return None
    inside = track[1][(track[0] >= window[0]) & (track[0] < window[1])]
    if not len(inside):
        return None
    middle = float(np.median(inside))
    return robust_std(inside - middle) / max(abs(middle), 1e-9)


def _force_on_blade(
    tracks: Mapping[str, Track], window: tuple[float, float]
) -> tuple[float | None, float | None, float | None]:
    """Power into the falling stroke, W, and mean force while the displacement falls and rises."""
    if FORCE.name not in tracks or DISPLACEMENT.name not in tracks:
        return None, None, None
    time_s, force = tracks[FORCE.name]
    inside = (time_s >= window[0]) & (time_s < window[1])
    time_s, force = time_s[inside], force[inside]
    if len(time_s) < 8:
        return None, None, None
    at_m = DISPLACEMENT.si_factor * np.interp(time_s, *tracks[DISPLACEMENT.name])
    rise_m = np.diff(at_m)
    middle_n = 0.5 * (force[1:] + force[:-1])
    power_w = -float(np.sum(middle_n * rise_m) / (time_s[-1] - time_s[0]))
    # Near a dead centre the sign of the motion is noise: weigh with the motion itself.
    down, up = np.maximum(-rise_m, 0.0), np.maximum(rise_m, 0.0)
    if down.sum() <= 0 or up.sum() <= 0:
        return power_w, None, None
    return power_w, float((middle_n * down).sum() / down.sum()), float((middle_n * up).sum() / up.sum())
