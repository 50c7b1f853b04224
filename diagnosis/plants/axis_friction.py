"""Dry friction of an axis straight from its balance of forces: how large, and whether it is the same both ways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from sawbench.bench.config import LinearAxisConfig
from sawbench.bench.plain_digits import plain
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.machines.linear_axis import AxisState

_LEAST_POINTS = 8
_LEAST_UNITS = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class ByDirection:
    """Dry friction by the direction of the motion, means over cycles.

    Attributes
    ----------
    forward_n, backward_n : float
        Towards larger and smaller displacement.
    difference_n, difference_std_n : float
        Forward less backward; standard uncertainty by the scatter of the cycles and the zero of the forces.
    is_significant : bool
        The difference is outside of its 95 % interval about 0.
    """

    forward_n: float
    backward_n: float
    difference_n: float
    difference_std_n: float
    is_significant: bool

    def report(self) -> dict[str, float | bool]:
        """Entry of the report."""
        return asdict(self)

    def words(self) -> str:
        """Say it for the page."""
        constant = f"{plain(0.5 * self.difference_n, 'N')} (a weight, the zero of the drive)"
        if min(self.forward_n, self.backward_n) < 0.0:
            # Friction never pushes: what does is no friction.
            friction = plain(max(0.5 * (self.forward_n + self.backward_n), 0.0), "N", digits=3)
            return (
                f"beside dry friction of {friction}, the same in both directions, acts a constant force of {constant}"
            )
        forward, backward = (plain(force_n, "N", digits=3) for force_n in (self.forward_n, self.backward_n))
        return (
            f"dry friction differs by direction (F+ ≠ F-): {forward} towards larger displacement, {backward} towards"
            f" smaller; a constant force of {constant} is indistinguishable from it"
        )


def friction_n(states: Sequence[AxisState], config: LinearAxisConfig) -> float:
    """Dry friction of the campaign: half the step of the drive's force between the directions, N; at least 0."""
    mass_kg = config.moving_mass_kg.nominal
    rows = np.concatenate([_rows(state, mass_kg, unit) for state in states for unit in range(len(state.position_m))])
    return 0.0 if len(rows) < _LEAST_POINTS else max(float(_by_direction(rows).mean()), 0.0)


def friction_by_direction(
    states: Sequence[AxisState], mass_kg: float, *, zero_std_n: float = 0.0
) -> ByDirection | None:
    """Size the dry friction in each direction, cycle by cycle.

    Parameters
    ----------
    states : sequence of AxisState
    mass_kg : float
        Of what moves.
    zero_std_n : float
        Standard uncertainty of a constant force between drive and load: it is added to one direction and taken from the
        other.

    Returns
    -------
    ByDirection or None
        None with fewer than three cycles or windows that move both ways.
    """
    from scipy.special import ndtri, stdtrit

    found = []
    for state in states:
        for unit in range(len(state.position_m)):
            rows = _rows(state, mass_kg, unit)
            forward, backward = (np.count_nonzero(rows[:, k]) for k in (0, 1))
            if min(forward, backward) >= _LEAST_POINTS:
                found.append(_by_direction(rows))
    if len(found) < _LEAST_UNITS:
        return None
    forward_n, backward_n = np.mean(found, axis=0)
    differences = np.array([a - b for a, b in found])
    std = float(np.std(differences, ddof=1) / np.sqrt(len(found)))
    difference, zero_n = float(differences.mean()), 2.0 * zero_std_n
    half = np.hypot(float(stdtrit(len(found) - 1, 0.975)) * std, float(ndtri(0.975)) * zero_n)
    return ByDirection(
        forward_n=float(forward_n),
        backward_n=float(backward_n),
        difference_n=difference,
        difference_std_n=float(np.hypot(std, zero_n)),
        is_significant=bool(abs(difference) > half),
    )


def both_ways_n(state: AxisState, force_n: Floats) -> float:
    """Constant part of a force, the same in both directions of the motion, N; 0 where it moves one way only."""
    speed = state.velocity_m_s
    least = SETTINGS.axis.standstill_share * np.abs(speed).max()
    ways = [force_n[way] for way in (speed > least, speed < -least)]
    return 0.0 if min(map(len, ways)) == 0 else float(np.mean([np.mean(way) for way in ways]))


def _rows(state: AxisState, mass_kg: float, unit: int) -> Floats:
    """Forward, backward, speed and drive less load and inertia, a row each, where the axis slows down.

    Play that a reversal has opened is closed there. Near standstill friction is whatever holds the axis.
    """
    v, a = state.velocity_m_s[unit], state.acceleration_m_s2[unit]
    speed = np.abs(v)
    kept = (speed > SETTINGS.axis.standstill_share * speed.max()) & (a * v <= 0.0)
    load = 0.0 if state.force_n is None else state.force_n[unit]
    left = state.drive_n[unit] - load - mass_kg * a
    return np.stack([v > 0.0, -1.0 * (v < 0.0), v, left], axis=1)[kept]


def _by_direction(rows: Floats) -> Floats:
    """Friction forward and backward, N: what the force has at no speed, the damping being the same both ways."""
    forces: Floats = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)[0].astype(np.float64)
    return forces[:2]
