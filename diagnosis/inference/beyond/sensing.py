"""Laws of the sensors that model and catalogue take as ideal: straight, each for itself, and at zero without a load."""

from __future__ import annotations

import numpy as np
from sawbench.diagnosis.inference.nuisances import reads_too_much
from sawbench.modeling.effects.effect import Effect, Strength
from sawbench.modeling.residuals import Baseline, Signature, plunger_acceleration
from sawbench.modeling.state import State

_FORCE, _MOTOR_CURRENT = 0.0, 1.0
_CURRENT, _ACCELERATION = 0.0, 1.0


def _bent_reading(baseline: Baseline, state: State, channel: float, sign: float) -> tuple[Signature, ...]:
    """A reading whose gain rises or falls with it: off by its square, stated at its usual peak."""
    if channel == _FORCE:
        if state.force_n is None:
            return ({},)
        by_n = sign * state.force_n * np.abs(state.force_n) / baseline.load.force_n
        return (reads_too_much(baseline, state, "force_n", by_n),)
    if state.current_a is None:
        return ({},)
    by_a = sign * state.current_a * np.abs(state.current_a) / baseline.usual_current_a
    return (reads_too_much(baseline, state, "motor_current_a", by_a),)


def _crosstalk(baseline: Baseline, state: State, of: float, sign: float) -> tuple[Signature, ...]:
    """A force that reads a share of the motor current, or of the mass that is shaken with the blade."""
    if state.force_n is None or state.current_a is None:
        return ({},)
    if of == _CURRENT:
        read_n = baseline.load.force_n * state.current_a / baseline.usual_current_a
    else:
        read_n = plunger_acceleration(baseline.mechanism, state)  # of a kilogram
    return (reads_too_much(baseline, state, "force_n", sign * read_n),)


def _creeping_zero(baseline: Baseline, state: State, time_constant_s: float) -> tuple[Signature, ...]:
    """A zero that follows the mean load of the trial late: glue and metal of the load cell that creep."""
    if state.force_n is None or state.kind != "running":
        return ({},)
    crept = -np.expm1(-np.broadcast_to(state.time_s, state.angle_rad.shape) / time_constant_s)
    return (reads_too_much(baseline, state, "force_n", crept * state.force_n.mean(axis=-1, keepdims=True)),)


BENT_READING = Effect(
    name="sensor whose gain changes with its reading",
    place="sensing",
    equation="reading = x (1 +- a |x| / x_0), of force or motor current",
    strength=Strength(name="share", unit="1", typical=0.03, low=0.1, high=10.0, source="assumed"),
    signature=_bent_reading,
    shapes=tuple({"channel": of, "sign": sign} for of in (_FORCE, _MOTOR_CURRENT) for sign in (1.0, -1.0)),
)
CROSSTALK = Effect(
    name="force that reads something else too",
    place="sensing",
    equation="F + c i, or F + m a of the blade",
    strength=Strength(name="share_or_mass_kg", unit="1", typical=0.02, low=0.1, high=10.0, source="assumed"),
    signature=_crosstalk,
    shapes=tuple({"of": of, "sign": sign} for of in (_CURRENT, _ACCELERATION) for sign in (1.0, -1.0)),
    needs=("force_n",),
)
CREEPING_ZERO = Effect(
    name="load cell that creeps",
    place="sensing",
    equation="F + c mean(F) (1 - exp(-t / T)) in every trial",
    strength=Strength(name="share", unit="1", typical=0.05, low=0.1, high=8.0, source="assumed; OIML R 60"),
    signature=_creeping_zero,
    shapes=tuple({"time_constant_s": tau} for tau in (1.5, 4.0, 10.0, 30.0)),
    silent_in=("air",),
    needs=("force_n",),
)
