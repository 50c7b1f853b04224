"""An adaptive Dormand-Prince 5(4) integrator that lands on every dead centre of the crank (numba).

Steps are cut where the crank passes a multiple of pi, so no step straddles the start or the end of a cut, and
the 4th-order continuous extension fills an equally spaced grid in between.

Source: J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl. Math. 6
(1980); continuous extension: L. F. Shampine, Some practical Runge-Kutta formulas, Math. Comp. 46 (1986).
"""

from __future__ import annotations

import zlib
from math import floor, pi
from pathlib import Path

import numpy as np
from numba import njit
from sawbench.blindcheck import dynamics
from sawbench.blindcheck.dynamics import N_OUTPUTS, N_STATES, evaluate

_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_C = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
_ERROR = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
_DENSE = np.array(
    [
        [1, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432],
        [0, 0, 0, 0],
        [0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799],
        [0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072],
        [0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632],
        [0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844],
        [0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423],
    ]
)
_CRANK = 2
MAX_STEP_S = 2e-3
MIN_STEP_S = 1e-10


@njit(cache=True)
def _dense(y, k, h, part, result):
    """State at the fraction `part` of a step."""
    for j in range(N_STATES):
        total = 0.0
        for stage in range(7):
            weight = ((_DENSE[stage, 3] * part + _DENSE[stage, 2]) * part + _DENSE[stage, 1]) * part
            total += (weight + _DENSE[stage, 0]) * part * k[stage, j]
        result[j] = y[j] + h * total


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@njit(cache=True)
def _stages(t, y, h, p, strokes, grain, wander, k, trial, out):
    """Fill the stages 1..6 (stage 0 is given); `trial` ends as the state after the step."""
    for stage in range(1, 7):
        for j in range(N_STATES):
            total = 0.0
            for earlier in range(stage):
                total += _A[stage, earlier] * k[earlier, j]
            trial[j] = y[j] + h * total
        evaluate(t + _C[stage] * h, trial, p, strokes, grain, wander, k[stage], out)


@njit(cache=True)
def _error_norm(y, trial, k, h, rtol, atol):
    total = 0.0
    for j in range(N_STATES):
        error = 0.0
        for stage in range(7):
            error += _ERROR[stage] * k[stage, j]
        scale = atol[j] + rtol * max(abs(y[j]), abs(trial[j]))
        total = max(total, abs(h * error) / scale)
    return total


@njit(cache=True)
def _part_at_crank(y, k, h, target, scratch):
    """Fraction of the step at which the crank angle is `target`, by bisection on the continuous extension."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        _dense(y, k, h, middle, scratch)
        if scratch[_CRANK] < target:
            low = middle
        else:
            high = middle
    return high


# Size: it holds `integrate` whole.
def _build(source_stamp: int):
    """Compile `integrate`; the stamp enters numba's cache key: a change of `dynamics.py` recompiles it."""

    # Size: compiled as a whole, with plain arrays.
    def integrate(y, t, t_end, step_s, first, grid_s, outputs, record, strokes, grain, wander, rtol, atol, stop_charge):
        """Advance `y` in place from `t` to `t_end`, or to where the charge drawn reaches `stop_charge`.

        Parameters
        ----------
        y : ndarray, shape (N_STATES,)
        t, t_end : float, s
        step_s : float
            First step to try, s.
        first : float, s
            Time of the first row of `outputs`; row n is at first + n * grid_s.
        grid_s : float, s
        outputs : ndarray, shape (n, N_OUTPUTS)
            Filled for the rows that lie in (t, t_end] (and at `t` itself).
        record : record array, shape (1,)
        strokes, grain, wander : ndarray
            Tables of `evaluate`.
        rtol : float
        atol : ndarray, shape (N_STATES,)
        stop_charge : float, A s
            Infinity to ignore.

        Returns
        -------
        t : float, s
        step_s : float, s
            Where it ended and the next step to try; the step is negative where no progress was possible.
        n_steps : int
        """
        if source_stamp < 0:
            return t, -1.0, 0
        p = record[0]
        k = np.zeros((7, N_STATES))
        trial = np.empty(N_STATES)
        scratch = np.empty(N_STATES)
        rates = np.empty(N_STATES)
        out = np.zeros(N_OUTPUTS)
        row = max(int(np.ceil((t - first) / grid_s - 1e-9)), 0)
        half_turn = floor(y[_CRANK] / pi + 1e-9)
        evaluate(t, y, p, strokes, grain, wander, k[0], out)
        if row < len(outputs) and first + row * grid_s <= t + 1e-12:
            outputs[row] = out
            row += 1
        n_steps = 0
        while t < t_end - 1e-13:
            h = min(step_s, MAX_STEP_S, t_end - t)
            _stages(t, y, h, p, strokes, grain, wander, k, trial, out)
            norm = _error_norm(y, trial, k, h, rtol, atol)
            if not norm <= 1.0:
                step_s = h * max(0.2, 0.9 * norm**-0.2) if norm < 1e30 else 0.1 * h
                if step_s < MIN_STEP_S:
                    return t, -1.0, n_steps
                continue
            proposal = h * min(4.0, 0.9 * max(norm, 1e-10) ** -0.2)
            target = (half_turn + 1) * pi
            if trial[_CRANK] > target + 1e-9:
                h *= max(_part_at_crank(y, k, h, target, scratch), 1e-6)
                _stages(t, y, h, p, strokes, grain, wander, k, trial, out)
            if trial[3] >= stop_charge:
                return t + h * (stop_charge - y[3]) / (trial[3] - y[3]), step_s, n_steps
            while row < len(outputs) and first + row * grid_s <= t + h + 1e-12:
                part = min(max((first + row * grid_s - t) / h, 0.0), 1.0)
                _dense(y, k, h, part, scratch)
                evaluate(t + part * h, scratch, p, strokes, grain, wander, rates, outputs[row])
                row += 1
            t += h
            y[:] = trial
            k[0] = k[6]
            half_turn = floor(y[_CRANK] / pi + 1e-9)
            step_s = proposal
            n_steps += 1
        return t, step_s, n_steps

    return njit(cache=True)(integrate)


integrate = _build(zlib.crc32(Path(dynamics.__file__).read_bytes()))
