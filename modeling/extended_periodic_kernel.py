"""The periodic stroke of the extended machine with its slow quantities frozen: Broyden's method on the stroke map."""

from __future__ import annotations

import math

import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.extended_kernel import N_RECORD, SCALE_CURRENT, SCALE_SPEED, TURN_S, simulate_extended
from modeling.extended_physics import (
    ANGLE,
    CURRENT,
    FORCE,
    N_ALL,
    N_SEEN,
    N_STATES,
    SPEED,
)
from modeling.machine import TWO_PI

PERIODIC, NO_DRIVE, NOT_CONVERGED = 0, 1, 2
MOST_STROKES = 60
LONGEST_S = 10.0
NEAR = 1e-8


@kernel()
def stroke(p, spline, ocv, x, frozen, tolerance, scales, time_s, out, seen, end):
    """One stroke from x = (i, W, F, duration of the turn before) at angle 0, or until the last of `time_s`.

    Fills `end`; returns the duration, 0 where the stroke does not get round.
    """
    y = np.zeros(N_ALL)
    y[:N_STATES] = frozen[:N_STATES]
    y[CURRENT], y[SPEED], y[ANGLE], y[FORCE] = x[0], x[1], 0.0, x[2]
    record = np.zeros(N_RECORD)
    record[TURN_S] = x[3]
    record[SCALE_CURRENT], record[SCALE_SPEED] = scales[0], scales[1]
    t, turns, _ = simulate_extended(
        p, spline, ocv, time_s, y, 0, 2, frozen, tolerance, out, seen, end, record
    )
    return t if turns == 2 else 0.0


@kernel()
def _solve(a, b, n):
    """Solve a small linear system in place by elimination with pivots; the answer is left in b."""
    for k in range(n):
        best = k
        for row in range(k + 1, n):
            if math.fabs(a[row, k]) > math.fabs(a[best, k]):
                best = row
        for col in range(n):
            a[k, col], a[best, col] = a[best, col], a[k, col]
        b[k], b[best] = b[best], b[k]
        if a[k, k] == 0.0:
            return False
        for row in range(k + 1, n):
            ratio = a[row, k] / a[k, k]
            for col in range(k, n):
                a[row, col] -= ratio * a[k, col]
            b[row] -= ratio * b[k]
    for k in range(n - 1, -1, -1):
        for col in range(k + 1, n):
            b[k] -= a[k, col] * b[col]
        b[k] /= a[k, k]
    return True


@kernel()
def _miss(p, spline, ocv, x, which, n, frozen, tolerance, scales, sizes, end, miss):
    """Fill what a stroke fails to come back to, over the sizes; returns its duration."""
    far = np.array([LONGEST_S])
    duration = stroke(
        p, spline, ocv, x, frozen, tolerance, scales, far, np.empty((4, 1)), np.empty((N_SEEN, 1)), end
    )
    values = (end[CURRENT], end[SPEED], end[FORCE], duration)
    for k in range(n):
        place = which[k]
        miss[k] = (values[place] - x[place]) / sizes[place]
    return duration


