"""A campaign of the blind check: trial tables, `campaign.toml` and `bench_config.toml`, as from a bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from sawbench.bench.errors import InputError
from sawbench.bench.units import CHANNELS, TIME_COLUMN
from sawbench.blindcheck.bench import Nature
from sawbench.blindcheck.csv_table import write_csv
from sawbench.blindcheck.drawing import CampaignDraw, Parameters, draw_campaign
from sawbench.blindcheck.draws import stream_of
from sawbench.blindcheck.dynamics import (
    CHARGE,
    CRANK,
    CUT_PATH,
    GREASE,
    HOUSING,
    N_STATES,
    POLAR_FAST,
    POLAR_SLOW,
    WINDING,
)
from sawbench.blindcheck.nuisances import NUISANCES, Moment
from sawbench.blindcheck.plans import TrialPlan
from sawbench.blindcheck.plant import GRID_S, MATERIALS, Floats, Plant, PlantSettings, parameter_record
from sawbench.blindcheck.readings import Readings
from sawbench.blindcheck.sensors import measure
from sawbench.blindcheck.true_parameters import true_parameters
from scipy.linalg import expm

# Relative: voltage, capacity and resistance of batteries of one type.
_BATTERY_STD = (0.003, 0.02, 0.06)
_FIRST_TRIAL = datetime(2026, 3, 2, 9, 0, 0, tzinfo=UTC)
_DECIMALS = {TIME_COLUMN: 6, "force_n": 2} | {channel.name: 4 for channel in CHANNELS if channel.name != "force_n"}


def trial_settings(draw: CampaignDraw, index: int) -> PlantSettings:
    """Return what the plant is in trial number `index` (from 0) of a campaign."""
    plan = draw.trials[index]
    rng = np.random.default_rng([draw.session_seed, 21, index])
    width = plan.thickness_mm / 20.0
    wood = MATERIALS[plan.workpiece]
    spread = float(np.exp(wood.piece_rel_std * rng.standard_normal()))
    harder = wood.k_fc_n_s_per_m / MATERIALS[draw.material].k_fc_n_s_per_m
    k_fc = draw.k_fc_n_s_per_m * harder * spread * width**draw.width_exponent if harder > 0.0 else 0.0
    settings = draw.bench.settings(
        draw.parameters,
        duty=plan.duty,
        k_fc_n_s_per_m=k_fc,
        stroke_rel_std=wood.stroke_rel_std,
        stroke_correlation=wood.stroke_correlation,
        feed_mm_s=plan.feed_mm_s,
        initial_crank_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        seed=int(rng.integers(2**31)),
        extras={"width_ratio": width} | dict(draw.change.shape) | dict(draw.change.plant),
    )
    for name, numbers in draw.nuisances.items():
        settings = NUISANCES[name].change(settings, numbers)
    return settings if plan.battery == draw.trials[0].battery else _with_battery(settings, draw, plan.battery)


def _with_battery(settings: PlantSettings, draw: CampaignDraw, battery: str) -> PlantSettings:
    """Return the settings with another battery of the same type: none is quite like the first."""
    rng = stream_of(draw.session_seed, battery, 25)
    voltage, charge, resistance = np.exp(np.array(_BATTERY_STD) * rng.standard_normal(3)).tolist()
    return replace(
        settings, nominal_voltage_v=voltage * settings.nominal_voltage_v, capacity_ah=charge * settings.capacity_ah,
        internal_resistance_ohm=resistance * settings.internal_resistance_ohm,
    )  # fmt: skip


def measured_trials(draw: CampaignDraw) -> Iterator[tuple[TrialPlan, float, Readings]]:
    """Simulate and measure the trials in their order; charge, wear and heat carry over.

    Yields
    ------
    TrialPlan, float, Readings
        The plan, the time since the session's start in s, and what was written down.
    """
    state = np.zeros(N_STATES)
    session_s = 0.0
    battery = draw.trials[0].battery
    for index, plan in enumerate(draw.trials):
        settings = trial_settings(draw, index)
        state = _after_rest(state, plan.rest_s, settings)
        if plan.battery != battery:
            battery = plan.battery
            state[[CHARGE, POLAR_FAST, POLAR_SLOW]] = 0.0
        state[CRANK] = settings.initial_crank_rad
        session_s += plan.rest_s
        plant = Plant(settings, state=state)
        standing_s = float(np.random.default_rng([draw.session_seed, 22, index]).uniform(0.05, 0.25)) + plan.late_s
        yield (
            plan,
            session_s,
            measure(
                _run(plant, plan),
                draw.sensors,
                rate_hz=draw.bench.rate_hz,
                session_s=session_s,
                rest_s=standing_s,
                seed=[draw.session_seed, index],
                disturb=lambda readings, at=(session_s, index): disturbed(draw, readings, *at),
            ),
        )
        state = plant.state
        session_s += plan.late_s + plan.seconds


def _run(plant: Plant, plan: TrialPlan) -> Floats:
    """Let the tool run, in air before and behind the cut, and coast where it is switched off before the end."""
    on_s = plan.seconds - plan.off_s
    parts = []
    for is_in, seconds in ((False, plan.in_air_s), (True, on_s - plan.in_air_s - plan.out_s), (False, plan.out_s)):
        if seconds > 0.0:
            plant.in_wood(is_in=is_in)
            parts.append(plant.advance(np.round(seconds / GRID_S) * GRID_S))
    if plan.off_s > 0.0:
        plant.switch_off()
        parts.append(plant.advance(plan.off_s))
    return np.concatenate([*(part[:-1] for part in parts[:-1]), parts[-1]])


def disturbed(draw: CampaignDraw, readings: Readings, session_s: float, index: int) -> Readings:
    """Return the readings of trial number `index` (from 0) with the faults that the campaign's sensors have."""
    for name, numbers in draw.nuisances.items():
        moment = Moment(
            session_s=session_s,
            session=stream_of(draw.session_seed, name, 23),
            trial=stream_of(draw.session_seed, name, 24, index),
        )
        readings = NUISANCES[name].disturb(readings, numbers, moment)
    return readings


