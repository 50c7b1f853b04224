"""Logged CAN frames and a DBC -> a recording: candump `.log`, Vector `.asc` and `.blf`, MF4 bus logs."""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.can_signals import (
    find_signal,
    frame_mask,
    is_available,
    load_dbc,
    multiplexers,
    needed_length,
    raw_signal,
)
from sawbench.acquisition.can_text_logs import read_asc, read_candump
from sawbench.acquisition.transports.can_batch import EXTENDED_FLAG
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, Gap, Recording, Signal, Trial

if TYPE_CHECKING:
    import can
    from cantools.database.can import Database, Message
    from cantools.database.can.signal import Signal as DbcSignal

SUFFIXES: Final = (".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".mf4")
# Frames of a cyclic message that come this many periods late have others missing before them.
_GAP_PERIODS: Final = 5.0
# A frame with more is one of CAN FD.
_CLASSIC_BYTES: Final = 8
_YEAR_2000_S: Final = 946_684_800.0


class _Frames(NamedTuple):
    time_s: NDArray[np.float64]
    identifier: NDArray[np.uint32]
    length: NDArray[np.int64]
    payload: NDArray[np.uint8]
    bus: NDArray[np.str_]

    @property
    def sender(self) -> NDArray[np.str_]:
        """Bus and identifier of each frame."""
        return np.char.add(np.char.add(self.bus, " "), self.identifier.astype(str))

    def where(self, mask: NDArray[np.bool_]) -> _Frames:
        """Return the frames for which `mask` is true."""
        return _Frames(self.time_s[mask], self.identifier[mask], self.length[mask], self.payload[mask], self.bus[mask])


class _Wanted(NamedTuple):
    name: str
    message: Message
    signal: DbcSignal


def is_can_log(path: str | Path) -> bool:
    """Whether the name says that the file holds CAN frames (an `.mf4` may also hold signals).

    Examples
    --------
    >>> is_can_log("drive.log.gz"), is_can_log("trial.csv")
    (True, False)
    """
    return str(path).lower().endswith(SUFFIXES)


def decode_can_log(
    path: str | Path,
    dbc_path: str | Path,
    signals: Mapping[str, str] | None = None,
    *,
    bus: str | None = None,
) -> Recording:
    """Decode a log of CAN frames.

    Parameters
    ----------
    path : str or Path
        Log; its suffix says the format, see `SUFFIXES`.
    dbc_path : str or Path
    signals : mapping of str to str, optional
        Channel -> `Message.Signal`. Without it every numeric signal that occurs, named `Message.Signal`.
    bus : str, optional
        Bus of the log to read; by default, for each message, the one that carries most of its frames.

    Returns
    -------
    Recording
        Time 0 is the first frame of the log. A log that is cut off gives the frames before, and is not complete. Frames
        of J1939 are matched by parameter group, whatever their priority and source; where several sources send a group,
        the most frequent one is taken and an event says so.

    Raises
    ------
    InputError
        If the log cannot be read, is empty, or holds none of the signals.
    ConfigError
        If the DBC is missing or has no such signal.
    """
    path = Path(path)
    database = load_dbc(dbc_path)
    wanted = _wanted(database, signals, str(dbc_path))
    frames, start_s, damage = _read_frames(path)
    if bus is not None:
        if bus not in frames.bus:
            raise InputError(f"has no bus {bus!r}; it has {', '.join(np.unique(frames.bus))}", where=path)
        frames = frames.where(frames.bus == bus)
    events: list[Event] = list(damage)
    frames = _of_described_length(frames, database, events)
    events += _clock_set_back(frames)
    found: dict[str, Signal] = {}
    for item in wanted:
        signal = _decode(item, frames, events)
        if signal is not None:
            found[item.name] = signal
        elif signals is not None:
            raise InputError(
                f"contains no frame of {item.message.name} with a value of {item.signal.name}",
                where=path,
                remedy="check that log and DBC belong together",
            )
    if not found:
        raise InputError("contains no frame that the DBC describes", where=path, remedy="use another DBC")
    started_at = datetime.fromtimestamp(start_s, UTC) if start_s > _YEAR_2000_S else None
    return Recording(
        trial=Trial(trial_id=path.name.split(".")[0], started_at=started_at, source=f"import of {path.name}"),
        signals=found,
        events=tuple(events),
        provenance={
            "dbc": Path(dbc_path).name,
            "clock": "time stamps of the log, 0 at its first frame; channels are aligned as the logger did",
        },
        is_complete=not damage,
        path=str(path),
    )


def _wanted(database: Database, signals: Mapping[str, str] | None, where: str) -> list[_Wanted]:
    if signals is not None:
        return [_Wanted(name, *find_signal(database, path, where=where)) for name, path in signals.items()]
    # What is wider than 64 bits is text.
    return [_Wanted(f"{m.name}.{s.name}", m, s) for m in database.messages for s in m.signals if s.length <= 64]


def _read_frames(path: Path) -> tuple[_Frames, float, list[Event]]:
    """Frames, the time of the first one, and where the log is damaged."""
    if not path.exists():
        raise InputError("no such file", where=path)
    if not is_can_log(path):
        raise InputError(
            f"is not a CAN log; suffixes are {', '.join(SUFFIXES)}", where=path, remedy="use the suffix of its format"
        )
    rows: list[tuple[float, int, int, bytes, str]] = []
    damage: list[Event] = []
    try:
        with _open_log(path) as reader:
            for m in reader:
                if m.is_error_frame or m.is_remote_frame:
                    continue
                identifier = m.arbitration_id | (EXTENDED_FLAG if m.is_extended_id else 0)
                rows.append((m.timestamp, identifier, len(m.data), bytes(m.data), str(m.channel)))
    except Exception as error:
        # The readers raise whatever their parsing runs into: ValueError, IndexError, struct.error, their own
        # classes.
        if not rows:
            what, remedy = str(error), "check that the suffix fits the content"
            if isinstance(error, InputError):
                what, remedy = error.what, error.remedy
            raise InputError(f"cannot be read as a CAN log: {what}", where=path, remedy=remedy) from error
        last_s = rows[-1][0] - min(row[0] for row in rows)
        text = f"the log is cut off or damaged after {len(rows)} frames"
        damage.append(Event(kind="interrupted", time_s=last_s, text=text))
    if not rows:
        raise InputError("contains no CAN frames", where=path)
    time_s, identifiers, lengths, payloads, buses = zip(*rows, strict=True)
    absolute_s = np.array(time_s)
    start_s = float(absolute_s.min())
    n_bytes = max(_CLASSIC_BYTES, *lengths)
    frames = _Frames(
        time_s=absolute_s - start_s,
        identifier=np.array(identifiers, dtype=np.uint32),
        length=np.array(lengths),
        payload=np.frombuffer(b"".join(p.ljust(n_bytes, b"\0") for p in payloads), dtype=np.uint8).reshape(-1, n_bytes),
        bus=np.array(buses),
    )
    return frames, start_s, damage


@contextmanager
def _open_log(path: Path) -> Iterator[Iterable[can.Message]]:
    from can.io.blf import BLFReader
    from can.io.mf4 import MF4Reader

    name = path.name.lower()
    with ExitStack() as stack:
        if name.endswith((".blf", ".mf4")):
            reader = (BLFReader if name.endswith(".blf") else MF4Reader)(path)
            stack.callback(reader.stop)
            yield reader
        else:
            file = stack.enter_context(cast("BinaryIO", (gzip.open if name.endswith(".gz") else open)(path, "rb")))
            yield (read_asc if ".asc" in name else read_candump)(file)


def _of_described_length(frames: _Frames, database: Database, events: list[Event]) -> _Frames:
    """Leave out frames of more than 8 bytes that are of no message of that kind."""
    is_wanted = frames.length <= _CLASSIC_BYTES
    if is_wanted.all():
        return frames
    for message in database.messages:
        if message.length > _CLASSIC_BYTES:
            is_wanted |= _is_of(message, frames)
    if n_others := int((~is_wanted).sum()):
        text = f"{n_others} frames of CAN FD with more than 8 bytes left out: the DBC has no such message"
        events.append(Event(kind="warning", time_s=0.0, text=text))
    return frames.where(is_wanted)


def _clock_set_back(frames: _Frames) -> list[Event]:
    """Say where the stamps go back: a log holds the frames of one sender as they were sent."""
    names, sender = np.unique(frames.sender, return_inverse=True)
    order = np.argsort(sender, kind="stable")
    found: list[tuple[float, float]] = []
    for time_s in np.split(frames.time_s[order], np.cumsum(np.bincount(sender, minlength=len(names)))[:-1]):
        step_s = np.diff(time_s)
        if (step_s < 0).any():
            # Less than a period is jitter of the stamps.
            period_s = float(np.median(np.abs(step_s[step_s != 0])))
            found += [(float(time_s[k]), -float(step_s[k])) for k in np.flatnonzero(step_s < -period_s)]
    if not found:
        return []
    at_s, back_s = min(found)[0], max(back for _, back in found)
    text = (
        f"the time stamps go back by up to {back_s:.3f} s, first behind {at_s:.3f} s, as where a clock was set back:"
        " frames from before and after it are mixed; split the log there"
    )
    return [Event(kind="warning", time_s=at_s, text=text)]


def _is_of(message: Message, frames: _Frames) -> NDArray[np.bool_]:
    mask, value = frame_mask(message)
    return (frames.identifier & np.uint32(mask)) == np.uint32(value)


def _decode(item: _Wanted, frames: _Frames, events: list[Event]) -> Signal | None:
    selectors = multiplexers(item.signal, item.message)
    n_bytes = needed_length([item.signal, *(selector for selector, _ in selectors)])
    is_ours = _is_of(item.message, frames) & (frames.length >= n_bytes)
    if not is_ours.any():
        return None
    is_ours &= _most_frequent_sender(item, frames, is_ours, events)
    payload, time_s = frames.payload[is_ours], frames.time_s[is_ours]
    raw = raw_signal(item.signal, payload)
    is_good = is_available(item.signal, item.message, raw)
    for selector, ids in selectors:
        is_good &= np.isin(raw_signal(selector, payload), ids)
    order = np.argsort(time_s[is_good], kind="stable")
    time_s, raw = time_s[is_good][order], raw[is_good][order]
    is_later = np.concatenate(([True], np.diff(time_s) > 0))[: len(time_s)]
    if not is_later.all():
        text = f"{item.name}: {int((~is_later).sum())} frames with the time stamp of their predecessor left out"
        events.append(Event(kind="warning", time_s=0.0, text=text, channel=item.name))
        time_s, raw = time_s[is_later], raw[is_later]
    values = raw * float(item.signal.scale) + float(item.signal.offset)
    if not len(values):
        return None
    return Signal(
        channel=item.name,
        unit=item.signal.unit or "",
        time_s=time_s,
        values=values,
        raw=raw,
        gaps=_gaps(time_s),
        device=item.message.name,
    )


def _most_frequent_sender(
    item: _Wanted, frames: _Frames, is_ours: NDArray[np.bool_], events: list[Event]
) -> NDArray[np.bool_]:
    """Mask of the (bus, identifier) that sends most of it: two senders must not become one channel."""
    senders = frames.sender
    names, counts = np.unique(senders[is_ours], return_counts=True)
    chosen = names[int(np.argmax(counts))]
    if len(names) > 1:
        bus, identifier = chosen.rsplit(" ", 1)
        shown = f"{int(identifier) & ~EXTENDED_FLAG:X}"
        share = f"{counts.max()} of {counts.sum()} frames"
        text = f"{item.name}: {len(names)} senders; taken is {shown} on bus {bus}, {share}"
        events.append(Event(kind="warning", time_s=0.0, text=text, channel=item.name))
    return senders == chosen


def _gaps(time_s: NDArray[np.float64]) -> tuple[Gap, ...]:
    step_s = np.diff(time_s)
    if len(step_s) < 2:
        return ()
    period_s = float(np.median(step_s))
    return tuple(
        Gap(
            start_s=float(time_s[k]),
            end_s=float(time_s[k + 1]),
            n_missing=round(float(step_s[k]) / period_s) - 1,
            reason="no frame in the log",
        )
        for k in np.flatnonzero(step_s > _GAP_PERIODS * period_s)
    )
