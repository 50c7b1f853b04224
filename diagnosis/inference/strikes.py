"""Strikes: moments in which a channel is far off what it does in all other strokes, and whether the motor feels them.

Interference strikes a cable; a carriage that slips, or a loose part, strikes the machine, and it answers: a blow on
the blade takes speed, and the current rises after it. Interference that one cable picks up ends with itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends
from sawbench.bench.spread import STD_OVER_MEDIAN
from sawbench.bench.units import FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.settings import SETTINGS

_NUMBERS: Final = SETTINGS.off_stroke


@dataclass(frozen=True, kw_only=True, slots=True)
class Strikes:
    """Moments in which one channel of one trial is far off what it does in all other strokes.

    Attributes
    ----------
    share : float
        Of the variance that does not follow the stroke.
    size : float
        Median of their largest deviations, in the unit of the channel.
    per_s : float
    """

    share: float
    size: float
    per_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """What the motor's current does after a strike of the force: sums over strikes of (impulse, rise of the current).

    Attributes
    ----------
    cross, square, response : float
        Impulse times rise, impulse squared, rise squared.
    count : int
    """

    cross: float = 0.0
    square: float = 0.0
    response: float = 0.0
    count: int = 0


class StruckTrial(Protocol):
    """What is asked of a trial."""

    @property
    def is_idle(self) -> bool:
        """Whether the blade runs in air."""
        ...

    @property
    def struck(self) -> Mapping[str, Strikes]:
        """By channel."""
        ...

    @property
    def answer(self) -> Answer:
        """Of the motor's current to the strikes of the force."""
        ...


def _runs(left: Floats, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """First cell of each strike and the one after its last: far off what the same cell does in other strokes.

    What is far off from the first stroke on is the end of the start.
    """
    measured = left[_is_measured(left)]
    if not len(measured):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    spread = np.maximum(STD_OVER_MEDIAN * np.median(np.abs(measured), axis=0), resolution)
    is_far = np.abs(left) > _NUMBERS.strike * spread
    is_far &= np.logical_or.accumulate(~is_far.any(axis=1))[:, None]
    far = is_far.ravel()
    beside = np.zeros_like(far)
    beside[1:] = far[:-1]
    beside[:-1] |= far[1:]
    return run_ends(far & beside)


def _is_measured(left: Floats) -> np.ndarray:
    """Strokes that are not zero throughout: what was not measured stands as zeros."""
    return np.asarray(left.any(axis=1))


def resolution_of(values: Floats) -> float:
    """Smallest difference of two values that occur; infinite for a constant."""
    levels = np.unique(values)
    return float(np.diff(levels).min()) if len(levels) > 1 else np.inf


def strikes(left: Floats, resolution: float, rate_hz: float) -> Strikes:
    """Find the strikes of one channel.

    Parameters
    ----------
    left : ndarray, shape (n_strokes, n_cells)
        Channel less its mean stroke; zero throughout a stroke that was not measured whole.
    resolution : float
        In the unit of the channel: the last bit that flips is no strike.
    rate_hz : float
        Strokes a second.

    Returns
    -------
    Strikes
    """
    first, last = _runs(left, resolution)
    flat = left.ravel()
    square = sum(float(np.sum(flat[a:b] ** 2)) for a, b in zip(first, last, strict=True))
    largest = [float(np.abs(flat[a:b]).max()) for a, b in zip(first, last, strict=True)]
    # One burst may fall below the limit in between.
    apart = 1 + int(np.sum(first[1:] - last[:-1] > _NUMBERS.same_burst * left.shape[1])) if len(first) else 0
    return Strikes(
        share=square / max(float(np.sum(flat**2)), 1e-300),
        size=float(np.median(largest)) if largest else 0.0,
        per_s=apart * rate_hz / max(int(_is_measured(left).sum()), 1),
    )


def answer_of(force: Floats | None, current: Floats | None, resolution: float) -> Answer:
    """Rise of the current over a strike of the force, from just before it to just after: a blow slows the motor.

    Parameters
    ----------
    force, current : ndarray, shape (n_strokes, n_cells), or None
        Less their mean strokes.
    resolution : float
        Of the force, N.

    Returns
    -------
    Answer
    """
    if force is None or current is None or force.shape != current.shape:
        return Answer()
    reach = max(int(_NUMBERS.felt * force.shape[1]), 2)
    felt, pulled = force.ravel(), current.ravel()
    impulses, rises = [], []
    for a, b in zip(*_runs(force, resolution), strict=True):
        if a > reach and b + reach < len(felt):
            impulses.append(float(felt[a:b].sum()))
            rises.append(float(pulled[b + 1 : b + 1 + reach].mean() - pulled[a - 1 - reach : a - 1].mean()))
    x, y = np.array(impulses), np.array(rises)
    return Answer(cross=float(x @ y), square=float(x @ x), response=float(y @ y), count=len(x))


def foreign_bursts(trials: Sequence[StruckTrial]) -> dict[str, Strikes]:
    """Bursts that are picked up by a sensor: in air, in force or motor current, and nothing that the motor feels.

    Parameters
    ----------
    trials : sequence of StruckTrial

    Returns
    -------
    dict of str to Strikes
        By channel, the median of the trials in air; empty where bursts also strike the supply or the displacement (all
        instruments at once: that is no fault of a sensor), or where the current answers the blows.
    """
    idle = [t for t in trials if t.is_idle]
    found: dict[str, Strikes] = {}
    for name in sorted({name for t in idle for name in t.struck}):
        hit = [t.struck[name] for t in idle if name in t.struck and t.struck[name].share > _NUMBERS.least_picked_up]
        if hit and len(hit) >= _NUMBERS.in_most * len(idle):
            share, size, per_s = (
                float(np.median(v)) for v in zip(*((h.share, h.size, h.per_s) for h in hit), strict=True)
            )
            found[name] = Strikes(share=share, size=size, per_s=per_s)
    is_of_one = FORCE.name in found and set(found) <= {FORCE.name, MOTOR_CURRENT.name}
    return found if is_of_one and not _is_felt(trials) else {}


def _is_felt(trials: Sequence[StruckTrial]) -> bool:
    """Whether the motor's current rises after a blow that the force shows."""
    answers = [t.answer for t in trials if t.is_idle]
    cross, square, response = (sum(getattr(a, n) for a in answers) for n in ("cross", "square", "response"))
    scale = np.sqrt(square * response / max(sum(a.count for a in answers), 1))
    return bool(cross > _NUMBERS.felt_stds * scale)
