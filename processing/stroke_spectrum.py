"""The spectrum in which the stroke is looked for."""

from __future__ import annotations

import numpy as np
from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.recording import Floats
from sawbench.processing.spectrum import Spectrum, power_spectrum, steady_stretch
from sawbench.processing.stretches import Stretches, holes_of, longest_step, without_holes

_LEAST_SAMPLES = 32


def stroke_spectrum(trial: ProcessedTrial, channel: str, band_hz: tuple[float, float]) -> Spectrum | None:
    """Power spectrum of a channel over its longest running stretch without a gap.

    Parameters
    ----------
    trial : ProcessedTrial
        With its channels, so not one that was read back from a file.
    channel : str
    band_hz : tuple of float
        Allowed stroke rates.

    Returns
    -------
    Spectrum or None
        None where the channel is missing, does not change, or has no stretch that is long enough.

    Examples
    --------
    >>> from sawbench.bench.config import BenchConfig
    >>> from sawbench.bench.recording import Recording, Signal, Trial
    >>> from sawbench.processing.process import process_recording
    >>> t = np.arange(0, 2, 1e-3)
    >>> stroke = Signal(channel="displacement_mm", unit="mm", time_s=t, values=10 * (1 - np.cos(2 * np.pi * 15 * t)))
    >>> found = process_recording(Recording(trial=Trial(trial_id="t1"), signals={"displacement_mm": stroke}),
    ...                           BenchConfig())
    >>> spectrum = stroke_spectrum(found, "displacement_mm", (1.0, 60.0))
    >>> bool(abs(spectrum.frequency_hz[np.argmax(spectrum.power)] - 15.0) < spectrum.resolution_hz)
    True
    """
    signal = trial.channels.get(channel)
    if signal is None or not len(signal.values):
        return None
    running = tuple((phase.start_s, phase.end_s) for phase in trial.phases if phase.kind == "running")
    holes = holes_of(signal.time_s, signal.gaps, longest_step(np.diff(signal.time_s)))
    return longest_spectrum(signal.time_s, signal.values, running, holes, band_hz)


def longest_spectrum(
    time_s: Floats, values: Floats, stretches: Stretches, holes: Stretches, band_hz: tuple[float, float]
) -> Spectrum | None:
    """Power spectrum of samples over the longest stretch without a hole.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    stretches, holes : tuple of (start_s, end_s)
        Without a stretch all samples count.
    band_hz : tuple of float
        Allowed stroke rates.

    Returns
    -------
    Spectrum or None
        None where the values do not change there, or the stretch is too short.
    """
    left = without_holes(stretches or ((float(time_s[0]), float(time_s[-1])),), holes)
    start, end = max(left, key=lambda stretch: stretch[1] - stretch[0], default=(0.0, 0.0))
    inside = (time_s >= start) & (time_s <= end)
    time_s, values = time_s[inside], values[inside]
    if len(time_s) < _LEAST_SAMPLES or float(np.ptp(values)) == 0.0:
        return None
    uniform, rate_hz = steady_stretch(time_s, values, *band_hz)
    return None if len(uniform) < _LEAST_SAMPLES else power_spectrum(uniform, rate_hz)
