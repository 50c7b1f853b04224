"""What every fault does to every instrument: `python -m benchmarks.fault_matrix` writes docs/faults.md.

The faults run on emulated instruments over real ptys in simulated time (`tests.rigs.resting`), each sensor a sine of
10 Hz that a second instrument sees too, so that times are checked against it.
"""

from __future__ import annotations

import argparse
import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import RecorderLimits, record
from sawbench.acquisition.recording_report import RecordingSummary
from sawbench.acquisition.simulation.plant_stream import SWITCH_CHANNEL
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import SawbenchError
from sawbench.bench.recording import Event, Recording, SampleBlock, Signal, Trial
from sawbench.processing.process import process_recording

from benchmarks.fault_rig import (
    EDGES,
    FAULT_AT_S,
    INSTRUMENTS,
    SECONDS,
    Instrument,
    Row,
    sine_of,
    worst_time_error_s,
)
from benchmarks.process_faults import process_rows
from tests.rigs.resting import resting_bench

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "faults.md"
STUCK_AFTER_S, LEAST_PROGRESS_S = 60.0, 0.5
NOT_JUDGED, SILENT = "not judged", "**SILENT**"


def link_faults(instrument: Instrument) -> dict[str, list[dict[str, Any]]]:
    """Faults on the way from one instrument to the host."""

    def one(kind: str, **options: Any) -> list[dict[str, Any]]:
        return [{"device": "victim", "kind": kind, "at_s": FAULT_AT_S, **options}]

    found = {
        "none": [],
        "late by 0.1 s": one("stall", seconds=0.1),
        "late by 1 s": one("stall", seconds=1.0),
        "late by 2 s": one("stall", seconds=2.0),
        "late by 0.1 s, ten times": [{**one("stall", seconds=0.1)[0], "at_s": FAULT_AT_S + 0.3 * k} for k in range(10)],
        "one byte lost": one("drop_bytes", n_bytes=1),
        "40 bytes lost": one("drop_bytes", n_bytes=40),
        "8 bytes garbled": one("garble_bytes", n_bytes=8),
        "one bit flipped": one("flip_bits", n_bytes=1),
        "whole frames of 12 ms lost": one("silence", seconds=0.012),
        "whole frames of 0.5 s lost": one("silence", seconds=0.5),
        "frames of 12 ms sent twice": one("double_bytes", n_bytes=instrument.n_bytes_12_ms),
        "unplugged for 0.4 s": one("unplug", seconds=0.4),
        "unplugged three times": [{**one("unplug", seconds=0.3)[0], "at_s": FAULT_AT_S + 1.5 * k} for k in range(3)],
        "gone for good": one("unplug", seconds=1e6),
        "silent for good": one("silence", seconds=1e6),
    }
    if not instrument.n_bytes_12_ms:
        # What is asked for, or comes by TCP, is not sent twice; of an edge there is no second one within 12 ms.
        del found["frames of 12 ms sent twice"]
    return found


class _Writer:
    def __init__(self) -> None:
        self.blocks: list[SampleBlock] = []
        self.events: list[Event] = []

    def write_block(self, block: SampleBlock) -> None:
        self.blocks.append(block)

    def write_event(self, event: Event) -> None:
        self.events.append(event)

    def close(self, **_: Any) -> None:
        pass

    def signal(self, channel: str) -> Signal:
        own = [block for block in self.blocks if block.channel == channel]
        time_s, values = (np.concatenate([getattr(b, name) for b in own]) for name in ("time_s", "values"))
        return Signal(channel=channel, unit=own[0].unit, time_s=time_s, values=values)


def run_link_fault(
    instrument: Instrument,
    name: str,
    faults: list[dict[str, Any]],
    *,
    wrong_value: float | None = None,
    observers: tuple[Callable[[Any], object], ...] = (),
    on_the_way: Callable[[bytes, float], bytes] | None = None,
) -> Row:
    """Record with one fault, and compare with the sine; `wrong_value` is what the sensor says for 12 ms."""

    def sensor(channel: str) -> Callable[..., Any]:
        def read(time_s: Any, noise: Any) -> Any:
            values = sine_of(channel, time_s, noise)
            lasts_s = max(0.012, 2.0 / instrument.rate_hz)
            is_wrong = (time_s > FAULT_AT_S) & (time_s < FAULT_AT_S + lasts_s) & (channel == instrument.channel)
            return values if wrong_value is None else np.where(is_wrong, wrong_value, values)

        return read

    behaviour = {channel: sensor(channel) for channel in (instrument.channel, instrument.witness) if channel != EDGES}
    behaviour[SWITCH_CHANNEL] = sensor("displacement_mm")
    writer, config = _Writer(), instrument.config()
    altered = {} if on_the_way is None else {"victim": on_the_way}
    with resting_bench(behaviour, config=config, faults=faults, on_the_way=altered) as rig:
        devices = build_devices(config, rig.ports, clock=rig.clock)
        try:
            # Simulated time waits for nobody's pauses, and where an instrument does not come back it stands still.
            limits = RecorderLimits(queue_length=1)
            with _stopped_where_stuck(rig.clock) as stuck:
                summary = record(
                    devices, writer, seconds=SECONDS, clock=rig.clock, observers=observers, limits=limits, stop=stuck
                )
        except SawbenchError as error:
            return Row(fault=name, lost="all", said=f"refused: {error.what}", time_error_ms=None, is_silent=False)
    if stuck.is_set():
        said = f"{NOT_JUDGED}: simulated time stood still for {STUCK_AFTER_S:g} s"
        return Row(fault=name, lost="-", said=said, time_error_ms=None, is_silent=False)
    return _judged(instrument, name, writer, summary)


