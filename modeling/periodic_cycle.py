"""The periodic stroke over the crank angle, for many parameter vectors at once: what a fit iterates on.

The stroke map of `stroke_kernel`, evaluated by numpy over all vectors together: nothing is compiled. Newton's method
runs on few steps a turn; between them every step is then refined on its own, all at once.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.modeling import slots
from sawbench.modeling.compilation import interpreted
from sawbench.modeling.dormand_prince import FRACTIONS, step_of
from sawbench.modeling.machine import Machine, load_at
from sawbench.modeling.machine import machine as machine_of
from sawbench.modeling.stroke_kernel import MOST_STEPS_TO_SETTLE, angle_rate, tangent_rate, to_rest

Floats = NDArray[np.float64]
CuttingHalf = Literal["pi_to_2pi", "zero_to_pi"]

PLANT_NAMES: Final = (
    "resistance_ohm",
    "inductance_h",
    "back_emf_constant_v_s_per_rad",
    "torque_constant_n_m_per_a",
    "rotor_inertia_kg_m2",
    "yoke_inertia_kg_m2",
    "reciprocating_mass_kg",
    "crank_radius_m",
    "motor_damping_n_m_s_per_rad",
)
COLUMNS: Final = (*PLANT_NAMES, "k_fc_n_s_per_m", "voltage_v")
N_STEPS: Final = 64
# Steps a turn of Newton's method: 6e-8 of the current.
N_COARSE: Final = 16
# Steps are divided by this where current or speed changes too fast for them.
_FINER: Final = 4
MOST_NEWTON_STEPS: Final = 30
# Relative; where few steps a turn leave more, all of them are taken.
LOCAL_ERROR: Final = 1e-4
# Relative Newton step that is the last: it leaves an error of its square.
ACCEPT: Final = 1e-5


def periodic_cycles(
    values: Floats,
    *,
    gear_ratio: float,
    cutting_half: CuttingHalf = "pi_to_2pi",
    rod_length_m: float | None = None,
    n_steps: int = N_STEPS,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Periodic current and crank speed at equally spaced crank angles, one row a parameter vector.

    Newton's method on the stroke map with its exact derivative, steps aligned with the dead centres; 1e-7 relative for
    the jigsaw. A machine that these steps cannot follow gets finer ones.

    Parameters
    ----------
    values : ndarray, shape (n_cases, 11)
        Columns as in `COLUMNS`, SI units; the voltage is what drives R, so a battery's resistance is in R.
    gear_ratio : float
        Motor turns a crank turn.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    rod_length_m : float, optional
        Length of the connecting rod of a slider-crank; None is a Scotch yoke.
    n_steps : int
        Angles a turn, a multiple of 16.

    Returns
    -------
    current_a, crank_speed_rad_s : ndarray, shape (n_cases, n_steps)
        At angles 2*pi*j/n_steps.
    is_periodic : ndarray of bool, shape (n_cases,)
        False where the stroke stops or the iteration does not settle; the row then holds zeros.
    """
    values = np.asarray(values, dtype=np.float64)
    cutting_sign = -1.0 if cutting_half == "pi_to_2pi" else 1.0
    current, speed = np.zeros((2, len(values), n_steps))
    is_periodic = np.zeros(len(values), dtype=np.bool_)
    left = np.arange(len(values))
    for n_coarse in (N_COARSE, n_steps):
        machine = _machine(values[left], gear_ratio, cutting_sign, rod_length_m or 0.0)
        loads, curve = _loads(machine, n_steps), (machine.voltage, 0.0, 0.0)
        with np.errstate(all="ignore"):  # a stroke that does not get round shows in its end
            coarse, is_settled, error = _newton(machine, _loads(machine, n_coarse), curve, _guess(machine, loads))
            found = _refine(machine, loads, curve, coarse)
        is_settled &= np.isfinite(found).all(axis=(0, 1)) & (found[1] > 0.0).all(axis=0)
        is_good = is_settled & (error < LOCAL_ERROR) if n_coarse < n_steps else is_settled
        place = left[is_good]
        current[place], speed[place], is_periodic[place] = found[0].T[is_good], 1.0 / found[1].T[is_good], True
        left = left[~is_good]
        if len(left) == 0:
            return current, speed, is_periodic
    machine = _machine(values[left], gear_ratio, cutting_sign, rod_length_m or 0.0)
    slowness = _guess(machine, _loads(machine, N_COARSE))[1]
    left = left[slowness > 0.0]
    if len(left) and _FINER * n_steps <= MOST_STEPS_TO_SETTLE:
        finer = periodic_cycles(
            values[left],
            gear_ratio=gear_ratio,
            cutting_half=cutting_half,
            rod_length_m=rod_length_m,
            n_steps=_FINER * n_steps,
        )
        current[left], speed[left], is_periodic[left] = finer[0][:, ::_FINER], finer[1][:, ::_FINER], finer[2]
    return current, speed, is_periodic


