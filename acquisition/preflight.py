"""Is the bench fit to record? What the instruments delivered in a few seconds -> findings in plain words.

Pure functions: `device_probe` reads, this judges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.device_probe import DeviceProbe, StreamProbe
from sawbench.acquisition.devices.device import StreamChannel
from sawbench.acquisition.preflight_values import Finding, PreflightLimits, channel_findings, std_about_line
from sawbench.bench.errors import NoAnswerError, OtherInstrumentError
from sawbench.bench.units import CHANNELS

Floats = NDArray[np.float64]
_WINDOW_S: Final = 0.25


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
    findings = _running_tool(findings)
    findings += _busy_computer(findings) + _missing_channels(probes)
    findings.sort(key=lambda f: f.severity != "fault")
    return Preflight(channels=tuple(channels), findings=tuple(findings))


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


def _device_findings(probe: DeviceProbe) -> list[Finding]:
    found: list[Finding] = []
    n_samples = sum(len(s.raw) for s in probe.streams)
    n_bytes = probe.n_discarded_bytes
    if probe.problem is not None:
        remedy = probe.problem.remedy or "check cable, power and settings"
        if isinstance(probe.problem, NoAnswerError) and n_bytes:
            what = f"{n_bytes} bytes were received from {probe.port}, but no valid frame"
            remedy = "most likely the baud rate is wrong (`baud_rate`), or the port belongs to another instrument"
            found.append(_fault("wrong_baud_or_instrument", probe.device, what=what, remedy=remedy))
        elif isinstance(probe.problem, NoAnswerError):
            what = f"no data was received from {probe.port}; {probe.problem.what}"
            found.append(_fault("no_bytes", probe.device, what=what, remedy=remedy))
        else:
            code = "link_broke" if probe.is_opened else "cannot_open"
            code = "other_instrument" if isinstance(probe.problem, OtherInstrumentError) else code
            found.append(_fault(code, probe.device, what=f"{probe.port}: {probe.problem.what}", remedy=remedy))
    elif not n_samples:
        found.append(_nothing_useful(probe, n_bytes))
    elif n_bytes:
        what = f"{n_bytes} bytes were damaged in transmission"
        remedy = "check cable length, shield, ground and USB hub; lower the baud rate if the fault remains"
        found.append(_fault("bytes_damaged", probe.device, what=what, remedy=remedy))
    n_overloads = int(probe.facts.get("n_overloads", "0"))
    if n_overloads:
        what = f"the amplifier itself marked {n_overloads} frames as overloaded"
        remedy = "check the wiring of the bridge and whether the sensor is overloaded"
        found.append(_fault("overload", probe.device, what=what, remedy=remedy))
    remedy = "correct the table of the configuration, or the instrument; a recording says the same"
    for text in (text for stream in probe.streams for text in stream.warnings):
        found.append(Finding(severity="note", code="driver_warning", device=probe.device, what=text, remedy=remedy))
    return found


def _nothing_useful(probe: DeviceProbe, n_bytes: int) -> Finding:
    n_other = int(probe.facts.get("n_other_frames", "0"))
    if n_other:
        what = f"{n_other} frames were received, but none of {', '.join(s.stream.name for s in probe.streams)}"
        remedy = "check that the DBC belongs to this bus and that the nodes are switched on"
        return _fault("no_samples", probe.device, what=what, remedy=remedy)
    if n_bytes:
        what = f"{n_bytes} bytes were received from {probe.port}, but no valid frame"
        remedy = "most likely the baud rate is wrong (`baud_rate`), or the port belongs to another instrument"
        return _fault("wrong_baud_or_instrument", probe.device, what=what, remedy=remedy)
    what = f"{probe.port} opens, but no sample was received"
    remedy = "check power and cable; on a CAN bus also `bitrate`, the two 120 ohm terminators, and CAN high and low"
    return _fault("no_bytes", probe.device, what=what, remedy=remedy)


def _stream_findings(probe: DeviceProbe, stream: StreamProbe, limits: PreflightLimits) -> list[Finding]:
    if not len(stream.raw):
        others = sum(len(s.raw) for s in probe.streams)
        if not others:
            return []
        what = f"no sample of {stream.stream.name} was received, but other messages of this device were"
        remedy = "check that its node is switched on and that its identifier in the DBC is correct"
        return [Finding(severity="fault", code="no_samples", device=probe.device, what=what, remedy=remedy)]
    nominal_hz = stream.stream.rate_hz
    if probe.problem is None and stream.silent_s > max(limits.silence_s, 5.0 / nominal_hz if nominal_hz > 0 else 0.0):
        what = f"{stream.stream.name} stopped: the last sample was received {stream.silent_s:.1f} s before the end"
        remedy = "check its power and connector, and whether it is in an error state"
        return [_fault("stopped", probe.device, what=what, remedy=remedy)]
    overall_hz, steady_hz = received_rate_hz(stream.arrival_s, stream.n_arrived)
    # Over a short time the rate is only known to the scatter of the arrivals, as the recorder has it.
    allowed = limits.rate_error + 0.03 / max(float(np.ptp(stream.arrival_s)), 1e-3)
    if nominal_hz > 0 and steady_hz > 0 and abs(steady_hz / nominal_hz - 1.0) > allowed:
        is_low = steady_hz < nominal_hz
        what = (
            f"{stream.stream.name} sends {steady_hz:.0f} samples/s, "
            f"{'only ' if is_low else ''}{steady_hz / nominal_hz:.0%} of the {nominal_hz:g} configured"
        )
        remedy = (
            "raise `baud_rate`, reduce the load of this computer, or lower `rate_hz` to the received rate"
            if is_low
            else "set `rate_hz` to the rate of the instrument"
        )
        return [_fault("rate_low" if is_low else "rate_high", probe.device, what=what, remedy=remedy)]
    found: list[Finding] = []
    if stream.n_missing or stream.n_gaps:
        what = (
            f"{stream.n_missing} samples of {stream.stream.name} are missing in {stream.n_gaps} gaps "
            f"({overall_hz:.0f} of {nominal_hz:g} samples/s received)"
        )
        remedy = "check cable and USB hub, and the load of this computer"
        found.append(_fault("samples_missing", probe.device, what=what, remedy=remedy))
    drift, drift_std = stream.drift_ppm, stream.drift_std_ppm
    if drift is not None and drift_std is not None and abs(drift) > limits.drift_ppm + 3.0 * drift_std:
        what = f"its clock deviates by {drift:+.0f} ± {drift_std:.0f} ppm, more than the tolerance of a quartz"
        remedy = "no action needed: the recorder follows the clock; have the instrument checked if the deviation grows"
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
        noise_std=std_about_line(stream.time_s, values) if len(values) >= 3 else None,
        rate_hz=received_rate_hz(stream.arrival_s, stream.n_arrived)[0],
        nominal_rate_hz=stream.stream.rate_hz,
        n_samples=len(values),
        n_gaps=stream.n_gaps,
        n_missing=stream.n_missing,
        drift_ppm=stream.drift_ppm,
        drift_std_ppm=stream.drift_std_ppm,
    )


def _busy_computer(findings: Sequence[Finding]) -> list[Finding]:
    """Say what slow instruments have in common: this computer."""
    slow = {f.device for f in findings if f.code == "rate_low"}
    if len(slow) < 2:
        return []
    what = f"{', '.join(sorted(slow))} are too slow at the same time: this computer may be the cause"
    remedy = "close other programs, connect the instruments to different USB ports, and check again"
    return [Finding(severity="note", code="computer_busy", what=what, remedy=remedy)]


def _running_tool(findings: list[Finding]) -> list[Finding]:
    """Say once that the tool runs, in place of what that does to each channel."""
    running = [f for f in findings if f.code == "tool_running"]
    if not running:
        return findings
    others = [f for f in findings if f.code not in {"tool_running", "noisy", "not_zero"}]
    return [*others, replace(running[0], device="", channel="")]


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
            what=f"no device provides {channel.name} ({channel.label})",
            remedy="add it to a [devices.*] table if it is measured",
        )
        for channel in CHANNELS
        if channel.name not in configured
    ]


def _fault(code: str, device: str, *, what: str, remedy: str) -> Finding:
    return Finding(severity="fault", code=code, device=device, what=what, remedy=remedy)


def _at(finding: Finding, device: str, channel: str) -> Finding:
    return replace(finding, device=device, channel=channel)
