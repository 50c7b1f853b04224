"""A campaign of the blind check: trial tables, `campaign.toml` and `bench_config.toml`, as from a bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from scipy.linalg import expm

from bench.errors import InputError
from bench.units import CHANNELS, TIME_COLUMN
from blindcheck.csv_table import write_csv
from blindcheck.drawing import NOMINAL, CampaignDraw, Parameters, TrialPlan, draw_campaign
from blindcheck.dynamics import (
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
from blindcheck.effects.change import Forms
from blindcheck.plant import MATERIALS, Floats, Plant, PlantSettings, parameter_record
from blindcheck.sensors import Readings, measure
from blindcheck.true_parameters import true_parameters

RATE_HZ = 5000.0
_FIRST_TRIAL = datetime(2026, 3, 2, 9, 0, 0, tzinfo=UTC)
_DECIMALS = {TIME_COLUMN: 6, "force_n": 2} | {channel.name: 4 for channel in CHANNELS if channel.name != "force_n"}
_WOOD_TRIAL_STD = {"nylon": 0.015, "black_locust": 0.04, "oak": 0.05, "none": 0.0}


def trial_settings(draw: CampaignDraw, index: int) -> PlantSettings:
    """Return what the plant is in trial number `index` (from 0) of a campaign."""
    plan = draw.trials[index]
    rng = np.random.default_rng([draw.session_seed, 21, index])
    spread = float(np.exp(_WOOD_TRIAL_STD[plan.workpiece] * rng.standard_normal()))
    width = plan.thickness_mm / 20.0
    wood = MATERIALS[plan.workpiece]
    k_fc = draw.k_fc_n_s_per_m * spread * width**draw.width_exponent if wood.k_fc_n_s_per_m > 0 else 0.0
    return PlantSettings(
        **dict(draw.parameters),  # type: ignore[arg-type]
        duty=plan.duty,
        k_fc_n_s_per_m=k_fc,
        stroke_rel_std=wood.stroke_rel_std,
        stroke_correlation=wood.stroke_correlation,
        feed_mm_s=plan.feed_mm_s,
        initial_crank_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        seed=int(rng.integers(2**31)),
        extras={"width_ratio": width} | dict(draw.change.shape) | dict(draw.change.plant),
    )


def measured_trials(draw: CampaignDraw, *, rate_hz: float = RATE_HZ) -> Iterator[tuple[TrialPlan, float, Readings]]:
    """Simulate and measure the trials in their order; charge, wear and heat carry over.

    Parameters
    ----------
    draw : CampaignDraw
    rate_hz : float
        Mean sample rate.

    Yields
    ------
    TrialPlan, float, Readings
        The plan, the time since the session's start in s, and what was written down.
    """
    state = np.zeros(N_STATES)
    session_s = 0.0
    for index, plan in enumerate(draw.trials):
        settings = trial_settings(draw, index)
        state = _after_rest(state, plan.rest_s, settings)
        state[CRANK] = settings.initial_crank_rad
        session_s += plan.rest_s
        plant = Plant(settings, state=state)
        standing_s = float(np.random.default_rng([draw.session_seed, 22, index]).uniform(0.05, 0.25))
        rows = plant.advance(plan.seconds)
        yield (
            plan,
            session_s,
            measure(
                rows,
                draw.sensors,
                rate_hz=rate_hz,
                session_s=session_s,
                rest_s=standing_s,
                seed=[draw.session_seed, index],
            ),
        )
        state = plant.state
        session_s += plan.seconds


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
    forms: Forms = "own",
    length: float = 1.0,
    rate_hz: float = RATE_HZ,
    repetition: int = 0,
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
    forms : {"own", "plain"}
    length : float
        Factor on the duration of every trial; 1 gives 18 trials of about 750 000 rows in all.
    rate_hz : float
        Mean sample rate of the tables.
    repetition : int
        See `draw_campaign`: from 1 on the same machine is measured again.

    Returns
    -------
    dict
        The truth, ready for JSON; nothing of it is in the folder.

    Raises
    ------
    InputError
        If the folder holds something already, or an effect is unknown.
    """
    out_dir = Path(out_dir)
    if out_dir.exists() and any(out_dir.iterdir()):
        raise InputError("is not empty", where=out_dir, remedy="name a new folder for the campaign")
    draw = draw_campaign(
        seed, effects=effects, parameters=parameters, background=background, forms=forms, length=length,
        repetition=repetition,
    )  # fmt: skip
    out_dir.mkdir(parents=True, exist_ok=True)
    (out_dir / "bench_config.toml").write_text(tomli_w.dumps(nominal_config()), encoding="utf-8")
    tables = []
    for number, (plan, session_s, readings) in enumerate(measured_trials(draw, rate_hz=rate_hz), start=1):
        name = f"trial-{number:02d}.csv"
        write_csv(out_dir / name, {TIME_COLUMN: readings.time_s} | readings.values, _DECIMALS)
        tables.append(_trial_table(name, plan, session_s))
    campaign = {"config": "bench_config.toml", "trial": tables}
    (out_dir / "campaign.toml").write_text(tomli_w.dumps(campaign), encoding="utf-8")
    return truth_of(draw, parameters=parameters, forms=forms, length=length, rate_hz=rate_hz)


def truth_of(
    draw: CampaignDraw, *, parameters: Parameters, forms: Forms, length: float, rate_hz: float
) -> dict[str, Any]:
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
        "forms": forms,
        "length": length,
        "rate_hz": rate_hz,
    }


def nominal_config() -> dict[str, Any]:
    """Return the tables `[plant]`, `[battery]` and `[cutting]` that the campaign's configuration states."""
    plant: dict[str, Any] = {name: {"nominal": value, "rel_std": std} for name, (value, std) in NOMINAL.items()}
    return {
        "plant": plant | {"gear_ratio": 56.0 / 6.0},
        "battery": {
            "nominal_voltage_v": 18.0,
            "capacity_ah": 1.5,
            "beta": 0.99,
            "internal_resistance_ohm": 0.02,
            "cutoff_soc": 0.2,
        },
        "cutting": {"cutting_half": "pi_to_2pi"},
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
        "battery": "P1",
        "started_at": started_at.strftime("%Y-%m-%dT%H:%M:%SZ"),
    }
