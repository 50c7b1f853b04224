"""Puts a campaign together, simulates it, and writes its recordings, its configuration and its entry of the key."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w
from sawbench.bench.recording import Alignment, Recording, Signal, Trial
from sawbench.storage.reader import write_recording

from benchmarks.independent_bench.benches import Bench, draw_bench, piece_hardness, ring_pattern
from benchmarks.independent_bench.cases import Case
from benchmarks.independent_bench.effects import EFFECTS, Hidden, hide, setting_of
from benchmarks.independent_bench.instruments import (
    CERTIFIED_STD,
    STATED_LATENCY_S,
    UNITS,
    Instruments,
    Reading,
    draw_instruments,
    read,
)
from benchmarks.independent_bench.parameters import Battery, Plant, Run
from benchmarks.independent_bench.plans import Plan, PlannedTrial, draw_plan
from benchmarks.independent_bench.plant import (
    ANGLE,
    CASING,
    CHARGE,
    CUT,
    FAST_V,
    FORCE,
    MAGNET,
    N_STATES,
    PLUNGER,
    SLOW_V,
    STEP_S,
    WINDING,
    Floats,
    integrate,
    rested,
)
from benchmarks.independent_bench.visibility import SETTLED_S, shown

CONFIG: Final = "bench_config.toml"
SOURCE: Final = "independent bench"
# Relative standard deviation of the stated constants of the plant.
STATED_STD: Final[Mapping[str, float]] = {
    "resistance_ohm": 0.05, "inductance_h": 0.1, "back_emf_constant_v_s_per_rad": 0.02,
    "torque_constant_n_m_per_a": 0.03, "rotor_inertia_kg_m2": 0.05, "yoke_inertia_kg_m2": 0.05,
    "reciprocating_mass_kg": 0.02, "crank_radius_m": 0.003, "motor_damping_n_m_s_per_rad": 0.3,
}  # fmt: skip
_LARGEST_ERROR = 2.3  # of an intact constant, in its standard deviations
_THICKNESS_MM = 20.0
# A machine that runs when the recording starts has run for so long, and the plant runs on after its end, s.
_RUN_BEFORE_S, _RUN_AFTER_S = 1.6, 0.05
_SWITCHED_LONG_AGO_S = -1e3
# A second battery of the same type: in how many campaigns, and how far voltage, charge and resistance differ.
_SECOND_SHARE, _BATTERY_STD = 0.5, (0.003, 0.02, 0.06)
# An edge carries a part of the force: the coefficient of the rest is smaller, so that the mean stays about the same.
_COEFFICIENT_BESIDE_EDGE = 0.85
# Quantile that counts as the largest force of a trial.
_PEAK_PERCENT = 99.8


class _Stream(IntEnum):
    """Random streams of a case; each part draws from its own, so that a change of one leaves the others as they are."""

    BENCH = 1
    PLAN = 2
    INSTRUMENTS = 3
    EFFECTS = 4
    NOMINAL = 5
    PIECE = 6
    RINGS = 7
    READING = 8
    ZERO = 9
    BATTERY = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class Campaign:
    """Everything that was drawn for a case.

    Attributes
    ----------
    seed : int
    case : Case
    bench : Bench
    plan : Plan
    instruments : Instruments
    hidden : Hidden
    nominal_errors : mapping of str to float
        True minus nominal value of each constant, in stated standard deviations.
    second_battery : (int, Battery) or None
        Number of the trial before which it is put in.
    """

    seed: int
    case: Case
    bench: Bench
    plan: Plan
    instruments: Instruments
    hidden: Hidden
    nominal_errors: Mapping[str, float]
    second_battery: tuple[int, Battery] | None = None

    @property
    def intact(self) -> Hidden:
        """The same bench without the hidden effects."""
        return Hidden(plant=_intact_plant(self.bench))

    def battery_of(self, trial: PlannedTrial) -> tuple[str, Battery]:
        """Name and numbers of the battery that a trial runs on."""
        if self.second_battery is not None and trial.number >= self.second_battery[0]:
            return "P2", self.second_battery[1]
        return "P1", self.bench.battery

    def stream(self, part: _Stream, trial: int = 0) -> np.random.Generator:
        """Random stream of a part, or of a part of one trial."""
        return _stream(self.seed, self.case, part, trial)


def _stream(seed: int, case: Case, part: _Stream, trial: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, case.number, part, trial])


def _intact_plant(bench: Bench) -> Plant:
    plant = Plant(machine=bench.machine, battery=bench.battery)
    return plant._replace(run=plant.run._replace(cutting_sign=bench.cutting_sign))


def draw_campaign(seed: int, case: Case) -> Campaign:
    """Draw bench, plan, instruments and what is hidden; simulates nothing."""
    effects = {} if case.kind == "parameters" else case.effects
    asked = frozenset().union(*(EFFECTS[name].asks for name in effects))
    bench = draw_bench(_stream(seed, case, _Stream.BENCH))
    plan = draw_plan(_stream(seed, case, _Stream.PLAN), bench, asked)
    measured_by = draw_instruments(_stream(seed, case, _Stream.INSTRUMENTS), asked)
    setting = setting_of(bench, plan, measured_by)
    hidden = hide(effects, _intact_plant(bench), _stream(seed, case, _Stream.EFFECTS), setting)
    errors = _stream(seed, case, _Stream.NOMINAL).standard_normal(len(STATED_STD))
    errors = np.clip(errors, -_LARGEST_ERROR, _LARGEST_ERROR)
    nominal_errors = dict(zip(STATED_STD, errors.tolist(), strict=True))
    if case.kind == "parameters":
        nominal_errors |= case.effects
    return Campaign(
        seed=seed, case=case, bench=bench, plan=plan, instruments=measured_by, hidden=hidden,
        nominal_errors=nominal_errors,
        second_battery=_second_battery(_stream(seed, case, _Stream.BATTERY), bench.battery, len(plan.trials)),
    )  # fmt: skip


def _second_battery(rng: np.random.Generator, first: Battery, n_trials: int) -> tuple[int, Battery] | None:
    if rng.random() > _SECOND_SHARE:
        return None
    before = int(rng.integers(n_trials // 3, n_trials)) + 1
    voltage, charge, resistance = 1.0 + np.array(_BATTERY_STD) * rng.standard_normal(3)
    return before, first._replace(
        nominal_voltage_v=float(voltage * first.nominal_voltage_v), charge_c=float(charge * first.charge_c),
        internal_resistance_ohm=float(resistance * first.internal_resistance_ohm),
    )  # fmt: skip


def simulate(campaign: Campaign, hidden: Hidden) -> Iterator[tuple[Floats, Floats]]:
    """Simulate the trials one after another; charge, heat and wear are carried on.

    Parameters
    ----------
    campaign : Campaign
    hidden : Hidden
        Of the campaign, or its `intact`.

    Yields
    ------
    signals : ndarray, shape (N_SIGNALS, n)
        Every `STEP_S`.
    state : ndarray, shape (N_STATES,)
        At the end of the trial.
    """
    state, last = np.zeros(N_STATES), ""
    for trial in campaign.plan.trials:
        name, battery = campaign.battery_of(trial)
        if name != last:
            state[[CHARGE, FAST_V, SLOW_V]], last = 0.0, name
        plant = hidden.plant._replace(run=_run_of(campaign, hidden, trial), battery=battery)
        hardness = _hardness(campaign, hidden, trial)
        state[ANGLE] = trial.crank_angle_rad
        state[PLUNGER] = plant.machine.crank_radius_m * (1.0 - math.cos(trial.crank_angle_rad))
        if not trial.has_run_up:
            plant = _already_running(plant, state, hardness)
        signals = integrate(plant, state, round((trial.duration_s + _RUN_AFTER_S) / STEP_S), hardness)
        if not (np.isfinite(signals).all() and np.isfinite(state).all()):
            raise FloatingPointError(f"{campaign.case.name}, trial {trial.number}: the plant diverges")
        yield signals, state.copy()
        state = rested(state, plant, trial.rest_s)


def _run_of(campaign: Campaign, hidden: Hidden, trial: PlannedTrial) -> Run:
    coefficient = 0.0
    if trial.material is not None:
        coefficient = campaign.bench.reference_coefficient_n_s_per_m * campaign.plan.woods[trial.material]
        # The wood is that of the campaign: the twin without the edge force cuts the same.
        coefficient *= _COEFFICIENT_BESIDE_EDGE if campaign.hidden.plant.edge.force_n > 0.0 else 1.0
    return hidden.plant.run._replace(
        duty=trial.duty, on_s=trial.on_s, ramp_s=trial.ramp_s, cutting_coefficient_n_s_per_m=coefficient,
        feed_mm_s=trial.feed_mm_s,
    )  # fmt: skip


def _hardness(campaign: Campaign, hidden: Hidden, trial: PlannedTrial) -> Floats:
    """Hardness of the piece over time: the same piece with and without the hidden effects."""
    if trial.material is None:
        return np.ones(1)
    cut = {"feed_mm_s": trial.feed_mm_s, "duration_s": trial.duration_s}
    piece = piece_hardness(campaign.stream(_Stream.PIECE, trial.number), campaign.bench.scatter, trial.material, **cut)
    return piece * ring_pattern(campaign.stream(_Stream.RINGS, trial.number), hidden.rings, trial.material, **cut)


def _already_running(plant: Plant, state: Floats, hardness: Floats) -> Plant:
    """Run before the recording, on the bench supply: it heats the machine but takes no charge and wears no blade."""
    plant = plant._replace(run=plant.run._replace(on_s=0.0))
    kept = [CHARGE, FAST_V, SLOW_V, CUT]
    before = state[kept]
    integrate(plant, state, round(_RUN_BEFORE_S / STEP_S), hardness[:1])
    state[kept] = before
    return plant._replace(run=plant.run._replace(on_s=_SWITCHED_LONG_AGO_S))


def write_case(seed: int, case: Case, out: Path) -> dict[str, Any]:
    """Simulate one case and write it into its folder.

    Parameters
    ----------
    seed : int
    case : Case
    out : Path
        Folder of the set; that of the case must not exist.

    Returns
    -------
    dict
        Entry of the key.
    """
    campaign = draw_campaign(seed, case)
    folder = out / case.name
    folder.mkdir(parents=True)
    config = tomli_w.dumps(config_of(campaign))
    (folder / CONFIG).write_text(config, encoding="utf-8")
    simulated = list(simulate(campaign, campaign.hidden))
    signals, state = [one for one, _ in simulated], simulated[-1][1]
    for recording in recordings_of(campaign, signals, config):
        write_recording(recording, folder / f"{recording.trial.trial_id}.mcap")
    return entry_of(campaign) | {
        "shows": _shown(campaign, signals),
        "state_of_charge_at_end": 1.0
        - float(state[CHARGE]) / campaign.battery_of(campaign.plan.trials[-1])[1].charge_c,
        "cut_m": float(state[CUT]),
        "winding_k": float(state[WINDING] + state[CASING]),
        "magnets_k": float(state[MAGNET]),
    }


def _shown(campaign: Campaign, signals: Sequence[Floats]) -> dict[str, Any] | None:
    """How far the hidden effects show in a mean stroke; None where they cannot: nothing, a late clock, a drift."""
    hidden, intact = campaign.hidden, campaign.intact
    if (hidden.plant, hidden.rings) == (intact.plant, intact.rings) and not hidden.sensors.change_strokes:
        return None
    twin = (one for one, _ in simulate(campaign, intact))
    return shown(signals, twin, hidden.sensors, campaign.instruments, peak_of(signals))


def config_of(campaign: Campaign) -> dict[str, Any]:
    """Contents of `bench_config.toml`: nominal values, off by their errors; of the battery as they are."""
    machine, battery = campaign.bench.machine, campaign.bench.battery
    plant: dict[str, Any] = {}
    for name, std in STATED_STD.items():
        nominal = getattr(machine, name) / (1.0 + campaign.nominal_errors[name] * std)
        plant[name] = {"nominal": float(f"{nominal:.5g}"), "rel_std": std}
    return {
        "plant": plant | {"gear_ratio": machine.gear_ratio},
        "battery": {
            "nominal_voltage_v": battery.nominal_voltage_v,
            "capacity_ah": battery.charge_c / 3600.0,
            "beta": battery.beta,
            "internal_resistance_ohm": float(f"{battery.internal_resistance_ohm:.4g}"),
            "cutoff_soc": 0.2,
        },
        "cutting": {"cutting_half": "pi_to_2pi" if campaign.bench.cutting_sign < 0.0 else "zero_to_pi"},
    }


def recordings_of(campaign: Campaign, signals: Sequence[Floats], config: str) -> Iterator[Recording]:
    """Record every trial with the instruments of the campaign.

    Parameters
    ----------
    campaign : Campaign
    signals : sequence of ndarray, shape (N_SIGNALS, n)
        Of every trial.
    config : str
        Text of `bench_config.toml`, which every recording holds too.
    """
    trials, measured_by = campaign.plan.trials, campaign.instruments
    peak_n = peak_of(signals)
    steps = campaign.stream(_Stream.ZERO).standard_normal(len(trials))
    zeros_n = 0.5 * measured_by.zero_wander_n * np.cumsum(steps)
    made: dict[tuple[Any, ...], int] = {}
    for trial, one, zero_n in zip(trials, signals, zeros_n, strict=True):
        point = (trial.duty, trial.material, trial.feed_mm_s)
        made[point] = made.get(point, 0) + 1
        readings = read(
            campaign.stream(_Stream.READING, trial.number), measured_by, campaign.hidden.sensors, one,
            peak_n=peak_n, duration_s=trial.duration_s, restart_zero_n=float(zero_n),
            session_s=(trial.started_at - trials[0].started_at).total_seconds(),
            stroke_mm=2e3 * campaign.bench.machine.crank_radius_m,
        )  # fmt: skip
        name, _ = campaign.battery_of(trial)
        yield _recording(measured_by, trial, readings, config, made[point], battery=name)


def peak_of(signals: Sequence[Floats]) -> float:
    """Largest force of a campaign, N; its rarest peaks left out."""
    settled = int(SETTLED_S / STEP_S)
    return max(float(np.percentile(one[FORCE, settled:], _PEAK_PERCENT)) for one in signals)


def _recording(
    measured_by: Instruments, planned: PlannedTrial, readings: Sequence[Reading], config: str, repetition: int,
    *, battery: str,
) -> Recording:  # fmt: skip
    trial = Trial(
        trial_id=f"trial-{planned.number:02d}", material=planned.material or "none", duty=planned.duty,
        thickness_mm=_THICKNESS_MM, feed_mm_s=planned.feed_mm_s, blade="B1", battery=battery, repetition=repetition,
        started_at=planned.started_at, source=SOURCE,
    )  # fmt: skip
    provenance, signals = {"source": SOURCE}, {}
    for reading in readings:
        channel, std_s = reading.channel, measured_by.devices[reading.device].alignment_std_s
        signals[channel] = Signal(
            channel=channel, unit=UNITS[channel], time_s=reading.time_s, values=reading.values, device=reading.device,
            alignment=Alignment(std_s=std_s, latency_s=STATED_LATENCY_S),
        )  # fmt: skip
        alignment = {"std_s": std_s, "latency_s": STATED_LATENCY_S}
        calibration = {
            "scale": 1.0, "offset": 0.0, "zero_raw": 0.0, "raw_unit": UNITS[channel],
            "rel_std": CERTIFIED_STD[channel], "source": "certificate",
        }  # fmt: skip
        provenance[f"alignment values {channel}"] = json.dumps(alignment)
        provenance[f"calibration values {channel}"] = json.dumps(calibration)
    return Recording(
        trial=trial, signals=signals, events=(), config_toml=config, provenance=provenance, is_complete=True, path=""
    )


def entry_of(campaign: Campaign) -> dict[str, Any]:
    """Entry of the key: what is hidden, and everything that was drawn."""
    plan, hidden, intact = campaign.plan, campaign.hidden, campaign.intact.plant
    changed = {name: group for name, group in hidden.plant._asdict().items() if group != getattr(intact, name)}
    return plain(
        {
            "kind": campaign.case.kind,
            "effects": campaign.case.effects,
            "at_severity_1": {name: EFFECTS[name].at_one for name in campaign.case.effects if name in EFFECTS},
            "numbers": hidden.numbers,
            "notes": hidden.notes,
            "nominal_errors_std": campaign.nominal_errors,
            "plant_changes": changed,
            "sensor_errors": hidden.sensors,
            "rings": hidden.rings,
            "bench": campaign.bench,
            "woods": plan.woods,
            "duties": sorted({trial.duty for trial in plan.trials}),
            "feeds_mm_s": plan.feeds_mm_s,
            "n_trials": len(plan.trials),
            "instruments": campaign.instruments,
        }
    )


def plain(what: Any) -> Any:
    """Dataclasses and named tuples as dictionaries, tuples as lists: what JSON holds."""
    if dataclasses.is_dataclass(what) and not isinstance(what, type):
        return plain({field.name: getattr(what, field.name) for field in dataclasses.fields(what)})
    if isinstance(what, tuple) and hasattr(what, "_asdict"):
        return plain(what._asdict())  # type: ignore[attr-defined]
    if isinstance(what, Mapping):
        return {str(name): plain(value) for name, value in what.items()}
    if isinstance(what, tuple | list):
        return [plain(value) for value in what]
    return what
