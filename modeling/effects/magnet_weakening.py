"""Warm magnets are weaker: k_e and k_m (1 - 0.0015/K * dT), dT = R_th * loss through thermal masses.

Positive amplitude: the back-EMF is smaller than the baseline says (electrical residual negative, idle speed
higher) and so is the torque for a current (mechanical residual positive). Both together tell it from
winding heat, which grows with the current. Ferrite loses 0.2 %/K, NdFeB 0.11 %/K (makers' tables of
remanence); 0.15 %/K is used here. The loss is that of the copper, without or with the rotor's friction b w^2,
which warms the housing at idle as well. Thermal resistance of the magnets' ring to air: 1 to 6 K/W, assumed.
"""

from __future__ import annotations

from typing import Final

from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.heat import COPPER_HEAT, HEAT_SHAPES, SPIN_HEAT, copper_loss_w, friction_loss_w
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

FLUX_LOSS_PER_K: Final = 0.0015


def _signature(
    baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float, friction: float
) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    heat_w = copper_loss_w(baseline, state, fast_s, slow_s, fast_share)
    if friction:
        heat_w = heat_w + friction * friction_loss_w(baseline, state, fast_s, slow_s, fast_share)
    return (weaker_flux(baseline, state, state.current_a, FLUX_LOSS_PER_K * heat_w),)  # at 1 K/W


def weaker_flux(baseline: Baseline, state: State, current_a: Floats, loss: Floats) -> Signature:
    """Residuals where back-EMF and torque of the motor are smaller by a share.

    Parameters
    ----------
    baseline : Baseline
    state : State
    current_a : ndarray, shape of the state
        Of the motor.
    loss : ndarray, broadcast to the state
    """
    plant = baseline.plant
    return {
        "electrical": -loss * plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * state.speed_rad_s,
        "mechanical": loss * plant.torque_constant_n_m_per_a.nominal * current_a,
    }


EFFECT = Effect(
    name="magnet_weakening",
    place="electrical",
    equation="k_e, k_m * (1 - 0.0015/K * dT)",
    words=Words(
        happens="the motor's magnets weaken with heat",
        measure="the idle speed at one voltage cold, and again right after a hot trial",
        mend="let the motor cool between trials",
    ),
    parts=("motor",),
    strength=Strength(
        name="thermal_resistance_k_per_w",
        unit="K/W",
        typical=3.0,
        low=0.1,
        high=4.0,
        source="assumed; 0.15 %/K: between ferrite and NdFeB",
        follows=lambda load: 1.0 / load.heat_w,  # a rise of 30 K
    ),
    signature=_signature,
    memories=(*COPPER_HEAT.values(), *SPIN_HEAT.values()),
    shapes=tuple({**masses, "friction": share} for masses in HEAT_SHAPES for share in (0.0, 1.0)),
    needs=("motor_current_a",),
    grows_with=("load", "time", "speed"),
    confused_with=("winding_heating",),
    told_apart_by="an idle run right after a hot trial: it runs faster",
)
