"""The linear cutting force: a damper that is engaged on one half of the crank turn.

    F_c = k_Fc v_c  on the cutting half,   0 on the other

v_c is the blade speed in the cutting direction, so F_c >= 0 opposes the motion. Assumptions: no dependence
on feed, wear or chip; see the effects for those. Range: k_Fc >= 0 (the paper searches 100 to 500 N*s/m).
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eq. 9 and section 4.1.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.validation import not_negative

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from sawbench.bench.recording import Floats

CuttingHalf = Literal["pi_to_2pi", "zero_to_pi"]
SIGNS = {"pi_to_2pi": -1.0, "zero_to_pi": 1.0}


@kernel()
def force(k_fc_n_s_per_m, speed_m_s):
    """Cutting force at a blade speed in the cutting direction, N (Eq. 9); also torque per lever and speed.

    Examples
    --------
    >>> force(240.0, 0.5)
    120.0
    """
    return k_fc_n_s_per_m * speed_m_s


def coefficient(force_n: Floats, speed_m_s: Floats, axis: int | None = None) -> Floats:
    """k_Fc by regression of the force on the blade speed, through zero.

    Parameters
    ----------
    force_n, speed_m_s : ndarray
        Of one shape; the speed is that in the cutting direction, 0 where the blade does not cut.
    axis : int, optional
        Summed over; all where not given.

    Returns
    -------
    ndarray
        N*s/m; 0 where the blade stands. Bias: an offset of the force sensor counts as force.

    Examples
    --------
    >>> import numpy as np
    >>> float(coefficient(np.array([0.0, 60.0, 110.0]), np.array([0.0, 0.25, 0.5])))
    224.0
    """
    import numpy as np

    return np.sum(force_n * speed_m_s, axis) / np.maximum(np.sum(speed_m_s * speed_m_s, axis), 1e-12)


def sign_of(cutting_half: str) -> float:
    """Return +1 where the blade cuts while its displacement grows (0..pi), -1 where it shrinks.

    Examples
    --------
    >>> sign_of("pi_to_2pi")
    -1.0
    """
    if cutting_half not in SIGNS:
        raise InputError(f"cutting_half must be one of {', '.join(SIGNS)}, got {cutting_half!r}")
    return SIGNS[cutting_half]


@dataclass(frozen=True, kw_only=True, slots=True)
class LinearCutting:
    """The paper's linear damper (Eq. 9).

    Attributes
    ----------
    k_fc_n_s_per_m : float
        Cutting coefficient, N*s/m; 0 is a blade that runs in air.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
        Crank angles at which the blade cuts.

    Examples
    --------
    >>> LinearCutting(k_fc_n_s_per_m=240.29).cutting_half
    'pi_to_2pi'
    """

    k_fc_n_s_per_m: float
    cutting_half: CuttingHalf = "pi_to_2pi"

    def __post_init__(self) -> None:
        not_negative("k_fc_n_s_per_m", self.k_fc_n_s_per_m, "N*s/m")
        sign_of(self.cutting_half)

    def spline(self) -> NDArray[np.float64] | None:
        """No table."""
        return None

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the cutting slots into a parameter vector, in place."""
        vector[slots.K_FC] = self.k_fc_n_s_per_m
        vector[slots.FORCE_SCALE] = 0.0
        vector[slots.CUTTING_SIGN] = sign_of(self.cutting_half)
