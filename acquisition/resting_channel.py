"""One channel at rest: what the instruments delivered -> a mean that may be trusted, or why not; the tare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from sawbench.acquisition.averaging import RestingMean, resting_mean, unsteady
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.calibration_book import zeroed
from sawbench.acquisition.device_probe import DeviceProbe
from sawbench.acquisition.devices.device import Device, StreamChannel
from sawbench.acquisition.preflight import judge
from sawbench.bench.errors import InputError, UntrustedResult

# A change that does not matter, and a zero that no sensor has: shares of half the range.
_TOLERANCE: Final = 0.001
_LARGEST_ZERO: Final = 0.2
_UNLIMITED: Final = 1e8
# Of no matter to a mean at rest: when the samples came, and how many.
_NO_MATTER: Final = frozenset({"rate_low", "rate_high", "samples_missing"})


@dataclass(frozen=True, kw_only=True, slots=True)
class RestingChannel:
    """A channel that stood still.

    Attributes
    ----------
    device, port : str
    channel : StreamChannel
        With the calibration it was read with.
    facts : mapping of str to str
        What the instrument says of itself.
    found : RestingMean
        In the channel's unit.
    raw_mean, raw_std : float
        Mean in the raw unit, and its standard uncertainty, `found.std` carried over.
    """

    device: str
    port: str
    channel: StreamChannel
    facts: Mapping[str, str]
    found: RestingMean
    raw_mean: float
    raw_std: float


def device_with(devices: Sequence[Device], channel: str) -> Device:
    """Return the instrument that gives `channel`.

    Raises
    ------
    InputError
        If none does.
    """
    given = {c.name: device for device in devices for s in device.streams for c in s.channels}
    if channel not in given:
        raise InputError(
            f"no device provides {channel}; available are {', '.join(given)}", remedy="choose another --channel"
        )
    return given[channel]


def resting_channel(probe: DeviceProbe, channel: str, *, tolerance: float | None = None) -> RestingChannel:
    """Average one channel.

    Parameters
    ----------
    probe : DeviceProbe
    channel : str
    tolerance : float, optional
        Change that does not matter, in the channel's unit; default 0.1 % of half the range.

    Raises
    ------
    UntrustedResult
        If the instrument has a fault, or the value moves or drifts.
    InputError
        If there are too few samples.
    """
    where = f"{probe.device} {channel}"
    for finding in judge([probe]).findings:
        if finding.severity == "fault" and finding.channel in {"", channel} and finding.code not in _NO_MATTER:
            raise UntrustedResult(finding.what, where=where, remedy=finding.remedy)
    stream, column = next((s, k) for s in probe.streams for k, c in enumerate(s.stream.channels) if c.name == channel)
    described = stream.stream.channels[column]
    raw = stream.raw[:, column]
    found = resting_mean(stream.time_s, described.calibration.apply(raw))
    half = 0.5 * (described.valid_range[1] - described.valid_range[0])
    if tolerance is None:
        tolerance = _TOLERANCE * half if half < _UNLIMITED else found.noise_std
    if reason := unsteady(found, tolerance=tolerance, unit=described.unit):
        raise UntrustedResult(
            f"the value is not steady: {reason}",
            where=where,
            remedy="let it settle and warm up, do not touch it; or allow more drift with --tolerance",
        )
    raw_mean = float(raw.mean())
    return RestingChannel(
        device=probe.device,
        port=probe.port,
        channel=described,
        facts=probe.facts,
        found=found,
        raw_mean=raw_mean,
        raw_std=found.std / abs(described.calibration.slope_at(raw_mean)),
    )


def tare(resting: RestingChannel, base: Calibration, *, force: bool = False) -> Calibration:
    """Return the calibration that reads 0 at the mean of `resting`.

    Parameters
    ----------
    resting : RestingChannel
    base : Calibration
        Without any tare.
    force : bool
        Take a zero that no unloaded sensor has.

    Raises
    ------
    UntrustedResult
        If the reading is more than a fifth of half the range away from the zero of `base`.
    """
    low, high = resting.channel.valid_range
    half, reading = 0.5 * (high - low), float(base.apply(resting.raw_mean))
    if not force and half < _UNLIMITED and abs(reading) > _LARGEST_ZERO * half:
        unit = resting.channel.unit
        raise UntrustedResult(
            f"reads {reading:.4g} {unit}, {abs(reading) / half:.0%} of its range: this is a load, not a zero",
            where=f"{resting.device} {resting.channel.name}",
            remedy="unload the sensor; if it is permanently deformed, use `sawbench calibrate`; --force accepts the"
            " value",
        )
    return zeroed(base, resting.raw_mean)
