"""Baseline of a linear drive axis: a force moves a mass on a guide with viscous friction, against a load.

    mechanical   r = F_drive - m a - b v - F_load        N

F_drive is a measured force, or a measured current times a force constant. x, v and a come from the measured
displacement; F_load is measured, or absent. Positive drive and displacement point the same way, the load
against them. The axis moves back and forth at a constant rate in each trial. Friction is not in the baseline but
for its viscous part, so what a real guide does is in the gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sawbench.bench.config import LinearAxisConfig
from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import Equation, Signature, summed, without
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.effects.known import KnownEffect


@dataclass(frozen=True, kw_only=True, slots=True)
class AxisState(State):
    """Measured cycles of an axis; `angle_rad` is the phase, `speed_rad_s` the phase rate.

    Attributes
    ----------
    position_m, velocity_m_s, acceleration_m_s2 : ndarray, shape (n_units, n_points)
    drive_n : ndarray, shape (n_units, n_points)
        Force of the drive, at its nominal force constant.
    is_cyclic : bool
        The end of a unit is followed by its beginning.
    """

    position_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats
    drive_n: Floats
    is_cyclic: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class AxisBaseline:
    """Nominal numbers of an axis, and what its campaign reaches.

    Attributes
    ----------
    config : LinearAxisConfig
    force_scale_n, stroke_m, top_speed_m_s : float
        Largest force of the drive, travel and speed in the campaign: what "typical" sizes are shares of.
    friction_n : float
        Dry friction by which the drive reverses its force, above 0: what is not felt across play in series with it.
    known : tuple of KnownEffect
        Effects that belong to the model.
    """

    config: LinearAxisConfig
    force_scale_n: float
    stroke_m: float
    top_speed_m_s: float
    friction_n: float = 1.0
    known: tuple[KnownEffect, ...] = ()

    def known_signature(self, state: State) -> Signature:
        """What all known effects change in the residuals together."""
        return summed([known.signature(self, state) for known in self.known])

    def evaluable_equations(self, state: State) -> frozenset[Equation]:
        """Every trial that was not left out has the balance of forces."""
        return frozenset(("mechanical",)) if isinstance(state, AxisState) else frozenset()

    def required_force(self, state: AxisState) -> Floats:
        """Force that the measured motion and load ask for in the baseline, N."""
        mass, damping = self.config.moving_mass_kg.nominal, self.config.viscous_damping_n_s_per_m.nominal
        load = 0.0 if state.force_n is None else state.force_n
        return mass * state.acceleration_m_s2 + damping * state.velocity_m_s + load


def residuals(baseline: AxisBaseline, state: State) -> Signature:
    """Balance of forces, N, shape of the state, less what known effects make of it."""
    return without(bare_residuals(baseline, state), baseline.known_signature(state))


def bare_residuals(baseline: AxisBaseline, state: State) -> Signature:
    """Evaluate `residuals` of the axis without any effect."""
    axis = as_axis(state)
    return {"mechanical": axis.drive_n - baseline.required_force(axis)}


def as_axis(state: State) -> AxisState:
    """Narrow a state to that of an axis.

    Raises
    ------
    TypeError
    """
    if not isinstance(state, AxisState):
        raise TypeError(f"a linear axis needs an AxisState, got {type(state).__name__}")
    return state
