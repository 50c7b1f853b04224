"""Recording that begins when the blade touches, with some seconds from before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import StreamChannel
from sawbench.bench.errors import InputError

# A single sample that was damaged on the way is no touch.
_IN_A_ROW: Final = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Touch:
    """When a recording begins.

    Attributes
    ----------
    above : float
        In the channel's unit; the tool that runs in air must stay below it.
    before_s : float
        What is kept from before, s.
    channel : str

    Raises
    ------
    InputError
        If a number is out of range.
    """

    above: float
    before_s: float = 3.0
    channel: str = "force_n"

    def __post_init__(self) -> None:
        if not self.above > 0 or not np.isfinite(self.above):
            raise InputError(f"the contact threshold is {self.above!r} in {self.channel}: allowed is above 0")
        if not 0 <= self.before_s <= 60:
            raise InputError(f"{self.before_s!r} s before the contact: allowed is 0 to 60 s")


class TouchWatch:
    """Finds the first sample of three in a row above the level.

    Parameters
    ----------
    touch : Touch
    channel : StreamChannel
        Its calibration and range hold.

    Examples
    --------
    >>> from sawbench.acquisition.calibration import Calibration
    >>> cell = StreamChannel(name="force_n", unit="N", calibration=Calibration(scale=2.0), valid_range=(-900.0, 900.0))
    >>> watch = TouchWatch(Touch(above=50.0), cell)
    >>> watch.first_above(np.arange(4.0), np.array([0.0, 400.0, 0.0, 30.0])) is None
    True
    >>> watch.first_above(np.arange(4.0, 8.0), np.array([30.0, 30.0, 0.0, 0.0]))
    3.0
    """

    def __init__(self, touch: Touch, channel: StreamChannel) -> None:
        self._touch = touch
        self._channel = channel
        self._since_s: float | None = None
        self._n_above = 0

    def first_above(self, time_s: NDArray[np.float64], raw: NDArray[np.float64]) -> float | None:
        """Take consecutive samples, shape (n,); return the time of the touch, as `time_s` has it, once it is there."""
        low, high = self._channel.valid_range
        with np.errstate(over="ignore", invalid="ignore"):
            values = self._channel.calibration.apply(raw)
            is_above = (values > self._touch.above) & (values >= low) & (values <= high)
        for k in range(len(is_above)) if is_above.any() or self._n_above else ():
            if not is_above[k]:
                self._n_above = 0
                continue
            if not self._n_above:
                self._since_s = float(time_s[k])
            self._n_above += 1
            if self._n_above == _IN_A_ROW:
                return self._since_s
        return None
