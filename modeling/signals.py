"""What follows from current, speed, angle and charge, sample by sample: blade, force, voltages, stored energy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.modeling import slots
from sawbench.modeling.parts import converter, crank, eq16, linear, measured, ocv_table
from sawbench.modeling.parts.mechanism import Mechanism

Floats = NDArray[np.float64]


def mechanism_of(vector: Floats) -> Mechanism:
    """Return the mechanism in a parameter vector."""
    rod_m = float(vector[slots.ROD])
    return Mechanism(radius_m=float(vector[slots.RADIUS]), rod_length_m=rod_m if rod_m > 0.0 else None)


def blade(
    vector: Floats, spline: Floats, angle_rad: Floats, motor_speed_rad_s: Floats
) -> tuple[Floats, Floats, Floats]:
    """Displacement, blade velocity and cutting force, shape (n,) each: m, m/s, N (Eqs. 1, 3, 9)."""
    mechanism, sign = mechanism_of(vector), vector[slots.CUTTING_SIGN]
    velocity = mechanism.lever(angle_rad) * motor_speed_rad_s / vector[slots.GEAR]
    is_cutting = sign * np.sin(angle_rad) > 0.0
    force = np.where(is_cutting, linear.force.py_func(vector[slots.K_FC], sign * velocity), 0.0)
    if vector[slots.FORCE_SCALE] != 0.0:
        replayed = measured.spline_force.py_func(spline, np.mod(angle_rad, 2.0 * np.pi))
        force = force + np.where(motor_speed_rad_s > 0.0, vector[slots.FORCE_SCALE] * replayed, 0.0)
    return mechanism.displacement(angle_rad), velocity, force


def open_circuit_voltage(vector: Floats, ocv: Floats, soc: Floats) -> Floats:
    """Open-circuit voltage of the battery, V, of the shape of `soc`."""
    if len(ocv):
        return ocv_table.voltage.py_func(ocv, soc)[0]
    fraction = 1.0 - (1.0 - soc) * vector[slots.CAPACITY_RATIO]
    return eq16.voltage.py_func(vector[slots.NOMINAL_VOLTAGE], vector[slots.BETA], fraction)[0]


def electric(vector: Floats, ocv: Floats, current_a: Floats, soc: Floats) -> tuple[Floats, Floats, Floats]:
    """Motor voltage, battery voltage and battery current, shape (n,) each: V, V, A."""
    if vector[slots.MODE] == slots.FIXED_VOLTAGE:
        voltage = np.full_like(current_a, vector[slots.VOLTAGE])
        return voltage, voltage, current_a
    open_v = open_circuit_voltage(vector, ocv, soc)
    drop, resistance, efficiency = vector[slots.DIODE], vector[slots.BATTERY_RESISTANCE], vector[slots.EFFICIENCY]
    duty = vector[slots.DUTY]
    if vector[slots.MODE] == slots.HELD_VOLTAGE:
        sag = resistance * converter.battery_current.py_func(1.0, current_a, efficiency)
        duty = converter.holding_duty.py_func(open_v, sag, vector[slots.VOLTAGE], drop)
    battery_current = converter.battery_current.py_func(duty, current_a, efficiency)
    battery_voltage = open_v - resistance * battery_current
    return converter.motor_voltage.py_func(duty, battery_voltage, drop), battery_voltage, battery_current


def stored_energy(vector: Floats, current_a: float, crank_speed_rad_s: float, angle_rad: float) -> float:
    """Magnetic and kinetic energy, J (Eq. 5)."""
    rotating = crank.rotating_inertia.py_func(
        vector[slots.ROTOR_INERTIA], vector[slots.YOKE_INERTIA], vector[slots.GEAR]
    )
    inertia = crank.inertia.py_func(rotating, vector[slots.MASS], mechanism_of(vector).lever(np.asarray(angle_rad)))
    return float(0.5 * vector[slots.INDUCTANCE] * current_a**2 + 0.5 * inertia * crank_speed_rad_s**2)
