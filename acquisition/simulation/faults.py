"""What can go wrong with an instrument, on purpose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

# The latest bytes that can be sent again.
_KEPT_BYTES: Final = 1 << 16

FaultKind = Literal["drop_bytes", "garble_bytes", "flip_bits", "double_bytes", "unplug", "silence", "stall"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """One fault of one device.

    Attributes
    ----------
    device : str
    kind : str
        drop_bytes, garble_bytes, flip_bits (the lowest of each byte), double_bytes (the latest bytes again): `n_bytes`
        bytes on the way to the host; unplug: gone for `seconds`, then
        switched on again; silence: samples of `seconds` are never sent; stall: samples of `seconds` are sent
        late, all at once.
    at_s : float
        After all instruments stream, s.
    seconds : float
    n_bytes : int
    """

    device: str
    kind: FaultKind
    at_s: float
    seconds: float = 0.5
    n_bytes: int = 1


class FaultySender:
    """Passes bytes on, with the faults of one device applied."""

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._waiting = sorted(faults, key=lambda f: f.at_s)
        self._active: list[Fault] = []
        self._n_to_drop = 0
        self._n_to_garble = 0
        self._garbled_by = 0xFF
        self._n_to_double = 0
        self._latest = b""
        self._delayed = b""

    def is_unplugged(self, since_s: float) -> bool:
        """Whether the plug is out at `since_s`, the time since all instruments stream."""
        self._update(since_s)
        return any(f.kind == "unplug" for f in self._active)

    def through(self, data: bytes, since_s: float) -> bytes:
        """Return what becomes of `data` on its way to the host."""
        self._update(since_s)
        if any(f.kind == "silence" for f in self._active):
            return b""
        if any(f.kind == "stall" for f in self._active):
            self._delayed += data
            return b""
        data, self._delayed = self._delayed + data, b""
        # From the middle, so that frames are cut, not just left out.
        at = min(len(data) // 2, max(0, len(data) - 1))
        if self._n_to_drop and data:
            n = min(self._n_to_drop, len(data) - at)
            data = data[:at] + data[at + n :]
            self._n_to_drop -= n
        if self._n_to_garble and data:
            n = min(self._n_to_garble, len(data) - at)
            data = data[:at] + bytes(b ^ self._garbled_by for b in data[at : at + n]) + data[at + n :]
            self._n_to_garble -= n
        self._latest = (self._latest + data)[-_KEPT_BYTES:]
        if self._n_to_double and data:
            data += self._latest[-self._n_to_double :]
            self._n_to_double = 0
        return data

    def _update(self, since_s: float) -> None:
        while self._waiting and self._waiting[0].at_s <= since_s:
            fault = self._waiting.pop(0)
            if fault.kind == "drop_bytes":
                self._n_to_drop += fault.n_bytes
            elif fault.kind in {"garble_bytes", "flip_bits"}:
                self._n_to_garble += fault.n_bytes
                self._garbled_by = 0x01 if fault.kind == "flip_bits" else 0xFF
            elif fault.kind == "double_bytes":
                self._n_to_double += fault.n_bytes
            else:
                self._active.append(fault)
        self._active = [f for f in self._active if since_s < f.at_s + f.seconds]
