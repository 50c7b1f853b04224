"""Equation-error residuals of the baseline model and their sensitivity to what may merely be mistuned.

Each equation of the baseline is evaluated on *measured* signals; what does not cancel is the gap, already
sorted by the equation it violates. Using the measured force in the mechanical equation and the measured
current and speed everywhere separates drive, cutting, supply and sensing without simulating anything:

    electrical   r = U - R i - L di/dt - k_e w                      V      (Eq. 12)
    mechanical   r = k_m i - b w - J_r dw/dt - 1/2 J_r' w^2 - T     N*m    (Eq. 13), T = -F g(angle)/gear
    cutting      r = F - k_Fc |v| on the cutting half, F elsewhere  N       v as measured
    supply       r = V_b - E(soc) + R_b i_b                         V      (Eq. 16)
    converter    r = i_b - duty i                                   A

with w the motor speed, g = dy/dangle the lever of the mechanism and F positive when the blade cuts. A signature
is the change of these residuals for a unit of a parameter error or of an effect: "measured minus baseline". What
known effects change is taken off: their machine has the residuals r - sum of value * signature.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.bench.recording import Floats
from sawbench.modeling.load import OAK, Load
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.effects.known import KnownEffect

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
    known : tuple of KnownEffect
        Effects that belong to the model.
    load : Load
        What it carries while it cuts.
    session_s : float
        Time from the first trial of a campaign to the end of the last one, s.
    mechanism : Mechanism
        What turns the crank's angle into the blade's travel, at its nominal lengths.
    """

    plant: PlantConfig
    battery: BatteryConfig | None
    cutting_sign: int
    known: tuple[KnownEffect, ...] = ()
    load: Load = OAK
    session_s: float = 3600.0
    mechanism: Mechanism = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "mechanism", Mechanism.of(self.plant))

    @property
    def gear(self) -> float:
        """Motor turns per crank turn."""
        return self.plant.gear_ratio

    @property
    def radius_m(self) -> float:
        """Crank radius."""
        return self.plant.crank_radius_m.nominal

    @property
    def usual_current_a(self) -> float:
        """Motor current that the usual cut asks for."""
        return self.load.torque_n_m / self.plant.torque_constant_n_m_per_a.nominal

    def inertia_kg_m2(self, lever_m: Floats) -> Floats:
        """Inertia at the crank where the blade's lever is so long: without the plunger where it is 0 (Eq. 6)."""
        from sawbench.modeling.parts import crank

        plant = self.plant
        rotating = crank.rotating_inertia.py_func(
            plant.rotor_inertia_kg_m2.nominal, plant.yoke_inertia_kg_m2.nominal, self.gear
        )
        return np.asarray(crank.inertia.py_func(rotating, plant.reciprocating_mass_kg.nominal, lever_m))

    def lever(self, state: State) -> Floats:
        """Derivative of the blade's travel by the crank angle, m, shape of the state."""
        return state.motion.levers(self.mechanism)[0]

    def blade_velocity(self, state: State) -> Floats:
        """Blade velocity, m/s, positive away from the dead centre at angle 0: Eq. 3, and what was measured beyond."""
        velocity = self.lever(state) * state.speed_rad_s
        return velocity if state.blade_excess_m_s is None else velocity + state.blade_excess_m_s

    def cutting_speed(self, state: State) -> Floats:
        """Speed of the blade into the wood, m/s: |v| on the cutting half, 0 on the return half."""
        return np.maximum(self.cutting_sign * self.blade_velocity(state), 0.0)

    def travelled(self, state: State) -> Floats:
        """Way of the blade from the dead centre at which the cutting half begins, m."""
        above = self.mechanism.displacement(state.angle_rad)
        return above if self.cutting_sign > 0 else 2.0 * self.radius_m - above

    def expected_force(self, state: State) -> Floats:
        """Force of the linear cutting law in the trial's own piece, N: what shifts or shapes a force goes with it."""
        return state.hardness * self.stock_force(state)

    def stock_force(self, state: State) -> Floats:
        """The same with k_Fc of the stock, N: what makes one trial harder to cut than another is said of this."""
        return state.k_guess_n_s_per_m * self.cutting_speed(state)

    def load_torque(self, state: State, force_n: Floats) -> Floats:
        """Torque at the motor that a blade force asks for, N*m (Eq. 8)."""
        return self.cutting_sign * force_n * self.lever(state) / self.gear

    def open_circuit_voltage(self, charge_used_as: Floats) -> Floats:
        """Voltage without the drop over the internal resistance, V."""
        if self.battery is None:
            raise ValueError("no battery in the configuration")
        soc = np.clip(1.0 - charge_used_as / (3600.0 * self.battery.capacity_ah), 1e-3, 1.0)
        from sawbench.modeling.configured_battery import open_circuit_voltage

        return open_circuit_voltage(self.battery, soc)

    def known_signature(self, state: State) -> Signature:
        """What all known effects change in the residuals together, as sensors that are known to distort show it."""
        from sawbench.modeling.effects.transfer import shown_through

        total = summed([known.signature(self, state) for known in self.known if known.effect.distorts is None])
        for sensor in self.known:
            if sensor.effect.distorts is not None:
                [shown] = shown_through(self, state, [total], sensor.transfers(state))
                total = summed([shown, sensor.signature(self, state)])
        return total

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


def summed(signatures: Sequence[Signature]) -> Signature:
    """Add signatures equation by equation."""
    total: Signature = {}
    for signature in signatures:
        for equation, wave in signature.items():
            total[equation] = total[equation] + wave if equation in total else wave
    return total


