"""Recordings with what their sensors are stated to read taken back."""

from __future__ import annotations

from dataclasses import replace

from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording


def with_true_values(recording: Recording, config: BenchConfig) -> Recording:
    """Return the recording with the true values of every channel of `[sensors]`; others are as they were."""
    if not config.sensors:
        return recording
    signals = {
        name: replace(signal, values=config.sensors[name].true(signal.values)) if name in config.sensors else signal
        for name, signal in recording.signals.items()
    }
    return replace(recording, signals=signals)
