"""Random machines and woods: what a laboratory that nobody asked may have on its bench."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import signal

from benchmarks.independent_bench.parameters import Battery, Machine
from benchmarks.independent_bench.plant import HARDNESS_STEP_S, Floats

# Cutting coefficient over that of the reference wood, lowest and highest piece. Assumed.
HARDWOODS: Final[Mapping[str, tuple[float, float]]] = {
    "oak": (0.85, 1.1),
    "black_locust": (0.7, 0.95),
    "beech": (0.6, 0.8),
}
# A plastic beside them, more even than any wood and without rings.
NYLON: Final = "nylon"
_NYLON_FACTOR, _NYLON_SPREAD = 0.27, 0.3
_BASE = Machine()
# Each constant lies within a factor of this of the paper's Table 3; the motor's constants within another.
_SPREAD, _MOTOR_SPREAD = 1.5, 1.3
# Strokes a second without load at a duty of 0.44 that a jigsaw runs at.
_STROKES_HZ = (13.0, 24.0)
# The wood of a table goes on for so long after the end of the trial, s.
_BEYOND_S = 2.5


@dataclass(frozen=True, kw_only=True, slots=True)
class Scatter:
    """How wood differs.

    Attributes
    ----------
    piece : float
        Standard deviation of the coefficient from piece to piece, relative.
    along : float
        The same along the cut, before the slower order that smooths it.
    length_mm : float
        Length of the feed over which it is forgotten.
    """

    piece: float
    along: float
    length_mm: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Rings:
    """Annual rings across the feed: depth of the wave (0: none) and mean spacing."""

    depth: float = 0.0
    spacing_mm: float = 4.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Bench:
    """Machine, battery and wood of a campaign.

    Attributes
    ----------
    machine : Machine
    battery : Battery
    cutting_sign : float
        -1: the blade cuts from pi to 2 pi of the crank angle.
    slowdown : float
        Drop of the speed under the mean load of the reference wood, over the speed under load.
    scatter : Scatter
    """

    machine: Machine
    battery: Battery
    cutting_sign: float
    slowdown: float
    scatter: Scatter

    @property
    def reference_coefficient_n_s_per_m(self) -> float:
        """Cutting coefficient of the reference wood: its mean damping, r^2 k / (4 gear^2), slows down as stated."""
        m = self.machine
        damping = m.back_emf_constant_v_s_per_rad * m.torque_constant_n_m_per_a / m.resistance_ohm
        return self.slowdown * damping * 4.0 * (m.gear_ratio / m.crank_radius_m) ** 2

    @property
    def crank_speed_rad_s(self) -> float:
        """Of the crank under load at a duty of 0.45."""
        m = self.machine
        unloaded = 0.45 * self.battery.nominal_voltage_v / m.back_emf_constant_v_s_per_rad / m.gear_ratio
        return unloaded / (1.0 + self.slowdown)

    def idle_strokes_hz(self, duty: float) -> float:
        """Strokes a second without any loss."""
        return _idle_strokes_hz(self.machine, self.battery, duty)


def _idle_strokes_hz(machine: Machine, battery: Battery, duty: float) -> float:
    speed = duty * battery.nominal_voltage_v / machine.back_emf_constant_v_s_per_rad
    return speed / machine.gear_ratio / (2.0 * math.pi)


def draw_bench(rng: np.random.Generator) -> Bench:
    """Draw a bench: constants around Table 3 of the paper, kept if it runs at the stroke rate of a jigsaw."""
    while True:
        machine, battery = _draw_machine(rng), _draw_battery(rng)
        if _STROKES_HZ[0] < _idle_strokes_hz(machine, battery, 0.44) < _STROKES_HZ[1]:
            break
    return Bench(
        machine=machine,
        battery=battery,
        cutting_sign=-1.0 if rng.random() < 0.8 else 1.0,
        slowdown=rng.uniform(0.2, 0.42),
        scatter=Scatter(
            piece=rng.uniform(0.01, 0.025), along=rng.uniform(0.012, 0.03), length_mm=rng.uniform(2.0, 6.0)
        ),
    )


def _factor(rng: np.random.Generator, spread: float) -> float:
    return math.exp(rng.uniform(-1.0, 1.0) * math.log(spread))


def _draw_machine(rng: np.random.Generator) -> Machine:
    varied = (
        "resistance_ohm", "inductance_h", "rotor_inertia_kg_m2", "yoke_inertia_kg_m2", "reciprocating_mass_kg",
        "motor_damping_n_m_s_per_rad",
    )  # fmt: skip
    back_emf = _BASE.back_emf_constant_v_s_per_rad * _factor(rng, _MOTOR_SPREAD)
    return _BASE._replace(
        **{name: getattr(_BASE, name) * _factor(rng, _SPREAD) for name in varied},
        back_emf_constant_v_s_per_rad=back_emf,
        torque_constant_n_m_per_a=back_emf * rng.uniform(0.74, 0.97),
        crank_radius_m=rng.uniform(0.0085, 0.0125),
        gear_ratio=float(rng.choice([56 / 6, 56 / 6, 61 / 6, 50 / 6, 63 / 7, 64 / 6])),
    )


def _draw_battery(rng: np.random.Generator) -> Battery:
    return Battery(
        nominal_voltage_v=float(rng.choice([18.0, 18.0, 18.0, 14.4, 21.6])),
        charge_c=3600.0 * float(rng.choice([1.5, 2.0, 2.5, 4.0])),
        beta=float(rng.choice([0.98, 0.985, 0.99, 0.99, 0.992])),
        internal_resistance_ohm=rng.uniform(0.015, 0.04),
    )


def draw_woods(rng: np.random.Generator) -> dict[str, float]:
    """Draw one or two materials of a campaign, a hardwood among them; their coefficient over the reference's."""
    factors = {name: rng.uniform(*ends) for name, ends in HARDWOODS.items()} | {NYLON: _NYLON_FACTOR}
    first = str(rng.choice(list(HARDWOODS)))
    chosen = [first]
    if rng.random() < 0.5:
        chosen.append(str(rng.choice([name for name in factors if name != first])))
    return {name: factors[name] for name in chosen}


