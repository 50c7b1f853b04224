"""From what happens in the plant to what the bench's instruments write down.

Order: what the force passes through (machine noise, carriage, preload, load cell), the amplifiers' lag, the
clocks, gain, zero, noise, quantisation. Equations are said where each is applied; every default is an honest,
slightly imperfect sensor without an effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from sawbench.blindcheck.plant import GRID_S, Floats, column
from sawbench.blindcheck.readings import Readings
from scipy import signal

Device = Literal["force", "displacement", "electrical"]
CHANNELS_OF: MappingProxyType[str, tuple[str, ...]] = MappingProxyType(
    {
        "force": ("force_n",),
        "displacement": ("displacement_mm",),
        "electrical": ("motor_current_a", "battery_voltage_v", "battery_current_a"),
    }
)
SOURCE = MappingProxyType(
    {
        "force_n": ("force_n", 1.0),
        "displacement_mm": ("plunger_m", 1e3),
        "motor_current_a": ("current_a", 1.0),
        "battery_voltage_v": ("battery_v", 1.0),
        "battery_current_a": ("battery_a", 1.0),
    }
)


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorSettings:
    """The instruments of one campaign; one value per channel in the order of `SOURCE` where a tuple.

    Attributes
    ----------
    gain : tuple of float
        Reading per true value.
    zero : tuple of float
        Reading at a true value of 0, in the channel's unit.
    noise : tuple of float
        Standard deviation of white noise, in the channel's unit.
    step : tuple of float
        Quantisation step, in the channel's unit.
    gear_ratio : float
        Turns of the motor a turn of the crank, for what the motor does to a signal.
    time_jitter : float
        Standard deviation of the sample times, in sample periods; the times written down are right.
    force_lag_s, current_lag_s : float
        Low-frequency delay of a 2nd-order Butterworth amplifier.
    lag_order : int
        2; 1 for a first-order lag.
    carriage_share : tuple of float
        Shares of the force that pass through the two modes of the carriage.
    carriage_hz, carriage_damping : tuple of float
    preload_n : float
        Force above which the carriage lifts off (0: never).
    late_device : str
        Device whose clock is late.
    late_s, late_drift : float
        Delay at the start of a trial and its growth, s and s/s.
    drift_n, drift_s, walk_n : float
        Zero of the force: settling amplitude, its time, and a random walk's standard deviation per 1000 s.
    pin_n, pin_hz : float
        Outside the catalogue: ringing of a loose pin after every dead centre.
    slip_n, slip_s : float
        Outside: sawtooth of a sticking carriage, and its period.
    unbalance_n : float
        Outside: rotor's unbalance in the load cell at a motor speed of 1000 rad/s.
    burst_size, burst_rate_hz : float
        Outside: interference bursts on every channel, in noise standard deviations.
    bow_per_mm : float
        Outside: quadratic error of the displacement sensor.
    crosstalk_n_per_a : float
        Outside: motor current seen by the load cell's cable.
    commutation : float
        Outside: relative ripple of the motor current at the commutator's passing.
    """

    gain: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0)
    zero: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    noise: tuple[float, ...] = (1.0, 0.01, 0.03, 0.005, 0.03)
    step: tuple[float, ...] = (0.06, 0.0005, 0.0122, 0.0024, 0.0122)
    gear_ratio: float = 56.0 / 6.0
    time_jitter: float = 0.03
    force_lag_s: float = 0.0
    current_lag_s: float = 0.0
    lag_order: int = 2
    carriage_share: tuple[float, float] = (0.0, 0.0)
    carriage_hz: tuple[float, float] = (140.0, 330.0)
    carriage_damping: tuple[float, float] = (0.035, 0.05)
    preload_n: float = 0.0
    late_device: Device = "force"
    late_s: float = 0.0
    late_drift: float = 0.0
    drift_n: float = 0.0
    drift_s: float = 900.0
    walk_n: float = 0.0
    pin_n: float = 0.0
    pin_hz: float = 620.0
    slip_n: float = 0.0
    slip_s: float = 0.43
    unbalance_n: float = 0.0
    burst_size: float = 0.0
    burst_rate_hz: float = 3.0
    bow_per_mm: float = 0.0
    crosstalk_n_per_a: float = 0.0
    commutation: float = 0.0


def measure(
    rows: Floats,
    sensors: SensorSettings,
    *,
    rate_hz: float,
    session_s: float,
    rest_s: float,
    seed: list[int],
    disturb: Callable[[Readings], Readings] = lambda readings: readings,
) -> Readings:
    """Sample a trial.

    Parameters
    ----------
    rows : ndarray, shape (n, 7)
        Output of `Plant.advance` on the default grid, from the instant of switching on.
    sensors : SensorSettings
    rate_hz : float
        Mean sample rate.
    session_s : float, s
        Time since the start of the session, for drifts.
    rest_s : float, s
        Time recorded before switching on.
    seed : list of int
        Of the noise of this trial.
    disturb : callable
        Faults of the sensors, of the readings before they are rounded to the instruments' steps.

    Returns
    -------
    Readings
        Times start near 0, which is `rest_s` before switching on.
    """
    rng = np.random.default_rng([*seed, 11])
    n_rest = round(rest_s / GRID_S)
    rows = np.concatenate([np.repeat(rows[:1], n_rest, axis=0), rows])
    grid_s = np.arange(len(rows), dtype=np.float64) * GRID_S
    n = int((grid_s[-1] - 0.01) * rate_hz)
    period_s = 1.0 / rate_hz
    jitter = np.clip(sensors.time_jitter * rng.standard_normal(n), -0.45, 0.45)
    time_s = np.maximum(period_s * (np.arange(n) + jitter), 0.0)
    time_s[0] = 0.0
    values: dict[str, Floats] = {}
    for index, (channel, (output, factor)) in enumerate(SOURCE.items()):
        true = factor * column(rows, output)
        if channel == "force_n":
            true = _force_path(true, rows, sensors, grid_s, np.random.default_rng([*seed, 12]))
            true = true + zero_drift(grid_s, session_s, sensors, seed)
        elif channel == "motor_current_a":
            true = _current_path(true, rows, sensors)
        elif channel == "displacement_mm" and sensors.bow_per_mm != 0.0:
            true = true + sensors.bow_per_mm * (true - 10.0) ** 2
        asked_s = time_s - _delay(channel, time_s, sensors)
        reading = sensors.gain[index] * np.interp(asked_s, grid_s, true) + sensors.zero[index]
        reading += sensors.noise[index] * (rng.standard_normal(n) + _bursts(time_s, sensors, rng))
        values[channel] = reading
    found = disturb(Readings(time_s=time_s, values=values))
    steps = dict(zip(SOURCE, sensors.step, strict=True))
    rounded = {name: np.round(reading / steps[name]) * steps[name] for name, reading in found.values.items()}
    return Readings(time_s=found.time_s, values=rounded)


def _lag(values: Floats, delay_s: float, order: int) -> Floats:
    """Delay by 1 / (1 + sqrt(2) s/w + (s/w)^2) with w = sqrt(2) / delay, or by a first-order lag."""
    if delay_s <= 0.0:
        return values
    w = (np.sqrt(2.0) if order == 2 else 1.0) / delay_s
    poles = [1.0, np.sqrt(2.0) * w, w * w] if order == 2 else [1.0, w]
    return _filtered(values, [poles[-1]], poles)


def _mode(values: Floats, hz: float, damping: float) -> Floats:
    """Return the response of w^2 / (s^2 + 2 d w s + w^2)."""
    w = 2.0 * np.pi * hz
    return _filtered(values, [w * w], [1.0, 2.0 * damping * w, w * w])


def _filtered(values: Floats, over: list[float], under: list[float]) -> Floats:
    """Apply a transfer function (bilinear), starting from the steady state of the first value."""
    b, a = signal.bilinear(over, under, fs=1.0 / GRID_S)
    filtered, _ = signal.lfilter(b, a, values, zi=signal.lfilter_zi(b, a) * values[0])
    return filtered


def _force_path(force: Floats, rows: Floats, s: SensorSettings, grid_s: Floats, rng: np.random.Generator) -> Floats:
    """Everything between the teeth and the load cell's amplifier, which is the last of it."""
    if s.pin_n != 0.0:
        force = force + s.pin_n * _pin_ringing(rows, s.pin_hz, grid_s, rng)
    if s.unbalance_n != 0.0:
        speed, crank = column(rows, "speed_rad_s"), column(rows, "crank_rad")
        force = force + s.unbalance_n * (speed / 1000.0) ** 2 * np.sin(crank * s.gear_ratio)
    if s.slip_n != 0.0:
        phase = grid_s / s.slip_s + 0.08 * np.sin(2.0 * np.pi * 0.31 * grid_s)
        force = force + s.slip_n * (2.0 * np.mod(phase, 1.0) ** 1.5 - 0.8) * (column(rows, "speed_rad_s") > 10.0)
    share = sum(s.carriage_share)
    if share > 0.0:
        modes = zip(s.carriage_share, s.carriage_hz, s.carriage_damping, strict=True)
        force = (1.0 - share) * force + sum(part * _mode(force, hz, damping) for part, hz, damping in modes)
    if s.preload_n > 0.0:
        over = np.logaddexp(0.0, (force - s.preload_n) / 4.0) * 4.0
        force = force - 0.93 * over
    if s.crosstalk_n_per_a != 0.0:
        force = force + s.crosstalk_n_per_a * column(rows, "current_a")
    return _lag(force, s.force_lag_s, s.lag_order)


