"""Frames of a CAN bus as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

EXTENDED_FLAG = 1 << 31


class ParsedFrame(NamedTuple):
    """One classic CAN frame.

    Attributes
    ----------
    identifier : int
        11 or 29 bits.
    is_extended : bool
    payload : bytes
        0..8 bytes.
    """

    identifier: int
    is_extended: bool
    payload: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class CanBatch:
    """Frames received together.

    Attributes
    ----------
    identifier : ndarray of uint32, shape (n,)
        Identifier; bit 31 is set for 29-bit identifiers.
    length : ndarray of uint8, shape (n,)
        Payload length in bytes.
    payload : ndarray of uint8, shape (n, 8)
        Zero beyond `length`.
    arrival_s : ndarray, shape (n,), s
        On the monotonic clock of this machine (or on the log's clock, for logs).
    """

    identifier: NDArray[np.uint32]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint8]
    arrival_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.identifier)

    @classmethod
    def of(cls, frames: Sequence[ParsedFrame], arrival_s: float | Sequence[float]) -> CanBatch:
        """Build from single frames and their arrival (one for all, or one each), s."""
        identifier = [f.identifier | (EXTENDED_FLAG if f.is_extended else 0) for f in frames]
        joined = b"".join(f.payload[:8].ljust(8, b"\0") for f in frames)
        return cls(
            identifier=np.array(identifier, dtype=np.uint32),
            length=np.array([len(f.payload) for f in frames], dtype=np.uint8),
            payload=np.frombuffer(joined, dtype=np.uint8).reshape(-1, 8),
            arrival_s=np.broadcast_to(np.asarray(arrival_s, dtype=np.float64), (len(frames),)),
        )
