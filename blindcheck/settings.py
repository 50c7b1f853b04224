"""What decides what the plant does: the settings and the workpieces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Literal

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.blindcheck.dynamics import FIELDS, N_OPEN_CIRCUIT


@dataclass(frozen=True, kw_only=True, slots=True)
class Material:
    """How a workpiece resists at 20 mm thickness, and how evenly.

    Attributes
    ----------
    k_fc_n_s_per_m : float
        Damper of the linear cutting law, N s/m.
    stroke_rel_std : float
        Standard deviation of the damper from stroke to stroke, relative.
    stroke_correlation : float
        Correlation of neighbouring strokes, 0..1.
    piece_rel_std : float
        Standard deviation of the damper from piece to piece, relative.
    """

    k_fc_n_s_per_m: float
    stroke_rel_std: float
    stroke_correlation: float
    piece_rel_std: float


def _material(k_fc_n_s_per_m: float, stroke_rel_std: float, correlation: float, piece_rel_std: float) -> Material:
    return Material(
        k_fc_n_s_per_m=k_fc_n_s_per_m,
        stroke_rel_std=stroke_rel_std,
        stroke_correlation=correlation,
        piece_rel_std=piece_rel_std,
    )


MATERIALS: Mapping[str, Material] = MappingProxyType(
    {
        "nylon": _material(58.0, 0.015, 0.2, 0.015),
        "black_locust": _material(283.0, 0.04, 0.3, 0.04),
        "oak": _material(318.0, 0.05, 0.35, 0.05),
        "pine": _material(150.0, 0.06, 0.4, 0.06),
        "beech": _material(290.0, 0.04, 0.3, 0.04),
        "mdf": _material(170.0, 0.02, 0.2, 0.02),
        "aluminium": _material(380.0, 0.015, 0.2, 0.02),
        "none": _material(0.0, 0.0, 0.0, 0.0),
    }
)


@dataclass(frozen=True, kw_only=True, slots=True)
class PlantSettings:
    """Everything that decides what the plant does, in SI units unless the name says otherwise.

    Attributes
    ----------
    resistance_ohm, inductance_h, back_emf_constant_v_s_per_rad, torque_constant_n_m_per_a : float
    rotor_inertia_kg_m2, yoke_inertia_kg_m2, reciprocating_mass_kg, crank_radius_m : float
    motor_damping_n_m_s_per_rad, gear_ratio : float
    rod_length_m : float, optional
        Connecting rod of an in-line slider crank; a Scotch yoke without one.
    nominal_voltage_v, capacity_ah, beta, internal_resistance_ohm : float
        The battery of Eq. 16 of the paper.
    open_circuit_v : tuple of float, optional
        Instead of Eq. 16: open-circuit voltage at `dynamics.N_OPEN_CIRCUIT` evenly spaced states of charge from 0 to 1.
    duty : float
        PWM duty, 0..1.
    held_voltage_v : float, optional
        The converter holds this motor voltage instead of the duty.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    k_fc_n_s_per_m : float
        0: the blade runs in air.
    stroke_rel_std, stroke_correlation : float
        Scatter of the damper from stroke to stroke.
    uneven_rel_std, uneven_mm : float
        How much harder or softer the wood is along the cut, and the way after which it is another; 0: even.
    feed_mm_s : float
    initial_crank_rad, initial_soc : float
    force_noise_n, displacement_noise_mm, current_noise_a, voltage_noise_v, battery_current_noise_a : float
        Standard deviation of white sensor noise; used by `StreamingPlant`.
    seed : int
    extras : mapping of str to float
        Fields of `dynamics.FIELDS` that are switched on beyond the baseline.
    """

    resistance_ohm: float = 0.176
    inductance_h: float = 3.21e-3
    back_emf_constant_v_s_per_rad: float = 7.383e-3
    torque_constant_n_m_per_a: float = 5.632e-3
    rotor_inertia_kg_m2: float = 2.4e-5
    yoke_inertia_kg_m2: float = 2.38e-5
    reciprocating_mass_kg: float = 0.239
    crank_radius_m: float = 0.01
    motor_damping_n_m_s_per_rad: float = 3.4274e-6
    gear_ratio: float = 56.0 / 6.0
    rod_length_m: float | None = None
    nominal_voltage_v: float = 18.0
    capacity_ah: float = 1.5
    beta: float = 0.99
    internal_resistance_ohm: float = 0.02
    open_circuit_v: tuple[float, ...] | None = None
    duty: float = 0.4375
    held_voltage_v: float | None = None
    cutting_half: Literal["pi_to_2pi", "zero_to_pi"] = "pi_to_2pi"
    k_fc_n_s_per_m: float = 240.29
    stroke_rel_std: float = 0.045
    stroke_correlation: float = 0.3
    uneven_rel_std: float = 0.0
    uneven_mm: float = 8.0
    feed_mm_s: float = 4.0
    initial_crank_rad: float = 0.0
    initial_soc: float = 1.0
    force_noise_n: float = 1.0
    displacement_noise_mm: float = 0.01
    current_noise_a: float = 0.03
    voltage_noise_v: float = 0.005
    battery_current_noise_a: float = 0.03
    seed: int = 0
    extras: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "extras", MappingProxyType(dict(self.extras)))
        unknown = sorted(set(self.extras) - set(FIELDS))
        if unknown:
            raise InputError(f"the plant has no extra called {', '.join(unknown)}")
        if self.open_circuit_v is not None and len(self.open_circuit_v) != N_OPEN_CIRCUIT:
            raise InputError(f"open_circuit_v has {len(self.open_circuit_v)} values, {N_OPEN_CIRCUIT} are needed")
        if not 0.0 < self.duty <= 1.0:
            raise InputError(f"duty is {self.duty!r}, allowed is above 0 up to 1")
        if self.rod_length_m is not None and not self.rod_length_m > self.crank_radius_m:
            raise InputError(
                f"rod_length_m is {self.rod_length_m!r}, allowed is above crank_radius_m {self.crank_radius_m!r}"
            )
        if not 0.0 < self.initial_soc <= 1.0:
            raise InputError(f"initial_soc is {self.initial_soc!r}, allowed is above 0 up to 1")
        if not 0.0 <= self.stroke_correlation < 1.0:
            raise InputError(f"stroke_correlation is {self.stroke_correlation!r}, allowed is 0 up to below 1")
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float) and not np.isfinite(value):
                raise InputError(f"{item.name} is {value!r}, a finite number is needed")

    @classmethod
    def for_material(cls, material: str, **settings: object) -> PlantSettings:
        """Return settings for a workpiece of `MATERIALS`, 20 mm thick.

        Examples
        --------
        >>> PlantSettings.for_material("nylon", seed=4).k_fc_n_s_per_m
        58.0
        """
        if material not in MATERIALS:
            raise InputError(f"unknown material {material!r}", remedy=f"choose from {', '.join(MATERIALS)}")
        wood = MATERIALS[material]
        base = {
            "k_fc_n_s_per_m": wood.k_fc_n_s_per_m,
            "stroke_rel_std": wood.stroke_rel_std,
            "stroke_correlation": wood.stroke_correlation,
        }
        return cls(**(base | settings))  # type: ignore[arg-type]
