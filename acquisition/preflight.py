"""Is the bench fit to record? What the instruments delivered in a few seconds -> findings in plain words.

Pure functions: `device_probe` reads, this judges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.device_probe import DeviceProbe, StreamProbe
from acquisition.devices.device import StreamChannel
from bench.errors import NoAnswerError
from bench.units import CHANNELS, FORCE

Floats = NDArray[np.float64]
Severity = Literal["fault", "note"]
_UNLIMITED: Final = 1e8
_WINDOW_S: Final = 0.25
_HUM_HZ: Final = (50.0, 60.0, 100.0, 120.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class PreflightLimits:
    """From where on something is said.

    Attributes
    ----------
    rate_error : float
        Relative; the recorder refuses beyond 0.03 too.
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
        A fault is not to be trusted; a note is worth knowing.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelCheck:
    """One channel in numbers.

    Attributes
    ----------
    device, channel, unit : str
    latest, mean : float or None
        Newest value and mean, in `unit`; None where no sample came.
    noise_std : float or None
        Robust standard deviation (1.4826 median absolute deviation) about a straight line, in `unit`.
    rate_hz, nominal_rate_hz : float
        Nominal 0: polled, as fast as it answers.
    n_samples, n_gaps, n_missing : int
    drift_ppm, drift_std_ppm : float or None
    """

    device: str
    channel: str
    unit: str
    latest: float | None
    mean: float | None
    noise_std: float | None
    rate_hz: float
    nominal_rate_hz: float
    n_samples: int
    n_gaps: int
    n_missing: int
    drift_ppm: float | None
    drift_std_ppm: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Preflight:
    """The whole check.

    Attributes
    ----------
    is_good : bool
        No fault.
    channels : tuple of ChannelCheck
    findings : tuple of Finding
        Faults first.
    """

    channels: tuple[ChannelCheck, ...]
    findings: tuple[Finding, ...]

    @property
    def is_good(self) -> bool:
        """Whether there is no fault."""
        return not any(f.severity == "fault" for f in self.findings)


def judge(
    probes: Sequence[DeviceProbe], *, is_running: bool = False, limits: PreflightLimits | None = None
) -> Preflight:
    """Judge what `probe_devices` returned.

    Parameters
    ----------
    probes : sequence of DeviceProbe
    is_running : bool
        The tool runs: noise and zero are then not judged, and a value that stands still always is.
    limits : PreflightLimits, optional

    Returns
    -------
    Preflight

    Notes
    -----
    Fails: a node that repeats its last value with noise added is not seen as frozen; a wrong scale is not seen at
    all (that is what a known load and `sawbench calibrate` are for).
    """
    limits = limits or PreflightLimits()
    channels: list[ChannelCheck] = []
    findings: list[Finding] = []
    for probe in probes:
        findings += _device_findings(probe)
        for stream in probe.streams:
            findings += _stream_findings(probe, stream, limits)
            for column, channel in enumerate(stream.stream.channels):
                values = channel.calibration.apply(stream.raw[:, column])
                channels.append(_channel_check(probe.device, stream, channel, values))
                if len(values):
                    found = channel_findings(channel, stream.time_s, values, is_running=is_running, limits=limits)
                    findings += [_at(f, probe.device, channel.name) for f in found]
    findings += _missing_channels(probes)
    findings.sort(key=lambda f: f.severity != "fault")
    return Preflight(channels=tuple(channels), findings=tuple(findings))


def robust_std(time_s: Floats, values: Floats) -> float:
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
    deviation = np.abs(residual - np.median(residual))
    spread = 1.4826 * float(np.median(deviation))
    most_equal = np.unique(values, return_counts=True)[1].max() > len(values) / 2
    return float(residual.std()) if most_equal else spread


def received_rate_hz(arrival_s: Floats, n_arrived: Floats) -> tuple[float, float]:
    """Rate over the whole time, and the median over windows of 0.25 s, which a gap does not move; Hz.

    Parameters
    ----------
    arrival_s : ndarray, shape (m,), s
    n_arrived : ndarray, shape (m,)
        Samples that had come until then.
    """
    if len(arrival_s) < 3 or arrival_s[-1] <= arrival_s[0]:
        return 0.0, 0.0
    span_s = float(arrival_s[-1] - arrival_s[0])
    # A line through all arrivals: the two end ones alone are as late as this machine was busy just then.
    t = arrival_s - arrival_s.mean()
    overall = float(t @ (n_arrived - n_arrived.mean()) / (t @ t))
    n_windows = int(span_s / _WINDOW_S)
    if n_windows < 4:
        return overall, overall
    edges = np.linspace(arrival_s[0], arrival_s[-1], n_windows + 1)
    counts = np.diff(np.interp(edges, arrival_s, n_arrived))
    return overall, float(np.median(counts) * n_windows / span_s)


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
    if saturated := _saturation(channel, values, limits):
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


