"""Causes of simple form that the catalogue does not hold: where one of them wins, the verdict is "unknown".

A catalogue that is bent to the nearest cause would name play where the displacement sensor is bent, and dry
friction where grease warms up. These forms are weighed beside the free discrepancy, so that what they explain
better than any effect of the catalogue is left to nobody.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.current_limit import held_back
from sawbench.modeling.effects.effect import BACKGROUND_SHARE, Effect, Strength
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, residuals
from sawbench.modeling.state import START_UP_STEP_S, State

N_BEND_HARMONICS = 4
# Standard deviation of each coefficient: an ordinary sensor is straight to about 0.15 % of its range, two of them.
ORDINARY_BEND_RAD = BACKGROUND_SHARE * SETTINGS.forms.bent_displacement_rad
_STEP_RAD = 1e-4
# The torque of viscous friction is stated at this speed of the motor.
_UNIT_RAD_S = 1000.0


def straightened(state: State, coefficients_rad: Floats) -> State:
    """State as it would be if the displacement had been read without its bend.

    A bent sensor reads a function of the displacement alone. Its ends are calibrated, because the radius is fitted to
    the reading: what is left vanishes at both dead centres and is the same up and down, so the angle is off by a series
    of sines of the read angle, and any such series is a bend.

    Parameters
    ----------
    state : State
    coefficients_rad : ndarray, shape (4,)
        Of each harmonic k times k^2, by how much the read angle is too large.

    Returns
    -------
    State
    """
    bent_by = np.flatnonzero(coefficients_rad)
    order = 1.0 + bent_by[:, None, None]
    size = coefficients_rad[bent_by][:, None, None] / order**2
    turned, speed = order * state.angle_rad, state.speed_rad_s
    slower = 1.0 - np.sum(size * order * np.cos(turned), axis=0)
    bent = np.sum(size * order**2 * np.sin(turned), axis=0)
    return replace(
        state,
        angle_rad=state.angle_rad - np.sum(size * np.sin(turned), axis=0),
        speed_rad_s=speed * slower,
        acceleration_rad_s2=state.acceleration_rad_s2 * slower + speed**2 * bent,
    )


def bend_of_displacement(baseline: Baseline, state: State, order: int) -> Signature:
    """Change of the residuals per radian of one coefficient of a bend, by central difference.

    At a start as well: there the speed is read wrong in the same way.

    Parameters
    ----------
    baseline : Baseline
    state : State
    order : int
        Harmonic, 1 to `N_BEND_HARMONICS`.
    """
    if not is_angle_known(state):
        return {}
    step = np.zeros(N_BEND_HARMONICS)
    step[order - 1] = _STEP_RAD
    more, less = straightened(state, step), straightened(state, -step)
    up, down = residuals(baseline, more), residuals(baseline, less)
    # What the reading hides is what straightening it takes away.
    found: Signature = {
        name: (down[name] - up[name]) / (2.0 * _STEP_RAD) for name in ("electrical", "mechanical") if name in up
    }
    if state.force_n is not None and not state.setting.is_idle:
        found["cutting"] = (baseline.expected_force(more) - baseline.expected_force(less)) / (2.0 * _STEP_RAD)
    return found


def _bent_displacement(baseline: Baseline, state: State) -> tuple[Signature, ...]:
    return tuple(bend_of_displacement(baseline, state, order) for order in range(1, N_BEND_HARMONICS + 1))


def _warming_friction(
    baseline: Baseline, state: State, time_constant_s: float, viscous: float
) -> tuple[Signature, ...]:
    """Friction that falls while the machine runs and is back after a rest: stiff grease, cold bearings.

    Dry friction that does not fall is its limit, and in the catalogue. Viscous friction that hardly falls while a trial
    lasts is a wrong number of the model: it counts where it falls to 1/e.
    """
    if viscous and float(np.max(state.time_s)) < time_constant_s:
        return ({},)
    cold = np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / time_constant_s)
    speed = baseline.gear * state.speed_rad_s
    return ({"mechanical": cold * (speed / _UNIT_RAD_S if viscous else np.ones_like(speed))},)


def _soft_start(
    baseline: Baseline, state: State, length_s: float, from_share: float, decays: float
) -> tuple[Signature, ...]:
    """Voltage held back at the start, at any current: a ramp of the duty, or one that ends like a decay.

    As with a current limit, the baseline still counts it (electrical residual positive) and expects more battery
    current (converter residual negative, by the same share of the current).
    """
    if state.kind != "start_up" or state.current_a is None:
        return ({},)
    since_s = (np.arange(state.angle_rad.shape[1]) + 0.5) * START_UP_STEP_S
    missing = np.exp(-since_s / length_s) if decays else np.maximum(1.0 - since_s / length_s, 0.0)
    return (held_back(state, state.current_a, (1.0 - from_share) * missing * state.motor_voltage_v),)


BENT_DISPLACEMENT = Effect(
    name="nonlinear displacement sensor",
    place="sensing",
    equation="nonlinear characteristic of the displacement sensor",
    strength=Strength(
        name="swing_rad", unit="rad", typical=SETTINGS.forms.bent_displacement_rad, low=0.1, high=5.0, source="assumed"
    ),
    signature=_bent_displacement,
)
WARMING_FRICTION = Effect(
    name="friction that falls as the machine warms up",
    place="mechanical",
    equation="tau * exp(-t / T) on the motor shaft, again after each rest",
    strength=Strength(name="torque_n_m", unit="N*m", typical=0.005, low=0.2, high=4.0, source="assumed"),
    signature=_warming_friction,
    shapes=tuple(
        {"time_constant_s": float(tau), "viscous": viscous} for tau in (3.0, 10.0, 30.0) for viscous in (0.0, 1.0)
    ),
    confused_with=("motor_coulomb_friction",),
)
SOFT_START = Effect(
    name="voltage ramp at every start",
    place="electrical",
    equation="duty * (1 - (1 - d_0) g(t / T)) after the start, g a ramp or a decay",
    strength=Strength(
        name="voltage_share_held_back", unit="1", typical=1.0, low=0.5, high=1.2, source="assumed; power-tool switches"
    ),
    signature=_soft_start,
    shapes=(
        *(
            {"length_s": float(length), "from_share": share, "decays": 0.0}
            for length in np.geomspace(0.02, 0.4, 10)
            for share in (0.0, 0.25, 0.5)
        ),
        *({"length_s": float(length), "from_share": 0.0, "decays": 1.0} for length in np.geomspace(0.01, 0.2, 8)),
    ),
)
BEYOND_CATALOGUE = (BENT_DISPLACEMENT, WARMING_FRICTION, SOFT_START)
