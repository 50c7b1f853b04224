"""The bench that a campaign is measured on: the paper's jigsaw at 5 kHz, or another one at another rate and noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.blindcheck.draws import between, stream_of
from sawbench.blindcheck.effects.change import Forms
from sawbench.blindcheck.nuisances import NUISANCES
from sawbench.blindcheck.plant import Plant, PlantSettings, column

Benches = Literal["own", "foreign"]
Mechanism = Literal["scotch_yoke", "slider_crank"]

# What a foreign bench differs in from the paper's; any of them can be left out.
SHIFTS = ("machine", "rate", "noise", "campaign", "operator", *NUISANCES)
_PACKS_V = (10.8, 12.0, 14.4, 18.0, 24.0, 36.0)
_PACKS_AH = (1.5, 2.0, 2.5, 4.0, 5.0)
_ROD_RATIOS = (0.2, 0.45)
# Limits that a machine of the generator keeps: stroke rate, and how far a hard cut may slow it down.
_RATES_HZ = (8.0, 60.0)
_LEAST_SPEED_LEFT = 0.6
_HARD_CUT_N_S_PER_M = 450.0
_MACHINES_TRIED = 200


@dataclass(frozen=True, kw_only=True, slots=True)
class Nature:
    """How campaigns are drawn, whatever they hide.

    Attributes
    ----------
    forms : {"own", "plain"}
        Functional forms of the effects.
    length : float
        Factor on the duration of every trial.
    rate_hz : float, optional
        Mean sample rate of the tables; the bench's unless given.
    benches : {"own", "foreign"}
        The paper's jigsaw on a clean bench, or a bench that is drawn as well.
    mechanism : {"scotch_yoke", "slider_crank"}
    without : tuple of str
        Of `SHIFTS`: what a foreign bench does not differ in. Nothing else that is drawn changes.
    """

    forms: Forms = "own"
    length: float = 1.0
    rate_hz: float | None = None
    benches: Benches = "own"
    mechanism: Mechanism = "scotch_yoke"
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "without", tuple(sorted(self.without)))
        unknown = sorted(set(self.without) - set(SHIFTS))
        if unknown:
            raise InputError(
                f"nothing called {', '.join(unknown)} can be left out", remedy=f"choose from {', '.join(SHIFTS)}"
            )

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Nature:
        """Read it from a label or from the options of a key; what older ones lack has its default."""
        return cls(**{item.name: record[item.name] for item in fields(cls) if item.name in record})

    def differs_in(self, shift: str) -> bool:
        """Whether the bench is drawn again in one of `SHIFTS`."""
        return self.benches == "foreign" and shift not in self.without


@dataclass(frozen=True, kw_only=True, slots=True)
class Bench:
    """A machine as its configuration states it, and the instruments on it.

    Attributes
    ----------
    nominal : mapping of str to (float, float)
        Nominal value and relative standard uncertainty, by setting of the plant.
    gear_ratio : float
    rod_length_m : float or None
        Of a slider crank.
    nominal_voltage_v, capacity_ah, beta, internal_resistance_ohm : float
        Of the battery.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    duties : tuple of float
        Low, middle and high.
    rate_hz : float
        Mean sample rate.
    noise_factor : float
        On the noise of every sensor.
    """

    nominal: Mapping[str, tuple[float, float]]
    gear_ratio: float = 56.0 / 6.0
    rod_length_m: float | None = None
    nominal_voltage_v: float = 18.0
    capacity_ah: float = 1.5
    beta: float = 0.99
    internal_resistance_ohm: float = 0.02
    cutting_half: Literal["pi_to_2pi", "zero_to_pi"] = "pi_to_2pi"
    duties: tuple[float, float, float] = (0.35, 0.4375, 0.55)
    rate_hz: float = 5000.0
    noise_factor: float = 1.0

    def settings(self, true: Mapping[str, float], **more: Any) -> PlantSettings:
        """Return the plant with true constants, at the middle duty unless `more` says otherwise."""
        constants: dict[str, Any] = {
            "gear_ratio": self.gear_ratio,
            "rod_length_m": self.rod_length_m,
            "beta": self.beta,
            "cutting_half": self.cutting_half,
            "duty": self.duties[1],
            **true,
            **more,
        }
        return PlantSettings(**constants)

    def config(self) -> dict[str, Any]:
        """Return the tables `[plant]`, `[battery]` and `[cutting]` of the campaign's configuration."""
        plant: dict[str, Any] = {
            name: {"nominal": value, "rel_std": std} for name, (value, std) in self.nominal.items()
        }
        plant["gear_ratio"] = self.gear_ratio
        if self.rod_length_m is not None:
            plant |= {"mechanism": "slider_crank", "rod_length_m": self.rod_length_m}
        battery = ("nominal_voltage_v", "capacity_ah", "beta", "internal_resistance_ohm")
        return {
            "plant": plant,
            "battery": {name: getattr(self, name) for name in battery} | {"cutoff_soc": 0.2},
            "cutting": {"cutting_half": self.cutting_half},
        }

    def record(self) -> dict[str, Any]:
        """Return it as plain values, for the label."""
        nominal = {name: value for name, (value, _) in self.nominal.items()}
        return {item.name: getattr(self, item.name) for item in fields(self)} | {
            "nominal": nominal, "duties": list(self.duties),
        }  # fmt: skip


