"""Ordinary faults of sensors, uneven wood and batteries with a curve of their own: a foreign bench has any mixture.

They are no effect: a diagnosis names them as faults of a signal, or leaves them alone. One row of `NUISANCES` is one
kind: `draw` its numbers for a campaign, in the key as they are drawn; `disturb` the readings of a trial, before they
are rounded to the instruments' steps, or `change` what is cut. Sizes are those of load cells, shunts and USB
instruments as their users know them, and of wood whose density differs by some percent: assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from sawbench.blindcheck.draws import between
from sawbench.blindcheck.plant import Floats
from sawbench.blindcheck.readings import Readings
from sawbench.blindcheck.settings import PlantSettings
from scipy import signal

Numbers = Mapping[str, float]
_WALK_STEP_S = 0.1
_USUAL_TRIAL_S = 8.0
_FULL_SCALE = MappingProxyType(
    {"force_n": 1000.0, "displacement_mm": 40.0, "motor_current_a": 100.0, "battery_voltage_v": 50.0,
     "battery_current_a": 100.0}
)  # fmt: skip
_SPIKED = ("force_n", "displacement_mm", "motor_current_a")


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """When a trial is measured, and what is random about it.

    Attributes
    ----------
    session_s : float
        Time since the session's start, s.
    session, trial : Generator
        Random numbers of one kind of fault: the same for all trials of the session; of this trial.
    """

    session_s: float
    session: np.random.Generator
    trial: np.random.Generator


@dataclass(frozen=True, kw_only=True, slots=True)
class Nuisance:
    """One kind of fault; see the module. Of a sensor, of the wood or of the battery."""

    draw: Callable[[np.random.Generator], dict[str, float]]
    disturb: Callable[[Readings, Numbers, Moment], Readings] = lambda readings, numbers, moment: readings
    change: Callable[[PlantSettings, Numbers], PlantSettings] = lambda settings, numbers: settings
    is_of_sensor: bool = True


def _added(readings: Readings, more: Mapping[str, Floats | float]) -> Readings:
    values = {name: column + more.get(name, 0.0) for name, column in readings.values.items()}
    return Readings(time_s=readings.time_s, values=values)


def _kept(readings: Readings, is_kept: np.ndarray) -> Readings:
    values = {name: column[is_kept] for name, column in readings.values.items()}
    return Readings(time_s=readings.time_s[is_kept], values=values)


def _draw_walk(rng: np.random.Generator) -> dict[str, float]:
    return {"n_in_8_s": float(rng.uniform(0.3, 1.0)), "memory_s": between(rng, 60.0, 2000.0)}


def _walk(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Let the zero of the force walk at random over the session, and forget over its memory.

    z(t + h) = q z(t) + s sqrt(h) n, q = exp(-h / memory), s the walk's size over sqrt(8 s).
    """
    end_s = moment.session_s + readings.time_s[-1] + 1.0
    n = int(end_s / _WALK_STEP_S) + 2
    steps = numbers["n_in_8_s"] * np.sqrt(_WALK_STEP_S / _USUAL_TRIAL_S) * moment.session.standard_normal(n)
    zero_n = signal.lfilter([1.0], [1.0, -np.exp(-_WALK_STEP_S / numbers["memory_s"])], steps)
    at_s = moment.session_s + readings.time_s
    return _added(readings, {"force_n": np.interp(at_s, _WALK_STEP_S * np.arange(n), zero_n)})


def _draw_flicker(rng: np.random.Generator) -> dict[str, float]:
    return {"rms_n": float(rng.uniform(0.2, 1.0))}