def without(found: Signature, taken: Signature) -> Signature:
    """Take a signature off residuals, in the equations that these have."""
    return {name: wave - taken[name] if name in taken else wave for name, wave in found.items()}


def residuals(baseline: Baseline, state: State, asked: Collection[Equation] = EQUATIONS) -> Signature:
    """Evaluate every equation asked for that the measured channels allow, less what known effects make of it.

    Parameters
    ----------
    baseline : Baseline
    state : State
        Arrays of shape (n_units, n_points).
    asked : collection of str
        Equations; default: all.

    Returns
    -------
    dict of str to ndarray, shape (n_units, n_points)
        In the units of `UNITS`; an equation is absent where one of its channels or the angle it needs is.
    """
    found = bare_residuals(baseline, state, asked)
    return without(found, baseline.known_signature(state)) if baseline.known else found


def bare_residuals(baseline: Baseline, state: State, asked: Collection[Equation] = EQUATIONS) -> Signature:
    """Evaluate `residuals` of the machine without any effect."""
    kept = baseline.evaluable_equations(state)
    return {name: evaluate(baseline, state) for name, evaluate in _BARE.items() if name in kept and name in asked}


def _electrical(baseline: Baseline, state: State) -> Floats:
    from sawbench.modeling.parts import dc_motor

    plant = baseline.plant
    assert state.current_a is not None and state.current_rate_a_s is not None
    without_rate = dc_motor.inductive_voltage.py_func(
        plant.resistance_ohm.nominal,
        plant.back_emf_constant_v_s_per_rad.nominal,
        state.motor_voltage_v,
        state.current_a,
        baseline.gear * state.speed_rad_s,
    )
    return without_rate - plant.inductance_h.nominal * state.current_rate_a_s


def _mechanical(baseline: Baseline, state: State) -> Floats:
    from sawbench.modeling.parts import dc_motor

    plant = baseline.plant
    assert state.current_a is not None
    shaft = dc_motor.shaft_torque.py_func(
        plant.torque_constant_n_m_per_a.nominal,
        plant.motor_damping_n_m_s_per_rad.nominal,
        state.current_a,
        baseline.gear * state.speed_rad_s,
    )
    force = np.zeros_like(state.speed_rad_s) if state.force_n is None else state.force_n
    return shaft - inertia_torque(baseline, state) - baseline.load_torque(state, force)


def _cutting(_: Baseline, state: State) -> Floats:
    assert state.force_n is not None
    return state.force_n


def _supply(baseline: Baseline, state: State) -> Floats:
    assert baseline.battery is not None and state.battery_voltage_v is not None and state.battery_current_a is not None
    drop_v = baseline.battery.internal_resistance_ohm * state.battery_current_a
    return state.battery_voltage_v - baseline.open_circuit_voltage(state.charge_used_as) + drop_v


def _converter(_: Baseline, state: State) -> Floats:
    assert state.battery_current_a is not None and state.current_a is not None
    return state.battery_current_a - state.setting.duty * state.current_a


_BARE: Final[Mapping[Equation, Callable[[Baseline, State], Floats]]] = MappingProxyType(
    {
        "electrical": _electrical, "mechanical": _mechanical, "cutting": _cutting, "supply": _supply,
        "converter": _converter,
    }
)  # fmt: skip


def is_angle_known(state: State) -> bool:
    """Whether the crank angle was measured; NaN where a trial has no displacement."""
    return bool(np.isfinite(state.angle_rad.flat[0]))


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
    plant, gear = baseline.plant, baseline.gear
    rotor = only.get("rotor", 0.0 if only else plant.rotor_inertia_kg_m2.nominal)
    yoke = only.get("yoke", 0.0 if only else plant.yoke_inertia_kg_m2.nominal)
    mass = only.get("mass", 0.0 if only else plant.reciprocating_mass_kg.nominal)
    acceleration = state.acceleration_rad_s2
    swing = mass * plunger_swing(baseline.mechanism, state) / gear
    return rotor * gear * acceleration + yoke * acceleration / gear + swing


def plunger_swing(mechanism: Mechanism, state: State) -> Floats:
    """Torque at the crank that moves one kilogram of plunger, N*m/kg: g (g alpha + g' w^2), shape of the state."""
    return state.motion.levers(mechanism)[0] * plunger_acceleration(mechanism, state)


def plunger_acceleration(mechanism: Mechanism, state: State) -> Floats:
    """Acceleration of the plunger by the crank's motion, m/s^2: g alpha + g' w^2, shape of the state."""
    lever_m, slope_m = state.motion.levers(mechanism)
    return lever_m * state.acceleration_rad_s2 + slope_m * state.speed_rad_s**2


def motor_ahead(baseline: Baseline, extra_speed: Floats, extra_acceleration: Floats) -> Signature:
    """Residuals where the motor turns faster than gear and crank say.

    Parameters
    ----------
    baseline : Baseline
    extra_speed : ndarray, shape of the state
        Of the motor, rad/s.
    extra_acceleration : ndarray, shape of the state
        Its time derivative, rad/s^2.
    """
    plant = baseline.plant
    return {
        "electrical": plant.back_emf_constant_v_s_per_rad.nominal * extra_speed,
        "mechanical": plant.rotor_inertia_kg_m2.nominal * extra_acceleration
        + plant.motor_damping_n_m_s_per_rad.nominal * extra_speed,
    }
