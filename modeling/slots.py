"""The flat parameter vector that every kernel reads: one named slot a number.

A run with other parameters, another supply or another effect is another vector, never another compilation. A
slot's default switches its effect off, so `defaults()` is a plain motor with no load.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bench.errors import InputError

# name, default, unit. The order is the layout of the vector.
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
    ("rc_resistance_ohm", 0.0, "Ohm"),
    ("rc_time_constant_s", 1.0, "s"),
    ("battery_sag_v", 0.0, "V"),  # across RC elements, where they are held frozen
    ("brush_offset_v", 0.0, "V"),  # brush drop of a current that keeps its sign
)
_EFFECTS: Final = (
    ("guide_coulomb_n", 0.0, "N"),
    ("guide_static_n", 0.0, "N"),  # below guide_coulomb_n: no Stribeck dip
    ("guide_stribeck_speed_m_s", 0.1, "m/s"),
    ("motor_coulomb_n_m", 0.0, "N*m"),
    ("windage_n_m_s2_per_rad2", 0.0, "N*m*s^2/rad^2"),
    ("load_friction", 0.0, "1"),
    ("backlash_m", 0.0, "m"),
    ("eccentricity_n_m", 0.0, "N*m"),
    ("eccentricity_phase_rad", 0.0, "rad"),
    ("blade_compliance_m_per_n", 0.0, "m/N"),
    ("return_rubbing_n_s_per_m", 0.0, "N*s/m"),
    ("return_rubbing_n", 0.0, "N"),
    ("tooth_amplitude", 0.0, "1"),
    ("tooth_pitch_m", 0.003, "m"),
    ("tooth_phase_rad", 0.0, "rad"),
    ("cutting_exponent", 1.0, "1"),
    ("cutting_reference_speed_m_s", 1.0, "m/s"),
    ("edge_force_n", 0.0, "N"),
    ("chip_exponent", 0.0, "1"),
    ("chip_reference_m", 3.0e-4, "m"),
    ("feed_m_s", 0.0, "m/s"),
    ("wear_per_m", 0.0, "1/m"),
    ("grain_amplitude", 0.0, "1"),
    ("grain_wavelength_m", 0.005, "m"),
    ("grain_phase_rad", 0.0, "rad"),
    ("engagement_fraction", 0.0, "1"),
    ("winding_heat_capacity_j_per_k", 0.0, "J/K"),  # 0: the winding keeps its temperature
    ("winding_thermal_resistance_k_per_w", 1.0e9, "K/W"),
    ("resistance_temperature_coefficient_per_k", 0.0039, "1/K"),  # copper
    ("magnet_temperature_coefficient_per_k", 0.0, "1/K"),
    ("brush_drop_v", 0.0, "V"),
    ("extra_battery_resistance_ohm", 0.0, "Ohm"),
    ("polarization_resistance_ohm", 0.0, "Ohm"),
    ("polarization_time_constant_s", 10.0, "s"),
    ("current_limit_a", 0.0, "A"),  # 0: no limit
)
SLOTS: Final = (*_PLANT, *_CUTTING, *_SUPPLY, *_EFFECTS)
NAMES: Final = tuple(name for name, _, _ in SLOTS)
UNITS: Final[Mapping[str, str]] = {name: unit for name, _, unit in SLOTS}
INDEX: Final[Mapping[str, int]] = {name: place for place, name in enumerate(NAMES)}
PLANT_NAMES: Final = tuple(name for name, _, _ in _PLANT)
EFFECT_NAMES: Final = tuple(name for name, _, _ in _EFFECTS)
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
RC_RESISTANCE: Final = INDEX["rc_resistance_ohm"]
RC_TIME: Final = INDEX["rc_time_constant_s"]
SAG: Final = INDEX["battery_sag_v"]
BRUSH_OFFSET: Final = INDEX["brush_offset_v"]
GUIDE_COULOMB: Final = INDEX["guide_coulomb_n"]
GUIDE_STATIC: Final = INDEX["guide_static_n"]
GUIDE_SPEED: Final = INDEX["guide_stribeck_speed_m_s"]
MOTOR_COULOMB: Final = INDEX["motor_coulomb_n_m"]
WINDAGE: Final = INDEX["windage_n_m_s2_per_rad2"]
LOAD_FRICTION: Final = INDEX["load_friction"]
BACKLASH: Final = INDEX["backlash_m"]
ECCENTRICITY: Final = INDEX["eccentricity_n_m"]
ECCENTRICITY_PHASE: Final = INDEX["eccentricity_phase_rad"]
COMPLIANCE: Final = INDEX["blade_compliance_m_per_n"]
RUBBING_VISCOUS: Final = INDEX["return_rubbing_n_s_per_m"]
RUBBING_CONSTANT: Final = INDEX["return_rubbing_n"]
TOOTH: Final = INDEX["tooth_amplitude"]
TOOTH_PITCH: Final = INDEX["tooth_pitch_m"]
TOOTH_PHASE: Final = INDEX["tooth_phase_rad"]
EXPONENT: Final = INDEX["cutting_exponent"]
REFERENCE_SPEED: Final = INDEX["cutting_reference_speed_m_s"]
EDGE_FORCE: Final = INDEX["edge_force_n"]
CHIP_EXPONENT: Final = INDEX["chip_exponent"]
CHIP_REFERENCE: Final = INDEX["chip_reference_m"]
FEED: Final = INDEX["feed_m_s"]
WEAR: Final = INDEX["wear_per_m"]
GRAIN: Final = INDEX["grain_amplitude"]
GRAIN_LENGTH: Final = INDEX["grain_wavelength_m"]
GRAIN_PHASE: Final = INDEX["grain_phase_rad"]
ENGAGEMENT: Final = INDEX["engagement_fraction"]
HEAT_CAPACITY: Final = INDEX["winding_heat_capacity_j_per_k"]
THERMAL_RESISTANCE: Final = INDEX["winding_thermal_resistance_k_per_w"]
RESISTANCE_TEMPERATURE: Final = INDEX["resistance_temperature_coefficient_per_k"]
MAGNET_TEMPERATURE: Final = INDEX["magnet_temperature_coefficient_per_k"]
BRUSH: Final = INDEX["brush_drop_v"]
EXTRA_RESISTANCE: Final = INDEX["extra_battery_resistance_ohm"]
POLARIZATION_RESISTANCE: Final = INDEX["polarization_resistance_ohm"]
POLARIZATION_TIME: Final = INDEX["polarization_time_constant_s"]
CURRENT_LIMIT: Final = INDEX["current_limit_a"]

# Sizes of effects that matter on the bench: steps of derivatives, scales of searches. Not limits.
TYPICAL: Final[Mapping[str, float]] = {
    "guide_coulomb_n": 5.0,
    "guide_static_n": 8.0,
    "guide_stribeck_speed_m_s": 0.1,
    "motor_coulomb_n_m": 0.004,
    "windage_n_m_s2_per_rad2": 4.0e-9,
    "load_friction": 0.05,
    "backlash_m": 2.0e-4,
    "eccentricity_n_m": 0.02,
    "eccentricity_phase_rad": 1.0,
    "blade_compliance_m_per_n": 3.0e-6,
    "return_rubbing_n_s_per_m": 15.0,
    "return_rubbing_n": 5.0,
    "tooth_amplitude": 0.15,
    "tooth_phase_rad": 1.0,
    "edge_force_n": 20.0,
    "chip_exponent": 0.6,
    "feed_m_s": 0.004,
    "wear_per_m": 2.0e-4,
    "grain_amplitude": 0.15,
    "grain_phase_rad": 1.0,
    "engagement_fraction": 0.1,
    "winding_heat_capacity_j_per_k": 60.0,
    "magnet_temperature_coefficient_per_k": 0.0015,
    "brush_drop_v": 1.0,
    "extra_battery_resistance_ohm": 0.05,
    "polarization_resistance_ohm": 0.05,
    "current_limit_a": 20.0,
    "diode_drop_v": 0.7,
    "battery_sag_v": 0.3,
    "brush_offset_v": 1.0,
    "force_scale": 1.0,
}

_DEFAULTS: Final = np.array([default for _, default, _ in SLOTS])
_DEFAULTS.setflags(write=False)
_EFFECTS_OFF: Final = _DEFAULTS[GUIDE_COULOMB:].tobytes()


_POSITIVE: Final = (
    "guide_stribeck_speed_m_s",
    "tooth_pitch_m",
    "cutting_reference_speed_m_s",
    "chip_reference_m",
    "grain_wavelength_m",
    "winding_thermal_resistance_k_per_w",
    "polarization_time_constant_s",
)
NOT_NEGATIVE: Final = (
    "backlash_m",
    "blade_compliance_m_per_n",
    "cutting_exponent",
    "feed_m_s",
    "engagement_fraction",
    "winding_heat_capacity_j_per_k",
    "current_limit_a",
    "tooth_amplitude",
    "grain_amplitude",
)


def defaults() -> NDArray[np.float64]:
    """Return a fresh vector, shape (N_SLOTS,), with every effect switched off.

    Examples
    --------
    >>> float(defaults()[GEAR]), float(defaults()[EXPONENT])
    (1.0, 1.0)
    """
    return _DEFAULTS.copy()


def needs_extended(vector: NDArray[np.float64]) -> bool:
    """Whether a vector holds anything that the baseline kernels leave out.

    Examples
    --------
    >>> needs_extended(defaults())
    False
    """
    # Bytes compare in a tenth of the time of an array expression; a -0.0 only costs the extended kernel.
    return bool(vector[RC_RESISTANCE] != 0.0) or vector[GUIDE_COULOMB:].tobytes() != _EFFECTS_OFF


def set_effects(vector: NDArray[np.float64], effects: Mapping[str, float] | None) -> None:
    """Write named effect slots into a vector, in place.

    Parameters
    ----------
    vector : ndarray, shape (N_SLOTS,)
    effects : mapping of slot name to value, or None
        Any of `EFFECT_NAMES`, units as in `UNITS`.

    Raises
    ------
    InputError
        On an unknown name or a value that is not finite.

    Examples
    --------
    >>> vector = defaults()
    >>> set_effects(vector, {"brush_drop_v": 1.0})
    >>> float(vector[BRUSH]), needs_extended(vector)
    (1.0, True)
    """
    if not effects:
        return
    for name, value in effects.items():
        if name not in EFFECT_NAMES:
            raise InputError(f"unknown effect slot {name!r}", remedy=f"one of {', '.join(EFFECT_NAMES)}")
        if not np.isfinite(value):
            raise InputError(f"effect {name} must be finite, got {value!r} {UNITS[name]}")
        vector[INDEX[name]] = float(value)
    _check_effects(vector)


def _check_effects(vector: NDArray[np.float64]) -> None:
    """Raise InputError where an effect lacks what it needs or is out of its range."""
    for name in _POSITIVE:
        if vector[INDEX[name]] <= 0:
            raise InputError(f"effect {name} must be greater than 0, got {vector[INDEX[name]]!r} {UNITS[name]}")
    for name in NOT_NEGATIVE:
        if vector[INDEX[name]] < 0:
            raise InputError(f"effect {name} must not be negative, got {vector[INDEX[name]]!r} {UNITS[name]}")
    if vector[COMPLIANCE] > 0 and vector[K_FC] <= 0:
        raise InputError("effect blade_compliance_m_per_n acts on the linear force: it needs k_fc_n_s_per_m > 0")
    if vector[CHIP_EXPONENT] != 0 and vector[FEED] <= 0:
        raise InputError("effect chip_exponent needs feed_m_s > 0")
    if vector[RADIUS] > 0 and vector[BACKLASH] >= 2 * vector[RADIUS]:
        raise InputError(f"effect backlash_m must be below the stroke, got {vector[BACKLASH]!r} m")
    if vector[ENGAGEMENT] >= 1:
        raise InputError(f"effect engagement_fraction must be below 1, got {vector[ENGAGEMENT]!r}")
