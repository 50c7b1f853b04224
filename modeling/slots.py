"""The flat parameter vector that every kernel reads: one named slot a number.

A run with other parameters or another supply is another vector, never another compilation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

# name, default, unit. The order is the layout of the vector; the defaults are a plain motor with no load.
_PLANT: Final = (
    ("resistance_ohm", 0.0, "Ohm"),
    ("inductance_h", 0.0, "H"),
    ("back_emf_constant_v_s_per_rad", 0.0, "V*s/rad"),
    ("torque_constant_n_m_per_a", 0.0, "N*m/A"),
    ("rotor_inertia_kg_m2", 0.0, "kg*m^2"),
    ("yoke_inertia_kg_m2", 0.0, "kg*m^2"),
    ("reciprocating_mass_kg", 0.0, "kg"),
    ("crank_radius_m", 0.0, "m"),
    ("motor_damping_n_m_s_per_rad", 0.0, "N*m*s/rad"),
    ("gear_ratio", 1.0, "1"),
    ("rod_length_m", 0.0, "m"),  # 0: Scotch yoke
)
_CUTTING: Final = (
    ("k_fc_n_s_per_m", 0.0, "N*s/m"),
    ("force_scale", 0.0, "1"),  # of the measured-force table
    ("cutting_sign", -1.0, "1"),  # -1: cuts on pi..2pi, +1: cuts on 0..pi
)
_SUPPLY: Final = (
    ("supply_mode", 0.0, "1"),  # FIXED_VOLTAGE, FIXED_DUTY, HELD_VOLTAGE
    ("voltage_v", 0.0, "V"),
    ("duty", 1.0, "1"),
    ("converter_efficiency", 1.0, "1"),
    ("diode_drop_v", 0.0, "V"),
    ("nominal_voltage_v", 0.0, "V"),
    ("capacity_a_s", 1.0, "A*s"),
    ("beta", 0.0, "1"),
    ("battery_resistance_ohm", 0.0, "Ohm"),
    ("capacity_ratio", 1.0, "1"),  # stated capacity over the capacity that shapes Eq. 16
)
SLOTS: Final = (*_PLANT, *_CUTTING, *_SUPPLY)
NAMES: Final = tuple(name for name, _, _ in SLOTS)
UNITS: Final[Mapping[str, str]] = {name: unit for name, _, unit in SLOTS}
INDEX: Final[Mapping[str, int]] = {name: place for place, name in enumerate(NAMES)}
PLANT_NAMES: Final = tuple(name for name, _, _ in _PLANT)
N_SLOTS: Final = len(SLOTS)

FIXED_VOLTAGE: Final = 0
FIXED_DUTY: Final = 1
HELD_VOLTAGE: Final = 2

RESISTANCE: Final = INDEX["resistance_ohm"]
INDUCTANCE: Final = INDEX["inductance_h"]
BACK_EMF: Final = INDEX["back_emf_constant_v_s_per_rad"]
TORQUE_CONSTANT: Final = INDEX["torque_constant_n_m_per_a"]
ROTOR_INERTIA: Final = INDEX["rotor_inertia_kg_m2"]
YOKE_INERTIA: Final = INDEX["yoke_inertia_kg_m2"]
MASS: Final = INDEX["reciprocating_mass_kg"]
RADIUS: Final = INDEX["crank_radius_m"]
DAMPING: Final = INDEX["motor_damping_n_m_s_per_rad"]
GEAR: Final = INDEX["gear_ratio"]
ROD: Final = INDEX["rod_length_m"]
K_FC: Final = INDEX["k_fc_n_s_per_m"]
FORCE_SCALE: Final = INDEX["force_scale"]
CUTTING_SIGN: Final = INDEX["cutting_sign"]
MODE: Final = INDEX["supply_mode"]
VOLTAGE: Final = INDEX["voltage_v"]
DUTY: Final = INDEX["duty"]
EFFICIENCY: Final = INDEX["converter_efficiency"]
DIODE: Final = INDEX["diode_drop_v"]
NOMINAL_VOLTAGE: Final = INDEX["nominal_voltage_v"]
CAPACITY: Final = INDEX["capacity_a_s"]
BETA: Final = INDEX["beta"]
BATTERY_RESISTANCE: Final = INDEX["battery_resistance_ohm"]
CAPACITY_RATIO: Final = INDEX["capacity_ratio"]

_DEFAULTS: Final = np.array([default for _, default, _ in SLOTS])
_DEFAULTS.setflags(write=False)


def defaults() -> NDArray[np.float64]:
    """Return a fresh vector, shape (N_SLOTS,).

    Examples
    --------
    >>> float(defaults()[GEAR]), float(defaults()[DUTY])
    (1.0, 1.0)
    """
    return _DEFAULTS.copy()
