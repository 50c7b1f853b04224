"""Look at instruments for a few seconds without recording: used by `check`, `tare` and `calibrate`.

Other than the recorder this continues where an instrument fails, since what failed is the very question.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Chunk, Device, Stream
from sawbench.acquisition.stream_timing import Loss, StreamTimer, Timed, TimedBlock
from sawbench.bench.errors import DeviceError, InputError

Floats = NDArray[np.float64]
_FIRST_SAMPLE_S: Final = 2.0
_WATCH_S: Final = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamProbe:
    """What one stream delivered.

    Attributes
    ----------
    stream : Stream
    time_s : ndarray, shape (n,), s
        On the common clock, 0 at the first sample.
    raw : ndarray, shape (n, n_channels)
        In the raw units; columns in the order of `stream.channels`.
    arrival_s, n_arrived : ndarray, shape (m,), s and samples
        After each read: when, and how many samples had come until then. Losses are not counted.
    n_gaps, n_missing : int
    silent_s : float
        From the last arrival to the end of the reading, s.
    drift_ppm, drift_std_ppm : float or None
        Of the instrument's quartz against this machine's clock, 1e-6; None where not known.
    warnings : tuple of str
        What the driver warned of.
    """

    stream: Stream
    time_s: Floats
    raw: Floats
    arrival_s: Floats
    n_arrived: Floats
    n_gaps: int = 0
    n_missing: int = 0
    silent_s: float = 0.0
    drift_ppm: float | None = None
    drift_std_ppm: float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceProbe:
    """What one instrument delivered.

    Attributes
    ----------
    device, port : str
    streams : tuple of StreamProbe
        Empty where it could not be opened.
    problem : DeviceError or None
        Why it could not be opened, or what ended the reading early.
    is_opened : bool
    n_discarded_bytes : int
        Bytes that were part of no valid frame: since the first sample, or ever where no sample came.
    facts : mapping of str to str
        What the instrument says of itself.
    """

    device: str
    port: str
    streams: tuple[StreamProbe, ...]
    problem: DeviceError | None
    is_opened: bool
    n_discarded_bytes: int
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))


def probe_devices(
    devices: Sequence[Device],
    *,
    seconds: float,
    clock: Callable[[], float] = time.monotonic,
    watch: Callable[[float], object] | None = None,
) -> tuple[DeviceProbe, ...]:
    """Open every instrument, read all of them at the same time for `seconds`, close them.

    Parameters
    ----------
    devices : sequence of Device
        Not opened yet; they are stopped when this returns or raises.
    seconds : float
        Counted from the first sample of each instrument.
    clock : callable
        Monotonic seconds; the same that the devices use.
    watch : callable, optional
        Called about ten times a second with the time since the beginning, s.

    Returns
    -------
    tuple of DeviceProbe
        In the order of `devices`. An instrument that is missing, silent or wrong raises nothing here.

    Raises
    ------
    InputError
        If the settings of an instrument can never work, for example a bit rate that its adapter does not have.
    """
    threads = [_ProbeThread(device, seconds=seconds, clock=clock) for device in devices]
    begun_s = clock()
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            while thread.is_alive():
                thread.join(_WATCH_S)
                if watch is not None:
                    watch(clock() - begun_s)
    finally:
        for thread in threads:
            thread.stop()
        for thread in threads:
            if thread.ident is not None:
                thread.join()
    for thread in threads:
        if thread.wrong_settings is not None:
            raise thread.wrong_settings
    return tuple(thread.result() for thread in threads)


class _Collector:
    """Chunks of one stream, timed."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._timer = StreamTimer(stream)
        self._blocks: list[TimedBlock] = []
        self._losses: list[Loss] = []
        self._arrivals: list[tuple[float, int]] = []
        self._n_arrived = 0
        self._warnings: list[str] = []

    def push(self, chunk: Chunk) -> None:
        self._n_arrived += len(chunk.raw)
        self._arrivals.append((float(chunk.arrival_s[-1]), self._n_arrived))
        self._warnings += [chunk.warning] if chunk.warning else []
        self._keep(self._timer.push(chunk))

    def finish(self, ended_s: float) -> StreamProbe:
        self._keep(self._timer.flush())
        n_channels = len(self.stream.channels)
        time_s = np.concatenate([b.time_s for b in self._blocks]) if self._blocks else np.empty(0)
        raw = np.concatenate([b.raw for b in self._blocks]) if self._blocks else np.empty((0, n_channels))
        arrivals = np.array(self._arrivals, dtype=np.float64).reshape(-1, 2)
        drift = self._timer.drift_ppm() if self._timer.has_data else None
        return StreamProbe(
            stream=self.stream,
            time_s=time_s - time_s[0] if len(time_s) else time_s,
            raw=raw,
            arrival_s=arrivals[:, 0],
            n_arrived=arrivals[:, 1],
            n_gaps=len(self._losses),
            n_missing=sum(loss.n_missing for loss in self._losses),
            silent_s=ended_s - self._arrivals[-1][0] if self._arrivals else 0.0,
            drift_ppm=None if drift is None else drift[0],
            drift_std_ppm=None if drift is None else drift[1],
            warnings=tuple(self._warnings),
        )

    def _keep(self, items: list[Timed]) -> None:
        for item in items:
            if isinstance(item, Loss):
                self._losses.append(item)
            elif isinstance(item, TimedBlock):
                self._blocks.append(item)


class _ProbeThread(threading.Thread):
    """Open, read, stop one device; keep whatever happened."""

    def __init__(self, device: Device, *, seconds: float, clock: Callable[[], float]) -> None:
        super().__init__(name=f"probe {device.name}", daemon=True)
        self._device = device
        self._seconds = seconds
        self._clock = clock
        self._stopping = threading.Event()
        self._collectors: dict[str, _Collector] = {}
        self._problem: DeviceError | None = None
        self.wrong_settings: InputError | None = None
        self._is_opened = False
        self._discarded_before = 0
        self._ended_s = clock()

    def stop(self) -> None:
        self._stopping.set()

    def run(self) -> None:
        device = self._device
        try:
            device.open()
            self._is_opened = True
            self._collectors = {stream.name: _Collector(stream) for stream in device.streams}
            device.start()
            self._read()
        except DeviceError as error:
            self._problem = error
        except InputError as error:
            self.wrong_settings = error
        except Exception as error:
            # A fault in one driver must not hide what the other instruments say.
            self._problem = DeviceError(f"driver failed: {error!r}", where=f"{device.name} on {device.port}")
        finally:
            self._ended_s = self._clock()
            device.stop()

    def result(self) -> DeviceProbe:
        """Return what was found; call after the thread has ended."""
        device = self._device
        return DeviceProbe(
            device=device.name,
            port=device.port,
            streams=tuple(c.finish(self._ended_s) for c in self._collectors.values()),
            problem=self._problem,
            is_opened=self._is_opened,
            n_discarded_bytes=device.n_discarded_bytes - self._discarded_before,
            facts=device.describe() if self._is_opened else {},
        )

    def _read(self) -> None:
        begun_s, first_s = self._clock(), None
        while not self._stopping.is_set():
            chunks = self._device.read()
            now_s = self._clock()
            if chunks and first_s is None:
                first_s = now_s
                # What came before the first whole frame was cut by our own arrival, not damaged on the way.
                self._discarded_before = self._device.n_discarded_bytes
            for chunk in chunks:
                self._collectors[chunk.stream].push(chunk)
            if now_s >= (begun_s + _FIRST_SAMPLE_S if first_s is None else first_s + self._seconds):
                return