def _flicker(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Add noise of the force whose power falls as 1/f, from a tenth of a hertz on."""
    n = len(readings.time_s)
    hz = np.fft.rfftfreq(n, (readings.time_s[-1] - readings.time_s[0]) / max(n - 1, 1))
    shape = np.where(hz > 0.0, 1.0 / np.sqrt(np.maximum(hz, 0.1)), 0.0)
    noise = np.fft.irfft(shape * np.fft.rfft(moment.trial.standard_normal(n)), n)
    return _added(readings, {"force_n": numbers["rms_n"] * noise / noise.std()})


def _draw_steps(rng: np.random.Generator) -> dict[str, float]:
    return {"step_n": between(rng, 0.5, 4.0)}


def _stepping(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Let every restart leave the zero of the force somewhere else."""
    return _added(readings, {"force_n": numbers["step_n"] * float(moment.trial.standard_normal())})


def _draw_hum(rng: np.random.Generator) -> dict[str, float]:
    return {
        "hz": float(rng.choice([50.0, 60.0]) * (1.0 + 4e-4 * rng.standard_normal())),
        "force_n": between(rng, 0.4, 5.0),
        "motor_current_a": between(rng, 0.04, 0.5),
        "second": float(rng.uniform(0.0, 0.4)),
        "third": float(rng.uniform(0.0, 0.5)),
    }


def _hum(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Add the mains and two harmonics to force and current, in any phase to the trial."""
    phase = 2.0 * np.pi * numbers["hz"] * readings.time_s + moment.trial.uniform(0.0, 2.0 * np.pi)
    wave = np.sin(phase) + numbers["second"] * np.sin(2.0 * phase + 0.7) + numbers["third"] * np.sin(3.0 * phase + 2.0)
    return _added(readings, {name: numbers[name] * wave for name in ("force_n", "motor_current_a")})


def _draw_bits(rng: np.random.Generator) -> dict[str, float]:
    return {"bits": float(rng.integers(9, 13))}


def _coarse(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Round to the steps of a converter of few bits."""
    del moment
    steps = {name: scale / 2.0 ** numbers["bits"] for name, scale in _FULL_SCALE.items()}
    values = {name: np.round(column / steps[name]) * steps[name] for name, column in readings.values.items()}
    return Readings(time_s=readings.time_s, values=values)


def _draw_missing(rng: np.random.Generator) -> dict[str, float]:
    return {
        "share": between(rng, 1e-3, 3e-2),
        "gaps_per_s": between(rng, 0.05, 0.5),
        "gap_s": between(rng, 0.005, 0.05),
    }


def _missing(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Lose single rows, and now and then all rows of a moment."""
    is_kept = moment.trial.random(len(readings.time_s)) >= numbers["share"]
    for start_s in _instants(readings.time_s, numbers["gaps_per_s"], moment.trial):
        is_kept &= ~((readings.time_s >= start_s) & (readings.time_s < start_s + numbers["gap_s"]))
    is_kept[0] = True
    return _kept(readings, is_kept)


def _draw_jitter(rng: np.random.Generator) -> dict[str, float]:
    return {"sample_periods": between(rng, 0.02, 0.15)}


def _jitter(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Write times that are not those of the samples; rows that would go back in time are lost."""
    time_s = readings.time_s
    error = np.clip(numbers["sample_periods"] * moment.trial.standard_normal(len(time_s)), -0.3, 0.3)
    written_s = np.maximum(time_s + error * float(np.median(np.diff(time_s))), 0.0)
    written_s[0] = 0.0
    is_later = np.concatenate([[True], np.diff(np.maximum.accumulate(written_s)) > 2e-6])
    return _kept(Readings(time_s=written_s, values=readings.values), is_later)


def _draw_spikes(rng: np.random.Generator) -> dict[str, float]:
    return {
        "per_s": between(rng, 0.2, 3.0),
        "size": between(rng, 0.05, 0.6),
        "channel": float(rng.integers(len(_SPIKED))),
    }


def _spikes(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Let single samples of one channel jump by a share of its range in the trial, either way."""
    channel = _SPIKED[int(numbers["channel"])]
    column = readings.values[channel]
    at = np.searchsorted(readings.time_s, _instants(readings.time_s, numbers["per_s"], moment.trial)) % len(column)
    jump = np.zeros(len(column))
    jump[at] = numbers["size"] * np.ptp(column) * moment.trial.choice([-1.0, 1.0], size=len(at))
    return _added(readings, {channel: jump})


def _draw_bursts(rng: np.random.Generator) -> dict[str, float]:
    return {"per_s": between(rng, 0.3, 4.0), "force_n": between(rng, 5.0, 40.0), "seconds": between(rng, 2e-3, 8e-3)}


def _bursts(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Let a relay or a drive near by burst into the cable of the load cell, a hundredth of it into the current's."""
    time_s = readings.time_s
    loud = np.zeros(len(time_s))
    for start_s in _instants(time_s, numbers["per_s"], moment.trial):
        loud += np.where(time_s >= start_s, np.exp(-np.maximum(time_s - start_s, 0.0) / numbers["seconds"]), 0.0)
    noise = numbers["force_n"] * loud * moment.trial.standard_normal(len(time_s))
    return _added(readings, {"force_n": noise, "motor_current_a": 0.01 * noise})


def _draw_gain_drift(rng: np.random.Generator) -> dict[str, float]:
    names = ("force_n", "motor_current_a")
    return {name: float(rng.choice([-1.0, 1.0])) * between(rng, 0.002, 0.01) for name in names}


def _gain_drift(readings: Readings, numbers: Numbers, moment: Moment) -> Readings:
    """Let amplifiers that warm up change their gain, by its number in the end."""
    grown = 1.0 - np.exp(-(moment.session_s + readings.time_s) / 1000.0)
    return _added(readings, {name: share * grown * readings.values[name] for name, share in numbers.items()})


def _draw_uneven(rng: np.random.Generator) -> dict[str, float]:
    return {"rel_std": between(rng, 0.015, 0.06), "mm": between(rng, 3.0, 25.0)}


def _uneven(settings: PlantSettings, numbers: Numbers) -> PlantSettings:
    """Let the wood be harder in one place than in another: over some millimetres, so that it changes in a trial."""
    return replace(settings, uneven_rel_std=numbers["rel_std"], uneven_mm=numbers["mm"])


def _draw_curve(rng: np.random.Generator) -> dict[str, float]:
    return {
        "surplus_share": between(rng, 0.002, 0.012), "gone_by": between(rng, 0.01, 0.05),
        "plateau_share": float(rng.uniform(-0.02, 0.05)),
    }  # fmt: skip


def _other_curve(settings: PlantSettings, numbers: Numbers) -> PlantSettings:
    """Let the battery have more voltage while it is full, and fall to a plateau, as cells do."""
    volts = settings.nominal_voltage_v
    curve = {
        "surplus_v": numbers["surplus_share"] * volts, "surplus_share": numbers["gone_by"],
        "plateau_v": numbers["plateau_share"] * volts,
    }  # fmt: skip
    return replace(settings, extras={**settings.extras, **curve})


def _instants(time_s: Floats, per_s: float, rng: np.random.Generator) -> Floats:
    """Draw a Poisson process over a trial."""
    seconds = float(time_s[-1] - time_s[0])
    return np.sort(time_s[0] + rng.uniform(0.0, seconds, rng.poisson(per_s * seconds)))


# In the order in which a signal meets them.
NUISANCES: Mapping[str, Nuisance] = MappingProxyType(
    {
        "wandering_zero": Nuisance(draw=_draw_walk, disturb=_walk),
        "flicker_zero": Nuisance(draw=_draw_flicker, disturb=_flicker),
        "stepping_zero": Nuisance(draw=_draw_steps, disturb=_stepping),
        "gain_drift": Nuisance(draw=_draw_gain_drift, disturb=_gain_drift),
        "hum": Nuisance(draw=_draw_hum, disturb=_hum),
        "bursts": Nuisance(draw=_draw_bursts, disturb=_bursts),
        "spikes": Nuisance(draw=_draw_spikes, disturb=_spikes),
        "coarse_steps": Nuisance(draw=_draw_bits, disturb=_coarse),
        "missing_samples": Nuisance(draw=_draw_missing, disturb=_missing),
        "jitter": Nuisance(draw=_draw_jitter, disturb=_jitter),
        "uneven_wood": Nuisance(draw=_draw_uneven, change=_uneven, is_of_sensor=False),
        "battery_curve": Nuisance(draw=_draw_curve, change=_other_curve, is_of_sensor=False),
    }
)
SENSOR_FAULTS = frozenset(name for name, nuisance in NUISANCES.items() if nuisance.is_of_sensor)