def piece_hardness(
    rng: np.random.Generator, scatter: Scatter, material: str, *, feed_mm_s: float, duration_s: float
) -> Floats:
    """Draw the hardness along a cut: coloured over the feed, smoothed by a slower order, 1 on average.

    Returns
    -------
    ndarray, shape (n,)
        In steps of `HARDNESS_STEP_S`.
    """
    n = _n_steps(duration_s)
    level = math.exp(scatter.piece * rng.standard_normal())
    step_mm = max(feed_mm_s, 0.5) * HARDNESS_STEP_S
    keep = math.exp(-step_mm / scatter.length_mm)
    wave = signal.lfilter([math.sqrt(1.0 - keep * keep)], [1.0, -keep], rng.standard_normal(n + 600))[600:]
    keep = math.exp(-step_mm / (scatter.length_mm / 4.0))
    smooth = np.asarray(signal.lfilter([1.0 - keep], [1.0, -keep], wave), dtype=np.float64)
    along = scatter.along * (_NYLON_SPREAD if material == NYLON else 1.0)
    return level * np.exp(along * smooth)


def ring_pattern(
    rng: np.random.Generator, rings: Rings, material: str, *, feed_mm_s: float, duration_s: float
) -> Floats:
    """Draw the wave of the annual rings along a cut, whose spacing wanders; ones for a material without rings.

    Returns
    -------
    ndarray, shape (n,)
        In steps of `HARDNESS_STEP_S`; its variance is that of a sine of the stated depth.
    """
    n = _n_steps(duration_s)
    if material == NYLON or rings.depth <= 0.0:
        return np.ones(n)
    across = feed_mm_s * HARDNESS_STEP_S * np.arange(n) / rings.spacing_mm
    wander = 0.5 * math.sqrt(feed_mm_s * HARDNESS_STEP_S / rings.spacing_mm) * np.cumsum(rng.standard_normal(n))
    phase = 2.0 * math.pi * across + wander + rng.uniform(0.0, 2.0 * math.pi)
    return 1.0 + rings.depth * (np.sin(phase) + 0.25 * np.sin(2.0 * phase + 0.5)) / math.hypot(1.0, 0.25)


def _n_steps(duration_s: float) -> int:
    return math.ceil((duration_s + _BEYOND_S) / HARDNESS_STEP_S)
