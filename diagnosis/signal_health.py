"""What the processing knows of every channel of a trial, as far as the report names it among the signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sawbench.bench.converter import step_of
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Signal
from sawbench.bench.units import CHANNEL_BY_NAME


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelHealth:
    """Health of one channel of one trial.

    Attributes
    ----------
    channel : str
    seconds, rate_hz : float
        Length, and samples a second.
    noise : float
        Standard deviation of the white noise, in the channel's unit.
    step : float
        Of the converter, in the channel's unit, where it is coarser than the noise; else 0.
    spikes, impacts : int
        Left out by the processing; kept, as they are at one crank angle.
    missing_share, jitter_share : float
        Samples that are missing, of all; standard deviation of the sample's time, of the sample period.
    """

    channel: str
    seconds: float
    rate_hz: float
    noise: float
    step: float
    spikes: int
    impacts: int
    missing_share: float
    jitter_share: float


def channel_health(trial: TrackedTrial) -> tuple[ChannelHealth, ...]:
    """Health of every known channel of a trial."""
    return tuple(
        ChannelHealth(
            channel=q.channel,
            seconds=q.n_samples / q.rate_hz,
            rate_hz=q.rate_hz,
            noise=q.noise_std,
            step=coarse_step(trial.channels[q.channel], q.noise_std),
            spikes=q.n_spikes,
            impacts=q.n_impacts,
            missing_share=q.n_missing / max(q.n_samples + q.n_missing, 1),
            # An interval holds the errors of two times.
            jitter_share=q.jitter_std_s * q.rate_hz / np.sqrt(2.0),
        )
        for q in trial.quality
        if q.channel in CHANNEL_BY_NAME and q.channel in trial.channels and q.rate_hz > 0
    )


def coarse_step(signal: Signal, noise: float) -> float:
    """Step of the converter, in the channel's unit, where it is coarser than the noise; else 0."""
    step = step_of(signal.values)
    return step if step > noise else 0.0