def _pin_ringing(rows: Floats, hz: float, grid_s: Floats, rng: np.random.Generator) -> Floats:
    """Return unit impacts after each dead centre that ring down in a few milliseconds, of uneven size."""
    half_turns = np.floor(column(rows, "crank_rad") / np.pi)
    hits = np.flatnonzero(np.diff(half_turns) > 0)
    impulses = np.zeros(len(grid_s))
    speed = np.abs(column(rows, "speed_rad_s")[hits]) / 700.0
    impulses[hits] = speed * (1.0 + 0.25 * rng.standard_normal(len(hits)))
    decay_s = np.arange(0.0, 0.02, GRID_S)
    ring = np.exp(-decay_s / 0.003) * np.sin(2.0 * np.pi * hz * decay_s)
    return signal.fftconvolve(impulses, ring)[: len(grid_s)]


def _current_path(current: Floats, rows: Floats, s: SensorSettings) -> Floats:
    if s.commutation != 0.0:
        passing = np.abs(np.sin(2.5 * column(rows, "crank_rad") * s.gear_ratio)) - 2.0 / np.pi
        current = current * (1.0 + s.commutation * passing)
    return _lag(current, s.current_lag_s, s.lag_order)


def zero_drift(grid_s: Floats, session_s: float, s: SensorSettings, seed: list[int]) -> Floats:
    """Return drift (1 - exp(-t / T)) + a random walk, N, over session time; the walk is the campaign's."""
    if s.drift_n == 0.0 and s.walk_n == 0.0:
        return np.zeros(len(grid_s))
    time_s = session_s + grid_s
    walk = np.random.default_rng([seed[0], 13]).standard_normal(4000).cumsum() / np.sqrt(100.0)
    walked = s.walk_n * np.interp(time_s, 10.0 * np.arange(4000), walk)
    return s.drift_n * (1.0 - np.exp(-time_s / s.drift_s)) + walked


def _delay(channel: str, time_s: Floats, s: SensorSettings) -> Floats | float:
    if channel not in CHANNELS_OF[s.late_device] or (s.late_s == 0.0 and s.late_drift == 0.0):
        return 0.0
    return s.late_s + s.late_drift * time_s


def _bursts(time_s: Floats, s: SensorSettings, rng: np.random.Generator) -> Floats | float:
    """Interference: bursts of 4 ms of strong noise at random instants, on every channel."""
    if s.burst_size == 0.0:
        return 0.0
    n_bursts = rng.poisson(s.burst_rate_hz * (time_s[-1] - time_s[0]))
    starts = np.sort(rng.uniform(time_s[0], time_s[-1], n_bursts))
    before = np.searchsorted(starts, time_s, side="right")
    age_s = np.where(before > 0, time_s - starts[np.maximum(before - 1, 0)], np.inf) if n_bursts else np.inf
    return s.burst_size * rng.standard_normal(len(time_s)) * (age_s < 0.004)
