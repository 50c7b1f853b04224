"""The periodic stroke of the extended machine, slow quantities frozen: Broyden's method on the stroke map.

The unknowns are current and speed at angle 0, the force in a compliant blade, and the duration of the turn
where the chip thickness depends on it. The iteration runs in Python: one stroke costs the kernel some thirty
times more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling import extended_kernel as kernel
from modeling import extended_physics as physics
from modeling import slots
from modeling.periodic_kernel import NO_DRIVE, NOT_CONVERGED, PERIODIC

Floats = NDArray[np.float64]
MOST_STROKES = 60
LONGEST_S = 10.0
NEAR = 1e-8
NUDGE = 1e-4
MOST_STEP = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeMap:
    """One stroke of the extended machine.

    Attributes
    ----------
    vector, spline, ocv : ndarray
        As in `steady_state.model_vector`.
    frozen : ndarray, shape (N_ALL,)
        Slow quantities that are held.
    scales : tuple of 2 floats
        Stall current, A, and no-load crank speed, rad/s.
    tolerance : float
        Local error of the steps.
    """

    vector: Floats
    spline: Floats
    ocv: Floats
    frozen: Floats
    scales: tuple[float, float]
    tolerance: float

    def run(self, x: Floats, time_s: Floats) -> tuple[float, Floats, Floats, Floats]:
        """One stroke from x = (i, W, F, duration of the turn before), or until the last of `time_s`.

        Returns the duration (0 where it does not get round), the end (N_ALL,), and the samples (4, n),
        (N_SEEN, n).
        """
        start = np.zeros(physics.N_ALL)
        start[: physics.N_STATES] = self.frozen[: physics.N_STATES]
        start[physics.CURRENT], start[physics.SPEED], start[physics.ANGLE] = x[0], x[1], 0.0
        start[physics.FORCE] = x[2]
        record = np.zeros(kernel.N_RECORD)
        record[kernel.TURN_S] = x[3]
        record[kernel.SCALE_CURRENT], record[kernel.SCALE_SPEED] = self.scales
        out, seen = np.empty((4, len(time_s))), np.empty((physics.N_SEEN, len(time_s)))
        end = np.empty(physics.N_ALL)
        t, turns, _ = kernel.simulate_extended(
            self.vector,
            self.spline,
            self.ocv,
            time_s,
            start,
            0,
            2,
            self.frozen,
            self.tolerance,
            out,
            seen,
            end,
            record,
        )
        return (float(t) if turns == 2 else 0.0), end, out, seen


_FAR: Floats = np.array([LONGEST_S])


def find_periodic(stroke: StrokeMap, guess: Floats) -> tuple[int, Floats, Floats, int]:
    """Find x that one stroke comes back to.

    Returns
    -------
    status, x, end of the last stroke (N_ALL,), strokes computed
    """
    p = stroke.vector
    which = [0, 1]
    if p[slots.COMPLIANCE] > 0.0:
        which.append(2)
    if p[slots.CHIP_EXPONENT] != 0.0:
        which.append(3)
    current, speed = stroke.scales
    sizes = np.array([0.2 * current, speed, max(0.01 * p[slots.K_FC] * speed, 1.0), guess[3]])[which]

    def miss_of(x: Floats) -> tuple[Floats, Floats, float]:
        duration, end, _, _ = stroke.run(x, _FAR)
        back = np.array([end[physics.CURRENT], end[physics.SPEED], end[physics.FORCE], duration])
        return (back - x)[which] / sizes, end, duration

    x = guess.copy()
    miss, end, duration = miss_of(x)
    count = 1
    while duration == 0.0 and count < 6:
        x[1] *= 1.5  # the stroke did not get round: start faster
        miss, end, duration = miss_of(x)
        count += 1
    jacobian: Floats | None = None
    while count < MOST_STROKES and duration > 0.0:
        if np.abs(miss).max() < NEAR:
            x[3] = duration
            return PERIODIC, x, end, count
        if jacobian is None:
            jacobian = np.empty((len(which), len(which)))
            for column, place in enumerate(which):
                trial = x.copy()
                trial[place] += NUDGE * sizes[column]
                jacobian[:, column] = (miss_of(trial)[0] - miss) / NUDGE
            count += len(which)
        try:
            step = np.linalg.solve(jacobian, -miss)
        except np.linalg.LinAlgError:
            return NOT_CONVERGED, x, end, count
        step *= min(1.0, MOST_STEP / np.abs(step).max())
        trial = x.copy()
        trial[which] += step * sizes
        trial[1] = max(trial[1], 0.3 * x[1])
        step = (trial - x)[which] / sizes
        new_miss, end, duration = miss_of(trial)
        count += 1
        jacobian += np.outer(new_miss - miss - jacobian @ step, step) / max(float(step @ step), 1e-300)
        if np.abs(new_miss).max() > 0.5 * np.abs(miss).max():
            jacobian = None
        x, miss = trial, new_miss
    if duration == 0.0:
        return NO_DRIVE, x, end, count
    x[3] = duration
    return (PERIODIC if np.abs(miss).max() < 1e-6 else NOT_CONVERGED), x, end, count


def waveform(stroke: StrokeMap, x: Floats, duration: float, n_points: int) -> tuple[Floats, Floats]:
    """Sample the stroke from x at the angles 2*pi*j/n_points: shapes (4, n_points) and (N_SEEN, n_points).

    The times are guessed from a first pass, then moved to the angles by the speed there.
    """
    target = 2 * np.pi * np.arange(n_points) / n_points
    grid = duration * np.arange(4 * n_points) / (4 * n_points)
    _, _, rough, _ = stroke.run(x, grid)
    times = np.interp(target, rough[2], grid)
    out, seen = rough, rough
    for _ in range(3):
        times = np.maximum.accumulate(np.clip(times, 0.0, duration) + 1e-13 * np.arange(n_points))
        _, _, out, seen = stroke.run(x, times)
        times = times + (target - out[2]) * stroke.vector[slots.GEAR] / np.maximum(out[1], 1e-6)
    return out, seen
