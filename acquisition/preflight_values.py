"""What the values of one channel at rest give away: range, clipping, a frozen sensor, noise, zero. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import StreamChannel
from sawbench.bench.spread import robust_std
from sawbench.bench.units import FORCE

Floats = NDArray[np.float64]
Severity = Literal["fault", "note"]
_UNLIMITED: Final = 1e8
_HUM_HZ: Final = (50.0, 60.0, 100.0, 120.0)
_STROKE_HZ: Final = (2.0, 45.0)
_STROKE_HARMONICS: Final = 6
_STROKE_SHARE: Final = 0.7


@dataclass(frozen=True, kw_only=True, slots=True)
class PreflightLimits:
    """From where on something is said.

    Attributes
    ----------
    rate_error : float
        Relative, plus 0.03 over the time looked at in seconds; the recorder refuses beyond that too.
    outside_share, clipped_share : float
        Share of samples beyond what the input can mean; share that sit exactly on the largest or smallest value.
    near_limit : float
        Share of the way from the middle of the range to its end.
    noise_factor : float
        Times the stated noise.
    noise_of_half_range : float
        Where no noise is stated: share of half the range.
    zero_of_half_range : float
        Reading of the unloaded load cell beyond which a tare is suggested, share of half the range.
    min_samples : int
        Fewer say nothing about noise or a frozen value.
    silence_s : float
        At the end of the reading; a stream that pauses this long has stopped.
    drift_ppm : float
        Quartz error that is worth a word, 1e-6.
    """

    rate_error: float = 0.03
    outside_share: float = 0.0
    clipped_share: float = 0.01
    near_limit: float = 0.95
    noise_factor: float = 5.0
    noise_of_half_range: float = 0.005
    zero_of_half_range: float = 0.002
    min_samples: int = 20
    silence_s: float = 0.4
    drift_ppm: float = 500.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """One thing that was seen.

    Attributes
    ----------
    severity : {"fault", "note"}
        A fault is not reliable; a note is worth knowing.
    code : str
        For scripts.
    device, channel : str
        Empty where they do not apply.
    what, remedy : str
        What was seen, with values, and what to do.
    """

    severity: Severity
    code: str
    device: str = ""
    channel: str = ""
    what: str
    remedy: str


def std_about_line(time_s: Floats, values: Floats) -> float:
    """Robust standard deviation about a straight line.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
    values : ndarray, shape (n,)

    Returns
    -------
    float
        1.4826 times the median absolute deviation; the plain standard deviation where more than half of the
        samples are equal, as with coarse steps. 0 for fewer than three samples.
    """
    if len(values) < 3:
        return 0.0
    residual = _without_line(time_s, values)
    spread = robust_std(residual - np.median(residual))
    most_equal = np.unique(values, return_counts=True)[1].max() > len(values) / 2
    return float(residual.std()) if most_equal else spread


def channel_findings(
    channel: StreamChannel,
    time_s: Floats,
    values: Floats,
    *,
    is_running: bool = False,
    limits: PreflightLimits | None = None,
) -> list[Finding]:
    """Judge the values of one channel: range, clipping, frozen, noise, zero.

    Parameters
    ----------
    channel : StreamChannel
    time_s : ndarray, shape (n,), s
    values : ndarray, shape (n,), in the channel's unit
    is_running : bool
    limits : PreflightLimits, optional

    Returns
    -------
    list of Finding
        Without the device's name.
    """
    limits = limits or PreflightLimits()
    if saturated := saturation(channel, values, limits):
        return [saturated]
    if len(values) < limits.min_samples:
        return []
    if np.ptp(values) == 0.0:
        return [_frozen(channel, values, is_running)]
    found: list[Finding] = []
    if not is_running:
        found += _noise(channel, time_s, values, limits)
        found += _zero(channel, values, limits)
    return found


def saturation(channel: StreamChannel, values: Floats, limits: PreflightLimits) -> Finding | None:
    """Say whether a channel is saturated: beyond its range, cut off at one level, or near the end of its range.

    Parameters
    ----------
    channel : StreamChannel
    values : ndarray, shape (n,), in the channel's unit
    limits : PreflightLimits
    """
    low, high = channel.valid_range
    unit = channel.unit
    outside = float(np.mean(~((values >= low) & (values <= high))))
    remedy = "check the wiring (a broken bridge wire saturates the input), the load, and `raw_range`"
    if outside > limits.outside_share:
        what = f"{outside:.1%} of the values are outside {low:g}..{high:g} {unit}, the range of the input"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    if (clipped := _clipped_at(values, limits)) is not None:
        what = f"the signal is clipped at {clipped:.4g} {unit}: amplifier saturated"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    value = float(np.median(values))
    reached = abs(value - middle) / half
    if half < _UNLIMITED and reached > limits.near_limit:
        what = f"the value is {value:.4g} {unit}, {reached:.0%} of full scale"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    return None


def _clipped_at(values: Floats, limits: PreflightLimits) -> float | None:
    """Value at which a varying signal is cut off: far more samples sit on it than on its neighbour."""
    least = max(20, limits.clipped_share * len(values))
    # Sorting costs ten times the rest of a check: only where an end holds samples enough.
    if max(np.count_nonzero(values == end) for end in (np.fmax.reduce(values), np.fmin.reduce(values))) < least:
        return None
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < 16:
        return None
    for end, neighbour in ((-1, -2), (0, 1)):
        if counts[end] >= least and counts[end] > 10 * counts[neighbour]:
            return float(levels[end])
    return None


def _frozen(channel: StreamChannel, values: Floats, is_running: bool) -> Finding:
    what = f"all {len(values)} values are exactly {values[0]:.6g} {channel.unit}"
    if channel.resolution > 0 and not is_running:
        what += f"; possible for a sensor at rest within its resolution of {channel.resolution:g} {channel.unit}"
        remedy = "run the tool and check again with --running, to distinguish a frozen sensor from one at rest"
        return Finding(severity="note", code="not_moving", what=what, remedy=remedy)
    remedy = "the sensor or its node is frozen: switch it off and on, check the sensor connector"
    return Finding(severity="fault", code="frozen", what=what, remedy=remedy)


def _noise(channel: StreamChannel, time_s: Floats, values: Floats, limits: PreflightLimits) -> list[Finding]:
    noise = std_about_line(time_s, values)
    half = 0.5 * (channel.valid_range[1] - channel.valid_range[0])
    if channel.noise_std is not None:
        allowed = limits.noise_factor * channel.noise_std
        basis = f"expected {channel.noise_std:.3g} {channel.unit} (`noise_std`)"
    elif half < _UNLIMITED:
        allowed = limits.noise_of_half_range * half
        basis = f"more than {limits.noise_of_half_range:.1%} of half the range; state `noise_std` for a better check"
    else:
        return []
    if noise <= allowed:
        return []
    hum = _hum(time_s, values)
    if hum is None and (stroke_hz := stroke_rate_hz(time_s, values)) is not None:
        what = f"{channel.name} oscillates by {float(np.ptp(values)):.3g} {channel.unit} at {stroke_hz:.1f} Hz"
        remedy = "switch the tool off and repeat; for a running tool use `sawbench check --running`"
        return [Finding(severity="fault", code="tool_running", what=f"the tool is running: {what}", remedy=remedy)]
    source = f", mainly {hum:g} Hz hum of the mains" if hum else ""
    what = f"the noise is {noise:.3g} {channel.unit} (1 std){source}; {basis}"
    remedy = (
        "check shield and ground of the sensor cable, and route it away from the motor leads"
        if hum
        else "check that nothing moves or vibrates and that the connector is seated; then shield and ground"
    )
    return [Finding(severity="fault", code="noisy", what=what, remedy=remedy)]


def _zero(channel: StreamChannel, values: Floats, limits: PreflightLimits) -> list[Finding]:
    half = 0.5 * (channel.valid_range[1] - channel.valid_range[0])
    rest = float(np.median(values))
    if channel.name != FORCE.name or half >= _UNLIMITED or abs(rest) <= limits.zero_of_half_range * half:
        return []
    what = f"reads {rest:.4g} {channel.unit} at rest"
    return [Finding(severity="note", code="not_zero", what=what, remedy="unload the cell and run `sawbench tare`")]


def _hum(time_s: Floats, values: Floats) -> float | None:
    """Mains line that makes up more than half of the variance, Hz."""
    residual = _without_line(time_s, values)
    for line_hz in _HUM_HZ:
        angle = 2.0 * np.pi * line_hz * time_s
        basis = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        amplitude = np.linalg.lstsq(basis, residual, rcond=None)[0]
        if np.var(residual - basis @ amplitude) < 0.5 * np.var(residual):
            return line_hz
    return None


def stroke_rate_hz(time_s: Floats, values: Floats) -> float | None:
    """Rate of a swing from 2 to 45 Hz that makes up most of the variance with its harmonics, Hz."""
    residual = _without_line(time_s, values)
    grid_s = np.linspace(time_s[0], time_s[-1], len(time_s))
    power = np.abs(np.fft.rfft(np.interp(grid_s, time_s, residual) * np.hanning(len(grid_s)))) ** 2
    rate_hz = np.fft.rfftfreq(len(grid_s), (grid_s[-1] - grid_s[0]) / (len(grid_s) - 1))
    is_stroke = (rate_hz >= _STROKE_HZ[0]) & (rate_hz <= _STROKE_HZ[1])
    if not is_stroke.any() or not power.sum() > 0:
        return None
    peak_hz = float(rate_hz[is_stroke][np.argmax(power[is_stroke])])
    width_hz = 2.0 * rate_hz[1]
    near = [np.abs(rate_hz - k * peak_hz) <= width_hz for k in range(1, _STROKE_HARMONICS + 1)]
    share = float(power[np.any(near, axis=0)].sum() / power.sum())
    # Lines this wide hold a part of any noise; a stroke holds much more.
    return peak_hz if share > max(_STROKE_SHARE, 2.0 * float(np.mean(np.any(near, axis=0)))) else None


def _without_line(time_s: Floats, values: Floats) -> Floats:
    t = time_s - time_s.mean()
    spread = float(t @ t)
    slope = float(t @ (values - values.mean())) / spread if spread > 0 else 0.0
    return values - values.mean() - slope * t
