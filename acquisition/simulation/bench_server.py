"""The simulated bench: every instrument of the configuration, on real ports, in real time."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TextIO

from sawbench.acquisition.devices import validate_table
from sawbench.acquisition.simulation.declared_channels import DeclaredChannels
from sawbench.acquisition.simulation.endpoints import Endpoint, PtyEndpoint, TcpEndpoint
from sawbench.acquisition.simulation.faults import Fault, FaultySender
from sawbench.acquisition.simulation.plant_stream import EmulatedInstrument, PlantStream
from sawbench.acquisition.simulation.sensor_readings import SensorReadings
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, InputError

TransportKind = Literal["auto", "pty", "tcp"]
# No multiple of a sample period: the newest sample is then sometimes sent at once, as the clock estimate
# needs.
TICK_S: Final = 0.0047


@dataclass(kw_only=True, slots=True)
class _Place:
    name: str
    instrument: EmulatedInstrument
    endpoint: Endpoint
    sender: FaultySender
    is_plugged: bool = True


class SimulatedBench:
    """All instruments and their plugs; `step` moves them on. Has no clock and no thread.

    Parameters
    ----------
    plant : PlantStream
    instruments : mapping of str to EmulatedInstrument
    endpoints : mapping of str to Endpoint
        Same names.
    faults : tuple of Fault
    trigger_after_s : float
        The tool is switched on this long after all instruments stream.
    """

    def __init__(
        self,
        plant: PlantStream,
        instruments: Mapping[str, EmulatedInstrument],
        endpoints: Mapping[str, Endpoint],
        *,
        faults: tuple[Fault, ...] = (),
        trigger_after_s: float = 1.0,
    ) -> None:
        for fault in faults:
            if fault.device not in instruments:
                raise InputError(f"unknown device {fault.device!r} in a fault; devices are {', '.join(instruments)}")
        self._plant = plant
        self._trigger_after_s = trigger_after_s
        self._is_triggered = False
        self._n_steps = 0
        self._all_stream_since_s: float | None = None
        self._places = [
            _Place(
                name=name,
                instrument=instrument,
                endpoint=endpoints[name],
                sender=FaultySender(tuple(f for f in faults if f.device == name)),
            )
            for name, instrument in instruments.items()
        ]

    def plug_in(self) -> dict[str, str]:
        """Make all ports; return device name -> address."""
        for place in self._places:
            place.endpoint.plug()
        return {place.name: place.endpoint.address for place in self._places}

    def unplug(self) -> None:
        """Remove all ports."""
        for place in self._places:
            place.endpoint.unplug()

    def step(self, now_s: float) -> None:
        """Answer commands and send what is due at bench time `now_s`."""
        if self._all_stream_since_s is None and all(p.instrument.is_streaming for p in self._places):
            self._all_stream_since_s = now_s
        since_s = -1.0 if self._all_stream_since_s is None else now_s - self._all_stream_since_s
        if since_s >= self._trigger_after_s and not self._is_triggered:
            self._is_triggered = True
            self._plant.trigger(now_s)
        # All is made before any is sent, and each is sent first in its turn: no instrument's smallest latency may hold
        # the time that another one takes, here or in the host's threads.
        due = [(place, self._due(place, now_s, since_s)) for place in self._places]
        self._n_steps += 1
        first = self._n_steps % len(due)
        for place, streamed in due[first:] + due[:first]:
            place.endpoint.write(streamed)

    def _due(self, place: _Place, now_s: float, since_s: float) -> bytes:
        """Plug or unplug, answer commands, and return what the instrument streams until `now_s`."""
        is_out = place.sender.is_unplugged(since_s)
        if is_out == place.is_plugged:
            if is_out:
                place.endpoint.unplug()
                place.instrument.power_cycle()
            else:
                place.endpoint.plug()
            place.is_plugged = not is_out
        if is_out:
            return b""
        commands = place.endpoint.read()
        if commands:
            was_streaming = place.instrument.is_streaming
            answers = place.instrument.receive(commands, now_s)
            if was_streaming and not place.instrument.is_streaming:
                # Samples still waiting belong to a measurement that was stopped.
                place.endpoint.drop_backlog()
            place.endpoint.write(answers)
        return place.sender.through(place.instrument.advance(now_s), since_s)


def make_instruments(
    plant: PlantStream, config: BenchConfig, *, clock_error_ppm: Mapping[str, float] | None = None
) -> dict[str, EmulatedInstrument]:
    """Emulate every device of the configuration.

    Parameters
    ----------
    plant : PlantStream
    config : BenchConfig
    clock_error_ppm : mapping of str to float, optional
        Device -> how much too fast its quartz runs, 1e-6.

    Raises
    ------
    ConfigError
        If there is no device, or one that cannot be emulated.
    """
    if not config.devices:
        raise ConfigError("the configuration has no [devices.*] table, so no instrument can be emulated")
    errors = clock_error_ppm or {}
    sensed = SensorReadings(DeclaredChannels(plant, config.known_channels), config.sensors)
    instruments = {}
    for name, table in config.devices.items():
        instrument, settings = validate_table(name, table, channels=config.known_channels)
        if instrument.emulate is None:
            raise ConfigError(f"driver {table['driver']!r} has no emulator", where=f"[devices.{name}]")
        instruments[name] = instrument.emulate(name, settings, sensed, errors.get(name, 0.0))
    return instruments


# Size: options by name, those of `sawbench simbench` and what stands in for its process in a test.
def run_bench(
    plant: PlantStream,
    config: BenchConfig,
    *,
    transport: TransportKind = "auto",
    trigger_after_s: float = 1.0,
    faults: tuple[Fault, ...] = (),
    clock_error_ppm: Mapping[str, float] | None = None,
    stop: threading.Event | None = None,
    watch_stdin: bool = True,
    out: TextIO | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Serve the instruments of `config` until stdin closes, `stop` is set, or SIGTERM or Ctrl-C arrives.

    Parameters
    ----------
    plant : PlantStream
    config : BenchConfig
    transport : {"auto", "pty", "tcp"}
        "auto": ptys where the system has them, else TCP ports on loopback.
    trigger_after_s : float
        The tool is switched on this long after all instruments stream, s.
    faults : tuple of Fault
    clock_error_ppm : mapping of str to float, optional
        See `make_instruments`.
    stop : threading.Event, optional
    watch_stdin : bool
        End when the parent closes our standard input.
    out : text stream, optional
        Gets one line of JSON, device name -> address, once the ports exist. Default: standard output.
    clock : callable
        Monotonic seconds.
    """
    stop = stop or threading.Event()
    instruments = make_instruments(plant, config, clock_error_ppm=clock_error_ppm)
    if transport == "auto":
        transport = "pty" if os.name == "posix" else "tcp"
    if watch_stdin:
        threading.Thread(target=_set_at_end_of_input, args=(stop,), daemon=True).start()
    with tempfile.TemporaryDirectory(prefix="sawbench-") as directory, _signals_set(stop):
        endpoints: dict[str, Endpoint] = {
            name: PtyEndpoint(Path(directory) / name) if transport == "pty" else TcpEndpoint() for name in instruments
        }
        bench = SimulatedBench(plant, instruments, endpoints, faults=faults, trigger_after_s=trigger_after_s)
        try:
            print(json.dumps(bench.plug_in()), file=out or sys.stdout, flush=True)
            begun_s = clock()
            while not stop.is_set():
                now_s = clock() - begun_s
                bench.step(now_s)
                # To the next tick of the clock, not a tick after the work: pacing must not drift with the
                # load.
                stop.wait(max(0.0005, (int(now_s / TICK_S) + 1) * TICK_S - (clock() - begun_s)))
        finally:
            bench.unplug()


def _set_at_end_of_input(stop: threading.Event) -> None:
    try:
        while sys.stdin.buffer.read(1):
            pass
    except (OSError, ValueError, AttributeError):
        # No standard input at all: that is the end of it too.
        pass
    stop.set()


@contextmanager
def _signals_set(stop: threading.Event) -> Iterator[None]:
    """Let SIGTERM and SIGINT set `stop` while the context lasts; outside the main thread, do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, lambda *_: stop.set()) for s in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
