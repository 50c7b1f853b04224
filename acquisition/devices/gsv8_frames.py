"""Frames of the ME-Systeme GSV-8 (and GSV-6) on its serial interface: pure bytes in, samples out.

A frame is `AA`, b1, b2, payload, `85`. b1: bits 7-6 frame type (0 measured values, 1 answer, 2 request), bits
5-4 interface (1 serial), bits 3-0 number of values - 1 (measured values) or payload length (answer, request).
b2 of measured values: bit 7 set, bits 6-4 bytes a value - 1 (1 int16, 2 int24, 3 float32), bit 1 six-axis
error, bit 0 input overload; of an answer: error code, 0 = done, 1 = done with a changed parameter; of a
request: command number. All numbers are big-endian; integers are in binary offset format. Facts from the
maker's public Python library gsv86lib and the header of its DLL (MEGSV86x64.h). Frames carry neither counter
nor checksum.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

DataType = Literal["int16", "int24", "float32"]
BYTES_PER_VALUE: Final = {"int16": 2, "int24": 3, "float32": 4}
SYNC: Final = 0xAA
END: Final = 0x85
_ANSWER: Final = 0x50
_REQUEST: Final = 0x90
_MEASURED: Final = 0x10
ERROR_TEXT: Final = {
    0x40: "command unknown",
    0x41: "command not supported by this model",
    0x42: "frame malformed",
    0x50: "wrong parameter",
    0x51: "wrong index or address",
    0x52: "wrong data",
    0x53: "wrong bits in a parameter",
    0x54: "value too large",
    0x55: "value too small",
    0x56: "parameters are not compatible",
    0x57: "value too large for the other settings",
    0x58: "value too small for the other settings",
    0x59: "parameter not supported",
    0x5A: "parameters were received too late",
    0x5B: "wrong number of parameters",
    0x5C: "parameter does not fit the settings",
    0x5E: "memory is in the wrong state",
    0x5F: "memory access denied",
    0x70: "access denied",
    0x71: "writing is blocked",
    0x72: "password wrong or missing",
    0x74: "too many writes",
    0x75: "this interface has no write access",
    0x80: "internal error",
    0x81: "arithmetic error",
    0x82: "converter error",
    0x83: "measured value invalid",
    0x84: "EEPROM error",
    0x91: "send buffer full",
    0x92: "busy",
    0x99: "receive buffer full",
}


class Answer(NamedTuple):
    """Answer to a request.

    Attributes
    ----------
    error : int
        0 done, 1 done with a changed parameter, otherwise a key of `ERROR_TEXT`.
    payload : bytes
    """

    error: int
    payload: bytes


class Piece(NamedTuple):
    """Measured values that followed each other without a break.

    Attributes
    ----------
    raw : ndarray, shape (n, n_values)
    n_lost : int
        Frames lost before the first one; a lower bound unless `is_loss_exact`.
    is_loss_exact : bool
    n_behind : int
        Bytes received behind its last frame so far.
    """

    raw: NDArray[np.float64]
    n_lost: int
    is_loss_exact: bool
    n_behind: int


def request(command: int, parameters: bytes = b"") -> bytes:
    """Build a request frame.

    Examples
    --------
    >>> request(0x23).hex(" ")
    'aa 90 23 85'
    """
    if len(parameters) > 15:
        raise ValueError(f"a request holds at most 15 parameter bytes, got {len(parameters)}")
    return bytes((SYNC, _REQUEST | len(parameters), command)) + parameters + bytes((END,))


class Gsv8Framer:
    """Find the frames in a byte stream, and find them again after bytes were lost or garbled.

    Parameters
    ----------
    n_values : int
        Values in each frame, 1..16.
    data_type : {"int16", "int24", "float32"}
    full_scale : float
        What the largest integer stands for, in the raw unit (of no meaning for float32).

    Notes
    -----
    `AA` and `85` may occur in the payload, so neither is searched for while frames follow each other: the
    next one must begin where the last ended. When that fails, a new beginning is accepted only where two
    whole frames stand one behind the other. What lies between is counted as discarded. A frame whose payload
    alone was garbled cannot be told from a good one; the recorder drops what no sensor can mean.

    Examples
    --------
    >>> framer = Gsv8Framer(n_values=1, data_type="float32")
    >>> pieces = framer.feed(bytes.fromhex("aa10b03f80000085" "aa10b04000000085"))
    >>> pieces[0].raw[:, 0]
    array([1., 2.])
    """

    def __init__(self, *, n_values: int, data_type: DataType, full_scale: float = 1.0) -> None:
        if not 1 <= n_values <= 16:
            raise ValueError(f"a frame holds 1..16 values, got {n_values}")
        self._data_type: DataType = data_type
        self._n_values = n_values
        self._full_scale = full_scale
        self._b1 = _MEASURED | (n_values - 1)
        self._b2 = 0x80 | (BYTES_PER_VALUE[data_type] - 1) << 4
        self._length = 4 + n_values * BYTES_PER_VALUE[data_type]
        self._buffer = bytearray()
        self._in_step = False
        self._had_frame = False
        self._skipped = 0
        self.answers: list[Answer] = []
        self.n_discarded_bytes = 0
        self.n_overloads = 0

    def feed(self, received: bytes) -> list[Piece]:
        """Return the measured values completed by `received`; answers are appended to `answers`."""
        self._buffer += received
        pieces: list[Piece] = []
        at = 0
        while True:
            before = at
            at = self._take_frames(at, pieces) if self._in_step else self._search(at)
            if at == before and not self._changed:
                break
        del self._buffer[:at]
        return pieces

    def _take_frames(self, at: int, pieces: list[Piece]) -> int:
        self._changed = False
        n_whole = (len(self._buffer) - at) // self._length
        n_good = 0
        if n_whole:
            whole = bytes(self._buffer[at : at + n_whole * self._length])
            rows = np.frombuffer(whole, dtype=np.uint8).reshape(n_whole, self._length)
            good = self._looks_measured(rows)
            n_good = n_whole if good.all() else int(np.argmin(good))
            at += n_good * self._length
            if n_good:
                pieces.append(self._piece(rows[:n_good], n_behind=len(self._buffer) - at))
        answer_length = self._answer_at(at)
        if answer_length > 0:
            self._changed = True
            return at + answer_length
        if answer_length == 0 and n_good < n_whole:
            self._in_step = False
            self._changed = True
        return at

    def _search(self, at: int) -> int:
        """Move to the next place where frames begin; get into step there."""
        self._changed = False
        start = at
        while True:
            found = self._buffer.find(SYNC, at)
            if found < 0:
                return self._skip(start, len(self._buffer))
            answer_length = self._answer_at(found)
            if answer_length > 0:
                self._skip(start, found)
                self._changed = True
                return found + answer_length
            begins = self._begins_frames(found)
            if begins is None or answer_length < 0:
                return self._skip(start, found)
            if begins:
                self._in_step = True
                self._changed = True
                return self._skip(start, found)
            at = found + 1

    def _begins_frames(self, at: int) -> bool | None:
        """Whether two frames of values (or one and an answer) begin at `at`; None: too few bytes to tell."""
        frame = self._buffer[at : at + self._length]
        rest = len(self._buffer) - at
        if not self._fits(frame):
            return False
        if rest < self._length:
            return None
        following = self._buffer[at + self._length : at + 2 * self._length]
        if self._answer_at(at + self._length) > 0:
            return True
        if not self._fits(following):
            return False
        return True if rest >= 2 * self._length else None

    def _fits(self, frame: bytearray) -> bool:
        """Whether `frame`, perhaps cut short, agrees with a measured-value frame as far as it goes."""
        n = len(frame)
        return not (
            (n > 0 and frame[0] != SYNC)
            or (n > 1 and frame[1] != self._b1)
            or (n > 2 and frame[2] & 0xF0 != self._b2)
            or (n >= self._length and frame[self._length - 1] != END)
        )

    def _answer_at(self, at: int) -> int:
        """Length of the answer frame at `at`, taken over; 0: none there; -1: perhaps, more bytes needed."""
        buffer = self._buffer
        head = buffer[at : at + 3]
        could_be = (
            head[:1] == bytes((SYNC,))
            and (len(head) < 2 or head[1] & 0xF0 == _ANSWER)
            and (len(head) < 3 or head[2] <= 1 or head[2] in ERROR_TEXT)
        )
        if not could_be:
            return 0
        n_payload = head[1] & 0x0F if len(head) > 1 else 0
        if len(buffer) - at < 4 + n_payload:
            return -1
        if buffer[at + 3 + n_payload] != END:
            return 0
        self.answers.append(Answer(buffer[at + 2], bytes(buffer[at + 3 : at + 3 + n_payload])))
        return 4 + n_payload

    def _skip(self, start: int, end: int) -> int:
        self.n_discarded_bytes += end - start
        self._skipped += end - start
        return end

    def _looks_measured(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_]:
        return (
            (rows[:, 0] == SYNC)
            & (rows[:, 1] == self._b1)
            & (rows[:, 2] & 0xF0 == self._b2)
            & (rows[:, self._length - 1] == END)
        )

    def _piece(self, rows: NDArray[np.uint8], *, n_behind: int) -> Piece:
        n_lost, is_exact = 0, True
        if self._had_frame and self._skipped:
            n_lost = -(-self._skipped // self._length)
            # Garbled frames keep their length; anything else means that bytes are missing too.
            is_exact = self._skipped % self._length == 0
        self._had_frame = True
        self._skipped = 0
        self.n_overloads += int(np.count_nonzero(rows[:, 2] & 1))
        return Piece(self._values(rows[:, 3:-1]), n_lost, is_exact, n_behind)

    def _values(self, payload: NDArray[np.uint8]) -> NDArray[np.float64]:
        n_bytes = BYTES_PER_VALUE[self._data_type]
        cells = np.ascontiguousarray(payload).reshape(len(payload), self._n_values, n_bytes)
        if self._data_type == "float32":
            return cells.view(">f4")[..., 0].astype(np.float64)
        weights = 256 ** np.arange(n_bytes - 1, -1, -1)
        half = 1 << (8 * n_bytes - 1)
        codes = (cells.astype(np.int64) @ weights - half).astype(np.float64)
        return codes * (self._full_scale / half)
