"""Temperature rise of the motor from its own current: slow states the campaign has computed once."""

from __future__ import annotations

from typing import Final

from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import Memory, State

_TIMES_S: Final = (15.0, 40.0, 100.0, 170.0, 300.0, 520.0, 900.0)
COPPER_HEAT: Final = {tau: Memory(drive="motor_current_squared_a2", time_constant_s=tau) for tau in _TIMES_S}
SPIN_HEAT: Final = {tau: Memory(drive="crank_speed_squared_rad2_s2", time_constant_s=tau) for tau in _TIMES_S}
# One or two thermal masses (winding, housing): time constants, s, and the share of the fast one.
HEAT_SHAPES: Final[tuple[dict[str, float], ...]] = (
    *({"fast_s": tau, "slow_s": tau, "fast_share": 1.0} for tau in _TIMES_S),
    {"fast_s": 15.0, "slow_s": 300.0, "fast_share": 0.5},
    {"fast_s": 40.0, "slow_s": 300.0, "fast_share": 0.5},
    {"fast_s": 40.0, "slow_s": 900.0, "fast_share": 0.3},
    {"fast_s": 100.0, "slow_s": 900.0, "fast_share": 0.5},
)


def copper_loss_w(baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float) -> Floats:
    """Copper loss as the thermal masses feel it, W, shape (n_units, 1).

    Times a thermal resistance it is the temperature rise in K.
    """
    fast_a2, slow_a2 = state.slow[COPPER_HEAT[fast_s]], state.slow[COPPER_HEAT[slow_s]]
    squared_a2 = fast_share * fast_a2 + (1.0 - fast_share) * slow_a2
    return baseline.plant.resistance_ohm.nominal * squared_a2


def friction_loss_w(baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float) -> Floats:
    """Friction of the rotor, b w^2, as the thermal masses feel it, W, shape (n_units, 1)."""
    fast, slow = state.slow[SPIN_HEAT[fast_s]], state.slow[SPIN_HEAT[slow_s]]
    squared_rad2_s2 = baseline.gear**2 * (fast_share * fast + (1.0 - fast_share) * slow)
    return baseline.plant.motor_damping_n_m_s_per_rad.nominal * squared_rad2_s2
