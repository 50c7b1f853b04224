"""The constants of motor, gear and mechanism."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.validation import not_negative, positive

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from sawbench.bench.config import PlantConfig

Mechanism = Literal["scotch_yoke", "slider_crank"]
MECHANISMS = ("scotch_yoke", "slider_crank")


@dataclass(frozen=True, kw_only=True, slots=True)
class JigsawParameters:
    """Motor, gear and mechanism (Table 3 of the paper), SI units.

    Attributes
    ----------
    resistance_ohm : float
        Armature circuit, R.
    inductance_h : float
        Armature, L.
    back_emf_constant_v_s_per_rad : float
        k_e; kept apart from the torque constant, their difference stands for losses inside the motor.
    torque_constant_n_m_per_a : float
        k_m.
    rotor_inertia_kg_m2 : float
        J_m, at the motor shaft.
    yoke_inertia_kg_m2 : float
        J_c, at the crank.
    reciprocating_mass_kg : float
        m_a.
    crank_radius_m : float
        r_c, half the stroke.
    motor_damping_n_m_s_per_rad : float
        b, at the motor shaft.
    gear_ratio : float
        Motor turns a crank turn, i_mc.
    mechanism : {"scotch_yoke", "slider_crank"}
    rod_length_m : float or None
        Connecting rod of a slider-crank.

    Raises
    ------
    InputError
        On a value that is not finite or outside its range; the message names the parameter.
    """

    resistance_ohm: float
    inductance_h: float
    back_emf_constant_v_s_per_rad: float
    torque_constant_n_m_per_a: float
    rotor_inertia_kg_m2: float
    yoke_inertia_kg_m2: float
    reciprocating_mass_kg: float
    crank_radius_m: float
    motor_damping_n_m_s_per_rad: float
    gear_ratio: float
    mechanism: Mechanism = "scotch_yoke"
    rod_length_m: float | None = None

    def __post_init__(self) -> None:
        may_be_zero = ("yoke_inertia_kg_m2", "reciprocating_mass_kg", "motor_damping_n_m_s_per_rad")
        for name in slots.PLANT_NAMES[:-1]:
            check = not_negative if name in may_be_zero else positive
            check(name, getattr(self, name), slots.UNITS[name])
        if self.mechanism not in MECHANISMS:
            raise InputError(f"mechanism must be one of {', '.join(MECHANISMS)}, got {self.mechanism!r}")
        if self.mechanism == "slider_crank":
            if self.rod_length_m is None:
                raise InputError("a slider_crank needs rod_length_m")
            positive("rod_length_m", self.rod_length_m, "m")
            if self.rod_length_m <= self.crank_radius_m:
                raise InputError(
                    f"rod_length_m must be greater than crank_radius_m ({self.crank_radius_m} m), "
                    f"got {self.rod_length_m} m"
                )

    @classmethod
    def from_config(cls, plant: PlantConfig) -> JigsawParameters:
        """Take the nominal values of the `[plant]` table."""
        values = {name: getattr(plant, name) for name in slots.PLANT_NAMES[:-2]}
        return cls(
            **{name: value.nominal for name, value in values.items()},
            gear_ratio=plant.gear_ratio,
            mechanism=plant.mechanism,
            rod_length_m=plant.rod_length_m,
        )

    def replace(self, **changes: Any) -> JigsawParameters:
        """Return a copy with some values changed, validated again."""
        return dataclasses.replace(self, **changes)

    def to_vector(self) -> NDArray[np.float64]:
        """Return a parameter vector, shape (N_SLOTS,): the plant, everything else at its default."""
        vector = slots.defaults()
        self.fill(vector)
        return vector

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the plant's slots into a parameter vector, in place."""
        vector[:11] = (
            self.resistance_ohm,
            self.inductance_h,
            self.back_emf_constant_v_s_per_rad,
            self.torque_constant_n_m_per_a,
            self.rotor_inertia_kg_m2,
            self.yoke_inertia_kg_m2,
            self.reciprocating_mass_kg,
            self.crank_radius_m,
            self.motor_damping_n_m_s_per_rad,
            self.gear_ratio,
            self.rod_length_m if self.mechanism == "slider_crank" and self.rod_length_m is not None else 0.0,
        )