def _after_rest(state: Floats, rest_s: float, settings: PlantSettings) -> Floats:
    """Return the state after a pause: charge and wear stay, heat and polarization decay."""
    p = parameter_record(settings)[0]
    after = np.zeros(N_STATES)
    after[CHARGE], after[CUT_PATH] = state[CHARGE], state[CUT_PATH]
    across = 1.0 / p["r_wind_house"]
    rates = np.array(
        [
            [-across / p["c_winding"], across / p["c_winding"]],
            [across / p["c_housing"], -(across + 1.0 / p["r_house_air"]) / p["c_housing"]],
        ]
    )
    after[[WINDING, HOUSING]] = expm(rates * rest_s) @ state[[WINDING, HOUSING]]
    after[POLAR_FAST] = state[POLAR_FAST] * np.exp(-rest_s / p["polar_fast_s"])
    after[POLAR_SLOW] = state[POLAR_SLOW] * np.exp(-rest_s / p["polar_slow_s"])
    after[GREASE] = state[GREASE] * np.exp(-rest_s / 60.0)
    return after


def make_campaign(
    seed: int,
    out_dir: Path,
    *,
    effects: Mapping[str, float] | None = None,
    parameters: Parameters = "within",
    background: tuple[int, float, float] | Mapping[str, float] = (3, 0.003, 0.02),
    repetition: int = 0,
    **nature: Any,
) -> dict[str, Any]:
    """Write a campaign into an empty or new folder and return its truth.

    Parameters
    ----------
    seed : int
    out_dir : Path
    effects : mapping of str to float, optional
        Severity by effect id (1 is typical), of `effects.table`.
    parameters : {"within", "beyond"}
    background : tuple of (int, float, float), or mapping of str to float
        Number of small effects that play along and the range of their severity, or the severity of each.
    repetition : int
        See `draw_campaign`: from 1 on the same machine is measured again.
    **nature
        Fields of `bench.Nature`; with none of them 18 trials of about 750 000 rows in all at 5 kHz.

    Returns
    -------
    dict
        The truth, ready for JSON; nothing of it is in the folder.

    Raises
    ------
    InputError
        If the folder holds something already, or an effect is unknown.
    """
    draw = draw_campaign(
        seed, effects=effects, parameters=parameters, background=background, repetition=repetition, **nature
    )
    write_campaign(draw, out_dir)
    return truth_of(draw, Nature(**nature), parameters=parameters)


def write_campaign(draw: CampaignDraw, out_dir: Path) -> None:
    """Measure the trials of a campaign and write them into an empty or new folder.

    Raises
    ------
    InputError
        If the folder holds something already.
    """
    out_dir = Path(out_dir)
    if out_dir.exists() and any(out_dir.iterdir()):
        raise InputError("is not empty", where=out_dir, remedy="name a new folder for the campaign")
    out_dir.mkdir(parents=True, exist_ok=True)
    (out_dir / "bench_config.toml").write_text(tomli_w.dumps(draw.bench.config()), encoding="utf-8")
    tables = []
    for number, (plan, session_s, readings) in enumerate(measured_trials(draw), start=1):
        name = f"trial-{number:02d}.csv"
        write_csv(out_dir / name, {TIME_COLUMN: readings.time_s} | readings.values, _DECIMALS)
        tables.append(_trial_table(name, plan, session_s))
    campaign = {"config": "bench_config.toml", "trial": tables}
    (out_dir / "campaign.toml").write_text(tomli_w.dumps(campaign), encoding="utf-8")


def truth_of(draw: CampaignDraw, nature: Nature, *, parameters: Parameters) -> dict[str, Any]:
    """Return the label of a campaign and what is needed to make it again."""
    return {
        "seed": draw.seed,
        "session_seed": draw.session_seed,
        "effects": dict(draw.effects),
        "reported_parameters": true_parameters(draw),
        "background": dict(draw.background),
        "parameters": parameters,
        "true_parameters": dict(draw.parameters),
        "shifts": dict(draw.shifts),
        "sensors": asdict(draw.sensors),
        "k_fc_n_s_per_m": draw.k_fc_n_s_per_m,
        "width_exponent": draw.width_exponent,
        **asdict(nature),
        "rate_hz": draw.bench.rate_hz,
        "without": list(nature.without),
        "bench": draw.bench.record(),
        "nuisances": {name: dict(numbers) for name, numbers in draw.nuisances.items()},
        "trials": [asdict(plan) for plan in draw.trials],
    }


def _trial_table(name: str, plan: TrialPlan, session_s: float) -> dict[str, Any]:
    started_at = _FIRST_TRIAL + timedelta(seconds=round(session_s))
    return {
        "file": name,
        "duty": plan.duty,
        "workpiece": plan.workpiece,
        "thickness_mm": plan.thickness_mm,
        "feed_mm_s": plan.feed_mm_s,
        "blade": "B1",
        "battery": plan.battery,
        "started_at": started_at.strftime("%Y-%m-%dT%H:%M:%SZ"),
    }
