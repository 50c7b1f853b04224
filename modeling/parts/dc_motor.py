"""A brushed motor with permanent magnets.

    U = R i + L di/dt + k_e w,   T = k_m i - b w

Both functions are homogeneous: with voltage and current per unit of speed, at speed 1, they give rates per unit of
angle. Assumptions: no saturation, no brush drop, constant temperature. k_e and k_m are kept apart: their difference
stands for losses inside the motor. Range: any current and speed.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eqs. 12 and 13.
"""

from __future__ import annotations

from sawbench.modeling.compilation import kernel


@kernel()
def inductive_voltage(resistance_ohm, back_emf_constant, voltage_v, current_a, speed_rad_s):
    """Voltage that is left to change the current, L di/dt, V (Eq. 12).

    Examples
    --------
    >>> inductive_voltage(0.2, 0.007, 8.0, 10.0, 500.0)
    2.5
    """
    return voltage_v - resistance_ohm * current_a - back_emf_constant * speed_rad_s


@kernel()
def shaft_torque(torque_constant, damping, current_a, speed_rad_s):
    """Torque at the shaft of a motor that turns steadily, N*m (Eq. 13).

    Examples
    --------
    >>> shaft_torque(0.005, 1.0e-5, 10.0, 500.0)
    0.045
    """
    return torque_constant * current_a - damping * speed_rad_s
