"""Sensors, clocks, noise, quantisation and calibration: what turns the plant's signals into recorded channels."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import signal

from benchmarks.independent_bench.plant import BATTERY_A, BATTERY_V, FORCE, MOTOR_A, POSITION, STEP_S, Floats

UNITS: Final[Mapping[str, str]] = {
    "force_n": "N", "displacement_mm": "mm", "motor_current_a": "A", "battery_voltage_v": "V", "battery_current_a": "A"
}  # fmt: skip
# Relative standard uncertainty of the scale, as the certificates state it.
CERTIFIED_STD: Final[Mapping[str, float]] = {
    "force_n": 0.005, "displacement_mm": 0.002, "motor_current_a": 0.005, "battery_voltage_v": 0.001,
    "battery_current_a": 0.005,
}  # fmt: skip
# Latency that the recording states as the largest possible, s; the true ones are smaller.
STATED_LATENCY_S: Final = 3e-4
LARGEST_LATENCY_S: Final = 2e-4
# What an effect can ask of the instruments, so that the campaign is one that shows it.
FAST_FORCE: Final = "force at 4.8 kHz or more"
FAST_CAN: Final = "CAN at 2 kHz"
_CAN: Final = "can"
_CAN_CHANNELS: Final = ("motor_current_a", "battery_voltage_v", "battery_current_a")
# The first sample of every device, and how long before the end of a trial the last one is taken, s.
_FIRST_S, _SPARED_S = 0.002, 0.004
# A wandering zero is drawn at so many places over at most so many seconds.
_N_WANDER, _WANDER_S = 400, 12.1
# Slope of a reading beyond the preload of its sensor.
_SLOPE_BEYOND_PRELOAD: Final = 0.06
# A drift starts faster than its mean rate over a session.
_DRIFT_AT_START: Final = 1.35


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorErrors:
    """Errors of sensors and clocks that a campaign may hide; zero is none.

    Attributes
    ----------
    ringing_period_s, ringing_damping : float
        Natural period and damping ratio of the carriage that holds the force sensor.
    preload_share : float
        Preload of the force sensor over the largest force of the campaign; the reading bends there.
    force_delay_s, force_damping, current_delay_s, current_damping : float
        Lag of second order: delay of slow signals, damping ratio.
    late_device : str
    late_s : float
        Delay of that device's clock.
    drift_n_per_1000_s, drift_time_s : float
        Warm-up of the force's zero over the session, and its time.
    """

    ringing_period_s: float = 0.0
    ringing_damping: float = 0.0
    preload_share: float = 0.0
    force_delay_s: float = 0.0
    force_damping: float = 1.0
    current_delay_s: float = 0.0
    current_damping: float = 1.0
    late_device: str = ""
    late_s: float = 0.0
    drift_n_per_1000_s: float = 0.0
    drift_time_s: float = 1000.0

    @property
    def change_strokes(self) -> bool:
        """Whether a mean stroke looks different; a late clock and a drifting zero leave its form."""
        return max(self.ringing_period_s, self.preload_share, self.force_delay_s, self.current_delay_s) > 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Device:
    """One instrument with a clock of its own.

    Attributes
    ----------
    channels : tuple of str
    rate_hz : float
    quartz_error : float
        Relative.
    latency_s : float
    alignment_std_s : float
        Of the time of each recording, as the recording states it too.
    jitter_s : float
        Half width of the time by which each sample is taken early or late.
    """

    channels: tuple[str, ...]
    rate_hz: float
    quartz_error: float
    latency_s: float
    alignment_std_s: float
    jitter_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensor:
    """One channel: gain, zero and noise in its unit.

    Attributes
    ----------
    gain, offset : float
    white_rms, pink_rms : float
    step : float
        Of the quantisation.
    bow : float
        Nonlinearity in the middle of the range, over the range.
    """

    gain: float
    white_rms: float
    step: float
    offset: float = 0.0
    pink_rms: float = 0.0
    bow: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Instruments:
    """All instruments of a campaign.

    Attributes
    ----------
    devices : mapping of str to Device
    sensors : mapping of str to Sensor
        By channel.
    zero_wander_n : float
        Of the force: scale of its random walk within a trial; half of it is its step from trial to trial.
    hum_n, hum_hz : float
        Of the mains in the force.
    """

    devices: Mapping[str, Device]
    sensors: Mapping[str, Sensor]
    zero_wander_n: float
    hum_n: float
    hum_hz: float


def draw_instruments(rng: np.random.Generator, asked: Collection[str] = ()) -> Instruments:
    """Draw instruments: two devices or three, rates, noise, gains and zeros.

    Parameters
    ----------
    rng : Generator
    asked : collection of str
        `FAST_FORCE`, `FAST_CAN`: what the hidden effects need to be seen.
    """
    return Instruments(
        devices=_draw_devices(rng, asked),
        sensors=_draw_sensors(rng),
        zero_wander_n=rng.uniform(0.2, 1.0),
        hum_n=rng.uniform(0.3, 2.0) if rng.random() < 0.35 else 0.0,
        hum_hz=float(rng.choice([50.0, 60.0])),
    )


def _draw_devices(rng: np.random.Generator, asked: Collection[str]) -> dict[str, Device]:
    shares_amplifier = rng.random() < 0.4
    amplifier_hz = float(rng.choice([2400.0, 4000.0, 4800.0, 6000.0, 6000.0, 9600.0, 10000.0]))
    stroke_hz = float(rng.choice([2000.0, 4000.0, 5000.0, 6000.0]))
    can_hz = float(rng.choice([100.0, 200.0, 500.0, 1000.0, 1000.0, 2000.0]))
    if FAST_FORCE in asked:
        amplifier_hz = max(amplifier_hz, 4800.0)
    if FAST_CAN in asked:
        can_hz = 2000.0
    rows: list[tuple[str, tuple[str, ...], float]]
    if shares_amplifier:
        rows = [("amplifier", ("force_n", "displacement_mm"), amplifier_hz)]
    else:
        rows = [("load_cell", ("force_n",), amplifier_hz), ("stroke_sensor", ("displacement_mm",), stroke_hz)]
    rows.append((_CAN, _CAN_CHANNELS, can_hz))
    return {
        name: Device(
            channels=channels, rate_hz=rate_hz, quartz_error=15e-6 * rng.standard_normal(),
            latency_s=rng.uniform(0.0, LARGEST_LATENCY_S), alignment_std_s=rng.uniform(3e-5, 9e-5),
            jitter_s=1e-5 if name == _CAN else 0.0,
        )
        for name, channels, rate_hz in rows
    }  # fmt: skip


def _draw_sensors(rng: np.random.Generator) -> dict[str, Sensor]:
    current_pink_rms, current_step = rng.uniform(0.002, 0.008), float(rng.choice([0.01, 0.02]))

    def gain(channel: str) -> float:
        return 1.0 + CERTIFIED_STD[channel] * rng.standard_normal()

    def current(channel: str, white_rms: float) -> Sensor:
        return Sensor(
            gain=gain(channel), offset=0.015 * rng.standard_normal(), white_rms=white_rms, pink_rms=current_pink_rms,
            step=current_step,
        )  # fmt: skip

    return {
        "force_n": Sensor(
            gain=gain("force_n"), white_rms=rng.uniform(0.3, 1.0), pink_rms=rng.uniform(0.05, 0.25),
            step=float(rng.choice([0.01, 0.02, 0.05])),
        ),
        "displacement_mm": Sensor(
            gain=gain("displacement_mm"), offset=0.01 * rng.standard_normal(), white_rms=rng.uniform(0.003, 0.012),
            step=float(rng.choice([0.0005, 0.001, 0.0025])), bow=rng.uniform(-6e-4, 6e-4),
        ),
        "motor_current_a": current("motor_current_a", rng.uniform(0.02, 0.06)),
        "battery_voltage_v": Sensor(
            gain=gain("battery_voltage_v"), white_rms=rng.uniform(0.002, 0.008),
            step=float(rng.choice([0.001, 0.005, 0.01])),
        ),
        "battery_current_a": current("battery_current_a", rng.uniform(0.015, 0.04)),
    }  # fmt: skip


def sensed_force(signals: Floats, errors: SensorErrors, peak_n: float) -> Floats:
    """Return the force as its sensor shows it, before noise.

    Parameters
    ----------
    signals : ndarray, shape (N_SIGNALS, n)
    errors : SensorErrors
    peak_n : float
        Largest force of the campaign.

    Returns
    -------
    ndarray, shape (n,), N
    """
    force_n = signals[FORCE]
    if errors.ringing_period_s > 0.0:
        force_n = _second_order(force_n, 2.0 * math.pi / errors.ringing_period_s, errors.ringing_damping)
    if errors.preload_share > 0.0:
        preload_n = errors.preload_share * peak_n
        force_n = np.where(force_n > preload_n, preload_n + _SLOPE_BEYOND_PRELOAD * (force_n - preload_n), force_n)
    if errors.force_delay_s > 0.0:
        force_n = _second_order(force_n, 2.0 * errors.force_damping / errors.force_delay_s, errors.force_damping)
    return force_n


def sensed_current(signals: Floats, errors: SensorErrors) -> Floats:
    """Return the motor current as its sensor shows it, before noise; ndarray, shape (n,), A."""
    if errors.current_delay_s <= 0.0:
        return signals[MOTOR_A]
    rate = 2.0 * errors.current_damping / errors.current_delay_s
    return _second_order(signals[MOTOR_A], rate, errors.current_damping)


def drift_n(errors: SensorErrors, session_s: Floats | float) -> Floats:
    """Zero of the force after so many seconds of the session, N."""
    scale_n = _DRIFT_AT_START * errors.drift_n_per_1000_s * errors.drift_time_s / 1000.0
    return scale_n * (1.0 - np.exp(-np.asarray(session_s) / errors.drift_time_s))


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """One channel as it is recorded: times on the recording's clock (s) and values, shape (n,)."""

    channel: str
    device: str
    time_s: Floats
    values: Floats