OWN = Bench(
    nominal=MappingProxyType(
        {
            "resistance_ohm": (0.176, 0.05),
            "inductance_h": (0.00321, 0.1),
            "back_emf_constant_v_s_per_rad": (0.007383, 0.02),
            "torque_constant_n_m_per_a": (0.005632, 0.03),
            "rotor_inertia_kg_m2": (2.4e-5, 0.05),
            "yoke_inertia_kg_m2": (2.38e-5, 0.05),
            "reciprocating_mass_kg": (0.239, 0.02),
            "crank_radius_m": (0.01, 0.003),
            "motor_damping_n_m_s_per_rad": (3.4274e-6, 0.3),
        }
    )
)


def draw_bench(seed: int, nature: Nature) -> Bench:
    """Draw the bench of a campaign.

    Examples
    --------
    >>> draw_bench(3, Nature()) == OWN
    True
    >>> 1e3 <= draw_bench(3, Nature(benches="foreign")).rate_hz <= 2e4
    True
    """
    bench = _machine(stream_of(seed, "machine")) if nature.differs_in("machine") else OWN
    if nature.differs_in("rate"):
        bench = replace(bench, rate_hz=round(between(stream_of(seed, "rate"), 1e3, 2e4)))
    if nature.differs_in("noise"):
        bench = replace(bench, noise_factor=between(stream_of(seed, "noise"), 0.3, 4.0))
    if nature.rate_hz is not None:
        bench = replace(bench, rate_hz=nature.rate_hz)
    if nature.mechanism == "slider_crank":
        ratio = float(stream_of(seed, "rod").uniform(*_ROD_RATIOS))
        bench = replace(bench, rod_length_m=round(bench.nominal["crank_radius_m"][0] / ratio, 5))
    return bench


def _machine(rng: np.random.Generator) -> Bench:
    """Draw jigsaws until one runs at the rates of jigsaws and is not brought down by a hard cut."""
    for _ in range(_MACHINES_TRIED):
        bench = _any_machine(rng)
        if _is_a_jigsaw(bench):
            return bench
    raise InputError(f"none of {_MACHINES_TRIED} machines was a jigsaw", remedy="try another seed")


def _any_machine(rng: np.random.Generator) -> Bench:
    """Draw every constant of the paper's Table 3 over a factor of two or more, for a battery of 10.8 to 36 V.

    Motors of one power for another voltage have constants that go with the voltage, resistance and inductance that
    go with its square. No motor gives more torque per ampere than volts per radian a second.
    """
    pack_v = float(rng.choice(_PACKS_V))
    turns = pack_v / OWN.nominal_voltage_v
    root = np.sqrt(2.0)
    factors = {
        "resistance_ohm": turns**2 * between(rng, 1.0 / root, root),
        "inductance_h": turns**2 * between(rng, 0.5, 2.0),
        "back_emf_constant_v_s_per_rad": turns * between(rng, 1.0 / root, root),
        "rotor_inertia_kg_m2": between(rng, 0.5, 2.0),
        "yoke_inertia_kg_m2": between(rng, 0.5, 2.0),
        "reciprocating_mass_kg": between(rng, 0.5, 1.5),
        "crank_radius_m": between(rng, 0.7, 1.4),
        "motor_damping_n_m_s_per_rad": between(rng, 0.5, 2.0),
    }
    values = {name: OWN.nominal[name][0] * factor for name, factor in factors.items()}
    values["torque_constant_n_m_per_a"] = values["back_emf_constant_v_s_per_rad"] * float(rng.uniform(0.72, 0.98))
    middle = float(rng.uniform(0.38, 0.62))
    return Bench(
        nominal=MappingProxyType({name: (float(f"{values[name]:.4g}"), std) for name, (_, std) in OWN.nominal.items()}),
        gear_ratio=round(between(rng, 6.0, 14.0), 3),
        nominal_voltage_v=pack_v,
        capacity_ah=float(rng.choice(_PACKS_AH)),
        beta=round(float(rng.uniform(0.93, 0.995)), 3),
        internal_resistance_ohm=float(f"{0.02 * turns**2 * between(rng, 0.5, 2.0):.3g}"),
        cutting_half="pi_to_2pi" if rng.random() < 0.7 else "zero_to_pi",
        duties=(round(0.8 * middle, 3), round(middle, 3), round(1.25 * middle, 3)),
    )


def _is_a_jigsaw(bench: Bench) -> bool:
    true = {name: value for name, (value, _) in bench.nominal.items()}
    true |= {
        "nominal_voltage_v": bench.nominal_voltage_v,
        "capacity_ah": bench.capacity_ah,
        "internal_resistance_ohm": bench.internal_resistance_ohm,
    }
    rates = {}
    for duty in (bench.duties[0], bench.duties[2]):
        for k_fc in (0.0, _HARD_CUT_N_S_PER_M):
            settings = bench.settings(true, duty=duty, k_fc_n_s_per_m=k_fc, stroke_rel_std=0.0)
            crank_rad = column(Plant(settings).advance(1.0)[10000:], "crank_rad")
            rates[duty, k_fc] = float(crank_rad[-1] - crank_rad[0]) / np.pi  # over the second half second
    slowest, fastest = rates[bench.duties[0], _HARD_CUT_N_S_PER_M], rates[bench.duties[2], 0.0]
    is_strong = slowest >= _LEAST_SPEED_LEFT * rates[bench.duties[0], 0.0]
    return is_strong and slowest >= _RATES_HZ[0] and fastest <= _RATES_HZ[1]
