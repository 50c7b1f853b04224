"""The crank behind its gear: inertia that changes with the angle, and what that does to the speed.

    J(a) = G^2 J_m + J_c + m_a g(a)^2
    J(a) dW/dt = T - d W - m_a g g' W^2

with the gear ratio G, the lever g = dy/da of the mechanism and its slope g', the driving torque T and a torque d per
unit of speed, all at the crank. Assumptions: rigid, no losses in the gear. Range: any angle.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eqs. 2, 6 and 13 (Eqs. 6 and 13 times G^2 and G).
"""

from __future__ import annotations

from sawbench.modeling.compilation import kernel


@kernel()
def rotating_inertia(rotor_inertia_kg_m2, yoke_inertia_kg_m2, gear_ratio):
    """Inertia of what only turns, at the crank, kg*m^2."""
    return rotor_inertia_kg_m2 * gear_ratio * gear_ratio + yoke_inertia_kg_m2


@kernel()
def inertia(rotating_kg_m2, mass_kg, lever_m):
    """Inertia at the crank with the reciprocating mass, kg*m^2 (Eq. 6)."""
    return rotating_kg_m2 + mass_kg * lever_m * lever_m


@kernel()
def swing(mass_kg, lever_m, slope_m):
    """Torque per squared speed that the change of inertia takes, N*m*s^2: half of dJ/da."""
    return mass_kg * lever_m * slope_m


@kernel()
def acceleration(inverse_inertia, torque, drag, swing_term, speed):
    """Angular acceleration of the crank, rad/s^2; `drag` is the torque per unit of speed, N*m*s (Eq. 13).

    Examples
    --------
    >>> acceleration(1.0 / 0.002, 0.5, 0.001, 0.0, 100.0)
    200.0
    """
    return inverse_inertia * (torque - (drag + swing_term * speed) * speed)