def read(
    rng: np.random.Generator, instruments: Instruments, errors: SensorErrors, signals: Floats, *,
    peak_n: float, duration_s: float, session_s: float, restart_zero_n: float, stroke_mm: float,
) -> list[Reading]:  # fmt: skip
    """Record a trial.

    Parameters
    ----------
    rng : Generator
    instruments : Instruments
    errors : SensorErrors
    signals : ndarray, shape (N_SIGNALS, n)
        Of the plant, every `STEP_S`.
    peak_n : float
        Largest force of the campaign.
    duration_s, session_s : float
        Of the recording, and from the start of the session to its own.
    restart_zero_n : float
        Zero of the force at the start of this trial.
    stroke_mm : float
        Range of the displacement.
    """
    plant_s = np.arange(signals.shape[1]) * STEP_S
    true = {
        "force_n": sensed_force(signals, errors, peak_n), "displacement_mm": 1e3 * signals[POSITION],
        "motor_current_a": sensed_current(signals, errors), "battery_voltage_v": signals[BATTERY_V],
        "battery_current_a": signals[BATTERY_A],
    }  # fmt: skip
    readings = []
    for name, device in instruments.devices.items():
        late_s = errors.late_s if name == errors.late_device else 0.0
        taken_s, label_s = _sample_times(rng, device, duration_s, late_s)
        for channel in device.channels:
            values = np.interp(taken_s, plant_s, true[channel])
            sensor = instruments.sensors[channel]
            added = sensor.bow * stroke_mm * 4.0 * (values / stroke_mm) * (1.0 - values / stroke_mm)
            if channel == "force_n":
                added = restart_zero_n + _zero_within(rng, instruments, taken_s)
                added = added + drift_n(errors, session_s + taken_s) + _hum(instruments, session_s + taken_s)
            values = sensor.gain * values + sensor.offset + added + _noise(rng, sensor, device.rate_hz, len(values))
            values = np.round(values / sensor.step) * sensor.step
            readings.append(Reading(channel=channel, device=name, time_s=label_s, values=values))
    return readings


