"""A force measured over the crank angle, replayed: the paper's "real cutting force".

    F_c = F(phi), periodic over one turn

Between the nodes a cubic spline runs through each half turn on its own, with nodes on the dead centres, so
that the kink at the reversal stays where it is. Assumptions: the force depends on the angle alone, not on
speed. Where the motor cannot overcome it the machine stands: at rest the force only holds, it never
drives the crank back.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, section 4.1 and Fig. 5b.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.parts.linear import CuttingHalf, sign_of
from sawbench.modeling.validation import not_negative

MOST_NODES = 512


@kernel()
def spline_force(spline, turn):
    """Force of a table at an angle in [0, 2*pi), N; `spline` as `MeasuredForce.spline` gives it."""
    width = 2.0 * np.pi / len(spline)
    place = np.maximum(np.minimum(np.int64(turn / width), len(spline) - 1), 0)
    u = turn - place * width
    return spline[place, 0] + u * (spline[place, 1] + u * (spline[place, 2] + u * spline[place, 3]))


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasuredForce:
    """Cutting force over the crank angle.

    Attributes
    ----------
    force_n : ndarray, shape (n_nodes,)
        Force at the angles 2*pi*j/n_nodes, N, positive when the blade cuts; n_nodes even, 8 to 512. Zero on
        the half that does not cut, unless the blade rubs there (then negative).
    scale : float
        Multiplies the force.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(32) / 32
    >>> force = MeasuredForce(force_n=280.0 * np.maximum(-np.sin(angle), 0.0))
    >>> float(np.round(force.force_at(np.array([1.5 * np.pi]))[0], 6))
    280.0
    """

    force_n: NDArray[np.float64]
    scale: float = 1.0
    cutting_half: CuttingHalf = "pi_to_2pi"
    _pieces: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        force = np.array(self.force_n, dtype=np.float64)
        if force.ndim != 1 or len(force) % 2 or not 8 <= len(force) <= MOST_NODES:
            raise InputError(f"force_n needs one even number of nodes from 8 to {MOST_NODES}, got shape {force.shape}")
        if not np.isfinite(force).all():
            bad = int(np.flatnonzero(~np.isfinite(force))[0])
            raise InputError(f"force_n must be finite, got {force[bad]!r} N at node {bad}")
        not_negative("scale", self.scale, "")
        sign_of(self.cutting_half)
        force.setflags(write=False)
        object.__setattr__(self, "force_n", force)
        object.__setattr__(self, "_pieces", _half_turn_splines(force))

    @classmethod
    def from_samples(
        cls,
        angle_rad: ArrayLike,
        force_n: ArrayLike,
        *,
        n_nodes: int = 128,
        cutting_half: CuttingHalf = "pi_to_2pi",
    ) -> MeasuredForce:
        """Take a force sampled at any increasing angles of one turn, shape (n,), rad and N.

        The half that does not cut is set to zero, as section 4.1 does.
        """
        from scipy.interpolate import CubicSpline

        angle = np.asarray(angle_rad, dtype=np.float64)
        force = np.asarray(force_n, dtype=np.float64)
        if angle.shape != force.shape or angle.ndim != 1 or len(angle) < 8:
            raise InputError(
                f"angle_rad and force_n need one equal length of at least 8, got {angle.shape}, {force.shape}"
            )
        if not (np.isfinite(angle).all() and np.isfinite(force).all()):
            raise InputError("angle_rad and force_n must be finite")
        if (np.diff(angle) <= 0).any() or angle[-1] - angle[0] >= 2 * np.pi:
            raise InputError("angle_rad must increase and span less than one turn")
        turn = CubicSpline(np.append(angle, angle[0] + 2 * np.pi), np.append(force, force[0]), bc_type="periodic")
        nodes = 2 * np.pi * np.arange(n_nodes) / n_nodes
        values = turn(nodes)
        values[sign_of(cutting_half) * np.sin(nodes) <= 1e-12] = 0.0
        return cls(force_n=values, cutting_half=cutting_half)

    def spline(self) -> NDArray[np.float64]:
        """Return c0..c3 of c0 + c1 u + c2 u^2 + c3 u^3, shape (n_nodes, 4); u in rad from the node."""
        return self._pieces

    def force_at(self, angle_rad: ArrayLike) -> NDArray[np.float64]:
        """Force at crank angles, any shape, rad; N."""
        turn = np.mod(np.asarray(angle_rad, dtype=np.float64), 2 * np.pi)
        return self.scale * spline_force.py_func(self.spline(), turn)

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the cutting slots into a parameter vector, in place."""
        vector[slots.K_FC] = 0.0
        vector[slots.FORCE_SCALE] = self.scale
        vector[slots.CUTTING_SIGN] = sign_of(self.cutting_half)


def _half_turn_splines(force_n: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients of two cubic splines, one a half turn, shape (n_nodes, 4)."""
    from scipy.interpolate import CubicSpline

    half = len(force_n) // 2
    closed = np.append(force_n, force_n[0])
    nodes = 2 * np.pi * np.arange(len(closed)) / len(force_n)
    pieces = []
    for part in (slice(0, half + 1), slice(half, 2 * half + 1)):
        coefficients = CubicSpline(nodes[part], closed[part]).c
        pieces.append(coefficients[::-1].T)
    return np.ascontiguousarray(np.vstack(pieces))
