"""One recording from instruments to a finished file; used by `record` and `demo`."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import ConfigError, DeviceError, InputError
from sawbench.bench.recording import Event, Trial

if TYPE_CHECKING:
    from sawbench.acquisition.calibration_book import BookEntry
    from sawbench.acquisition.devices.device import Device
    from sawbench.acquisition.pre_trigger import Touch
    from sawbench.acquisition.recording_report import RecordingStatus, RecordingSummary
    from sawbench.bench.config import LoadedConfig
    from sawbench.storage.writer import RecordingWriter

# A start takes 2 s; this is for a computer that has much else to do.
_START_TIMEOUT_S = 180.0
# After this long the simulated tool is switched on: never.
NEVER_S: Final = 1e9
# A second of rest before it shows the zero of the load cell.
SWITCH_ON_S: Final = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SessionOptions:
    """What one recording needs beside the configuration.

    Attributes
    ----------
    path : Path
        The `.mcap` file.
    trial : Trial
    seconds : float or None
        None: until Ctrl-C.
    endpoints : mapping of str to str
        Device name -> port, instead of the configured ones.
    overwrite : bool
    calibration_book : Path, optional
        Tares and calibrations to apply; without it the configuration's alone.
    touch : Touch, optional
        Recording begins when the blade touches.
    """

    path: Path
    trial: Trial
    seconds: float | None
    endpoints: Mapping[str, str] = field(default_factory=dict)
    overwrite: bool = False
    calibration_book: Path | None = None
    touch: Touch | None = None


def check_devices(loaded: LoadedConfig) -> None:
    """Build every instrument of the configuration and open none.

    Raises
    ------
    ConfigError
        If a `[devices.*]` table is wrong; names file and table.
    """
    from sawbench.acquisition.devices import build_devices

    try:
        build_devices(loaded.config)
    except ConfigError as error:
        where = loaded.path if error.where is None else f"{loaded.path}: {error.where}"
        raise ConfigError(error.what, where=where, remedy=error.remedy) from error


def record_trial(
    loaded: LoadedConfig,
    options: SessionOptions,
    *,
    observers: Sequence[Any] = (),
    status: Callable[[RecordingStatus], object] | None = None,
    notes: NoteBook | None = None,
    stop: threading.Event | None = None,
) -> RecordingSummary:
    """Open the instruments, record one trial, finish the file.

    Parameters
    ----------
    loaded : LoadedConfig
    options : SessionOptions
    observers : sequence of callable
        Live views; see `acquisition.observers`.
    status : callable, optional
    notes : NoteBook, optional
        Operator's notes taken while recording.
    stop : threading.Event, optional

    Raises
    ------
    DeviceError
        If an instrument is missing, silent or wrong; then no file is left.
    KeyboardInterrupt
        By Ctrl-C once the end has come, or where writing hangs; it says where the recording is.
    """
    from sawbench.acquisition.calibration_book import (
        CalibrationBook,
        build_calibrated,
        entries_in_force,
        provenance,
        read_book,
        refuse_uncalibrated,
    )
    from sawbench.acquisition.recorder import RecorderLimits, record
    from sawbench.acquisition.recording_report import RecordingStart
    from sawbench.storage.writer import RecordingWriter

    book = CalibrationBook() if options.calibration_book is None else read_book(options.calibration_book)
    devices, configured = build_calibrated(loaded.config, book, options.endpoints)
    refuse_uncalibrated(book, configured, loaded.config.known_channels)
    made = provenance(book, configured)
    settings = loaded.config.recording
    opened: list[RecordingWriter] = []

    def open_writer(start: RecordingStart) -> RecordingWriter:
        writer = RecordingWriter(
            path=options.path,
            trial=replace(options.trial, started_at=start.started_at),
            config_toml=loaded.text,
            provenance={**start.provenance, **made, "config_sha256": loaded.sha256, "source": options.trial.source},
            started_at=start.started_at,
            preview_rate_hz=settings.preview_rate_hz,
            flush_every_s=settings.flush_every_s,
            second_copy=None if settings.second_copy is None else Path(settings.second_copy),
            overwrite=options.overwrite,
        )
        opened.append(writer)
        _warn_of_other_instruments(writer, entries_in_force(book, configured), devices)
        if notes is not None:
            notes.attach(writer, (datetime.now(UTC) - start.started_at).total_seconds())
        return writer

    try:
        limits = RecorderLimits(preload_n=settings.preload_n, folder=options.path.parent, touch=options.touch)
        return record(
            devices, open_writer, seconds=options.seconds, observers=observers, status=status, stop=stop, limits=limits
        )
    except BaseException as error:
        _close_broken_off(opened, error)
        raise
    finally:
        if notes is not None:
            notes.detach()


def _warn_of_other_instruments(
    writer: RecordingWriter, entries: Sequence[BookEntry], devices: Sequence[Device]
) -> None:
    """Say on the terminal and in the recording which calibrations were made with an instrument of another number."""
    from sawbench.acquisition.calibration_book import of_other_instruments

    facts = {device.name: device.describe() for device in devices}
    for entry, words in of_other_instruments(entries, facts):
        text = f"{entry.channel}: {words}"
        writer.write_event(Event(kind="warning", time_s=0.0, text=text, device=entry.device))
        click.echo(f"warning: {text}", err=True)


def _close_broken_off(opened: Sequence[RecordingWriter], error: BaseException) -> None:
    """Close what an error broke off, as not complete; say of a Ctrl-C where the recording is."""
    for writer in opened:
        was_closed = writer.is_closed
        writer.__exit__(type(error), error, error.__traceback__)
        if isinstance(error, KeyboardInterrupt):
            why = str(error) or "interrupted while the recording was being finished"
            raise KeyboardInterrupt(f"{why}: {_what_is_left(writer, was_closed=was_closed)}") from error


def _what_is_left(writer: RecordingWriter, *, was_closed: bool) -> str:
    part = Path(f"{writer.path}.part")
    if part.exists():
        return f"{part} has what was recorded; read it with `sawbench recover`"
    return (
        f"{writer.path} is finished" if was_closed else f"{writer.path} has what was recorded, marked as not complete"
    )


class NoteBook:
    """Operator's notes: lines typed while recording become events at the time they were typed."""

    def __init__(self) -> None:
        self._writer: Any = None
        self._begun_s = 0.0
        self._lock = threading.Lock()

    def attach(self, writer: Any, elapsed_s: float = 0.0) -> None:
        """Start to take notes into `writer`; its time 0 was `elapsed_s` ago."""
        import time

        with self._lock:
            self._writer, self._begun_s = writer, time.monotonic() - elapsed_s

    def detach(self) -> None:
        """Take no more notes."""
        with self._lock:
            self._writer = None

    def take(self, text: str) -> bool:
        """Write one note; False where nothing is being recorded."""
        import time

        with self._lock:
            if self._writer is None or not text.strip():
                return False
            self._writer.write_event(Event(kind="note", time_s=time.monotonic() - self._begun_s, text=text.strip()))
            return True

    def listen(self, lines: Iterator[str]) -> threading.Thread:
        """Take every line of `lines` as a note, in a thread that ends with the program."""

        def loop() -> None:
            for line in lines:
                self.take(line)

        thread = threading.Thread(target=loop, name="operator notes", daemon=True)
        thread.start()
        return thread


