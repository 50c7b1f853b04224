"""Signals of a DBC file, read from whole batches of frames at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.transports.can_batch import EXTENDED_FLAG
from sawbench.bench.errors import ConfigError, InputError

if TYPE_CHECKING:
    from cantools.database.can import Database, Message
    from cantools.database.can.signal import Signal as DbcSignal

SHIPPED_DBC_DIRECTORY: Final = Path(__file__).parent / "devices"
# J1939: priority and source address are not part of what a message is.
_J1939_PGN_MASK: Final = 0x03FFFF00
J1939_SOURCE_MASK: Final = 0xFF
_J1939_PDU2: Final = 0xF0


def load_dbc(path: str | Path) -> Database:
    """Read a DBC file; a bare name of a shipped one (`jigsaw_bench.dbc`) is found too.

    Raises
    ------
    ConfigError
        If it is missing or is not a DBC.
    """
    import cantools

    given = Path(path)
    shipped = SHIPPED_DBC_DIRECTORY / given.name
    file = shipped if not given.exists() and given.parent == Path() and shipped.exists() else given
    try:
        database = cantools.database.load_file(file, strict=False)
    except FileNotFoundError:
        raise ConfigError(
            "no such DBC file", where=given, remedy="correct `dbc`; the package includes jigsaw_bench.dbc"
        ) from None
    except Exception as error:
        # cantools raises a different class for every kind of malformed file, some of them bare Exceptions.
        raise ConfigError(f"is not a readable DBC: {error}", where=given) from error
    if not hasattr(database, "messages"):
        raise ConfigError("contains no CAN messages", where=given)
    return cast("Database", database)


def find_signal(database: Database, path: str, *, where: str) -> tuple[Message, DbcSignal]:
    """Find `Message.Signal`, or `Signal` where one message alone has it.

    Raises
    ------
    ConfigError
        If there is none, or several.
    """
    message_name, _, signal_name = path.rpartition(".")
    found = [
        (message, signal)
        for message in database.messages
        for signal in message.signals
        if signal.name == signal_name and message_name in {"", message.name}
    ]
    if len(found) == 1:
        return found[0]
    known = sorted(f"{m.name}.{s.name}" for m in database.messages for s in m.signals)
    if found:
        raise ConfigError(
            f"signal {path!r} is in {len(found)} messages: {', '.join(m.name for m, _ in found)}",
            where=where,
            remedy="write it as Message.Signal",
        )
    import difflib

    close = difflib.get_close_matches(path, known, n=3, cutoff=0.4)
    raise ConfigError(
        f"the DBC has no signal {path!r}",
        where=where,
        remedy=f"did you mean {', '.join(close)}?" if close else f"it has {', '.join(known[:20])}",
    )


def frame_mask(message: Message) -> tuple[int, int]:
    """Mask and value that an identifier (bit 31: extended) must match to be `message`."""
    identifier = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
    if message.protocol == "j1939" and message.is_extended_frame:
        mask = _J1939_PGN_MASK | EXTENDED_FLAG
        if (message.frame_id >> 16) & 0xFF < _J1939_PDU2:
            # PDU1: the lower byte of the group number is a destination, not part of it.
            mask &= ~0xFF00
        return mask, identifier & mask
    return 0xFFFFFFFF, identifier


def raw_signal(signal: DbcSignal, payload: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Extract the unscaled number of `signal` from payloads.

    Parameters
    ----------
    signal : cantools Signal
        At most 64 bits within 8 bytes, integer or IEEE float of 32 or 64 bits.
    payload : ndarray of uint8, shape (n, n_bytes)
        At least 8 bytes; zero beyond the frame.

    Returns
    -------
    ndarray, shape (n,)
        Integers are exact up to 53 bits.

    Raises
    ------
    InputError
        If the signal lies in more than 8 bytes, or beyond the payload.
    """
    is_little = signal.byte_order == "little_endian"
    # Motorola start bit: byte * 8 + bit, where bit 7 is the first on the wire.
    first_bit = signal.start if is_little else 8 * (signal.start // 8) + (7 - signal.start % 8)
    first_byte = max(0, min(first_bit // 8, payload.shape[1] - 8))
    bit = first_bit - 8 * first_byte
    shift = bit if is_little else 64 - bit - signal.length
    if shift < 0 or shift + signal.length > 64:
        raise InputError(
            f"signal {signal.name} lies in more than 8 bytes, or beyond a frame of {payload.shape[1]} bytes"
        )
    window = np.ascontiguousarray(payload[:, first_byte : first_byte + 8])
    words = window.view("<u8" if is_little else ">u8")[:, 0]
    mask = np.uint64((1 << signal.length) - 1)
    bits = (words.astype(np.uint64) >> np.uint64(shift)) & mask
    if signal.is_float:
        if signal.length == 32:
            with np.errstate(invalid="ignore"):
                return bits.astype(np.uint32).view(np.float32).astype(np.float64)
        return bits.view(np.float64)
    if signal.is_signed:
        wide = (bits << np.uint64(64 - signal.length)).view(np.int64) >> np.int64(64 - signal.length)
        return wide.astype(np.float64)
    return bits.astype(np.float64)


def multiplexers(signal: DbcSignal, message: Message) -> list[tuple[DbcSignal, list[int]]]:
    """Multiplexers that decide whether a frame holds `signal`, innermost first, with the values at which it does."""
    found: list[tuple[DbcSignal, list[int]]] = []
    while signal.multiplexer_signal is not None:
        values = list(signal.multiplexer_ids or [])
        signal = message.get_signal_by_name(signal.multiplexer_signal)
        found.append((signal, values))
    return found


def is_available(signal: DbcSignal, message: Message, raw: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where a number is a measurement: the top of the range of J1939 means "error" or "not available"."""
    if message.protocol != "j1939" or signal.is_float or signal.is_signed or signal.length < 8:
        return np.isfinite(raw)
    top_byte = 1 << (signal.length - 8)
    return raw < 0xFB * top_byte


def counts_of(signal: DbcSignal) -> tuple[int, int]:
    """First count of a counter, unscaled, and how many there are: its stated range, else all that its bits can say.

    Many counters leave some out: that of AUTOSAR's E2E profile 1 has 4 bits and runs from 0 to 14.
    """
    n_counts = 1 << signal.length
    first = -(n_counts // 2) if signal.is_signed else 0
    if signal.minimum is None or signal.maximum is None or signal.minimum >= signal.maximum:
        return first, n_counts
    low, high = sorted(round((end - signal.offset) / signal.scale) for end in (signal.minimum, signal.maximum))
    is_possible = first <= low and high < first + n_counts
    return (low, high - low + 1) if is_possible else (first, n_counts)


def needed_length(signals: list[DbcSignal]) -> int:
    """Bytes a frame must have to hold all `signals`."""
    last_bits = []
    for signal in signals:
        if signal.byte_order == "little_endian":
            last_bits.append(signal.start + signal.length - 1)
        else:
            last_bits.append(8 * (signal.start // 8) + (7 - signal.start % 8) + signal.length - 1)
    return max(last_bits) // 8 + 1
