"""What goes wrong around the recorder: killed, stopped, started twice, without permission, on a full disk.

Part of `python -m benchmarks.fault_matrix`. Instruments and recorders are forked processes, in real time, so the
figures change a little from run to run and with what else the machine does.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tomli_w
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.simulation.bench_server import run_bench
from sawbench.bench.config import BenchConfig, parse_config
from sawbench.bench.errors import SawbenchError
from sawbench.bench.recording import Recording, Trial
from sawbench.commands.recording_session import SessionOptions, record_trial
from sawbench.storage.reader import read_recording
from sawbench.visualization.live_process import LiveViewProcess

from benchmarks.fault_rig import SILENT_ERROR_S, Instrument, Row, sine_of, worst_time_error_s

SECONDS, FAULT_AFTER_S = 5.0, 2.0
NOBODY = 65534
# A disk holds whole pages, and the names of the files.
DISK_BYTES = 36_000
SMALL_DISK = "size=40k"
NO_FILE_S = 60.0


class _Sines:
    def read(self, channel: str, time_s: Any) -> Any:
        return sine_of(channel, time_s)

    def trigger(self, time_s: float) -> None:
        del time_s


@contextlib.contextmanager
def bench(config: BenchConfig) -> Iterator[dict[str, str]]:
    """The instruments in a process of their own; gives their ports."""
    from_bench, to_us = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            with os.fdopen(to_us, "w") as out:
                run_bench(_Sines(), config, transport="pty", watch_stdin=False, out=out)
        finally:
            os._exit(0)
    os.close(to_us)
    try:
        with os.fdopen(from_bench) as announced:
            ports = json.loads(announced.readline())
        # Whoever this process becomes may reach them, unless a fault says otherwise.
        for port in ports.values():
            Path(port).parent.chmod(0o755)
            Path(port).resolve().chmod(0o666)
        yield ports
    finally:
        os.kill(pid, signal.SIGTERM)
        os.waitpid(pid, 0)


class Recorder:
    """`sawbench record` in a forked process: `before` is done there first, `watch` gives its observers."""

    def __init__(
        self,
        instrument: Instrument,
        ports: dict[str, str],
        path: Path,
        *,
        before: Callable[[], object] = lambda: None,
        watch: Callable[[], list[Any]] = list,
    ) -> None:
        self.path = path
        self.part = path.with_name(path.name + ".part")
        # Imported here: whom the other process becomes may not be allowed to read the drivers.
        build_devices(instrument.config())
        from_recorder, to_us = os.pipe()
        self.pid = os.fork()
        if self.pid:
            os.close(to_us)
            self._said = os.fdopen(from_recorder)
            return
        found: dict[str, Any] = {}
        try:
            before()
            options = SessionOptions(path=path, trial=Trial(trial_id="f"), seconds=SECONDS, endpoints=ports)
            summary = record_trial(instrument.loaded(), options, observers=watch())
            found = {"losses": summary.losses, "is_complete": summary.is_complete}
        except SawbenchError as error:
            text = str(error).replace(str(path.parent), "FOLDER").replace(str(Path(ports["victim"]).parent), "PORTS")
            found = {"error": " ".join(text.split())}
        finally:
            with os.fdopen(to_us, "w") as out:
                out.write(json.dumps(found))
            os._exit(0)

    def wait_for_file(self) -> None:
        """Until the recording has begun, or the recorder ended."""
        deadline_s = time.monotonic() + NO_FILE_S
        while not self.part.exists() and time.monotonic() < deadline_s:
            time.sleep(0.01)

    def send(self, number: int) -> None:
        """Send a signal."""
        os.kill(self.pid, number)

    def end(self) -> dict[str, Any]:
        """Wait for its end; what it said of itself, nothing where it was killed."""
        with self._said:
            text = self._said.read()
        os.waitpid(self.pid, 0)
        return json.loads(text) if text else {}

    def recording(self) -> Recording:
        """What it left."""
        return read_recording(self.path if self.path.exists() else self.part)


def row(name: str, instrument: Instrument, recorder: Recorder, said: list[str], *, until_s: float = SECONDS) -> Row:
    """One line: what the recording holds of the `until_s` that it should, and what was said."""
    recording = recorder.recording()
    victim, witness = (recording.signals.get(c) for c in (instrument.channel, instrument.witness))
    marks = [(e.time_s, e.end_s) for e in recording.events if e.kind in {"gap", "warning"} and e.end_s is not None]
    error_s = 0.0
    if victim is not None and witness is not None:
        last_s = min(until_s, float(victim.time_s[-1]), float(witness.time_s[-1]))
        error_s = worst_time_error_s(victim, witness, marks, last_s)
    n_lost = round(instrument.rate_hz * until_s) - (0 if victim is None else len(victim.time_s))
    kinds = {"gap", "warning", "interrupted"}
    here = str(recorder.path.parent)
    texts = [f"{e.kind}: {e.text}".replace(here, "FOLDER") for e in recording.events if e.kind in kinds]
    said = [*said, *texts, *([] if recording.is_complete else ["file: not complete"])]
    is_wrong = abs(n_lost) > 3 or error_s > SILENT_ERROR_S
    return Row(
        fault=name,
        lost=f"{n_lost} samples ({n_lost / instrument.rate_hz:.2f} s)",
        said="; ".join(said) or "nothing",
        time_error_ms=1e3 * error_s,
        is_silent=is_wrong and not said,
    )


def _refused(name: str, recorder: Recorder) -> Row:
    """One line for a recorder that cannot begin."""
    said = recorder.end()
    is_left = recorder.path.exists() or recorder.part.exists()
    text = said.get("error", "") + ("; leaves a file" if is_left else "; no file is left")
    return Row(fault=name, lost="all", said=f"refused: {text}", time_error_ms=None, is_silent="error" not in said)


def _said_of(found: dict[str, Any]) -> list[str]:
    if "error" in found:
        return [f"error: {found['error']}"]
    return [f"exit 1: {text}" for text in found.get("losses", [])] + (
        [] if found.get("is_complete", True) else ["exit 1: not complete"]
    )


def killed_and_restarted(instrument: Instrument, folder: Path) -> list[Row]:
    """SIGKILL, and a new recorder on the instruments that still stream."""
    with bench(instrument.config()) as ports:
        first = Recorder(instrument, ports, folder / "killed.mcap")
        first.wait_for_file()
        time.sleep(FAULT_AFTER_S)
        killed_at_s = time.time()
        first.send(signal.SIGKILL)
        first.end()
        second = Recorder(instrument, ports, folder / "again.mcap")
        said = _said_of(second.end())
        begun = first.recording().trial.started_at
        assert begun is not None
        until_s = killed_at_s - begun.timestamp()
        return [
            row("recorder killed (SIGKILL)", instrument, first, [], until_s=until_s),
            row("started again after that", instrument, second, said),
        ]


def stopped(instrument: Instrument, folder: Path) -> list[Row]:
    """SIGSTOP for a second: the machine sleeps, or swaps."""
    with bench(instrument.config()) as ports:
        recorder = Recorder(instrument, ports, folder / "stopped.mcap")
        recorder.wait_for_file()
        time.sleep(FAULT_AFTER_S)
        recorder.send(signal.SIGSTOP)
        time.sleep(1.0)
        recorder.send(signal.SIGCONT)
        said = _said_of(recorder.end())
        return [row("recorder stopped for 1 s (SIGSTOP)", instrument, recorder, said)]


def two_recorders(instrument: Instrument, folder: Path) -> list[Row]:
    """A second recorder at the same port, and one that wants the same file."""
    with bench(instrument.config()) as ports:
        first = Recorder(instrument, ports, folder / "first.mcap")
        first.wait_for_file()
        second = Recorder(instrument, ports, folder / "second.mcap").end()
        rows = [row("second recorder at the port", instrument, first, _said_of(first.end()))]
        rows[0] = _also(rows[0], f"second: {second.get('error', 'NOT refused')}")
        (folder / "same.mcap.part").write_bytes(b"")
        return [*rows, _kept(_refused("second recorder into the file of another", _at(instrument, ports, folder)))]


def _at(instrument: Instrument, ports: dict[str, str], folder: Path) -> Recorder:
    return Recorder(instrument, ports, folder / "same.mcap")


def _kept(found: Row) -> Row:
    return Row(
        fault=found.fault,
        lost="nothing of the other",
        said=found.said.replace("; leaves a file", ""),
        time_error_ms=None,
        is_silent=found.is_silent,
    )


def _also(found: Row, text: str) -> Row:
    said = text if found.said == "nothing" else f"{text}; {found.said}"
    return Row(
        fault=found.fault,
        lost=found.lost,
        said=said,
        time_error_ms=found.time_error_ms,
        is_silent=found.is_silent or "NOT refused" in text,
    )


def without_permission(instrument: Instrument, folder: Path) -> list[Row]:
    """A port and a folder that belong to somebody else."""

    def become_nobody() -> None:
        if os.geteuid() == 0:
            os.setgid(NOBODY)
            os.setuid(NOBODY)

    open_folder, closed_folder = folder / "open", folder / "closed"
    open_folder.mkdir()
    closed_folder.mkdir()
    for place, mode in ((folder, 0o755), (open_folder, 0o777), (closed_folder, 0o555)):
        place.chmod(mode)
    with bench(instrument.config()) as ports:
        not_ours = Recorder(instrument, ports, closed_folder / "t.mcap", before=become_nobody)
        rows = [_refused("folder without permission", not_ours)]
        Path(ports["victim"]).resolve().chmod(0)
        nobody = Recorder(instrument, ports, open_folder / "t.mcap", before=become_nobody)
        return [_refused("port without permission", nobody), *rows]


def full_disk(instrument: Instrument, folder: Path) -> list[Row]:
    """A disk that is full (ENOSPC), where this process may mount one; else a file that may not grow (RLIMIT_FSIZE)."""

    def limit() -> None:
        if not is_mounted:
            resource.setrlimit(resource.RLIMIT_FSIZE, (DISK_BYTES, DISK_BYTES))

    disk = folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", SMALL_DISK, "tmpfs", str(disk)]
    is_mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        with bench(instrument.config()) as ports:
            recorder = Recorder(instrument, ports, disk / "full.mcap", before=limit)
            said = _said_of(recorder.end())
            return [row("disk full" if is_mounted else "file may not grow", instrument, recorder, said)]
    finally:
        if is_mounted:
            subprocess.run(["umount", str(disk)], check=True)


class _OffBus:
    """Frames of the instrument on python-can's virtual bus, which then says that it is off, and comes back."""

    def __init__(self, channel: str) -> None:
        import can

        self._bus = can.Bus(interface="virtual", channel=channel)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        import can

        begun_s, n, is_off = time.monotonic(), 0, False
        while not self._stopping.wait(0.004):
            now_s = time.monotonic() - begun_s
            if not is_off and now_s > 3.0:
                is_off = True
                self._bus.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
            for k in range(n, int(1000 * now_s)):
                if not 3.0 < k / 1000 < 3.5:
                    data = (k & 0xFFFF).to_bytes(2, "little") + bytes(2)
                    self._bus.send(can.Message(arbitration_id=0x100, data=data, is_extended_id=False))
            n = int(1000 * now_s)

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._bus.shutdown()