def _guess(machine: Machine, loads: Floats) -> Floats:
    """Current and inverse speed that balance the mean torques, shape (2, n_cases)."""
    drag = loads[:, 0, 2].mean(axis=0)
    speed = machine.voltage / (machine.back_emf + machine.resistance * drag / machine.torque_constant)
    return np.array([drag * speed / machine.torque_constant, 1.0 / speed])


def _machine(values: Floats, gear: float, cutting_sign: float, rod_m: float) -> Machine:
    """Machines of many vectors: arrays of shape (n_cases,), on a source of fixed voltage."""
    vector = slots.defaults().tolist()
    for name, column in zip(COLUMNS, values.T, strict=True):
        vector[slots.INDEX[name]] = column
    vector[slots.GEAR], vector[slots.ROD], vector[slots.CUTTING_SIGN] = gear, rod_m, cutting_sign
    return interpreted(machine_of)(vector)


def _loads(machine: Machine, n_steps: int) -> Floats:
    """`machine.load_at` at the stages of equal steps, shape (n_steps, n_stages, 4, n_cases)."""
    angle = (np.arange(n_steps)[:, None, None] + FRACTIONS[None, :, None]) * (2.0 * np.pi / n_steps)
    # A stage that ends a step belongs to its half turn.
    is_second = (np.arange(n_steps) >= n_steps // 2)[:, None, None]
    idle, cutting = (
        interpreted(load_at)(machine, None, np.sin(angle), np.cos(angle), angle, is_cutting)
        for is_cutting in (False, True)
    )
    shape = cutting[2].shape
    drag = np.where(is_second == (machine.cutting_sign < 0.0), cutting[2], idle[2])
    return np.stack([np.broadcast_to(x, shape) for x in (idle[0], idle[1], drag, idle[3])], axis=2)


def _newton(
    machine: Machine, loads: Floats, curve: tuple[Any, ...], start: Floats
) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """Current and inverse speed at the begin of every step, shape (2, n_steps, n_cases), by Newton's method.

    Then whether it settled, and the largest local error, relative, shape (n_cases,) each.
    """
    begin = np.zeros((6, start.shape[1]))
    begin[2] = begin[5] = 1.0
    begin[:2] = start
    h = 2.0 * np.pi / len(loads)
    places = [(machine, rows, curve) for rows in loads]
    path = np.empty((len(loads), *begin.shape))
    is_done = np.zeros(start.shape[1], dtype=np.bool_)
    step, worst = np.zeros_like(start), np.zeros(start.shape[1])
    for _ in range(MOST_NEWTON_STEPS):
        y, k = begin.copy(), _tangent_rate(places[0], 0, begin)
        worst[:] = 0.0
        for n, place in enumerate(places):
            path[n] = y
            y, k, error_i, error_r = _tangent_step(place, h, y, k)
            worst = np.maximum(worst, np.maximum(error_i / (np.abs(begin[0]) + 1e-3), error_r / begin[1]))
        step = np.array(interpreted(to_rest)(y, y[0] - begin[0], y[1] - begin[1]))
        size = np.max(np.abs(step) / (np.abs(begin[:2]) + np.array([[1e-3], [0.0]])), axis=0)
        is_lost = ~np.isfinite(size) | ~(y[1] > 0.0)
        is_done = size < ACCEPT
        if (is_done | (begin[1] < 1e-12)).all():
            break
        damped = np.minimum(1.0, 0.5 / size) * step
        # Where a stroke did not get round: start faster.
        begin[:2] = np.where(is_lost, begin[:2] * np.array([[1.0], [0.5]]), begin[:2] + np.where(is_lost, 0.0, damped))
    # The last step, carried along by the derivatives.
    moved = np.array([path[:, 2] * step[0] + path[:, 3] * step[1], path[:, 4] * step[0] + path[:, 5] * step[1]])
    return path[:, :2].swapaxes(0, 1) + moved, is_done, worst


def _refine(machine: Machine, loads: Floats, curve: tuple[Any, ...], coarse: Floats) -> Floats:
    """Current and inverse speed at every fine step, shape (2, n_steps, n_cases), from those at the coarse ones."""
    n_parts = len(loads) // coarse.shape[1]
    y = np.concatenate([coarse, np.zeros_like(coarse[:1])])
    found = []
    for part in range(n_parts):
        found.append(y[:2])
        place = (machine, loads[part::n_parts].transpose(1, 2, 0, 3), curve)
        y = _angle_step(place, 2.0 * np.pi / len(loads), y, _angle_rate(place, 0, y))[0]
    return np.stack(found, axis=2).reshape(2, len(loads), -1)


def _add(y: Floats, a: float, k: Floats) -> Floats:
    return y + a * k


def _angle_rate(place: Any, stage: int, y: Floats) -> Floats:
    return np.array(interpreted(angle_rate)(place, stage, y)[:3])


def _tangent_rate(place: Any, stage: int, y: Floats) -> Floats:
    return np.array(interpreted(tangent_rate)(place, stage, y)[:6])


_angle_step = step_of(_angle_rate, _add)
_tangent_step = step_of(_tangent_rate, _add)
