"""Equation-error residuals of the baseline model and their sensitivity to what may merely be mistuned.

Each equation of the baseline is evaluated on *measured* signals; what does not cancel is the gap, already
sorted by the equation it violates. Using the measured force in the mechanical equation and the measured
current and speed everywhere separates drive, cutting, supply and sensing without simulating anything:

    electrical   r = U - R i - L di/dt - k_e w                      V      (Eq. 12)
    mechanical   r = k_m i - b w - J_r dw/dt - 1/2 J_r' w^2 - T     N*m    (Eq. 13), T = -F r sin(angle)/gear
    cutting      r = F - k_Fc |v| on the cutting half, F elsewhere  N       v as measured
    supply       r = V_b - E(soc) + R_b i_b                         V      (Eq. 16)
    converter    r = i_b - duty i                                   A

with w the motor speed and F positive when the blade cuts. A signature is the change of these residuals for
a unit of a parameter error or of an effect: "measured minus baseline".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from bench.config import BatteryConfig, PlantConfig
from bench.recording import Floats
from diagnosis.state import State

Equation = Literal["electrical", "mechanical", "cutting", "supply", "converter"]
EQUATIONS: Final[tuple[Equation, ...]] = ("electrical", "mechanical", "cutting", "supply", "converter")
UNITS: Final[Mapping[Equation, str]] = {
    "electrical": "V",
    "mechanical": "N*m",
    "cutting": "N",
    "supply": "V",
    "converter": "A",
}
Signature = dict[Equation, Floats]


@dataclass(frozen=True, kw_only=True, slots=True)
class Baseline:
    """Nominal numbers of the baseline model, SI.

    Attributes
    ----------
    plant : PlantConfig
    battery : BatteryConfig or None
    cutting_sign : int
        -1 where the blade cuts on pi..2*pi (blade velocity negative), +1 on 0..pi.
    """

    plant: PlantConfig
    battery: BatteryConfig | None
    cutting_sign: int

    @property
    def gear(self) -> float:
        """Motor turns per crank turn."""
        return self.plant.gear_ratio

    @property
    def radius_m(self) -> float:
        """Crank radius."""
        return self.plant.crank_radius_m.nominal

    def blade_velocity(self, state: State) -> Floats:
        """Blade velocity, m/s, positive away from the dead centre at angle 0: Eq. 3, and what was measured beyond."""
        velocity = self.radius_m * state.speed_rad_s * np.sin(state.angle_rad)
        return velocity if state.blade_excess_m_s is None else velocity + state.blade_excess_m_s

    def cutting_speed(self, state: State) -> Floats:
        """Speed of the blade into the wood, m/s: |v| on the cutting half, 0 on the return half."""
        return np.maximum(self.cutting_sign * self.blade_velocity(state), 0.0)

    def is_cutting_half(self, state: State) -> Floats:
        """1 on the cutting half, 0 on the return half."""
        return (self.cutting_sign * np.sin(state.angle_rad) > 0).astype(float)

    def expected_force(self, state: State) -> Floats:
        """Force of the linear cutting law with the campaign's own k_Fc for this stock, N."""
        return state.slow["k_guess_n_s_per_m"] * self.cutting_speed(state)

    def load_torque(self, state: State, force_n: Floats) -> Floats:
        """Torque at the motor that a blade force asks for, N*m (Eq. 8)."""
        return self.cutting_sign * force_n * self.radius_m * np.sin(state.angle_rad) / self.gear

    def open_circuit_voltage(self, charge_used_as: Floats) -> Floats:
        """Eq. 16 without the drop over the internal resistance, V."""
        if self.battery is None:
            raise ValueError("no battery in the configuration")
        soc = np.clip(1.0 - charge_used_as / (3600.0 * self.battery.capacity_ah), 1e-3, 1.0)
        return self.battery.nominal_voltage_v * soc / (1.0 - self.battery.beta * (1.0 - soc))

    def evaluable_equations(self, state: State) -> frozenset[Equation]:
        """Name the equations that `residuals` can evaluate on a state's channels."""
        has_current, has_angle = state.current_a is not None, is_angle_known(state)
        has_battery_current = state.battery_current_a is not None
        found: dict[Equation, bool] = {
            "electrical": has_current,
            "mechanical": has_current and has_angle and (state.force_n is not None or state.setting.is_idle),
            "cutting": state.force_n is not None and has_angle,
            "supply": has_battery_current and state.battery_voltage_v is not None and self.battery is not None,
            "converter": has_battery_current and has_current,
        }
        return frozenset(name for name, is_there in found.items() if is_there)


