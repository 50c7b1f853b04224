"""Warnings while a trial is recorded: what the samples of each second give away. Starts no thread, reads no clock."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Stream, StreamChannel
from sawbench.acquisition.preflight_values import PreflightLimits, saturation
from sawbench.acquisition.stream_recorder import OUTSIDE, SILENT_PERIODS
from sawbench.bench.recording import Event, SampleBlock
from sawbench.bench.spread import robust_std
from sawbench.bench.units import DISPLACEMENT, FORCE, MOTOR_CURRENT

Floats = NDArray[np.float64]
Source = tuple[str, str]
# (what, device, channel): one warning at a time for each.
Key = tuple[str, str, str]
Drifts = Callable[[], Mapping[Source, tuple[float, float] | None]]

_WINDOW_S: Final = 1.0
# Samples of a window may come so much later than its end.
_LATENESS_S: Final = 0.5
_MOST_WINDOWS: Final = 10
_LEAST_SAMPLES: Final = 20
# The tool runs where the blade moves so far in a second, or the motor draws so much and this share of the most it drew.
_MOVES_MM: Final = 1.0
_DRAWS_SHARE: Final = 0.3
_DRAWS_A: Final = 0.5
_STROKE_SHARE: Final = 0.2
_NOISE_FACTOR: Final = 3.0
_BASE_WINDOWS: Final = 3
# Every stroke moves these, whatever their resolution.
_MOVED_BY_STROKE: Final = frozenset({DISPLACEMENT.name, FORCE.name, MOTOR_CURRENT.name})
# What moves by so many steps of its resolution in a second does not keep one value by chance.
_MANY_STEPS: Final = 10.0
# Of a second, so many values make a median that is good to 3 %, wherever in the stroke they lie.
_ENOUGH: Final = 2000
_PRELOAD_SHARE: Final = 0.9
_SPOILS: Final = frozenset({"saturated", "flat", "preload", "stroke", "silent", "disk", "overload"})
_LEAST_FREE_BYTES: Final = 500e6


class LiveWarnings:
    """Judge a recording second by second.

    Parameters
    ----------
    streams : mapping of (device, stream) to Stream
    preload_n : float, optional
        Force with which the carriage is pressed on the load cell; above it the carriage lifts off its support.
    folder : Path, optional
        Where the recording is written, for the space on its disk.
    busy : callable, optional
        Says that this computer is too busy; empty where it is not.
    overloads : callable, optional
        Gives, for each device, how many frames it has marked as overloaded so far.
    limits : PreflightLimits, optional

    Notes
    -----
    A second is judged half a second after its end. The rules, each for one channel or instrument:

    - saturated: `preflight_values.saturation`, and samples beyond what the instrument can mean.
    - overload: the amplifier marks frames as overloaded; of which input it does not say, so no value is left out.
    - flat: all values of a second are equal while the tool runs; a channel other than displacement, force
      and motor current may, within its resolution, where it did not move by ten steps in the first three such seconds.
    - noise: the standard deviation of white noise that the third differences show (robust, over sqrt 20) is over three
      times its median of the first three seconds of the running tool, twice in a row.
    - preload: the force exceeds 90 % of `preload_n`.
    - rate: samples come more than 3 % faster or slower than configured.
    - stroke: the blade moves less than a fifth of before, while the motor draws more than half of before.
    - clock: more than 500 ppm and three standard uncertainties off.
    - silent: an instrument is a second, or three of its periods, behind the newest sample of the others.
    - disk: under 500 MB are free.
    - busy: this computer let the recorder wait for 0.25 s, or has four programs a processor; an instrument that is
      silent then may not be to blame.

    The tool runs where the blade moves by 1 mm in a second or the motor draws 0.5 A and 30 % of the most it drew. A
    second in which that changes is judged for range and rate alone. What the latest sample of a channel showed holds
    until the next one, or until the instrument is silent. Fails: noise that is there from the beginning.
    """

    def __init__(
        self,
        streams: Mapping[Source, Stream],
        *,
        preload_n: float | None = None,
        folder: Path | None = None,
        busy: Callable[[], str] = str,
        overloads: Callable[[], Mapping[str, int]] = dict,
        limits: PreflightLimits | None = None,
    ) -> None:
        self._streams = dict(streams)
        self._channels = {c.name: (device, c) for (device, _), stream in streams.items() for c in stream.channels}
        self._source = {c.name: source for source, stream in streams.items() for c in stream.channels}
        self._preload_n = preload_n
        self._folder = folder
        self._busy = busy
        self._overloads = overloads
        self._n_overloads = dict(overloads())
        self._limits = limits or PreflightLimits()
        self._blocks: dict[str, list[SampleBlock]] = {name: [] for name in self._channels}
        self._outside: dict[str, list[Event]] = {}
        self._reached_s = dict.fromkeys(self._streams, 0.0)
        self._n_windows = 0
        self._is_running = False
        self._noise: dict[str, list[float]] = {}
        self._swings: dict[str, list[float]] = {}
        self._is_noisy: set[str] = set()
        self._most: dict[str, float] = {}
        self._active: dict[Key, str] = {}

    @property
    def active(self) -> tuple[str, ...]:
        """What is wrong now, in words."""
        return tuple(_named(key, text) for key, text in self._active.items())

    @property
    def is_spoilt(self) -> bool:
        """Whether one of them makes a trial that is not reliable; noise, rate and clock can be looked into."""
        return any(what in _SPOILS for what, _, _ in self._active)

    def take(self, item: SampleBlock | Event) -> None:
        """Take what was written into the recording."""
        if isinstance(item, SampleBlock):
            if item.channel in self._blocks and len(item.time_s):
                self._blocks[item.channel].append(item)
                source = self._source[item.channel]
                self._reached_s[source] = max(self._reached_s[source], float(item.time_s[-1]))
        elif item.kind == "gap" and OUTSIDE in item.text:
            self._outside.setdefault(item.channel, []).append(item)

    def check(self, now_s: float, drift_ppm: Drifts) -> list[Event]:
        """Judge the seconds that are over.

        Parameters
        ----------
        now_s : float
            Recording time.
        drift_ppm : callable
            Gives, for each (device, stream), clock error and its standard uncertainty, 1e-6, or None.

        Returns
        -------
        list of Event
            Of kind "warning": one where something begins, one where it is over.
        """
        events: list[Event] = []
        # Where the computer slept, the seconds of that time are no matter any more.
        self._n_windows = max(self._n_windows, int(now_s / _WINDOW_S) - _MOST_WINDOWS)
        while now_s >= (self._n_windows + 1) * _WINDOW_S + _LATENESS_S:
            start_s = self._n_windows * _WINDOW_S
            found = dict(self._judge(start_s, drift_ppm))
            events += self._changed(found, start_s)
            # The words of the beginning, whose numbers stay.
            self._active = {key: self._active.get(key, text) for key, text in found.items()}
            self._n_windows += 1
        return events

    def _changed(self, found: Mapping[Key, str], start_s: float) -> Iterator[Event]:
        for key, text in found.items():
            if key not in self._active:
                yield Event(kind="warning", time_s=start_s, text=text, device=key[1], channel=key[2])
        for key, text in self._active.items():
            if key not in found:
                yield Event(kind="warning", time_s=start_s, text=f"over: {text}", device=key[1], channel=key[2])

    def _judge(self, start_s: float, drift_ppm: Drifts) -> Iterator[tuple[Key, str]]:
        end_s = start_s + _WINDOW_S
        window = {name: self._cut(name, start_s, end_s) for name in self._channels}
        is_running = self._runs(window)
        is_steady = is_running == self._is_running
        for name, (device, channel) in self._channels.items():
            is_seen = bool(len(window[name][1])) or name in self._outside
            if not is_seen and not self._is_silent(self._source[name], end_s):
                yield from ((key, text) for key, text in self._active.items() if key[2] == name)
                continue
            for what, text in self._of_channel(channel, window[name][1], is_running=is_running, is_steady=is_steady):
                yield (what, device, name), text
        if is_steady:
            yield from self._stroke(window)
        yield from self._of_streams(window, end_s, drift_ppm)
        yield from self._overloaded()
        yield from self._disk()
        if text := self._busy():
            yield ("busy", "", ""), text
        self._is_running = is_running

    def _cut(self, name: str, start_s: float, end_s: float) -> tuple[Floats, Floats]:
        """Return times and values of one second, and forget what lies before its end."""
        blocks = self._blocks[name]
        self._blocks[name] = [block for block in blocks if block.time_s[-1] >= end_s]
        if not blocks:
            return np.empty(0), np.empty(0)
        time_s = np.concatenate([block.time_s for block in blocks])
        values = np.concatenate([block.values for block in blocks])
        inside = (time_s >= start_s) & (time_s < end_s)
        return time_s[inside], values[inside]

    def _runs(self, window: Mapping[str, tuple[Floats, Floats]]) -> bool:
        _, displacement = window.get(DISPLACEMENT.name, (np.empty(0), np.empty(0)))
        _, current = window.get(MOTOR_CURRENT.name, (np.empty(0), np.empty(0)))
        drawn = float(np.abs(current).mean()) if len(current) else 0.0
        self._most["drawn"] = max(drawn, self._most.get("drawn", 0.0))
        moves = bool(len(displacement)) and float(np.ptp(displacement)) > _MOVES_MM
        return moves or drawn > max(_DRAWS_A, _DRAWS_SHARE * self._most["drawn"])

    def _of_channel(
        self, channel: StreamChannel, values: Floats, *, is_running: bool, is_steady: bool
    ) -> Iterator[tuple[str, str]]:
        outside = self._outside.pop(channel.name, [])
        if outside:
            yield "saturated", f"samples are {OUTSIDE}: overloaded, or a broken wire"
        if not len(values):
            return
        if is_steady and not outside and (found := saturation(channel, values, self._limits)) is not None:
            yield "saturated", found.what
        if channel.name == FORCE.name and self._preload_n is not None:
            peak_n = float(values.max())
            if peak_n > _PRELOAD_SHARE * self._preload_n:
                yield (
                    "preload",
                    f"{peak_n:.0f} N of {self._preload_n:g} N preload: above it the carriage lifts off its support",
                )
        if is_running and is_steady and len(values) >= _LEAST_SAMPLES:
            if self._must_move(channel, values) and np.ptp(values) == 0.0:
                what = f"all values of a second are {values[0]:.6g} {channel.unit}"
                yield "flat", f"flat line: {what} while the tool runs"
            else:
                yield from self._noisy(channel, values)

    def _must_move(self, channel: StreamChannel, values: Floats) -> bool:
        swings = self._swings.setdefault(channel.name, [])
        if len(swings) < _BASE_WINDOWS:
            swings.append(float(np.ptp(values)))
        moves = float(np.median(swings)) >= _MANY_STEPS * channel.resolution
        return moves or channel.name in _MOVED_BY_STROKE

    def _noisy(self, channel: StreamChannel, values: Floats) -> Iterator[tuple[str, str]]:
        differences = _enough_of(np.diff(values, 3))
        noise = robust_std(differences - np.median(differences)) / np.sqrt(20.0)
        base = self._noise.setdefault(channel.name, [])
        if len(base) < _BASE_WINDOWS:
            base.append(noise)
            return
        usual = float(np.median(base))
        was_noisy = channel.name in self._is_noisy
        is_noisy = usual > 0 and noise > _NOISE_FACTOR * usual
        (self._is_noisy.add if is_noisy else self._is_noisy.discard)(channel.name)
        if is_noisy and was_noisy:
            yield "noise", f"noise {noise:.3g} {channel.unit}, {noise / usual:.1f} times that of the first seconds"

    def _stroke(self, window: Mapping[str, tuple[Floats, Floats]]) -> Iterator[tuple[Key, str]]:
        """Say where the blade has stopped although the motor still draws."""
        if DISPLACEMENT.name not in window or MOTOR_CURRENT.name not in window:
            return
        displacement, current = window[DISPLACEMENT.name][1], window[MOTOR_CURRENT.name][1]
        if not len(displacement) or not len(current):
            return
        moved_mm, drawn_a = float(np.ptp(displacement)), float(np.abs(current).mean())
        most_mm = self._most.get("moved", 0.0)
        if most_mm > _MOVES_MM and moved_mm < _STROKE_SHARE * most_mm and drawn_a > 0.5 * self._most["usual"]:
            what = f"{moved_mm:.2g} mm in a second, {most_mm:.3g} mm before, while the motor draws {drawn_a:.3g} A"
            yield ("stroke", self._channels[DISPLACEMENT.name][0], DISPLACEMENT.name), f"stroke lost: {what}"
        elif moved_mm > max(_MOVES_MM, 0.5 * most_mm):
            self._most |= {"moved": max(moved_mm, most_mm), "usual": drawn_a}

    def _of_streams(
        self,
        window: Mapping[str, tuple[Floats, Floats]],
        end_s: float,
        drift_ppm: Drifts,
    ) -> Iterator[tuple[Key, str]]:
        drifts = drift_ppm()
        for (device, name), stream in self._streams.items():
            if self._is_silent((device, name), end_s):
                blame = ", or its samples wait: this computer is too busy" if self._busy() else ""
                yield ("silent", device, ""), f"{name} is silent{blame}"
                continue
            time_s = window[stream.channels[0].name][0] if stream.channels else np.empty(0)
            if text := self._rate(stream, time_s):
                yield ("rate", device, ""), text
            drift = drifts.get((device, name))
            if drift is not None and abs(drift[0]) > self._limits.drift_ppm + 3.0 * drift[1]:
                yield ("clock", device, ""), f"the clock of {name} deviates by {drift[0]:+.0f} ± {drift[1]:.0f} ppm"

    def _is_silent(self, source: Source, end_s: float) -> bool:
        newest_s = min(max(self._reached_s.values()), end_s + _LATENESS_S)
        allowed_s = max(_WINDOW_S, SILENT_PERIODS * self._streams[source].period_s)
        return newest_s - self._reached_s[source] > allowed_s

    def _rate(self, stream: Stream, time_s: Floats) -> str:
        if stream.rate_hz <= 0 or len(time_s) < _LEAST_SAMPLES:
            return ""
        # The median is that of the samples that came: what was lost is a gap, no other rate.
        rate_hz = 1.0 / float(np.median(_enough_of(np.diff(time_s))))
        if abs(rate_hz / stream.rate_hz - 1.0) <= self._limits.rate_error:
            return ""
        return f"{stream.name} sends {rate_hz:.4g} samples/s, configured are {stream.rate_hz:g}"

    def _overloaded(self) -> Iterator[tuple[Key, str]]:
        before, self._n_overloads = self._n_overloads, dict(self._overloads())
        for device, n in self._n_overloads.items():
            # An amplifier that was opened again counts anew.
            if n not in {0, before.get(device, 0)}:
                yield (
                    ("overload", device, ""),
                    "overload of the amplifier, at one or more of its inputs",
                )

    def _disk(self) -> Iterator[tuple[Key, str]]:
        if self._folder is None:
            return
        free = shutil.disk_usage(self._folder).free
        if free < _LEAST_FREE_BYTES:
            yield ("disk", "", ""), f"only {free / 1e6:.0f} MB are free in {self._folder}"


def _enough_of(values: Floats) -> Floats:
    """At least `_ENOUGH` of the values, spread evenly over them; all where there are fewer."""
    return values[:: max(len(values) // _ENOUGH, 1)]


def _named(key: Key, text: str) -> str:
    whose = key[2] or key[1]
    return f"{whose}: {text}" if whose else text
