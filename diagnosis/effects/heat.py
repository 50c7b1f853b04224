"""Temperature rise of the motor from its own current: slow states the campaign has computed once."""

from __future__ import annotations

from typing import Final

from bench.recording import Floats
from diagnosis.equations import Baseline
from diagnosis.state import State

# One or two thermal masses (winding, housing): time constants, s, and the share of the fast one.
HEAT_SHAPES: Final[tuple[dict[str, float], ...]] = (
    *({"fast_s": tau, "slow_s": tau, "fast_share": 1.0} for tau in (15.0, 40.0, 100.0, 170.0, 300.0, 520.0, 900.0)),
    {"fast_s": 15.0, "slow_s": 300.0, "fast_share": 0.5},
    {"fast_s": 40.0, "slow_s": 300.0, "fast_share": 0.5},
    {"fast_s": 40.0, "slow_s": 900.0, "fast_share": 0.3},
    {"fast_s": 100.0, "slow_s": 900.0, "fast_share": 0.5},
)


def copper_loss_w(baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float) -> Floats:
    """Copper loss as the thermal masses feel it, W, shape (n_units, 1).

    Times a thermal resistance it is the temperature rise in K.
    """
    fast_a2, slow_a2 = state.slow[f"heat_{fast_s:.0f}_a2"], state.slow[f"heat_{slow_s:.0f}_a2"]
    squared_a2 = fast_share * fast_a2 + (1.0 - fast_share) * slow_a2
    return baseline.plant.resistance_ohm.nominal * squared_a2


def friction_loss_w(baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float) -> Floats:
    """Friction of the rotor, b w^2, as the thermal masses feel it, W, shape (n_units, 1)."""
    fast, slow = state.slow[f"spin_{fast_s:.0f}_rad2_s2"], state.slow[f"spin_{slow_s:.0f}_rad2_s2"]
    squared_rad2_s2 = baseline.gear**2 * (fast_share * fast + (1.0 - fast_share) * slow)
    return baseline.plant.motor_damping_n_m_s_per_rad.nominal * squared_rad2_s2