def _device_findings(probe: DeviceProbe) -> list[Finding]:
    found: list[Finding] = []
    n_samples = sum(len(s.raw) for s in probe.streams)
    n_bytes = probe.n_discarded_bytes
    if probe.problem is not None:
        remedy = probe.problem.remedy or "check cable, power and settings"
        if isinstance(probe.problem, NoAnswerError) and n_bytes:
            what = f"{n_bytes} bytes came from {probe.port}, but they make no sense"
            remedy = "most likely the baud rate is wrong (`baud_rate`), or the port belongs to another instrument"
            found.append(_fault("wrong_baud_or_instrument", probe.device, what=what, remedy=remedy))
        elif isinstance(probe.problem, NoAnswerError):
            what = f"not a single byte came from {probe.port}; {probe.problem.what}"
            found.append(_fault("no_bytes", probe.device, what=what, remedy=remedy))
        else:
            code = "link_broke" if probe.is_opened else "cannot_open"
            found.append(_fault(code, probe.device, what=f"{probe.port}: {probe.problem.what}", remedy=remedy))
    elif not n_samples:
        found.append(_nothing_useful(probe, n_bytes))
    elif n_bytes:
        what = f"{n_bytes} bytes were damaged on the way"
        remedy = "check cable length, shield, ground and USB hub; lower the baud rate if it stays"
        found.append(_fault("bytes_damaged", probe.device, what=what, remedy=remedy))
    n_overloads = int(probe.facts.get("n_overloads", "0"))
    if n_overloads:
        what = f"the amplifier itself marked {n_overloads} frames as overloaded"
        remedy = "check the wiring of the bridge and whether the sensor is overloaded"
        found.append(_fault("overload", probe.device, what=what, remedy=remedy))
    return found


def _nothing_useful(probe: DeviceProbe, n_bytes: int) -> Finding:
    n_other = int(probe.facts.get("n_other_frames", "0"))
    if n_other:
        what = f"{n_other} frames came, but none of {', '.join(s.stream.name for s in probe.streams)}"
        remedy = "check that the DBC belongs to this bus and that the nodes are switched on"
        return _fault("no_samples", probe.device, what=what, remedy=remedy)
    if n_bytes:
        what = f"{n_bytes} bytes came from {probe.port}, but no valid frame"
        remedy = "most likely the baud rate is wrong (`baud_rate`), or the port belongs to another instrument"
        return _fault("wrong_baud_or_instrument", probe.device, what=what, remedy=remedy)
    what = f"{probe.port} opens, but not a single sample came"
    remedy = "check power and cable; on a CAN bus also `bitrate`, the two 120 ohm ends, and CAN high and low"
    return _fault("no_bytes", probe.device, what=what, remedy=remedy)


def _stream_findings(probe: DeviceProbe, stream: StreamProbe, limits: PreflightLimits) -> list[Finding]:
    if not len(stream.raw):
        others = sum(len(s.raw) for s in probe.streams)
        if not others:
            return []
        what = f"no sample of {stream.stream.name} came, though others of this device did"
        remedy = "check that its node is switched on and that the DBC has its right identifier"
        return [Finding(severity="fault", code="no_samples", device=probe.device, what=what, remedy=remedy)]
    nominal_hz = stream.stream.rate_hz
    if probe.problem is None and stream.silent_s > max(limits.silence_s, 5.0 / nominal_hz if nominal_hz > 0 else 0.0):
        what = f"{stream.stream.name} stopped: the last sample came {stream.silent_s:.1f} s before the end"
        remedy = "check its power and plug, and whether it fell into an error state"
        return [_fault("stopped", probe.device, what=what, remedy=remedy)]
    overall_hz, steady_hz = received_rate_hz(stream.arrival_s, stream.n_arrived)
    if nominal_hz > 0 and steady_hz > 0 and abs(steady_hz / nominal_hz - 1.0) > limits.rate_error:
        is_low = steady_hz < nominal_hz
        what = (
            f"{stream.stream.name} brings {steady_hz:.0f} samples/s, "
            f"{'only ' if is_low else ''}{steady_hz / nominal_hz:.0%} of the {nominal_hz:g} configured"
        )
        remedy = (
            "raise `baud_rate`, relieve this computer, or lower `rate_hz` to what arrives"
            if is_low
            else "set `rate_hz` to what it sends"
        )
        return [_fault("rate_low" if is_low else "rate_high", probe.device, what=what, remedy=remedy)]
    found: list[Finding] = []
    if stream.n_missing or stream.n_gaps:
        what = (
            f"{stream.n_missing} samples of {stream.stream.name} are missing in {stream.n_gaps} gaps "
            f"({overall_hz:.0f} of {nominal_hz:g} samples/s came)"
        )
        remedy = "check cable and USB hub, and whether this computer is busy with something else"
        found.append(_fault("samples_missing", probe.device, what=what, remedy=remedy))
    drift, drift_std = stream.drift_ppm, stream.drift_std_ppm
    if drift is not None and drift_std is not None and abs(drift) > limits.drift_ppm + 3.0 * drift_std:
        what = f"its clock is off by {drift:+.0f} +/- {drift_std:.0f} ppm, more than a quartz should be"
        remedy = "nothing to do: the recorder follows the clock; have the instrument looked at if it grows"
        note = Finding(severity="note", code="clock_drift", device=probe.device, what=what, remedy=remedy)
        found.append(note)
    return found


