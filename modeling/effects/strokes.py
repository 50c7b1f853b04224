"""How single strokes bear on an effect that mean strokes hardly show.

Every stroke has one number, its cutting coefficient. Along the feed these numbers may wave; over blade life and
from trial to trial they may grow. And every return stroke reads the zero of the force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from sawbench.bench.recording import Floats

# (distance cut in m, logarithm of feed a stroke over its mean, size, **shape) -> change of log hardness, shape (n,).
LogChange = Callable[..., Floats]


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeWave:
    """Hardness waves along the feed path, at one wavelength whatever feed and stroke rate.

    Mean strokes do not know it: averaging takes the wave away.

    Attributes
    ----------
    waves_per_m : tuple of float
        Lowest and highest place of the wave that occurs, 1/m.
    depths : ndarray, shape (m,)
        Amplitudes that occur, relative.
    words : str
        What was found, with `{wavelength_mm}`.
    """

    waves_per_m: tuple[float, float]
    depths: Floats
    words: str


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeTrend:
    """Hardness changes over blade life or from trial to trial, the force over the stroke keeps its shape.

    Attributes
    ----------
    log_change : callable
        (distance_m, log_thickness, size, **shape) -> change of the logarithm of the hardness, shape (n,).
    sizes : ndarray, shape (n,)
        Values of the reported parameter that occur.
    shapes : tuple of dict
        Forms, all equally likely.
    goes_with_feed : bool
        A power of the feed that another effect of the cut might have cannot be told from it.
    is_whole_in : callable
        Of the shape of the effect: whether it does nothing else in that form. Then single strokes know all of it.
    """

    log_change: LogChange
    sizes: Floats
    shapes: tuple[dict[str, float], ...] = field(default=({},))
    goes_with_feed: bool = False
    is_whole_in: Callable[[Mapping[str, float]], bool] = lambda shape: True


@dataclass(frozen=True, kw_only=True, slots=True)
class ZeroTrend:
    """The zero of the force, which the middle of every return stroke reads, goes its way over the session.

    Where the zero wanders as well, no mean stroke of a withheld trial can tell the two; the zeros of all trials can.
    """


Strokes = StrokeWave | StrokeTrend | ZeroTrend
