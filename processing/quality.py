"""Health of a channel: rate, jitter, gaps, spikes, clipping, noise, and whether its values make sense."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.converter import clipped_levels
from sawbench.bench.plausible import BATTERY_VOLTAGE, LENGTH_UNITS, TRAVEL, is_outside, most_battery_current_a
from sawbench.bench.processed import ChannelQuality, CrankAngle
from sawbench.bench.recording import Alignment, Floats, Recording, Signal
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.processing.held_values import alignment_of_rows
from sawbench.processing.interpolated_rows import own_samples
from sawbench.processing.noise import robust_range, white_noise_std
from sawbench.processing.spikes import at_one_crank_angle, find_overloads, find_spikes
from sawbench.processing.stretches import Stretches, holes_of, longest_step

_CONSTANT: Final = "constant at"
_CLIPPED: Final = "clipped:"
# Problems that begin so make the values wrong; the others only leave fewer of them.
_WRONG_VALUES: Final = (_CONSTANT, _CLIPPED)


@dataclass(frozen=True, kw_only=True, slots=True)
class CleanChannel:
    """One channel without its spikes, and where it has holes.

    Attributes
    ----------
    channel, unit : str
    time_s, values : ndarray, shape (n,)
    holes : tuple of (start_s, end_s)
        Stretches without samples, s.
    noise_std : float
    quality : ChannelQuality
    alignment : Alignment, optional
        Of the times.
    """

    channel: str
    unit: str
    time_s: Floats
    values: Floats
    holes: Stretches
    noise_std: float
    quality: ChannelQuality
    alignment: Alignment | None = None


def clean_channel(signal: Signal, angle: CrankAngle | None = None) -> CleanChannel:
    """Judge one channel; drop its spikes, and the rows of a table between the samples of a slow instrument.

    Parameters
    ----------
    signal : Signal
    angle : CrankAngle, optional
        Spikes at one angle of it are impacts in the machine: they stay.

    Examples
    --------
    >>> from sawbench.bench.recording import Signal
    >>> t = np.arange(1000) * 1e-3
    >>> y = np.sin(20 * t)
    >>> y[500] = 40.0
    >>> clean_channel(Signal(channel="force_n", unit="N", time_s=t, values=y)).quality.n_spikes
    1
    """
    time, values = own_samples(signal.time_s, signal.values)
    noise = white_noise_std(values, time)
    is_overload = find_overloads(values, signal.channel)
    is_far_off = find_spikes(values, noise) | is_overload
    is_impact = at_one_crank_angle(time, is_far_off & ~is_overload, angle)
    is_spike = is_far_off & ~is_impact
    n_clipped = sum(clipped_levels(values[~is_far_off]).values())
    step = np.diff(time)
    typical = float(np.median(step)) if len(step) else 0.0
    longest = longest_step(step)
    # What is missing at the end shows in no step of the time; what a foreign table lost stands in no gap.
    n_missing = max(_count_missing(step, typical, longest), signal.n_missing)
    regular = step[step <= 1.5 * typical] if typical else step
    if is_far_off.any():
        noise = white_noise_std(values[~is_far_off], time[~is_far_off])
    n_spikes, n_impacts = int(is_spike.sum()), int(is_impact.sum())
    problems = _health_problems(values, n_spikes, n_impacts, n_clipped, n_missing, signal.unit)
    alignment, kept = signal.alignment, signal
    if len(values) < len(signal.values):
        kept = replace(signal, time_s=time, values=values, raw=None)
        problems += (_rows_between(len(signal.values) / len(values)),)
        alignment = alignment_of_rows(signal.time_s, time)
    return CleanChannel(
        channel=signal.channel,
        unit=signal.unit,
        time_s=time[~is_spike],
        values=values[~is_spike],
        holes=holes_of(time, signal.gaps, longest),
        noise_std=noise,
        alignment=alignment,
        quality=ChannelQuality(
            channel=signal.channel,
            unit=signal.unit,
            rate_hz=kept.rate_hz,
            n_samples=len(values),
            n_missing=n_missing,
            jitter_std_s=float(np.std(regular)) if len(regular) else 0.0,
            noise_std=noise,
            n_spikes=n_spikes,
            n_impacts=n_impacts,
            n_clipped=n_clipped,
            problems=problems,
            doubts=tuple(text for text in problems if text.startswith(_WRONG_VALUES)),
        ),
    )


def clean_channels(recording: Recording) -> dict[str, CleanChannel]:
    """Every channel that has samples, cleaned by itself."""
    return {name: clean_channel(signal) for name, signal in recording.signals.items() if len(signal.values)}


def with_impacts(
    channels: Mapping[str, CleanChannel], recording: Recording, angle: CrankAngle | None
) -> dict[str, CleanChannel]:
    """Give back the spikes at one crank angle; not in the channel that the angle comes from."""

    def is_asked(name: str) -> bool:
        return angle is not None and name != angle.source and channels[name].quality.n_spikes > 0

    return {
        name: clean_channel(recording.signals[name], angle) if is_asked(name) else channel
        for name, channel in channels.items()
    }


def without_spikes(recording: Recording, channels: Mapping[str, CleanChannel]) -> dict[str, Signal]:
    """Channels as they were recorded, but for what was left out of them."""
    found = {}
    for name, clean in channels.items():
        signal = recording.signals[name]
        if len(clean.values) < len(signal.values):
            signal = replace(
                signal, time_s=clean.time_s, values=clean.values, raw=None, alignment=clean.alignment
            )  # fmt: skip
        found[name] = signal
    return found


def _rows_between(rows: float) -> str:
    return f"there are {rows:.3g} rows for each sample of the instrument; the rows between the samples are left out"


def _count_missing(step: Floats, typical: float, longest: float) -> int:
    """Count the samples missing; only real gaps count where the times are irregular by nature."""
    if not len(step):
        return 0
    is_regular = np.percentile(np.abs(step / typical - 1), 80.0) < 0.3
    missing = step[step > (1.5 * typical if is_regular else longest)]
    return int(np.sum(np.maximum(np.round(missing / typical) - 1, 0)))


def _health_problems(
    values: Floats, n_spikes: int, n_impacts: int, n_clipped: int, n_missing: int, unit: str
) -> tuple[str, ...]:
    problems = []
    n = len(values)
    if n < 16:
        return (f"only {n} samples",)
    if values.max() == values.min():
        problems.append(f"{_CONSTANT} {values[0]:.6g} {unit}: the sensor is probably not connected")
    if n_clipped:
        problems.append(
            f"{_CLIPPED} {n_clipped} samples are at {values.min():.6g} or {values.max():.6g} {unit}; "
            "sensor or amplifier saturated"
        )
    if n_spikes:
        problems.append(f"{n_spikes} spikes were left out; check cable and connector")
    if n_impacts:
        problems.append(f"{n_impacts} spikes are at the same crank angle: impacts in the machine; they stay")
    if n_missing:
        problems.append(f"{n_missing} samples are missing ({100 * n_missing / (n + n_missing):.2g} %)")
    return tuple(problems)


def plausibility_problems(
    channels: Mapping[str, CleanChannel], config: BenchConfig, duty: float | None
) -> dict[str, tuple[str, ...]]:
    """Name channels that are probably swapped, reversed or in another unit.

    Parameters
    ----------
    channels : mapping of str to CleanChannel
    config : BenchConfig
    duty : float or None
        Commanded duty of the trial.

    Returns
    -------
    dict of str to tuple of str
        Problems by channel; only channels that have any. None on a linear axis: what is plausible is that of a saw.
    """
    if config.linear_axis is not None:
        return {}
    found: dict[str, list[str]] = {}
    for name, channel in channels.items():
        known = CHANNEL_BY_NAME.get(name)
        if known is None or not len(channel.values):
            continue
        low, high = robust_range(channel.values)
        if low < known.plausible[0] or high > known.plausible[1]:
            found.setdefault(name, []).append(
                f"ranges from {low:.4g} to {high:.4g} {known.unit}, plausible is {known.plausible[0]:g}.."
                f"{known.plausible[1]:g} {known.unit}: other unit (milli?) or swapped channel"
            )
    _check_displacement(channels, config, found)
    _check_force(channels, found)
    _check_supply(channels, config, duty, found)
    return {name: tuple(problems) for name, problems in found.items()}


def _check_displacement(channels: Mapping[str, CleanChannel], config: BenchConfig, found: dict[str, list[str]]) -> None:
    channel = channels.get("displacement_mm")
    if channel is None or config.plant is None or len(channel.values) < 16:
        return
    low, high = robust_range(channel.values)
    travel, expected = float(high - low), 2e3 * config.plant.crank_radius_m.nominal
    if travel <= 20 * channel.noise_std:
        return
    ratio = travel / expected
    for unit, factor in LENGTH_UNITS:
        if not is_outside(ratio * factor, TRAVEL):
            found.setdefault("displacement_mm", []).append(
                f"travels {travel:.4g} where {expected:.4g} mm are expected: probably in {unit}"
            )
            return
    if ratio > TRAVEL[1]:
        found.setdefault("displacement_mm", []).append(
            f"travels {travel:.4g} mm where the configured crank allows {expected:.4g} mm: wrong radius, "
            "sensor gain or a swapped channel"
        )


def _check_force(channels: Mapping[str, CleanChannel], found: dict[str, list[str]]) -> None:
    channel = channels.get("force_n")
    if channel is None or len(channel.values) < 16:
        return
    low, high = robust_range(channel.values)
    swing = float(high - low)
    if 1e-4 < swing < 1.0 and swing > 50 * channel.noise_std:
        found.setdefault("force_n", []).append(
            f"varies by only {swing:.3g} N, far above its noise: the values are probably in kN"
        )
    middle = float(np.median(channel.values))
    if middle - low > 3 * (high - middle) and swing > 20 * channel.noise_std:
        found.setdefault("force_n", []).append(
            f"its peaks point downwards (to {low:.4g} N): the sign is probably reversed"
        )


def _check_supply(
    channels: Mapping[str, CleanChannel], config: BenchConfig, duty: float | None, found: dict[str, list[str]]
) -> None:
    voltage = channels.get("battery_voltage_v")
    if voltage is not None and config.battery is not None and len(voltage.values):
        level, nominal = float(np.median(voltage.values)), config.battery.nominal_voltage_v
        if is_outside(level / nominal, BATTERY_VOLTAGE):
            found.setdefault("battery_voltage_v", []).append(
                f"is at {level:.4g} V, the nominal battery voltage is {nominal:g} V: other unit or swapped channel"
            )
    motor, battery = channels.get("motor_current_a"), channels.get("battery_current_a")
    if motor is None or battery is None or not len(motor.values) or not len(battery.values):
        return
    of_motor, of_battery = float(np.mean(motor.values)), float(np.mean(battery.values))
    noise = 5 * (motor.noise_std + battery.noise_std) / np.sqrt(min(len(motor.values), len(battery.values)))
    if duty is not None and of_battery > max(of_motor + noise, most_battery_current_a(duty, of_motor)):
        found.setdefault("battery_current_a", []).append(
            f"its mean of {of_battery:.4g} A exceeds the motor's {of_motor:.4g} A at a duty of {duty:g}: "
            "motor and battery current are probably swapped"
        )
    for name, level in (("motor_current_a", of_motor), ("battery_current_a", of_battery)):
        if level < -noise - 0.05:
            found.setdefault(name, []).append(f"its mean is {level:.4g} A: the sign is probably reversed")
