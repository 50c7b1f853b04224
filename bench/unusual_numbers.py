"""What the numbers of a battery tool usually are: one that lies outside was probably stated in another unit.

The ranges reach from small engraving tools to large reciprocating saws. They refuse nothing: a machine may be unusual.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from sawbench.bench.config import BenchConfig, Uncertain
from sawbench.bench.plausible import is_outside

_PLANT: Final = MappingProxyType(
    {
        "resistance_ohm": (0.005, 20.0), "inductance_h": (5e-6, 0.05), "back_emf_constant_v_s_per_rad": (5e-4, 0.2),
        "torque_constant_n_m_per_a": (5e-4, 0.2), "rotor_inertia_kg_m2": (1e-7, 2e-3),
        "yoke_inertia_kg_m2": (0.0, 2e-3), "reciprocating_mass_kg": (0.0, 5.0), "crank_radius_m": (0.001, 0.1),
        "motor_damping_n_m_s_per_rad": (0.0, 1e-3), "gear_ratio": (1.0, 50.0),
    }
)  # fmt: skip
_BATTERY: Final = MappingProxyType(
    {"nominal_voltage_v": (3.0, 130.0), "capacity_ah": (0.2, 60.0), "internal_resistance_ohm": (0.0, 1.0)}
)


def unusual_numbers(config: BenchConfig) -> list[str]:
    """Name the numbers of a saw and its battery that lie outside of what battery tools have.

    Parameters
    ----------
    config : BenchConfig

    Returns
    -------
    list of str
        One sentence each: table, key, value, the usual range, what to do.
    """
    outside = [
        f"[{name}] {key} = {value:g} is unusual: battery tools have {low:g} to {high:g}; check its unit"
        for name, table, usual in (("plant", config.plant, _PLANT), ("battery", config.battery, _BATTERY))
        if table is not None
        for key, (low, high) in usual.items()
        if is_outside(value := _value(getattr(table, key)), (low, high))
    ]
    vague = [
        f"[plant] {key} has rel_std = {number.rel_std:g}, which is {100.0 * number.rel_std:g} %: a share, not percent?"
        for key, number in config.plant or ()
        if isinstance(number, Uncertain) and number.rel_std is not None and number.rel_std > 1.0
    ]
    return [*outside, *vague]


def _value(number: Uncertain | float) -> float:
    return number.nominal if isinstance(number, Uncertain) else number