@contextlib.contextmanager
def _stopped_where_stuck(clock: Callable[[], float]) -> Iterator[threading.Event]:
    """Give an event that is set once simulated time hardly moves, however slow the machine is."""
    stuck, done = threading.Event(), threading.Event()

    def watch() -> None:
        seen_s = clock()
        while not done.wait(STUCK_AFTER_S):
            if clock() < seen_s + LEAST_PROGRESS_S:
                stuck.set()
            seen_s = clock()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield stuck
    finally:
        done.set()
        thread.join()


def _judged(instrument: Instrument, name: str, writer: _Writer, summary: RecordingSummary) -> Row:
    signals = {channel: writer.signal(channel) for channel in (instrument.channel, instrument.witness)}
    # The last second may hold what waits to be judged; the end is said by its own events.
    marks = [(e.time_s, e.end_s) for e in writer.events if e.kind in {"gap", "warning"} and e.end_s is not None]
    error_s = worst_time_error_s(signals[instrument.channel], signals[instrument.witness], marks, SECONDS)
    true_lost = _lost(instrument, signals[instrument.channel])
    (counted,) = [c.n_missing for c in summary.channels if c.channel == instrument.channel]
    said = [f"{e.kind}: {e.text}" for e in writer.events if e.kind in {"gap", "warning"} or e.text.startswith("link ")]
    processed = process_recording(Recording(trial=Trial(trial_id="t"), signals=signals), BenchConfig())
    doubts = [f"process: {text}" for q in processed.quality for text in q.doubts if "strokes" in text]
    exits = summary.losses or (() if summary.is_complete else ("not complete",))
    # How many there should be of an instrument that is asked is unknown; its times show every pause.
    is_wrong = error_s > instrument.silent_error_s or (abs(true_lost) > 3 and not instrument.is_polled)
    return Row(
        fault=name,
        lost=f"longest pause {_longest_pause_s(signals[instrument.channel]):.2f} s"
        if instrument.is_polled
        else f"{true_lost} samples, counted {counted}",
        said="; ".join([*said, *doubts, *(f"exit 1: {text}" for text in exits)]) or "nothing",
        time_error_ms=1e3 * error_s,
        is_silent=is_wrong and not (said or doubts or exits),
    )


def _lost(instrument: Instrument, signal: Signal) -> int:
    return round(instrument.rate_hz * SECONDS) - len(signal.values)


def _longest_pause_s(signal: Signal) -> float:
    return float(np.max(np.diff(np.append(signal.time_s, SECONDS)), initial=0.0))


def flipped_counter_bit() -> Callable[[bytes, float], bytes]:
    """Turn bit 14 of the counter of one MotorStatus (id 100, 4 bytes, the counter first, low byte first)."""
    left = [1]

    def alter(data: bytes, now_s: float) -> bytes:
        at = data.find(b"t1004") + len(b"t1004") + 2
        if now_s < FAULT_AT_S or b"t1004" not in data or not left:
            return data
        left.clear()
        return data[:at] + b"%X" % (int(data[at : at + 1], 16) ^ 4) + data[at + 1 :]

    return alter


def other_faults(instrument: Instrument) -> list[Row]:
    """Wrong values, a wrong counter, and a live view that fails in the recorder."""

    def dies(_: Any) -> None:
        raise RuntimeError("the viewer died")

    if instrument.is_polled:
        values = []
    elif instrument.name == "dbc_can":
        values = [
            run_link_fault(
                instrument, "bit 14 of the sample counter flipped, once", [], on_the_way=flipped_counter_bit()
            )
        ]
    else:
        values = [run_link_fault(instrument, "12 ms beyond the range of the input", [], wrong_value=instrument.beyond)]
    if instrument.name == "gsv8":
        # Its frames hold floats.
        values.append(run_link_fault(instrument, "12 ms of NaN", [], wrong_value=float("nan")))
    return [*values, run_link_fault(instrument, "an observer of the samples fails", [], observers=(dies,))]


