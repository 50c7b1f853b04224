"""The controller pulls the duty back above i_max: flat-topped start-up and peaks of the current.

At the limit di/dt is about 0, so the voltage pulled back is what is left: duty V_b - R i_max - k_e w > 0.
The baseline still counts it (electrical residual positive) and expects more battery current (converter
residual negative, by the same share of the current). Forms: hard (the voltage is missing above a share of the
campaign's top current, a low one where the duty comes back slowly), soft (the duty falls in proportion to the
excess over a knee; the unit is then all the voltage that R times the top current leaves), slow to let go (what the
largest excess held back returns with a time constant; the unit is all the voltage at 40 % above). Without a limit the
left-over voltage at the top of a start-up is 0, so is the signature; where only running machines were recorded, the top
current is that of the hardest cut. Limits of 10 to 40 A: assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import START_UP_STEP_S, State

if TYPE_CHECKING:
    from sawbench.modeling.effects.known import KnownEffect

# Width of the hard limit's edge over the distance of the edge from the top current.
_EDGE = 0.25
# A limiter that lets go slowly: how far above the limit, as a share of the top current, all the voltage is held back.
_FULL_EXCESS = 0.4
_LIMITS, _RELEASES_S = tuple(float(s) for s in np.linspace(0.44, 0.92, 9)), (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)


def _signature(
    baseline: Baseline, state: State, share: float, soft: float = 0.0, release_s: float = 0.0
) -> tuple[Signature, ...]:
    top_a = state.top_current_a
    if state.current_a is None or not top_a > 0.0:
        return ({},)
    plant = baseline.plant
    if release_s:
        excess = np.maximum(state.current_a / top_a - share, 0.0)
        lack_v = state.motor_voltage_v * _held(state, excess, release_s) / _FULL_EXCESS
    elif soft:
        left_v = np.maximum(state.motor_voltage_v - plant.resistance_ohm.nominal * top_a, 0.0)
        lack_v = left_v * np.clip((state.current_a / top_a - share) / (1.0 - share), 0.0, 1.0)
    else:
        lack_v = _left_over(baseline, state, state.current_a) / (
            1.0 + np.exp(np.clip((share - state.current_a / top_a) / (_EDGE * (1.0 - share)), -50.0, 50.0))
        )
    return (held_back(state, state.current_a, lack_v),)


def held_back(state: State, current_a: Floats, lack_v: Floats) -> Signature:
    """What a voltage that is held back leaves: in the motor's balance, and as battery current not drawn."""
    share = lack_v / np.maximum(state.motor_voltage_v, 1e-3)
    return {"electrical": lack_v, "converter": -state.setting.duty * share * current_a}


def _held(state: State, excess: Floats, release_s: float) -> Floats:
    """Largest excess so far, each let go with a time constant, of the shape of the state."""
    n = excess.shape[-1]
    if state.kind == "start_up":
        since_s = START_UP_STEP_S * np.arange(n)
    else:
        # A stroke and the one before it: what was held then is still there.
        excess = np.concatenate([excess, excess], axis=-1)
        since_s = np.cumsum(2.0 * np.pi / n / np.tile(state.speed_rad_s, 2), axis=-1)
    grown = np.exp(np.minimum(since_s / release_s, 300.0))
    return (np.maximum.accumulate(excess * grown, axis=-1) / grown)[..., -n:]


def _left_over(baseline: Baseline, state: State, current_a: Floats) -> Floats:
    plant = baseline.plant
    emf = plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * state.speed_rad_s
    return np.maximum(state.motor_voltage_v - plant.resistance_ohm.nominal * current_a - emf, 0.0)


def beyond_limit(known: Sequence[KnownEffect], states: Sequence[State]) -> tuple[str, ...]:
    """Say where the current of predicted strokes stays above a limit, one sentence; nothing where it does not.

    The forms hold back no more than the voltage that is left over: the current then rises no further, but only a motor
    that becomes faster takes it back below the limit.

    Parameters
    ----------
    known : sequence of KnownEffect
        Others than current limits are passed over.
    states : sequence of State
        Running, with a current.
    """
    tops_a = [one.scales.get("top_current_a", np.inf) for one in known if one.effect.name == EFFECT.name]
    least_a = [float(state.current_a.min()) for state in states if state.current_a is not None]
    if not tops_a or max(least_a, default=0.0) <= min(tops_a):
        return ()
    return (
        f"[effects] {EFFECT.name} limits the top of the current, to {min(tops_a):.4g} A (top_current_a); here the"
        f" predicted current stays above that over the whole stroke, at {max(least_a):.4g} A and more: a limited saw"
        " is slower and draws less, so the runtime is too short",
    )


EFFECT = Effect(
    name="current_limit",
    place="electrical",
    equation="duty falls so that i <= i_max",
    words=Words(
        happens="the controller limits the current",
        measure="the starting current under load with an oscilloscope: a flat top",
        mend="check the current limit of the controller",
    ),
    parts=("converter", "motor"),
    strength=Strength(name="voltage_share_pulled_back", unit="1", typical=1.0, low=0.1, high=1.5, source="assumed"),
    signature=_signature,
    shapes=(
        *({"share": s, "soft": 0.0} for s in (0.98, 0.92, 0.85, 0.7, 0.55)),
        *({"share": s, "soft": 1.0} for s in (0.5, 0.7, 0.85)),
        *({"share": s, "release_s": tau} for s in _LIMITS for tau in _RELEASES_S),
    ),
    continuous=("share", "release_s"),
    is_pointwise=False,
    scales=("top_current_a",),
    needs=("motor_current_a", "battery_voltage_v"),
    grows_with=("load",),
    confused_with=("brush_voltage_drop", "winding_heating"),
    told_apart_by="a recorded start-up; the histogram of the current",
    background=(),
)
