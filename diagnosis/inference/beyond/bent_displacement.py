"""A displacement sensor whose reading is not straight between the ends of the stroke."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import Effect, Strength
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, residuals
from sawbench.modeling.state import State

N_BEND_HARMONICS = 4
_STEP_RAD = 1e-4


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
    up, down = (residuals(baseline, read, ("electrical", "mechanical")) for read in (more, less))
    # What the reading hides is what straightening it takes away.
    found: Signature = {name: (down[name] - up[name]) / (2.0 * _STEP_RAD) for name in up}
    if state.force_n is not None and not state.setting.is_idle:
        found["cutting"] = (baseline.expected_force(more) - baseline.expected_force(less)) / (2.0 * _STEP_RAD)
    return found


def _bent_displacement(baseline: Baseline, state: State) -> tuple[Signature, ...]:
    return tuple(bend_of_displacement(baseline, state, order) for order in range(1, N_BEND_HARMONICS + 1))


BENT_DISPLACEMENT = Effect(
    name="nonlinear displacement sensor",
    place="sensing",
    equation="nonlinear characteristic of the displacement sensor",
    strength=Strength(
        name="swing_rad", unit="rad", typical=SETTINGS.forms.bent_displacement_rad, low=0.1, high=5.0, source="assumed"
    ),
    signature=_bent_displacement,
)
