"""What a trial is made of: signals, gaps, events, metadata. Frozen; arrays are read-only."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError

Floats = NDArray[np.float64]
EventKind = Literal["gap", "note", "device", "start", "stop", "trigger", "interrupted", "warning"]


def read_only(values: Any, *, name: str, allow_nan: bool = False) -> Floats:
    """Return `values` as a one-dimensional, finite, read-only float64 array.

    Parameters
    ----------
    values : array_like, shape (n,)
    name : str
        Used in the error.
    allow_nan : bool
        Accept NaN (never infinities).

    Raises
    ------
    InputError
        If the array is not one-dimensional or holds a value that is not finite.
    """
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1:
        raise InputError(f"{name} must be one-dimensional, got shape {array.shape}")
    bad = np.isinf(array) if allow_nan else ~np.isfinite(array)
    if bad.any():
        index = int(np.flatnonzero(bad)[0])
        raise InputError(
            f"{name} has {int(bad.sum())} values that are not finite, the first at index {index}",
            remedy="remove the rows or mark them as a gap",
        )
    array.flags.writeable = False
    return array


# A channel that misses more than this share of its samples makes a trial that is not reliable.
HEAVY_LOSS_SHARE: Final = 0.01


def loss_in_words(channel: str, n_samples: int, n_missing: int) -> str:
    """Say how many samples of a channel are missing; empty up to a hundredth.

    Parameters
    ----------
    channel : str
    n_samples, n_missing : int
        Samples that are there, and those that are not.

    Examples
    --------
    >>> loss_in_words("force_n", 90, 10)
    'force_n: 10 of 100 samples are missing'
    """
    if n_missing <= HEAVY_LOSS_SHARE * (n_samples + n_missing):
        return ""
    return f"{channel}: {n_missing} of {n_samples + n_missing} samples are missing"


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """A stretch without samples: annotated, never filled.

    Attributes
    ----------
    start_s, end_s : float
        Last sample before and first sample after, s on the recording's clock.
    n_missing : int
        Samples that should have been there (estimate from the sample period).
    reason : str
    """

    start_s: float
    end_s: float
    n_missing: int
    reason: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class SampleBlock:
    """Consecutive samples of one channel as a driver emits them and the recording stores them.

    Attributes
    ----------
    device, channel, unit : str
    first_index : int
        Running number of the first sample since the device started; a jump says samples were lost.
    time_s : ndarray, shape (n,), s
        Time of each sample on the recording's common clock (0 = start of the recording).
    values : ndarray, shape (n,), in `unit`
        Calibrated values.
    raw : ndarray, shape (n,), optional
        What the instrument sent, before calibration (counts, mV/V, ...).
    period_s : float, optional
        Set where the samples are equally spaced; `time_s[k] = time_s[0] + k * period_s`.
    """

    device: str
    channel: str
    unit: str
    first_index: int
    time_s: Floats
    values: Floats
    raw: Floats | None = None
    period_s: float | None = None

    def __post_init__(self) -> None:
        time_s = read_only(self.time_s, name=f"{self.channel} time_s")
        values = read_only(self.values, name=self.channel)
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "values", values)
        if self.raw is not None:
            object.__setattr__(self, "raw", read_only(self.raw, name=f"{self.channel} raw"))
        if len(time_s) != len(values) or (self.raw is not None and len(self.raw) != len(values)):
            raise InputError(f"block of {self.channel}: times, values and raw values differ in length")


@dataclass(frozen=True, kw_only=True, slots=True)
class Event:
    """Something that happened during a trial: an operator's note, a gap, a reconnect.

    Attributes
    ----------
    kind : str
        One of `EventKind`.
    time_s : float
        On the recording's clock, s.
    text : str
    device, channel : str
        Empty where they do not apply.
    end_s : float, optional
    """

    kind: EventKind
    time_s: float
    text: str
    device: str = ""
    channel: str = ""
    end_s: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Alignment:
    """How well the times of a channel are known on the recording's clock.

    Attributes
    ----------
    std_s : float
        Standard uncertainty of this recording's alignment, s.
    latency_s : float
        Largest latency of the link that no receiver can see, s; the same in every recording over this link.
    """

    std_s: float
    latency_s: float

    def __post_init__(self) -> None:
        for name in ("std_s", "latency_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} of an alignment is {value!r}, allowed is a number >= 0")

    def entry(self, channel: str) -> dict[str, str]:
        """Provenance that states it for one channel of a recording."""
        return {alignment_key(channel): json.dumps(asdict(self))}


def alignment_key(channel: str) -> str:
    """Name of the entry of a recording's provenance that states the alignment of a channel."""
    return f"alignment values {channel}"


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One channel over a whole trial; without slots, for what is worked out once and kept here.

    Attributes
    ----------
    channel : str
        Name from `bench.units` (or the importer's column name).
    unit : str
    time_s : ndarray, shape (n,), s
        Strictly increasing; need not be equally spaced.
    values : ndarray, shape (n,), in `unit`
    raw : ndarray, shape (n,), optional
    gaps : tuple of Gap
    device : str
    alignment : Alignment, optional
        None where nobody stated it, as in a table.

    Examples
    --------
    >>> s = Signal(channel="force_n", unit="N", time_s=[0.0, 0.1, 0.2], values=[1.0, 2.0, 3.0])
    >>> s.rate_hz
    10.0
    """

    channel: str
    unit: str
    time_s: Floats
    values: Floats
    raw: Floats | None = None
    gaps: tuple[Gap, ...] = ()
    device: str = ""
    alignment: Alignment | None = None

    def __post_init__(self) -> None:
        time_s = read_only(self.time_s, name=f"time_s of {self.channel}")
        values = read_only(self.values, name=self.channel)
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "values", values)
        if self.raw is not None:
            object.__setattr__(self, "raw", read_only(self.raw, name=f"{self.channel} raw"))
        if len(time_s) != len(values):
            raise InputError(f"{self.channel}: {len(time_s)} times but {len(values)} values")
        step = np.diff(time_s)
        if len(step) and step.min() <= 0:
            index = int(np.argmin(step)) + 1
            raise InputError(
                f"{self.channel}: time does not increase at sample {index} (t = {time_s[index]:.9g} s)",
                remedy="sort the rows by time and drop repeated ones",
            )

    @cached_property
    def rate_hz(self) -> float:
        """Median sample rate, Hz (0 for fewer than two samples)."""
        if len(self.time_s) < 2:
            return 0.0
        return float(np.round(1.0 / np.median(np.diff(self.time_s)), 9))

    @property
    def n_missing(self) -> int:
        """Samples in all gaps."""
        return sum(gap.n_missing for gap in self.gaps)

    @property
    def duration_s(self) -> float:
        """Time between the first and the last sample, s."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0

    def later(self, by_s: float) -> Signal:
        """Return the signal with `by_s` seconds added to its times.

        Examples
        --------
        >>> Signal(channel="force_n", unit="N", time_s=[0.0, 0.5], values=[1.0, 2.0]).later(2.0).time_s
        array([2. , 2.5])
        """
        if by_s == 0.0:
            return self
        gaps = tuple(replace(gap, start_s=gap.start_s + by_s, end_s=gap.end_s + by_s) for gap in self.gaps)
        return replace(self, time_s=self.time_s + by_s, gaps=gaps)


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """What was done: the settings of one trial. `None` means nobody said.

    Attributes
    ----------
    trial_id : str
    material : str, optional
        Workpiece; "none" means that the blade runs in air.
    duty : float, optional
        Commanded PWM duty, 0..1.
    thickness_mm, feed_mm_s : float, optional
    blade, battery, operator : str, optional
        Identities, so that wear and state of charge can carry over between trials.
    started_at : datetime, optional
        Timezone-aware.
    notes : str
    repetition : int, optional
    batch : str, optional
        Identity of the lot that the workpiece was taken from.
    source : str
        Where the signals come from: "bench", "simulated bench", "import of FILE".
    amendments : tuple of str
        Corrections of these settings that were made after the recording, in words; the settings have them in already.
    """

    trial_id: str
    material: str | None = None
    duty: float | None = None
    thickness_mm: float | None = None
    feed_mm_s: float | None = None
    blade: str | None = None
    battery: str | None = None
    operator: str | None = None
    started_at: datetime | None = None
    notes: str = ""
    repetition: int | None = None
    batch: str | None = None
    source: str = "bench"
    amendments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.duty is not None and not 0.0 <= self.duty <= 1.0:
            raise InputError(
                f"duty is {self.duty!r}, allowed is 0..1",
                where=f"trial {self.trial_id}",
                remedy="give the duty as a fraction, not in percent",
            )
        for name in ("thickness_mm", "feed_mm_s"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value!r}, allowed is a number >= 0", where=f"trial {self.trial_id}")

    @property
    def is_idle(self) -> bool:
        """Whether the blade ran in air."""
        return self.material == "none"


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """One trial as it is on disk.

    Attributes
    ----------
    trial : Trial
    signals : mapping of str to Signal
        By channel name; a channel that was not measured is absent.
    events : tuple of Event
    config_toml : str
        The bench configuration as it was when the trial was recorded ("" if unknown).
    provenance : mapping of str to str
        Software version, clock alignment, calibration, host, ...
    is_complete : bool
        False where the file was cut off and salvaged.
    path : str
        File it was read from ("" if it never was on disk).
    """

    trial: Trial
    signals: Mapping[str, Signal]
    events: tuple[Event, ...] = ()
    config_toml: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    is_complete: bool = True
    path: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def interruptions(self) -> tuple[str, ...]:
        """Where an incomplete recording is cut off, in words; empty for a complete one."""
        if self.is_complete:
            return ()
        lost = [
            f"it ends at {event.time_s:.2f} s, what came after is lost ({event.text})"
            for event in self.events
            if event.kind == "interrupted"
        ]
        return (f"the recording is incomplete{': ' if lost else ''}{'; '.join(lost)}",)

    def signal(self, channel: str) -> Signal:
        """Return the signal of `channel`.

        Raises
        ------
        InputError
            If the recording has no such channel.
        """
        try:
            return self.signals[channel]
        except KeyError:
            raise InputError(
                f"has no channel {channel}; its channels are {', '.join(self.signals) or 'none'}",
                where=self.path or self.trial.trial_id,
            ) from None
