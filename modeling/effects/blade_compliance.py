"""The blade (with clamp and workpiece) gives way: F + (k / k_b) dF/dt = k v, k_b its stiffness along the cut.

The force lags the velocity by k/k_b and decays after the reversal. Stiffer stock lags longer, or all stock as long as
one of 240 N*s/m (`by_stock` 0): where the force hardly grows with speed, its slope is not k. A late force is small
where the velocity is large: a coefficient that was regressed over it is too small, of stiff stock the more, and k is
the one of which that much is left. The reading is the true force, so current and speed feel the late force too and the
mechanical residual stays 0: that tells it from a lag of the load cell. Second form: on the way back the retreating
plunger unloads the spring, until the teeth are free (F >= 0). Axial steel alone would give 1e7 N/m; bending, clamp and
carriage give 2e4 to 2e6 N/m: assumed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, Words
from sawbench.modeling.effects.stock import ALIKE, BY_COEFFICIENT, K_UNIT_N_S_PER_M
from sawbench.modeling.effects.transfer import Spectrum, low_pass
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import TWO_PI, State

_RISES = np.linspace(1.0, 2.4, 71)
# Power of the harmonics of half a sine, the blade's speed into the wood, over their sum.
_ORDERS = np.array([0, 1, *range(2, 21, 2)])
_HALF_SINE = 4.0 * np.array([1.0 / np.pi**2, 0.125, *(2.0 / (np.pi * (1.0 - _ORDERS[2:] ** 2.0)) ** 2)])
# Blade, clamp and workpiece one behind the other; a twentieth of that compliance is the background below.
_USUAL_N_PER_M = 1e5
_STIFFNESS_N_PER_M = tuple(float(k) for k in np.geomspace(2e4, 2e6, 16))


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    force = baseline.expected_force(state)
    spectrum = Spectrum(force, state)
    drive = state.hardness * state.k_guess_n_s_per_m * baseline.cutting_sign * baseline.blade_velocity(state)
    unloading = _unloading(drive, state)

    def signature(stiffness_n_per_m: float, unloads: float, by_stock: float = BY_COEFFICIENT) -> tuple[Signature, ...]:
        if by_stock == ALIKE:
            tau_s = max(K_UNIT_N_S_PER_M / stiffness_n_per_m, 1e-7)
            rise = 1.0 / float(_left(np.array(state.regressed_at_rad_s * tau_s)))
        else:
            regressed_s = max(state.hardness * state.k_guess_n_s_per_m / stiffness_n_per_m, 1e-7)
            rise = _rise(state.regressed_at_rad_s * regressed_s)
            tau_s = rise * regressed_s
        late = unloading(tau_s) if unloads else spectrum.through(low_pass(tau_s))
        return ({"cutting": rise * late - force},)

    return signature


def _rise(angle_rad: float) -> float:
    """Cutting coefficient over the regressed one, of a force that is late by k / k_b.

    `angle_rad` is what the crank turns in the time constant of the regressed coefficient.
    """
    return float(np.interp(1.0, _RISES * _left(angle_rad * _RISES), _RISES))


def _left(angle_rad: Floats) -> Floats:
    """Share of the coefficient that a regression through zero finds in a late half sine, shape of `angle_rad`."""
    return (_HALF_SINE / (1.0 + (_ORDERS * angle_rad[..., None]) ** 2)).sum(axis=-1)


def _unloading(drive: Floats, state: State) -> Callable[[float], Floats]:
    """Periodic solution of tau dF/dt = drive - F with F >= 0; exact between points where drive is linear."""
    step_s = TWO_PI / drive.shape[-1] / state.speed_rad_s
    step_s = 0.5 * (step_s + np.roll(step_s, 1, axis=-1))
    before = np.roll(drive, 1, axis=-1)
    growth = (drive - before) / step_s

    def late(tau_s: float) -> Floats:
        from sawbench.modeling.effects.unloading_kernel import settled  # numba is heavy

        # From one point to the next: F = rise + keep * F before.
        keep = np.exp(-step_s / tau_s)
        behind = tau_s * growth
        return settled(drive - behind - keep * (before - behind), keep)

    return late


EFFECT = Effect(
    name="blade_compliance",
    place="cutting",
    equation="F + (k / k_b) * dF/dt = k * v",
    words=Words(
        happens="blade, clamp or workpiece is compliant",
        measure="the deflection of the blade under a known load along the cut",
        mend="clamp shorter and tighter; check the seat of the blade",
    ),
    parts=("blade",),
    silent_in=("air", "start_up"),
    strength=Strength(
        name="stiffness_n_per_m",
        unit="N/m",
        typical=1.0,
        low=0.7,
        high=1.4,
        usual=_USUAL_N_PER_M,
        is_less_if_larger=True,
        source="assumed",
    ),
    signature=Prepared(_prepared),
    shapes=(
        *({"stiffness_n_per_m": k, "unloads": u} for k in _STIFFNESS_N_PER_M for u in (0.0, 1.0)),
        *({"stiffness_n_per_m": k, "unloads": u, "by_stock": ALIKE} for k in _STIFFNESS_N_PER_M for u in (0.0, 1.0)),
    ),
    continuous=("stiffness_n_per_m",),
    shape_strength=lambda amplitude, shape: shape["stiffness_n_per_m"] / max(amplitude, 1e-9),
    carries=("stiffness_n_per_m",),
    is_pointwise=False,
    needs=("force_n",),
    grows_with=("speed", "load"),
    confused_with=("force_sensor_lag", "clock_offset", "return_stroke_rubbing"),
    told_apart_by="the motor current: it responds to the delayed force, but not to a lag of the load cell",
    background=tuple(({"stiffness_n_per_m": _STIFFNESS_N_PER_M[-1], "unloads": u}, 1.0) for u in (0.0, 1.0)),
)
