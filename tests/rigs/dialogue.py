"""A serial port that answers as a document says, and keeps what was sent."""

from __future__ import annotations


class Dialogue:
    """`answers`: request -> bytes that follow it. Time goes on by 0.05 s with every look at the clock."""

    def __init__(self, answers: dict[bytes, bytes] | None = None) -> None:
        self._answers = answers or {}
        self._waiting: list[bytes] = []
        self._now_s = 0.0
        self.sent: list[bytes] = []
        self.is_open = False
        self.facts: dict[str, str] = {}

    def clock(self) -> float:
        self._now_s += 0.05
        return self._now_s

    def give(self, data: bytes) -> None:
        """Let `data` arrive with the next read."""
        self._waiting.append(data)

    def open(self) -> None:
        self.is_open = True

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if data in self._answers:
            self._waiting.append(self._answers[data])

    def read(self) -> bytes:
        return self._waiting.pop(0) if self._waiting else b""

    def drop_waiting(self) -> None:
        self._waiting.clear()

    def close(self) -> None:
        self.is_open = False


def opened(monkeypatch, make, table, answers=None, *, name="cell"):
    """Build a device on a `Dialogue` and open it; give both."""
    port = Dialogue(answers)
    monkeypatch.setattr("sawbench.acquisition.devices.serial_instrument.SerialPort", lambda *_a, **_k: port)
    device = make(name, table, port.clock)
    device.open()
    return device, port