def bench_ports(
    config_path: Path,
    *,
    simulated: bool,
    seed: int,
    material: str = "none",
    duty: float | None = None,
    trigger_after_s: float = NEVER_S,
    load: tuple[str, float] | None = None,
) -> contextlib.AbstractContextManager[dict[str, str]]:
    """Give the ports of the simulated bench, whose tool stays off unless asked; none where the configured ones hold.

    Parameters
    ----------
    config_path : Path
    simulated : bool
    seed, material, duty, trigger_after_s, load
        As `simulated_bench`.
    """
    if not simulated:
        return contextlib.nullcontext({})
    return simulated_bench(
        config_path, material=material, duty=duty, seed=seed, trigger_after_s=trigger_after_s, load=load
    )


def ports_of_trial(
    config_path: Path, trial: Trial, folder: Path, *, simulated: bool, seed: int
) -> contextlib.AbstractContextManager[dict[str, str]]:
    """Give the ports of the bench for a trial; the simulated tool cuts it, with its battery as its recordings left it.

    Parameters
    ----------
    config_path : Path
    trial : Trial
    folder : Path
        Of the campaign's recordings.
    simulated : bool
    seed : int
    """
    if not simulated:
        return contextlib.nullcontext({})
    from sawbench.commands.simulated_battery import drawn_ah

    return simulated_bench(
        config_path,
        material=trial.material or "none",
        duty=trial.duty,
        seed=seed,
        drawn_ah=drawn_ah(folder, trial.battery),
    )


# Size: options by name, those of `sawbench simbench`.
@contextlib.contextmanager
def simulated_bench(
    config_path: Path,
    *,
    material: str,
    duty: float | None,
    seed: int,
    trigger_after_s: float = SWITCH_ON_S,
    truth_path: Path | None = None,
    load: tuple[str, float] | None = None,
    drawn_ah: float = 0.0,
) -> Iterator[dict[str, str]]:
    """Run `sawbench simbench` beside us and give its ports: device name -> port.

    Parameters
    ----------
    config_path : Path
    material : str
    duty : float, optional
    seed : int
    trigger_after_s : float
    truth_path : Path, optional
        The other process writes the truth there; this one never reads it.
    load : tuple of (str, float), optional
        Channel and what is added to what its sensor feels, in its unit: a known weight or length.
    drawn_ah : float
        Charge drawn from the battery before, Ah; see `commands.simulated_battery`.

    Raises
    ------
    InputError
        If the process refuses its settings, for example the material.
    DeviceError
        If it ends for another reason before it announces its ports.
    """
    call = [sys.executable, "-m", "sawbench.commands.main", "simbench", "--config", str(config_path)]
    call += ["--material", material, "--seed", str(seed), "--trigger-after", str(trigger_after_s)]
    call += [] if duty is None else ["--duty", str(duty)]
    call += [] if truth_path is None else ["--truth", str(truth_path)]
    call += [] if load is None else ["--load", f"{load[0]}={load[1]!r}"]
    call += ["--drawn-ah", repr(drawn_ah)] if drawn_ah else []
    process = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield _announced_ports(process)
    finally:
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def _announced_ports(process: subprocess.Popen[str]) -> dict[str, str]:
    assert process.stdout is not None and process.stderr is not None
    timer = threading.Timer(_START_TIMEOUT_S, process.kill)
    timer.daemon = True
    timer.start()
    try:
        line = process.stdout.readline()
    finally:
        # Ctrl-C comes here too: the command must not wait for the timer.
        timer.cancel()
    if not line:
        said = process.stderr.read().strip().removeprefix("sawbench: error: ")
        code = process.wait()
        kind = InputError if code == InputError.exit_code else DeviceError
        why = f"no answer within {_START_TIMEOUT_S:g} s" if code < 0 else f"it ended with exit code {code}"
        raise kind(f"the simulated bench did not start: {said or why}")
    return json.loads(line)
