"""What nature draws for one campaign: the tool as it truly is, its instruments, the order of the trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from blindcheck.effects.change import Change, Forms, Setting
from blindcheck.effects.table import CATALOGUE, NOT_AS_BACKGROUND, changes_of
from blindcheck.plant import MATERIALS, Plant, PlantSettings, column
from blindcheck.sensors import SensorSettings

Parameters = Literal["within", "beyond"]

# Nominal value and relative standard uncertainty that the campaign's configuration states.
NOMINAL: Mapping[str, tuple[float, float]] = MappingProxyType(
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
_STRONG = ("resistance_ohm", "back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a")
_ALSO = ("inductance_h", "rotor_inertia_kg_m2", "reciprocating_mass_kg", "motor_damping_n_m_s_per_rad")
_GAIN_STD = (0.005, 0.002, 0.005, 0.002, 0.005)
_ZERO_STD = (0.5, 0.02, 0.02, 0.005, 0.02)
DUTIES = (0.35, 0.4375, 0.55)


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialPlan:
    """Settings of one trial; `rest_s` is the pause before it."""

    duty: float
    workpiece: str
    thickness_mm: float
    feed_mm_s: float
    seconds: float
    rest_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class CampaignDraw:
    """Everything that decides a campaign, and what its label says.

    Attributes
    ----------
    seed : int
    session_seed : int
        Of noise, wood and where each trial starts; `seed` unless the machine is drawn again.
    effects, background : mapping of str to float
        Severity by effect id.
    parameters : mapping of str to float
        True constants of the tool, keyword arguments of `PlantSettings`.
    shifts : mapping of str to float
        Their distance from the nominal values, in stated standard deviations of the logarithm.
    sensors : SensorSettings
    change : Change
    k_fc_n_s_per_m, width_exponent : float
        Cutting damper at 20 mm and its dependence on the thickness.
    trials : tuple of TrialPlan
    peak_force_n, working_current_a : float
        Peak of the cutting force and mean motor current at the middle duty and 20 mm, without effects.
    """

    seed: int
    session_seed: int
    effects: Mapping[str, float]
    background: Mapping[str, float]
    parameters: Mapping[str, float]
    shifts: Mapping[str, float]
    sensors: SensorSettings
    change: Change
    k_fc_n_s_per_m: float
    width_exponent: float
    trials: tuple[TrialPlan, ...]
    peak_force_n: float
    working_current_a: float


def draw_campaign(
    seed: int,
    *,
    effects: Mapping[str, float] | None = None,
    parameters: Parameters = "within",
    background: tuple[int, float, float] | Mapping[str, float] = (3, 0.003, 0.02),
    forms: Forms = "own",
    length: float = 1.0,
    repetition: int = 0,
) -> CampaignDraw:
    """Draw a campaign; what the effects are does not change anything else that is drawn.

    One exception: an effect that is also among the small ones is left out of these. Whoever wants a campaign with and
    without an effect gives `background` by name.

    Parameters
    ----------
    seed : int
    effects : mapping of str to float, optional
        Severity by effect id (1 is typical).
    parameters : {"within", "beyond"}
        Constants of the tool within their stated uncertainty, or some of them 4 to 8 standard deviations off.
    background : tuple of (int, float, float), or mapping of str to float
        How many small effects play along, and the range of their severity (log-uniform); or the severity of each.
    forms : {"own", "plain"}
        Functional forms of the effects.
    length : float
        Factor on the duration of every trial.
    repetition : int
        0 for the campaign of the seed; from 1 on the same machine and operating points with other noise, wood, pauses
        and order of trials.

    Returns
    -------
    CampaignDraw
    """
    effects = dict(effects or {})
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
    shifts = _draw_shifts(streams[0], parameters)
    true = {name: nominal * np.exp(shifts[name] * std) for name, (nominal, std) in NOMINAL.items()}
    true |= {
        "nominal_voltage_v": 18.0 * (1.0 + 0.004 * streams[0].standard_normal()),
        "capacity_ah": 1.5 * (1.0 + 0.02 * streams[0].standard_normal()),
        "internal_resistance_ohm": 0.02 * np.exp(0.05 * streams[0].standard_normal()),
    }
    true = {name: float(value) for name, value in true.items()}
    material = str(streams[1].choice(["nylon", "black_locust", "oak"], p=[0.2, 0.4, 0.4]))
    k_fc = MATERIALS[material].k_fc_n_s_per_m * float(np.exp(0.12 * streams[1].standard_normal()))
    width_exponent = 1.0 + 0.05 * float(streams[1].standard_normal())
    small = (
        dict(background) if isinstance(background, Mapping) else _draw_background(streams[2], background, set(effects))
    )
    peak_force_n, working_current_a = _working_point(true, k_fc)
    setting = Setting(seed=seed, peak_force_n=peak_force_n, forms=forms)
    change = changes_of(small | effects, setting)
    again = np.random.default_rng([seed, repetition, 31])
    return CampaignDraw(
        seed=seed,
        session_seed=int(again.integers(2**62)) if repetition else seed,
        effects=MappingProxyType(effects),
        background=MappingProxyType(small),
        parameters=MappingProxyType(true),
        shifts=MappingProxyType(shifts),
        sensors=_draw_sensors(streams[3], change),
        change=change,
        k_fc_n_s_per_m=k_fc,
        width_exponent=width_exponent,
        trials=_plan(streams[4], material, length, again if repetition else streams[4]),
        peak_force_n=peak_force_n,
        working_current_a=working_current_a,
    )


def _draw_shifts(rng: np.random.Generator, parameters: Parameters) -> dict[str, float]:
    """Return the distance of every constant from its nominal value, in standard deviations."""
    shifts = {name: float(np.clip(rng.standard_normal(), -2.0, 2.0)) for name in NOMINAL}
    far = [str(rng.choice(_STRONG)), *map(str, rng.choice(_ALSO, size=2, replace=False))]
    beyond = {name: float(rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 8.0)) for name in far}
    return shifts | beyond if parameters == "beyond" else shifts


def _draw_background(
    rng: np.random.Generator, background: tuple[int, float, float], taken: set[str]
) -> dict[str, float]:
    count, low, high = background
    ids = [name for name in CATALOGUE if name not in NOT_AS_BACKGROUND]
    order = [str(name) for name in rng.permutation(ids)]
    sizes = np.exp(rng.uniform(np.log(low), np.log(high), size=len(ids)))
    chosen = list(zip(order, map(float, sizes), strict=True))[:count]
    return {name: size for name, size in chosen if name not in taken}


def _draw_sensors(rng: np.random.Generator, change: Change) -> SensorSettings:
    gain = tuple(float(1.0 + std * rng.standard_normal()) for std in _GAIN_STD)
    zero = tuple(float(std * rng.standard_normal()) for std in _ZERO_STD)
    noise = tuple(float(std * np.exp(0.2 * rng.standard_normal())) for std in SensorSettings().noise)
    return replace(SensorSettings(gain=gain, zero=zero, noise=noise), **change.sensors)


def _working_point(true: Mapping[str, float], k_fc: float) -> tuple[float, float]:
    """Return the peak of the cutting force, N, and the mean motor current, A, once the tool is up to speed."""
    settings = PlantSettings(**dict(true), k_fc_n_s_per_m=k_fc, stroke_rel_std=0.0)  # type: ignore[arg-type]
    rows = Plant(settings).advance(0.8)[8000:]
    return float(column(rows, "force_n").max()), float(column(rows, "current_a").mean())


def _plan(
    rng: np.random.Generator, material: str, length: float, of_session: np.random.Generator
) -> tuple[TrialPlan, ...]:
    """Plan 18 trials: three duties, idle, repeats, two feeds, two thicknesses, a long one, idle again.

    Pauses and order are drawn from `of_session`, which may be `rng`.
    """
    feed = float(rng.choice([3.0, 4.0, 5.0]))
    other_feed = feed * float(rng.choice([0.6, 1.5]))
    thick = float(rng.choice([12.0, 30.0]))
    middle = DUTIES[1]

    def trial(
        duty: float, seconds: float, *, cuts: bool = True, feed_mm_s: float = feed, mm: float = 20.0
    ) -> TrialPlan:
        return TrialPlan(
            duty=duty,
            workpiece=material if cuts else "none",
            thickness_mm=mm if cuts else 0.0,
            feed_mm_s=feed_mm_s if cuts else 0.0,
            seconds=length * seconds,
            rest_s=float(of_session.uniform(40.0, 150.0)),
        )

    idle = [trial(duty, 5.0, cuts=False) for duty in DUTIES]
    cuts = [trial(duty, 7.7) for duty in DUTIES for _ in range(3)]
    cuts += [trial(middle, 7.7, feed_mm_s=other_feed) for _ in range(2)]
    cuts += [trial(middle, 7.7, mm=thick) for _ in range(2)]
    mixed = [cuts[k] for k in of_session.permutation(len(cuts))]
    return (*idle, *mixed, trial(middle, 30.0), trial(middle, 5.0, cuts=False))
