"""The stroke as a clock: every channel follows the same crank, so its phase against the strokes stays where it is.

Samples that were lost, or sent twice, without notice move all that follows in time. The phase of a channel's first
harmonic over the crank angle then steps from one stroke to the next, with its amplitude unchanged; wear, load and
drifting clocks move it slowly, a change of material changes the amplitude too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.processing.folding import Cycles

DISPLACEMENT: Final = "displacement_mm"
# Strokes on either side of a step that are compared, and the fewest at the ends of a trial.
_WINDOW: Final = 6
_FEWEST: Final = 3
# Strokes on either side whose scatter tells whether the phase means anything there.
_AROUND: Final = 4 * _WINDOW
# A step is at least so long, so much of a turn, and so many times the scatter of single strokes about it.
_LEAST_S: Final = 0.0025
_LEAST_RAD: Final = 0.1
_LEAST_STDS: Final = 5.0
# Relative change of amplitude beyond which the load changed rather than the time.
_SAME_AMPLITUDE: Final = 0.15
_SAME_SHIFT: Final = 0.35


@dataclass(frozen=True, kw_only=True, slots=True)
class Slip:
    """A channel that moves in time against the strokes.

    Attributes
    ----------
    channel : str
        The displacement where all others move together.
    time_s : float
        Middle of the stroke in which it happened.
    shift_s : float
        Positive: what follows comes later than it should (samples sent twice); negative: earlier (samples lost).
    """

    channel: str
    time_s: float
    shift_s: float

    def words(self) -> str:
        """Say what was found and what it means."""
        cause = "sent twice" if self.shift_s > 0 else "lost"
        direction = "later" if self.shift_s > 0 else "earlier"
        return (
            f"from {self.time_s:.2f} s on it comes {1e3 * abs(self.shift_s):.1f} ms {direction} against the strokes "
            f"than before: samples were {cause} there without notice; use the part before or after, or record again"
        )


def find_slips(
    angle: CrankAngle, channels: Mapping[str, tuple[Floats, Floats]], cycles: Mapping[str, Cycles]
) -> tuple[Slip, ...]:
    """Find where a channel steps in time against the crank.

    Parameters
    ----------
    angle : CrankAngle
        From the displacement.
    channels : mapping of str to (time_s, values)
    cycles : mapping of str to Cycles
        Complete strokes of each channel, without gaps.

    Returns
    -------
    tuple of Slip
        In order of time. A step that all other channels make together, at least two, is the displacement's.

    Notes
    -----
    Found from 2.5 ms and 0.1 rad of the stroke on, if five times the scatter of single strokes, there and around. The
    shift is known up to whole strokes. Within three strokes of an end of the trial, and before the strokes begin,
    nothing is seen.
    """
    found: list[Slip] = []
    n_judged = 0
    for name, (time_s, values) in channels.items():
        own = cycles.get(name)
        if name == DISPLACEMENT or own is None or len(own.index) < 2 * _FEWEST + 1:
            continue
        n_judged += 1
        found += _slips_of(name, own, stroke_waves(angle, time_s, values, own))
    return tuple(sorted(_of_displacement(found, n_judged), key=lambda slip: slip.time_s))


def stroke_waves(angle: CrankAngle, time_s: Floats, values: Floats, cycles: Cycles) -> NDArray[np.complex128]:
    """First harmonic of a channel over the crank angle of every stroke, complex, shape (n_cycles,)."""
    turned = np.interp(time_s, angle.time_s, angle.angle_rad)
    step = np.diff(turned)
    middle, held = 0.5 * (turned[1:] + turned[:-1]), 0.5 * (values[1:] + values[:-1])
    # Each step between two samples counts for the stroke that its middle lies in; without its mean, the little that
    # is missing or too much at the ends of a stroke does no harm.
    stroke = np.searchsorted(cycles.index, np.floor(middle / (2.0 * np.pi)).astype(np.int64))
    inside = stroke < len(cycles.index)
    inside[inside] = cycles.index[stroke[inside]] == np.floor(middle[inside] / (2.0 * np.pi))
    stroke, middle, held, step = stroke[inside], middle[inside], held[inside], step[inside]

    def sums(weights: Floats) -> Floats:
        found = np.bincount(stroke, weights=weights * step, minlength=len(cycles.index))
        return np.asarray(found, dtype=np.float64)

    mean = sums(held) / np.maximum(sums(np.ones_like(held)), 1e-12)
    left = held - mean[stroke]
    return (sums(left * np.cos(middle)) - 1j * sums(left * np.sin(middle))) / np.pi


def _slips_of(channel: str, cycles: Cycles, waves: NDArray[np.complex128]) -> list[Slip]:
    size = np.abs(waves)
    if not size.min() > 0:
        return []
    middle_s, typical_s = 0.5 * (cycles.start_s + cycles.end_s), float(np.median(cycles.period_s))
    least_rad = max(_LEAST_RAD, 2.0 * np.pi * _LEAST_S / typical_s)
    steps_rad, turned = np.zeros(len(waves)), waves / size
    for k in range(_FEWEST, len(waves) - _FEWEST):
        steps_rad[k] = _step_at(turned, size, k, least_rad)
    found: list[Slip] = []
    while steps_rad.any():
        k = int(np.argmax(np.abs(steps_rad)))
        shift_s = -float(steps_rad[k] * typical_s / (2.0 * np.pi))
        found.append(Slip(channel=channel, time_s=float(middle_s[k]), shift_s=shift_s))
        steps_rad[max(0, k - _WINDOW) : k + _WINDOW + 1] = 0.0
    return found


def _step_at(turned: NDArray[np.complex128], size: Floats, k: int, least_rad: float) -> float:
    """Step of the phase in stroke `k`, rad; 0 where there is none, or where the single strokes scatter too much."""
    before, after = _sides(k)
    step_rad = float(np.angle(np.sum(turned[after]) * np.conj(np.sum(turned[before]))))
    if abs(step_rad) < least_rad or abs(np.log(np.median(size[after]) / np.median(size[before]))) > _SAME_AMPLITUDE:
        return 0.0
    if abs(step_rad) < _LEAST_STDS * max(_std_at(turned, k), _std_around(turned, k)):
        return 0.0
    return step_rad


def _sides(k: int) -> tuple[slice, slice]:
    """Strokes before and after stroke `k`."""
    return slice(max(0, k - _WINDOW), k), slice(k + 1, k + 1 + _WINDOW)


def _std_at(turned: NDArray[np.complex128], k: int) -> float:
    """Scatter of the phase of single strokes about the mean of their side of stroke `k`, rad."""
    off_rad = [np.angle(turned[side] * np.conj(np.sum(turned[side]))) for side in _sides(k)]
    return float(np.std(np.concatenate(off_rad)))


def _std_around(turned: NDArray[np.complex128], k: int) -> float:
    """Scatter of the strokes before and after those that show a step: a few of pure noise agree now and then."""
    near = range(max(_FEWEST, k - _AROUND), min(len(turned) - _FEWEST, k + _AROUND + 1))
    others = [_std_at(turned, other) for other in near if abs(other - k) > _WINDOW]
    return float(np.median(others)) if len(others) >= _WINDOW else 0.0


def _of_displacement(found: list[Slip], n_judged: int) -> list[Slip]:
    """Replace steps that all channels make together by one of the displacement, the other way round."""
    kept: list[Slip] = []
    waiting = list(found)
    while waiting:
        first = waiting[0]
        together = [
            slip
            for slip in waiting
            if abs(slip.time_s - first.time_s) < 1.0
            and abs(slip.shift_s - first.shift_s) < _SAME_SHIFT * abs(first.shift_s)
        ]
        together = list({slip.channel: slip for slip in reversed(together)}.values())
        if n_judged >= 2 and len(together) == n_judged:
            shift_s = -float(np.median([slip.shift_s for slip in together]))
            kept.append(Slip(channel=DISPLACEMENT, time_s=first.time_s, shift_s=shift_s))
        else:
            together = [first]
            kept.append(first)
        waiting = [slip for slip in waiting if slip not in together]
    return kept
