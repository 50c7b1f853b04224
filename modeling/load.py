"""What a saw carries while it cuts: forces and torques of effects are typical in proportion to it.

An edge force of 40 N is usual where 265 N are cut and large where 60 N are. Friction goes with what the motor drives,
not with the wood: soft wood does not make a guide run more easily. Heat is typical as a rise of temperature, not
as a thermal resistance: a motor that loses 1 W gets some kelvin warmer, which every motor does. Resistances of a
battery are typical as the share of its voltage that they take. Voltage drops of brushes and diodes, delays, and shares
of something follow no load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.modeling.state import Memory

if TYPE_CHECKING:
    from sawbench.modeling.residuals import Baseline
    from sawbench.modeling.state import State


@dataclass(frozen=True, kw_only=True, slots=True)
class Load:
    """Usual values of a cutting trial.

    Attributes
    ----------
    force_n : float
        Peak of the cutting force over the mean stroke.
    blade_speed_m_s : float
        Peak of the blade's speed.
    torque_n_m : float
        Mean torque of the motor.
    motor_speed_rad_s : float
    heat_w : float
        Copper loss of the motor as a thermal mass of 100 s has felt it at most: times a thermal resistance it is a rise
        of the temperature.
    battery_v : float
        Voltage of the battery, as the configuration states it.
    battery_ohm : float
        Voltage of the battery over its current.
    """

    force_n: float
    blade_speed_m_s: float
    torque_n_m: float
    motor_speed_rad_s: float
    heat_w: float
    battery_v: float
    battery_ohm: float

    @property
    def drive_n(self) -> float:
        """Force that the motor's power would drive at the peak of the blade's speed: what the machine is made for."""
        return self.torque_n_m * self.motor_speed_rad_s / self.blade_speed_m_s

    @property
    def battery_a(self) -> float:
        """Current of the battery."""
        return self.battery_v / self.battery_ohm


# The saw of the paper in 20 mm of oak at a duty of 0.4375, as in `recordings/oak-01.mcap`, for some minutes.
OAK: Final = Load(
    force_n=265.0,
    blade_speed_m_s=0.86,
    torque_n_m=0.074,
    motor_speed_rad_s=780.0,
    heat_w=10.0,
    battery_v=18.0,
    battery_ohm=3.7,
)

_HEAT: Final = Memory(drive="motor_current_squared_a2", time_constant_s=100.0)


def load_of(baseline: Baseline, states: Sequence[State]) -> Load:
    """Load of the usual cutting trial of a campaign.

    Parameters
    ----------
    baseline : Baseline
    states : sequence of State

    Returns
    -------
    Load
        Medians over the cutting trials that have force and motor current, and over those with battery voltage and motor
        current; what no trial says is that of `OAK`.
    """
    torque_constant = baseline.plant.torque_constant_n_m_per_a.nominal
    cutting = [s for s in states if s.kind == "running" and not s.setting.is_idle and s.current_a is not None]
    carried = [
        (
            float(state.force_n.mean(axis=0).max()),
            float(np.abs(baseline.blade_velocity(state)).mean(axis=0).max()),
            float(torque_constant * np.abs(state.current_a).mean()),
            float(baseline.gear * state.speed_rad_s.mean()),
        )
        for state in cutting
        if state.force_n is not None
    ]
    drawn_ohm = [
        float(state.battery_voltage_v.mean() / (state.setting.duty * np.abs(state.current_a).mean()))
        for state in cutting
        if state.battery_voltage_v is not None
    ]
    squared_a2 = max((float(state.slow[_HEAT].max()) for state in states if _HEAT in state.slow), default=0.0)
    found: dict[str, float] = {}
    if carried and (np.median(carried, axis=0) > 0.0).all():
        names = ("force_n", "blade_speed_m_s", "torque_n_m", "motor_speed_rad_s")
        found |= zip(names, np.median(carried, axis=0).tolist(), strict=True)
    if baseline.battery is not None:
        found["battery_v"] = baseline.battery.nominal_voltage_v
    if drawn_ohm:
        found["battery_ohm"] = float(np.median(drawn_ohm))
    if squared_a2 > 0.0:
        found["heat_w"] = baseline.plant.resistance_ohm.nominal * squared_a2
    return replace(OAK, **found)