@kernel()
def periodic_extended(p, spline, ocv, frozen, x, tolerance, scales, end):
    """Find x = (i, W, F, duration of a turn), in place, that one stroke comes back to.

    `frozen`, shape (N_ALL,), holds the slow quantities; `end` is filled with the last stroke's end, its integrals
    included. Returns duration, strokes, status.
    """
    which = np.array([0, 1, 2, 3])
    n = 2
    if p[slots.COMPLIANCE] > 0.0:
        which[n] = 2
        n += 1
    if p[slots.CHIP_EXPONENT] != 0.0:
        which[n] = 3
        n += 1
    sizes = np.array([scales[0] * 0.2, scales[1], max(p[slots.K_FC] * 0.01 * scales[1], 1.0), x[3]])
    miss = np.zeros(4)
    other = np.zeros(4)
    jacobian = np.zeros((4, 4))
    work = np.zeros((4, 4))
    step = np.zeros(4)
    trial = np.zeros(4)
    duration = _miss(p, spline, ocv, x, which, n, frozen, tolerance, scales, sizes, end, miss)
    count = 1
    while duration == 0.0 and count < 6:
        x[1] *= 1.5  # the stroke did not get round: start faster
        duration = _miss(p, spline, ocv, x, which, n, frozen, tolerance, scales, sizes, end, miss)
        count += 1
    if duration == 0.0:
        return 0.0, count, NO_DRIVE
    is_fresh = False
    while count < MOST_STROKES:
        if not is_fresh:
            for col in range(n):
                trial[:] = x
                trial[which[col]] += 1e-4 * sizes[which[col]]
                if (
                    _miss(p, spline, ocv, trial, which, n, frozen, tolerance, scales, sizes, end, other)
                    == 0.0
                ):
                    return 0.0, count, NO_DRIVE
                for row in range(n):
                    jacobian[row, col] = (other[row] - miss[row]) / 1e-4
            count += n
            is_fresh = True
        work[:] = jacobian
        for k in range(n):
            step[k] = -miss[k]
        if not _solve(work, step, n):
            return 0.0, count, NOT_CONVERGED
        largest = 0.0
        for k in range(n):
            largest = max(largest, math.fabs(step[k]))
        damping = min(1.0, 0.3 / max(largest, 1e-30))
        trial[:] = x
        for k in range(n):
            trial[which[k]] += damping * step[k] * sizes[which[k]]
        if trial[1] <= 0.05 * scales[1]:
            trial[1] = max(0.5 * x[1], 0.02 * scales[1])
        duration = _miss(p, spline, ocv, trial, which, n, frozen, tolerance, scales, sizes, end, other)
        count += 1
        if duration == 0.0:
            return 0.0, count, NO_DRIVE
        square = 0.0
        for k in range(n):
            step[k] = (trial[which[k]] - x[which[k]]) / sizes[which[k]]
            square += step[k] * step[k]
        for row in range(n):
            change = other[row] - miss[row]
            for col in range(n):
                change -= jacobian[row, col] * step[col]
            for col in range(n):
                jacobian[row, col] += change * step[col] / max(square, 1e-300)
        x[:] = trial
        before = 0.0
        after = 0.0
        for k in range(n):
            before = max(before, math.fabs(miss[k]))
            after = max(after, math.fabs(other[k]))
            miss[k] = other[k]
        if after < NEAR:
            x[3] = duration
            return duration, count, PERIODIC
        if after > 0.5 * before:
            is_fresh = False
    return duration, count, PERIODIC if math.fabs(miss[0]) + math.fabs(miss[1]) < 1e-6 else NOT_CONVERGED


@kernel()
def extended_waveform(p, spline, ocv, frozen, x, duration, tolerance, scales, n_points, out, seen):
    """Fill `out`, shape (4, n_points), and `seen` at the angles 2*pi*j/n_points of the stroke from x.

    Times first guessed, then moved to the angles by the speed there.
    """
    end = np.empty(N_ALL)
    times = np.empty(n_points)
    fine = 4 * n_points
    grid = np.empty(fine)
    for k in range(fine):
        grid[k] = duration * k / fine
    rough = np.empty((4, fine))
    stroke(p, spline, ocv, x, frozen, tolerance, scales, grid, rough, np.empty((N_SEEN, fine)), end)
    k = 0
    for j in range(n_points):
        target = TWO_PI * j / n_points
        while k + 1 < fine and rough[2, k + 1] <= target:
            k += 1
        times[j] = grid[k] + (target - rough[2, k]) / max(rough[1, k] / p[slots.GEAR], 1e-9)
    times[0] = 0.0
    for _ in range(3):
        for j in range(1, n_points):
            times[j] = min(max(times[j], times[j - 1] + 1e-12), duration)
        stroke(p, spline, ocv, x, frozen, tolerance, scales, times, out, seen, end)
        for j in range(1, n_points):
            target = TWO_PI * j / n_points
            times[j] += (target - out[2, j]) / max(out[1, j] / p[slots.GEAR], 1e-9)
