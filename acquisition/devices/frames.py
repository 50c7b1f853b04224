"""Frames of fixed length from an instrument -> numbers: sync bytes, fields, checksum, end bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.row_instrument import Rows

Bytes = NDArray[np.uint8]
_NUMPY_TYPES: Final = MappingProxyType(
    {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "l": "i4", "L": "u4"}
    | {"q": "i8", "Q": "u8", "f": "f4", "d": "f8", "x": "V1"}
)
# So many frames in a row make a new beginning: without a checksum the sync bytes may stand in the numbers too.
_TO_LOCK_CHECKED: Final = 1
_TO_LOCK_UNCHECKED: Final = 3


def _crc16(rows: Bytes, polynomial: int, *, is_reflected: bool) -> NDArray[np.int64]:
    """CRC of 16 bits of every row, beginning with FFFF."""
    value = np.full(len(rows), 0xFFFF, dtype=np.int64)
    for column in rows.T.astype(np.int64):
        value ^= column if is_reflected else column << 8
        for _ in range(8):
            if is_reflected:
                value = np.where(value & 1, (value >> 1) ^ polynomial, value >> 1)
            else:
                value = np.where(value & 0x8000, (value << 1) ^ polynomial, value << 1) & 0xFFFF
    return value


# Name -> (bytes, function of the rows that are summed)
CHECKSUMS: Final[Mapping[str, tuple[int, Callable[[Bytes], NDArray[np.int64]]]]] = MappingProxyType(
    {
        "sum8": (1, lambda rows: rows.astype(np.int64).sum(axis=1) % 256),
        "xor8": (1, lambda rows: np.bitwise_xor.reduce(rows.astype(np.int64), axis=1)),
        "sum16": (2, lambda rows: rows.astype(np.int64).sum(axis=1) % 65536),
        # Polynomial 8005, reflected, FFFF first: Modbus. Polynomial 1021, FFFF first: CCITT-FALSE.
        "crc16_modbus": (2, lambda rows: _crc16(rows, 0xA001, is_reflected=True)),
        "crc16_ccitt": (2, lambda rows: _crc16(rows, 0x1021, is_reflected=False)),
    }
)


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    r"""Sync bytes, fields, checksum, end bytes, in this order.

    Attributes
    ----------
    sync, end : bytes
    fields : str
        As Python's `struct` writes them, byte order first: `<Hhh`, `>4f`; `x` is a byte that means nothing.
    columns : tuple of int
        Fields to read, from 1; bytes `x` are not counted.
    checksum : str
        Of `CHECKSUMS`, in the byte order of the fields; "" where there is none.
    covers_sync : bool
        Whether the checksum covers the sync bytes too.

    Examples
    --------
    >>> frame = FrameFormat(sync=b"\xaaU", fields="<Bhh", columns=(3, 1), checksum="sum8")
    >>> frame.n_bytes, frame.n_fields
    (8, 3)
    """

    sync: bytes
    fields: str
    columns: tuple[int, ...]
    checksum: str = ""
    covers_sync: bool = False
    end: bytes = b""

    @cached_property
    def field_types(self) -> tuple[str, ...]:
        """Type of each field in numpy's words, bytes `x` among them.

        Raises
        ------
        ValueError
            If `fields` holds anything that is not a number of fixed length.
        """
        order, text = self.fields[:1], self.fields[1:]
        if order not in {"<", ">"}:
            raise ValueError(f"begins with {order!r}: it must begin with < (low byte first) or > (high byte first)")
        types: list[str] = []
        count = ""
        for character in text.replace(" ", ""):
            if character.isdigit():
                count += character
            elif character in _NUMPY_TYPES:
                types += [order + _NUMPY_TYPES[character]] * int(count or 1)
                count = ""
            else:
                raise ValueError(f"holds {character!r}; fields are {', '.join(_NUMPY_TYPES)}")
        if count or not types:
            raise ValueError("has a number without a field" if count else "has no field")
        return tuple(types)

    @property
    def n_fields(self) -> int:
        """Number of fields that are numbers."""
        return sum("V" not in kind for kind in self.field_types)

    @property
    def n_bytes(self) -> int:
        """Length of a frame."""
        return len(self.sync) + struct.calcsize(self.fields) + self._n_check + len(self.end)

    def is_whole(self, rows: Bytes) -> NDArray[np.bool_]:
        """Whether each row is a frame.

        Parameters
        ----------
        rows : ndarray of uint8, shape (n, n_bytes)
        """
        body_end = self.n_bytes - len(self.end) - self._n_check
        is_whole = np.all(rows[:, : len(self.sync)] == np.frombuffer(self.sync, np.uint8), axis=1)
        if self.end:
            is_whole &= np.all(rows[:, -len(self.end) :] == np.frombuffer(self.end, np.uint8), axis=1)
        if self.checksum:
            n, of = CHECKSUMS[self.checksum]
            sent = np.ascontiguousarray(rows[:, body_end : body_end + n]).view(f"{self.fields[0]}u{n}")[:, 0]
            is_whole &= of(rows[:, 0 if self.covers_sync else len(self.sync) : body_end]) == sent
        return is_whole

    def numbers(self, rows: Bytes) -> NDArray[np.float64]:
        """Return the fields of `columns`, shape (n, n_columns)."""
        types = [(f"{'x' if 'V' in kind else 'f'}{k}", kind) for k, kind in enumerate(self.field_types)]
        begin = len(self.sync)
        body = np.ascontiguousarray(rows[:, begin : begin + struct.calcsize(self.fields)])
        table = body.view(np.dtype(types))[:, 0]
        names = [name for name, _ in types if name.startswith("f")]
        return np.stack([table[names[column - 1]].astype(np.float64) for column in self.columns], axis=1)

    @property
    def _n_check(self) -> int:
        return CHECKSUMS[self.checksum][0] if self.checksum else 0


class FrameFramer:
    """Bytes in, numbers out; finds the frames again after bytes were lost or garbled.

    Notes
    -----
    Frames that follow each other are taken together. Behind a break the next beginning is where the sync bytes and the
    checksum fit, or without a checksum where three frames stand in a row; the frame before such a break is then dropped
    too, as it may hold bytes of the next. What cannot be told without a checksum: a garbled number.

    Examples
    --------
    >>> frame = FrameFormat(sync=b"U", fields="<h", columns=(1,), checksum="xor8")
    >>> FrameFramer(frame).feed(bytes.fromhex("55 0100 01  aa  55 ff00 ff"))
    [Rows(values=array([[1.]]), n_lost=0), Rows(values=array([[255.]]), n_lost=1)]
    """

    def __init__(self, frame_format: FrameFormat) -> None:
        self._format = frame_format
        self._length = frame_format.n_bytes
        self._n_to_lock = _TO_LOCK_CHECKED if frame_format.checksum else _TO_LOCK_UNCHECKED
        self._buffer = b""
        self._is_locked = False
        self._had_frame = False
        self._n_skipped = 0
        self.n_discarded_bytes = 0

    def feed(self, received: bytes) -> list[Rows]:
        """Return the frames that `received` completes."""
        self._buffer += received
        pieces: list[Rows] = []
        while len(self._buffer) >= self._length * (1 if self._is_locked else self._n_to_lock):
            whole = len(self._buffer) // self._length * self._length
            rows = np.frombuffer(self._buffer, np.uint8, whole).reshape(-1, self._length)
            is_whole = self._format.is_whole(rows)
            n_good = len(rows) if is_whole.all() else int(np.argmin(is_whole))
            if not self._is_locked and n_good < self._n_to_lock:
                self._skip()
                continue
            is_broken = n_good < len(rows)
            n_taken = n_good - 1 if is_broken and not self._format.checksum else n_good
            if n_taken > 0:
                pieces.append(self._piece(rows[:n_taken]))
            self._buffer = self._buffer[max(n_taken, 0) * self._length :]
            self._is_locked = not is_broken
            if is_broken:
                self._skip()
        return pieces

    def _skip(self) -> None:
        """Go on to the next place where the sync bytes stand, or could begin."""
        at = self._buffer.find(self._format.sync, 1)
        if at < 0:
            keep = len(self._format.sync) - 1
            at = max(1, len(self._buffer) - keep)
        self._buffer = self._buffer[at:]
        self._n_skipped += at
        self.n_discarded_bytes += at

    def _piece(self, rows: Bytes) -> Rows:
        n_lost = -(-self._n_skipped // self._length) if self._had_frame else 0
        self._had_frame, self._n_skipped = True, 0
        return Rows(self._format.numbers(rows), n_lost)
