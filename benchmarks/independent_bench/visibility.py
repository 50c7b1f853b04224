"""How far the hidden effects change what the instruments show, so that a miss can be judged."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.independent_bench.instruments import Instruments, SensorErrors, sensed_current, sensed_force
from benchmarks.independent_bench.plant import BATTERY_A, BATTERY_V, CRANK_ANGLE, STEP_S, Floats

# A machine has settled by then, s.
SETTLED_S: Final = 3.0
_N_CELLS = 48
_CHANNELS = ("force_n", "motor_current_a", "battery_voltage_v", "battery_current_a")


def shown(
    signals: Sequence[Floats], twin: Iterable[Floats], errors: SensorErrors, measured_by: Instruments, peak_n: float
) -> dict[str, Any]:
    """Largest difference of a mean stroke from that of the intact twin.

    Parameters
    ----------
    signals, twin : sequence and iterable of ndarray, shape (N_SIGNALS, n)
        Of every trial: of the campaign, and of the same bench without the hidden effects.
    errors : SensorErrors
        Of the campaign. A late clock and a drifting zero are not looked at.
    measured_by : Instruments
    peak_n : float
        Largest force of the campaign.

    Returns
    -------
    dict
        `channel`, and `times_noise`: root mean square of the difference over the white noise of the channel.
    """
    noise = np.array([measured_by.sensors[channel].white_rms for channel in _CHANNELS])
    largest = np.zeros(len(_CHANNELS))
    for one, other in zip(signals, twin, strict=True):
        difference = _mean_stroke(one, errors, peak_n) - _mean_stroke(other, SensorErrors(), peak_n)
        largest = np.maximum(largest, np.sqrt(np.mean(difference**2, axis=1)) / noise)
    place = int(np.argmax(largest))
    return {"channel": _CHANNELS[place], "times_noise": float(largest[place])}


def _mean_stroke(signals: Floats, errors: SensorErrors, peak_n: float) -> Floats:
    """Mean over the crank angle, shape (4, `_N_CELLS`)."""
    first = int(SETTLED_S / STEP_S)
    turn = 2.0 * math.pi
    cells = np.minimum(np.mod(signals[CRANK_ANGLE, first:], turn) / turn * _N_CELLS, _N_CELLS - 1).astype(np.int64)
    counts = np.maximum(np.bincount(cells, minlength=_N_CELLS), 1)
    channels = (
        sensed_force(signals, errors, peak_n), sensed_current(signals, errors), signals[BATTERY_V], signals[BATTERY_A]
    )  # fmt: skip
    return np.array([np.bincount(cells, one[first:], _N_CELLS) / counts for one in channels])
