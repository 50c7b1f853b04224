"""What nature draws for one campaign: the tool as it truly is, its instruments, the order of the trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from sawbench.blindcheck.bench import Bench, Nature, draw_bench
from sawbench.blindcheck.draws import stream_of
from sawbench.blindcheck.effects.change import Change, Setting
from sawbench.blindcheck.effects.table import CATALOGUE, NOT_AS_BACKGROUND, changes_of
from sawbench.blindcheck.nuisances import NUISANCES
from sawbench.blindcheck.plans import TrialPlan, any_plan, as_operated, own_plan, with_batteries
from sawbench.blindcheck.plant import MATERIALS, Plant, column
from sawbench.blindcheck.sensors import SensorSettings

Parameters = Literal["within", "beyond"]

_STRONG = ("resistance_ohm", "back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a")
_ALSO = ("inductance_h", "rotor_inertia_kg_m2", "reciprocating_mass_kg", "motor_damping_n_m_s_per_rad")
_GAIN_STD = (0.005, 0.002, 0.005, 0.002, 0.005)
_ZERO_STD = (0.5, 0.02, 0.02, 0.005, 0.02)
_NUISANCE_SHARE = 0.3
# A typical limiter acts that far below the peak of the start-up current of a foreign tool.
_LIMIT_SHARE = 0.6


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
    bench : Bench
    nuisances : mapping of str to mapping
        Numbers of the ordinary faults of the sensors, by kind.
    parameters : mapping of str to float
        True constants of the tool, keyword arguments of `PlantSettings`.
    shifts : mapping of str to float
        Their distance from the nominal values, in stated standard deviations of the logarithm.
    sensors : SensorSettings
    change : Change
    material : str
        What is usually cut.
    k_fc_n_s_per_m, width_exponent : float
        Its cutting damper at 20 mm and the dependence on the thickness.
    trials : tuple of TrialPlan
    peak_force_n, working_current_a : float
        Peak of the cutting force and mean motor current at the middle duty and 20 mm, without effects.
    """

    seed: int
    session_seed: int
    effects: Mapping[str, float]
    background: Mapping[str, float]
    bench: Bench
    nuisances: Mapping[str, Mapping[str, float]]
    parameters: Mapping[str, float]
    shifts: Mapping[str, float]
    sensors: SensorSettings
    change: Change
    material: str
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
    repetition: int = 0,
    **nature: Any,
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
    repetition : int
        0 for the campaign of the seed; from 1 on the same machine and operating points with other noise, wood, pauses
        and order of trials.
    **nature
        Fields of `bench.Nature`.
    """
    of_nature = Nature(**nature)
    bench = draw_bench(seed, of_nature)
    effects = dict(effects or {})
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
    shifts = _draw_shifts(streams[0], bench, parameters)
    true = _true_constants(streams[0], bench, shifts)
    material, k_fc, width_exponent = _draw_wood(streams[1])
    small = _draw_background(streams[2], background, set(effects))
    work = _working_point(bench, true, k_fc)
    change = changes_of(small | effects, _setting(seed, of_nature, work))
    again = np.random.default_rng([seed, repetition, 31])
    session_seed = int(again.integers(2**62)) if repetition else seed
    return CampaignDraw(
        seed=seed,
        session_seed=session_seed,
        effects=MappingProxyType(effects),
        background=MappingProxyType(small),
        bench=bench,
        nuisances=_draw_nuisances(seed, of_nature),
        parameters=MappingProxyType(true),
        shifts=MappingProxyType(shifts),
        sensors=_draw_sensors(streams[3], bench, change),
        change=change,
        material=material,
        k_fc_n_s_per_m=k_fc,
        width_exponent=width_exponent,
        trials=_plan(seed, of_nature, bench, work, material, (streams[4], again if repetition else streams[4])),
        peak_force_n=work.peak_force_n,
        working_current_a=work.current_a,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Work:
    """The middle duty in the usual material at 20 mm, without effects."""

    peak_force_n: float
    current_a: float
    start_current_a: float
    battery_a: float


def _setting(seed: int, nature: Nature, work: _Work) -> Setting:
    found = Setting(seed=seed, peak_force_n=work.peak_force_n, forms=nature.forms)
    if nature.differs_in("machine"):
        found = replace(found, usual_limit_a=_LIMIT_SHARE * work.start_current_a)
    return found


def _plan(
    seed: int,
    nature: Nature,
    bench: Bench,
    work: _Work,
    material: str,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> tuple[TrialPlan, ...]:
    """Plan the trials; `rngs`: of the plan, and of the session's pauses and order, which may be the same."""
    if nature.differs_in("campaign"):
        plans = any_plan(stream_of(seed, "campaign"), material, bench, nature.length, rngs[1])
    else:
        plans = own_plan(rngs[0], material, bench, nature.length, rngs[1])
    if nature.differs_in("operator"):
        plans = as_operated(plans, stream_of(seed, "operator"))
    if nature.benches == "own":
        return plans
    rng = stream_of(seed, "swaps")
    is_swapper = nature.differs_in("operator") and rng.random() < 0.5
    return with_batteries(
        plans, usual_current_a=work.battery_a, capacity_ah=bench.capacity_ah,
        swap_share=0.08 if is_swapper else 0.0, rng=rng,
    )  # fmt: skip


