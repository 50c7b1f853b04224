"""A tool at rest behind the simulated instruments, on ptys, with noise and on demand what goes wrong with sensors.

Time is simulated: it moves on once the host has read what was sent, so a busy machine changes nothing. Shares no code
with what judges or averages it.
"""

from __future__ import annotations

import array
import contextlib
import fcntl
import queue
import select
import tempfile
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sawbench.acquisition.simulation.bench_server import SimulatedBench, make_instruments
from sawbench.acquisition.simulation.endpoints import PtyEndpoint
from sawbench.acquisition.simulation.faults import Fault
from sawbench.bench.config import load_config

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
REST = {"force_n": 0.0, "displacement_mm": 4.0, "motor_current_a": 0.2, "battery_voltage_v": 18.0}
NOISE = {"force_n": 0.3, "displacement_mm": 0.01, "motor_current_a": 0.03, "battery_voltage_v": 0.005}


class RestingTool:
    """`behaviour`: channel -> function of (times, noise) that gives what the sensor says."""

    def __init__(self, behaviour: dict[str, Callable] | None = None) -> None:
        self._behaviour = behaviour or {}
        self._rng = np.random.default_rng(7)

    def read(self, channel, time_s):
        noise = self._rng.standard_normal(len(time_s))
        if channel in self._behaviour:
            return self._behaviour[channel](np.asarray(time_s), noise)
        return REST.get(channel, 0.0) + NOISE.get(channel, 0.03) * noise

    def trigger(self, time_s):
        del time_s


class Rig:
    """The instruments in a thread; `clock` is their time and has to be that of the host too.

    `on_the_way`: instrument -> function of (bytes, time) that gives what arrives of them.
    """

    def __init__(
        self,
        folder: Path,
        behaviour=None,
        *,
        faults=(),
        clock_error_ppm=None,
        config_path=CONFIG,
        config=None,
        on_the_way=None,
    ) -> None:
        plant = RestingTool(behaviour)
        config = load_config(config_path).config if config is None else config
        self._instruments = make_instruments(plant, config, clock_error_ppm=clock_error_ppm)
        self._endpoints = {name: PtyEndpoint(folder / name) for name in self._instruments}
        for name, altered in (on_the_way or {}).items():
            self._alter(self._endpoints[name], altered)
        faults = tuple(Fault(**f) for f in faults)
        self._bench = SimulatedBench(plant, self._instruments, self._endpoints, faults=faults, trigger_after_s=1e9)
        self._awaited: set[str] = set()
        self._now_s = 0.0
        self._extra: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.ports = self._bench.plug_in()
        self._thread.start()

    def _alter(self, endpoint: PtyEndpoint, altered: Callable[[bytes, float], bytes]) -> None:
        write = endpoint.write
        endpoint.write = lambda data: write(altered(data, self._now_s))

    def clock(self) -> float:
        return self._now_s

    def inject(self, name: str, data: bytes) -> None:
        """Let bytes that the instrument never sent arrive from it."""
        self._extra.put((name, data))

    def close(self) -> None:
        self._stop.set()
        self._thread.join(20)
        self._bench.unplug()

    def _run(self) -> None:
        while not self._stop.is_set():
            self._bench.step(self._now_s)
            while not self._extra.empty():
                name, data = self._extra.get()
                self._endpoints[name].write(data)
            self._wait_until_read()
            if not self._is_host_awaited():
                self._now_s += 0.0047

    def _is_host_awaited(self) -> bool:
        """Whether an instrument is plugged in again and the host has not started it yet: then time stands still."""
        self._awaited |= {name for name, endpoint in self._endpoints.items() if endpoint._host_side < 0}
        self._awaited -= {name for name in self._awaited if self._instruments[name].is_streaming}
        return any(self._endpoints[name]._host_side >= 0 for name in self._awaited)

    def _wait_until_read(self) -> None:
        """Wait for the host, however long it takes, until it sends a command: one that gives up reading says so."""
        while any(self._n_pending(name) for name in self._endpoints):
            if self._stop.is_set() or self._is_command_there():
                break
            time.sleep(0.0002)
        time.sleep(0.0001)

    def _n_pending(self, name: str) -> int:
        """Bytes that the host has not read."""
        endpoint = self._endpoints[name]
        return _n_waiting(endpoint._host_side) if self._instruments[name].is_streaming else 0

    def _is_command_there(self) -> bool:
        return any(_n_waiting(endpoint._our_side) for endpoint in self._endpoints.values())


def _n_waiting(side: int) -> int:
    """Bytes that can be read from one side of a pty; none where it is unplugged."""
    count = array.array("i", [0])
    if side >= 0:
        # On a busy machine what was written is on its way for a while; to be asked whether it is there brings it there.
        there = select.poll()
        there.register(side, select.POLLIN)
        there.poll(0)
        fcntl.ioctl(side, termios.FIONREAD, count)
    return count[0]


@contextlib.contextmanager
def resting_bench(behaviour=None, **options):
    """Give a `Rig`."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder), behaviour, **options)
        try:
            yield rig
        finally:
            rig.close()


def missampled(data: bytes, *, sent_baud: int, read_baud: int) -> bytes:
    """What a receiver at `read_baud` makes of `data` sent at `sent_baud`, 8N1, bit by bit."""
    bits = np.array([bit for byte in data for bit in (0, *(byte >> k & 1 for k in range(8)), 1)])
    ratio = sent_baud / read_baud

    def line(position: float) -> int:
        index = int(position)
        return int(bits[index]) if index < len(bits) else 1

    out, at = bytearray(), 0.0
    while at < len(bits):
        if line(at):
            at += 0.25
            continue
        # The middle of each of eight bits after the start bit, in the receiver's idea of time.
        out.append(sum(line(at + ratio * (1.5 + k)) << k for k in range(8)))
        at += ratio * 9.5
    return bytes(out)