def residuals(baseline: Baseline, state: State) -> Signature:
    """Evaluate every equation that the measured channels allow.

    Parameters
    ----------
    baseline : Baseline
    state : State
        Arrays of shape (n_units, n_points).

    Returns
    -------
    dict of str to ndarray, shape (n_units, n_points)
        In the units of `UNITS`; an equation is absent where one of its channels or the angle it needs is.
    """
    plant, gear = baseline.plant, baseline.gear
    motor_speed = gear * state.speed_rad_s
    found: Signature = {}
    if state.current_a is not None and state.current_rate_a_s is not None:
        found["electrical"] = (
            state.motor_voltage_v
            - plant.resistance_ohm.nominal * state.current_a
            - plant.inductance_h.nominal * state.current_rate_a_s
            - plant.back_emf_constant_v_s_per_rad.nominal * motor_speed
        )
        force = np.zeros_like(state.current_a) if state.force_n is None else state.force_n
        if is_angle_known(state) and (state.force_n is not None or state.setting.is_idle):
            found["mechanical"] = (
                plant.torque_constant_n_m_per_a.nominal * state.current_a
                - plant.motor_damping_n_m_s_per_rad.nominal * motor_speed
                - inertia_torque(baseline, state)
                - baseline.load_torque(state, force)
            )
    if state.force_n is not None and is_angle_known(state):
        found["cutting"] = state.force_n
    if state.battery_voltage_v is not None and state.battery_current_a is not None and baseline.battery:
        found["supply"] = (
            state.battery_voltage_v
            - baseline.open_circuit_voltage(state.charge_used_as)
            + baseline.battery.internal_resistance_ohm * state.battery_current_a
        )
    if state.battery_current_a is not None and state.current_a is not None:
        found["converter"] = state.battery_current_a - state.setting.duty * state.current_a
    return found


def is_angle_known(state: State) -> bool:
    """Whether the crank angle was measured; NaN where a trial has no displacement."""
    return bool(np.isfinite(state.angle_rad[0, 0]))


def inertia_torque(baseline: Baseline, state: State, **only: float) -> Floats:
    """Torque that accelerates rotor, yoke wheel and reciprocating mass, at the motor, N*m (Eq. 6, 13).

    Parameters
    ----------
    baseline : Baseline
    state : State
    **only : float
        Replace the nominal `rotor`, `yoke` (kg*m^2) or `mass` (kg); the others count as zero then.

    Returns
    -------
    ndarray, shape of the state
    """
    plant, gear, radius = baseline.plant, baseline.gear, baseline.radius_m
    rotor = only.get("rotor", 0.0 if only else plant.rotor_inertia_kg_m2.nominal)
    yoke = only.get("yoke", 0.0 if only else plant.yoke_inertia_kg_m2.nominal)
    mass = only.get("mass", 0.0 if only else plant.reciprocating_mass_kg.nominal)
    sine, cosine = np.sin(state.angle_rad), np.cos(state.angle_rad)
    speed, acceleration = state.speed_rad_s, state.acceleration_rad_s2
    swing = mass * radius**2 * sine * (sine * acceleration + cosine * speed**2) / gear
    return rotor * gear * acceleration + yoke * acceleration / gear + swing