def bus_off(instrument: Instrument, folder: Path) -> list[Row]:
    """A CAN bus that goes off for half a second, on an interface that tells of it."""
    if instrument.name != "dbc_can":
        return []
    path, channel = folder / "off.mcap", "off"
    table = {**instrument.table, "interface": "virtual", "port": channel}
    loaded = parse_config(tomli_w.dumps({"devices": {"victim": table}}))
    sender = _OffBus(channel)
    try:
        record_trial(loaded, SessionOptions(path=path, trial=Trial(trial_id="o"), seconds=SECONDS))
    finally:
        sender.close()
    recording = read_recording(path)
    n_lost = round(instrument.rate_hz * SECONDS) - len(recording.signals[instrument.channel].time_s)
    said = [f"{e.kind}: {e.text}" for e in recording.events if e.kind == "gap" or e.text.startswith("link ")]
    return [
        Row(
            fault="bus off for 0.5 s (error frame)",
            lost=f"{n_lost} samples ({n_lost / instrument.rate_hz:.2f} s)",
            said="; ".join(said) or "nothing",
            time_error_ms=None,
            is_silent=n_lost > 3 and not said,
        )
    ]


def dead_views(instrument: Instrument, folder: Path) -> list[Row]:
    """The process of the live view killed, and stopped."""

    def watch(number: int, path: Path) -> Callable[[], list[Any]]:
        def start() -> list[Any]:
            view = LiveViewProcess(show="none", save_path=path)
            path.with_suffix(".pid").write_text(str(view.pid))
            threading.Timer(FAULT_AFTER_S, lambda: os.kill(view.pid, number)).start()
            return [view]

        return start

    rows = []
    for name, number in (("live view killed", signal.SIGKILL), ("live view hangs (SIGSTOP)", signal.SIGSTOP)):
        path = folder / f"view{int(number)}.mcap"
        with bench(instrument.config()) as ports:
            recorder = Recorder(instrument, ports, path, watch=watch(number, path.with_suffix(".rrd")))
            said = _said_of(recorder.end())
            # One that hangs would hang forever.
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(path.with_suffix(".pid").read_text()), signal.SIGKILL)
            rows.append(row(name, instrument, recorder, said))
    return rows


FAULTS = (killed_and_restarted, stopped, two_recorders, without_permission, full_disk, bus_off, dead_views)


def process_rows(instrument: Instrument) -> list[Row]:
    """Every fault of this file with one instrument."""
    rows: list[Row] = []
    for fault in FAULTS:
        with tempfile.TemporaryDirectory() as folder:
            rows += fault(instrument, Path(folder))
    return rows