def _true_constants(rng: np.random.Generator, bench: Bench, shifts: Mapping[str, float]) -> dict[str, float]:
    true = {name: nominal * np.exp(shifts[name] * std) for name, (nominal, std) in bench.nominal.items()}
    true |= {
        "nominal_voltage_v": bench.nominal_voltage_v * (1.0 + 0.004 * rng.standard_normal()),
        "capacity_ah": bench.capacity_ah * (1.0 + 0.02 * rng.standard_normal()),
        "internal_resistance_ohm": bench.internal_resistance_ohm * np.exp(0.05 * rng.standard_normal()),
    }
    return {name: float(value) for name, value in true.items()}


def _draw_nuisances(seed: int, nature: Nature) -> Mapping[str, Mapping[str, float]]:
    """Draw which faults the sensors have, each by itself, and their numbers."""
    found = {}
    for name, nuisance in NUISANCES.items():
        rng = stream_of(seed, name)
        if rng.random() < _NUISANCE_SHARE and nature.differs_in(name):
            found[name] = MappingProxyType(nuisance.draw(rng))
    return MappingProxyType(found)


def _draw_shifts(rng: np.random.Generator, bench: Bench, parameters: Parameters) -> dict[str, float]:
    """Return the distance of every constant from its nominal value, in standard deviations."""
    shifts = {name: float(np.clip(rng.standard_normal(), -2.0, 2.0)) for name in bench.nominal}
    far = [str(rng.choice(_STRONG)), *map(str, rng.choice(_ALSO, size=2, replace=False))]
    beyond = {name: float(rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 8.0)) for name in far}
    return shifts | beyond if parameters == "beyond" else shifts


def _draw_wood(rng: np.random.Generator) -> tuple[str, float, float]:
    """Draw what is usually cut, its damper at 20 mm in N s/m, and the exponent of its thickness."""
    material = str(rng.choice(["nylon", "black_locust", "oak"], p=[0.2, 0.4, 0.4]))
    k_fc = MATERIALS[material].k_fc_n_s_per_m * float(np.exp(0.12 * rng.standard_normal()))
    return material, k_fc, 1.0 + 0.05 * float(rng.standard_normal())


def _draw_background(
    rng: np.random.Generator, background: tuple[int, float, float] | Mapping[str, float], taken: set[str]
) -> dict[str, float]:
    if isinstance(background, Mapping):
        return dict(background)
    count, low, high = background
    ids = [name for name in CATALOGUE if name not in NOT_AS_BACKGROUND]
    order = [str(name) for name in rng.permutation(ids)]
    sizes = np.exp(rng.uniform(np.log(low), np.log(high), size=len(ids)))
    chosen = list(zip(order, map(float, sizes), strict=True))[:count]
    return {name: size for name, size in chosen if name not in taken}


def _draw_sensors(rng: np.random.Generator, bench: Bench, change: Change) -> SensorSettings:
    gain = tuple(float(1.0 + std * rng.standard_normal()) for std in _GAIN_STD)
    zero = tuple(float(std * rng.standard_normal()) for std in _ZERO_STD)
    noise = tuple(
        float(std * np.exp(0.2 * rng.standard_normal())) * bench.noise_factor for std in SensorSettings().noise
    )
    settings = SensorSettings(gain=gain, zero=zero, noise=noise, gear_ratio=bench.gear_ratio)
    return replace(settings, **change.sensors)


def _working_point(bench: Bench, true: Mapping[str, float], k_fc: float) -> _Work:
    """Run the tool up, and take forces and currents once it is up to speed."""
    rows = Plant(bench.settings(true, k_fc_n_s_per_m=k_fc, stroke_rel_std=0.0)).advance(0.8)
    steady = rows[8000:]
    return _Work(
        peak_force_n=float(column(steady, "force_n").max()),
        current_a=float(column(steady, "current_a").mean()),
        start_current_a=float(column(rows, "current_a").max()),
        battery_a=float(column(steady, "battery_a").mean()),
    )
