"""Stroke rate while the saw runs, from the displacement as it arrives."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats


class LiveStrokeRate:
    """Stroke rate from the rising crossings of the mid-stroke, one value per stroke.

    The mid-level is half-way between the extremes of the last `window_s` seconds, and a crossing counts only
    after the signal has been in the lower quarter, so noise around the level makes no strokes. The crossing
    time is interpolated linearly between two samples.

    Bias and failure cases: the rate is the mean over one stroke, so a change shows one stroke late; linear
    interpolation errs by less than one hundredth of a sample period for a sine. A stroke below `min_stroke`
    (sensor noise at rest) gives nothing. A gap longer than `window_s` starts afresh. For a result with an
    uncertainty use the processing of the whole trial.

    Parameters
    ----------
    window_s : float
        Must hold at least one stroke; strokes slower than `1 / window_s` are not found, s.
    min_stroke : float
        Peak to peak below which the blade counts as standing, in the unit of the values (mm).

    Examples
    --------
    >>> time_s = np.arange(4000) / 2000.0
    >>> found = LiveStrokeRate().update(time_s, 10.0 - 10.0 * np.cos(2 * np.pi * 12.5 * time_s))
    >>> f"{found[-1][1]:.3f} Hz"
    '12.500 Hz'
    """

    def __init__(self, *, window_s: float = 1.0, min_stroke: float = 1.0) -> None:
        self._window_s = window_s
        self._min_stroke = min_stroke
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._time_s: Floats = np.empty(0)
        self._values: Floats = np.empty(0)
        self._n_searched = 0
        self._is_armed = False
        self._last_crossing_s: float | None = None

    def update(self, time_s: Floats, values: Floats) -> list[tuple[float, float]]:
        """Take the next samples and return the strokes they complete.

        Parameters
        ----------
        time_s : ndarray, shape (n,), s
            Continues the samples given before.
        values : ndarray, shape (n,), mm
            Displacement.

        Returns
        -------
        list of (time_s, rate_hz)
            Time of the crossing that ended the stroke, and its rate.
        """
        if not len(time_s):
            return []
        if len(self._time_s) and time_s[0] - self._time_s[-1] > self._window_s:
            self._start_afresh()
        self._time_s = np.concatenate((self._time_s, time_s))
        self._values = np.concatenate((self._values, values))
        strokes = self._search()
        n_old = int(np.searchsorted(self._time_s, self._time_s[-1] - self._window_s))
        self._time_s, self._values = self._time_s[n_old:], self._values[n_old:]
        self._n_searched = len(self._time_s)
        return strokes

    def _search(self) -> list[tuple[float, float]]:
        in_window = self._values[np.searchsorted(self._time_s, self._time_s[-1] - self._window_s) :]
        low, high = float(in_window.min()), float(in_window.max())
        if high - low < self._min_stroke:
            self._is_armed, self._last_crossing_s = False, None
            return []
        middle, arming = 0.5 * (low + high), low + 0.25 * (high - low)
        strokes = []
        for k in range(max(self._n_searched, 1), len(self._values)):
            before, now = self._values[k - 1], self._values[k]
            self._is_armed = self._is_armed or now < arming
            if not (self._is_armed and before < middle <= now):
                continue
            step_s = self._time_s[k] - self._time_s[k - 1]
            crossing_s = float(self._time_s[k - 1] + step_s * (middle - before) / (now - before))
            if self._last_crossing_s is not None and crossing_s - self._last_crossing_s <= self._window_s:
                strokes.append((crossing_s, 1.0 / (crossing_s - self._last_crossing_s)))
            self._last_crossing_s, self._is_armed = crossing_s, False
        return strokes