def _channel_check(device: str, stream: StreamProbe, channel: StreamChannel, values: Floats) -> ChannelCheck:
    has_values = len(values) > 0
    return ChannelCheck(
        device=device,
        channel=channel.name,
        unit=channel.unit,
        latest=float(values[-1]) if has_values else None,
        mean=float(values.mean()) if has_values else None,
        noise_std=robust_std(stream.time_s, values) if len(values) >= 3 else None,
        rate_hz=received_rate_hz(stream.arrival_s, stream.n_arrived)[0],
        nominal_rate_hz=stream.stream.rate_hz,
        n_samples=len(values),
        n_gaps=stream.n_gaps,
        n_missing=stream.n_missing,
        drift_ppm=stream.drift_ppm,
        drift_std_ppm=stream.drift_std_ppm,
    )


def _saturation(channel: StreamChannel, values: Floats, limits: PreflightLimits) -> Finding | None:
    low, high = channel.valid_range
    unit = channel.unit
    outside = float(np.mean(~((values >= low) & (values <= high))))
    remedy = "check the wiring (a broken bridge wire drives the input to its end), the load, and `raw_range`"
    if outside > limits.outside_share:
        what = f"{outside:.1%} of the values lie beyond {low:g}..{high:g} {unit}, what the input can mean"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    if (clipped := _clipped_at(values, limits)) is not None:
        what = f"the value is cut off at {clipped:.4g} {unit}: the amplifier is at its end"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    reached = abs(float(np.median(values)) - middle) / half
    if half < _UNLIMITED and reached > limits.near_limit:
        what = f"the value stands at {float(np.median(values)):.4g} {unit}, {reached:.0%} of the way to the end"
        return Finding(severity="fault", code="saturated", what=what, remedy=remedy)
    return None


def _clipped_at(values: Floats, limits: PreflightLimits) -> float | None:
    """Value at which a varying signal is cut off: far more samples sit on it than on its neighbour."""
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < 16:
        return None
    for end, neighbour in ((-1, -2), (0, 1)):
        if counts[end] >= max(20, limits.clipped_share * len(values)) and counts[end] > 10 * counts[neighbour]:
            return float(levels[end])
    return None


def _frozen(channel: StreamChannel, values: Floats, is_running: bool) -> Finding:
    what = f"all {len(values)} values are exactly {values[0]:.6g} {channel.unit}"
    if channel.resolution > 0 and not is_running:
        what += f"; a sensor at rest can do that within its step of {channel.resolution:g} {channel.unit}"
        remedy = "run the tool and check again with --running, to tell a frozen sensor from one at rest"
        return Finding(severity="note", code="not_moving", what=what, remedy=remedy)
    remedy = "the sensor or its node is frozen: switch it off and on, check the sensor's plug"
    return Finding(severity="fault", code="frozen", what=what, remedy=remedy)


def _noise(channel: StreamChannel, time_s: Floats, values: Floats, limits: PreflightLimits) -> list[Finding]:
    noise = robust_std(time_s, values)
    half = 0.5 * (channel.valid_range[1] - channel.valid_range[0])
    if channel.noise_std is not None:
        allowed = limits.noise_factor * channel.noise_std
        basis = f"{channel.noise_std:.3g} {channel.unit} are expected (`noise_std`)"
    elif half < _UNLIMITED:
        allowed = limits.noise_of_half_range * half
        basis = f"more than {limits.noise_of_half_range:.1%} of half the range; state `noise_std` to judge it better"
    else:
        return []
    if noise <= allowed:
        return []
    hum = _hum(time_s, values)
    source = f", most of it {hum:g} Hz hum of the mains" if hum else ""
    what = f"the noise is {noise:.3g} {channel.unit} (1 std){source}; {basis}"
    remedy = (
        "check shield and ground of the sensor cable, and keep it away from the motor leads"
        if hum
        else "check that nothing moves or vibrates and that the plug sits; then shield and ground"
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


def _without_line(time_s: Floats, values: Floats) -> Floats:
    t = time_s - time_s.mean()
    spread = float(t @ t)
    slope = float(t @ (values - values.mean())) / spread if spread > 0 else 0.0
    return values - values.mean() - slope * t


def _missing_channels(probes: Sequence[DeviceProbe]) -> list[Finding]:
    configured = {c.name for p in probes for s in p.streams for c in s.stream.channels}
    if any(not p.is_opened for p in probes):
        # What a device that did not open would give is not known here; its own fault is said already.
        return []
    return [
        Finding(
            severity="note",
            code="channel_not_configured",
            channel=channel.name,
            what=f"no device gives {channel.name} ({channel.label})",
            remedy="add it to a [devices.*] table if it is measured",
        )
        for channel in CHANNELS
        if channel.name not in configured
    ]


def _fault(code: str, device: str, *, what: str, remedy: str) -> Finding:
    return Finding(severity="fault", code=code, device=device, what=what, remedy=remedy)


def _at(finding: Finding, device: str, channel: str) -> Finding:
    return replace(finding, device=device, channel=channel)
