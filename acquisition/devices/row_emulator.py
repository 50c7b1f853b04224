"""An instrument that sends rows of numbers, as the host sees it: requests in, lines or frames out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor

# (readings of all sensors in the raw unit, number of the sample, its time in s) -> the line or frame
Render = Callable[[Sequence[float], int, float], bytes]
# (emulator, time in s) -> answer
Act = Callable[["RowEmulator", float], bytes]

# Of an instrument whose rows carry time stamps and whose table states no rate.
_STAMPS_HZ: Final = 200.0


class DescribedRows(Protocol):
    """What a table says that describes an instrument by itself: requests, each empty where there is none, and rate."""

    @property
    def start(self) -> str:
        """Begins the transmission."""
        ...

    @property
    def stop(self) -> str:
        """Ends it."""
        ...

    @property
    def question(self) -> str:
        """Asks for one row."""
        ...

    @property
    def rate_hz(self) -> float:
        """Rows per second; 0 where their stamps say it."""
        ...


class RowEmulator:
    """One instrument.

    Parameters
    ----------
    plant : PlantStream
    sensors : tuple of EmulatedSensor
    render : callable
        (readings, index, time in s) -> line or frame.
    requests : mapping of bytes to callable
        What is obeyed, found anywhere in what the host sends.
    sampler : Sampler
    is_always_sending : bool
        From switching on, without a request.
    """

    def __init__(
        self,
        plant: PlantStream,
        sensors: tuple[EmulatedSensor, ...],
        *,
        render: Render,
        requests: dict[bytes, Act],
        sampler: Sampler,
        is_always_sending: bool = False,
    ) -> None:
        self._plant = plant
        self._sensors = sensors
        self._render = render
        self._requests = requests
        self._sampler = sampler
        self._is_always_sending = is_always_sending
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """Whether it sends, or was asked."""
        return self._sampler.is_running or self._was_asked or self._is_always_sending

    def power_cycle(self) -> None:
        """As after switching on."""
        self._incoming = b""
        self._was_asked = False
        self._sampler.end()

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey every request in what came, in their order."""
        self._incoming += commands
        answers = b""
        while places := [(self._incoming.find(r), -len(r), r) for r in self._requests if r in self._incoming]:
            at, _, request = min(places)
            self._incoming = self._incoming[at + len(request) :]
            answers += self._requests[request](self, now_s)
        self._incoming = self._incoming[-64:]
        return answers

    def advance(self, now_s: float) -> bytes:
        """Rows of the samples up to `now_s`."""
        if self._is_always_sending and not self._sampler.is_running:
            self._sampler.begin(now_s)
        first = self._sampler.n_taken
        time_s = self._sampler.due(now_s)
        return b"".join(
            self._render(row, first + k, float(time_s[k])) for k, row in enumerate(self._readings(time_s).tolist())
        )

    def begin(self, now_s: float) -> bytes:
        """Send from now on."""
        self._sampler.begin(now_s)
        return b""

    def end(self, now_s: float) -> bytes:
        """Send no more."""
        del now_s
        self._sampler.end()
        return b""

    def one_row(self, now_s: float) -> bytes:
        """Answer with one row."""
        self._was_asked = True
        return self._render(self._readings(np.array([now_s]))[0].tolist(), 0, now_s)

    def _readings(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        if not len(time_s):
            return np.empty((0, len(self._sensors)))
        return np.stack([s.raw(self._plant, time_s) for s in self._sensors], axis=1)


def described(
    settings: DescribedRows,
    plant: PlantStream,
    sensors: tuple[EmulatedSensor, ...],
    *,
    render: Render,
    as_sent: Callable[[str], bytes],
    clock_error_ppm: float,
) -> RowEmulator:
    """Build the instrument that a table describes by itself; `as_sent` makes bytes of a request as it is written."""
    acts: dict[str, Act] = {
        settings.start: RowEmulator.begin,
        settings.stop: RowEmulator.end,
        settings.question: RowEmulator.one_row,
    }
    return RowEmulator(
        plant,
        sensors,
        render=render,
        requests={as_sent(request): act for request, act in acts.items() if request},
        sampler=Sampler(settings.rate_hz or _STAMPS_HZ, clock_error_ppm),
        is_always_sending=not settings.question and not settings.start,
    )