def _sample_times(rng: np.random.Generator, device: Device, duration_s: float, late_s: float) -> tuple[Floats, Floats]:
    """When the samples are taken, and when the recording says so: the rate is corrected to some 3 ppm."""
    since_s = np.arange(int((duration_s - _SPARED_S) * device.rate_hz)) / device.rate_hz
    taken_s = _FIRST_S + since_s * (1.0 + device.quartz_error)
    label_s = _FIRST_S + since_s * (1.0 + device.quartz_error + 3e-6 * rng.standard_normal())
    label_s += device.latency_s + late_s + device.alignment_std_s * rng.standard_normal()
    return taken_s + device.jitter_s * rng.uniform(-1.0, 1.0, len(since_s)), label_s


def _zero_within(rng: np.random.Generator, instruments: Instruments, taken_s: Floats) -> Floats:
    walk = np.cumsum(rng.standard_normal(_N_WANDER)) * 0.02 * instruments.zero_wander_n
    return np.interp(taken_s, np.linspace(0.0, _WANDER_S, _N_WANDER), walk)


def _hum(instruments: Instruments, session_s: Floats) -> Floats:
    return instruments.hum_n * np.sin(2.0 * math.pi * instruments.hum_hz * session_s + 0.3)


def _noise(rng: np.random.Generator, sensor: Sensor, rate_hz: float, n: int) -> Floats:
    noise = sensor.white_rms * rng.standard_normal(n)
    return noise + _pink(rng, n, rate_hz, sensor.pink_rms) if sensor.pink_rms > 0.0 else noise


def _pink(rng: np.random.Generator, n: int, rate_hz: float, rms: float) -> Floats:
    """1/f noise: processes of first order, an octave and a half apart, from 0.2 Hz on."""
    corners_hz = 0.2 * 3.0 ** np.arange(6)
    found = np.zeros(n)
    for corner_hz in corners_hz:
        keep = math.exp(-2.0 * math.pi * corner_hz / rate_hz)
        found += signal.lfilter([math.sqrt(1.0 - keep * keep)], [1.0, -keep], rng.standard_normal(n + 200))[200:]
    return found * rms / math.sqrt(len(corners_hz))


def _second_order(wave: Floats, rate_rad_s: float, damping: float) -> Floats:
    """Low pass of second order, settled at the start."""
    square = rate_rad_s * rate_rad_s
    b, a = signal.bilinear([square], [1.0, 2.0 * damping * rate_rad_s, square], 1.0 / STEP_S)
    return signal.lfilter(b, a, wave, zi=signal.lfilter_zi(b, a) * wave[0])[0]