HEAD = """# Faults

What every fault does to every instrument; `python -m benchmarks.fault_matrix` writes this page. Link faults run on
emulated instruments over real ptys in simulated time, at 3 s of 9 s; what goes wrong around the recorder runs in real
time with processes of their own, 2 s into 5 s. The time error is the largest shift of a 10 Hz sine, of both
instruments, outside of what an event marks. "Said" is what the recording's events, the exit code and the processing
say. Silent is a fault that loses more than three samples, or moves times by more than 2.5 ms or three samples, with
nothing said. What is around the recorder is the same for every driver and runs with three of them. Late links in
detail: [arrivals](arrivals.md); cut and altered files: [recording format](recording_format.md).

{summary}

Nothing tells a loss or a doubling of whole frames below about 2.5 ms where the protocol has no counter: the times are
wrong by that much. So it is with five GSV-8 frames lost from the middle of one to the middle of another (40 bytes): the
two halves look like a whole frame. A value changed on the way stands as it is where the protocol has no checksum
(GSV-3, GSV-8, serial CAN adapters). Behind a serial CAN adapter a bus that is off is an instrument that is silent;
other interfaces tell of it. An instrument that is asked for every value (MSC7xxx, Mantracourt ASCII) has no rate: each
value has the time of its own question, and every pause shows in the times. So does a lost edge of an inductive switch
(`edge_times`), whose edges are compared with where the sine passes the switch; one that is silent cannot be told from a
tool at rest, 0 strokes/s. NI and LabJack come through their makers' packages and have no emulator here.
"""


def _table(title: str, rows: list[Row]) -> str:
    lines = [f"## {title}", "", "| fault | lost | time error | said |", "|---|---|---|---|"]
    for row in rows:
        error = "-" if row.time_error_ms is None else f"{row.time_error_ms:.2f} ms"
        said = (f"{SILENT} " if row.is_silent else "") + _short(row.said)
        lines.append(f"| {row.fault} | {row.lost} | {error} | {said} |")
    return "\n".join(lines) + "\n"


def _short(said: str, most: int = 220) -> str:
    """Equal texts once, and no more than fits a line."""
    text = "; ".join(dict.fromkeys(said.replace("|", "/").split("; ")))
    return text if len(text) <= most else text[: most - 1].rsplit(" ", 1)[0] + " …"


def tables_of(instrument: Instrument) -> dict[str, list[Row]]:
    """Run every fault on one instrument; rows by the title of their table."""
    rows = [run_link_fault(instrument, name, faults) for name, faults in link_faults(instrument).items()]
    found = {f"`{instrument.name}`, {instrument.rate_words}": [*rows, *other_faults(instrument)]}
    if instrument.has_processes:
        found[f"`{instrument.name}`: around the recorder"] = process_rows(instrument)
    return found


def _tables_of(page: Path) -> dict[str, str]:
    """Return the tables that a page holds, by title."""
    parts = page.read_text(encoding="utf-8").split("\n## ")[1:] if page.exists() else []
    return {part.splitlines()[0]: f"## {part.rstrip()}\n" for part in parts}


def main() -> None:
    """Run every fault on every instrument and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PAGE)
    parser.add_argument("--only", help="instruments, with commas between them; the page keeps the tables of the others")
    parser.add_argument("--jobs", type=int, default=1, help="instruments at a time")
    options = parser.parse_args()
    wanted = options.only.split(",") if options.only else [instrument.name for instrument in INSTRUMENTS]
    instruments = [instrument for instrument in INSTRUMENTS if instrument.name in wanted]
    tables = _tables_of(options.out) if options.only else {}
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for instrument, found in zip(instruments, pool.map(tables_of, instruments), strict=True):
            tables |= {title: _table(title, rows) for title, rows in found.items()}
            print(instrument.name, "done", flush=True)
    order = [instrument.name for instrument in INSTRUMENTS]
    texts = [tables[title] for title in sorted(tables, key=lambda title: order.index(title.split("`")[1]))]
    rows = [line for text in texts for line in text.splitlines()[4:]]
    n_silent, n_open = (sum(word in row for row in rows) for word in (SILENT, NOT_JUDGED))
    judged = f"Of {len(rows) - n_open} faults, {n_silent} {'is' if n_silent == 1 else 'are'} silent."
    summary = f"{judged} {n_open} were not judged." if n_open else judged
    options.out.write_text("\n".join([HEAD.format(summary=summary), *texts]), encoding="utf-8")
    print(f"{options.out}: {summary}")


if __name__ == "__main__":
    main()
