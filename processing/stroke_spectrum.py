"""The spectrum in which the stroke is looked for, of a trial that is processed already."""

from __future__ import annotations

import numpy as np
from sawbench.bench.processed import ProcessedTrial
from sawbench.processing.spectrum import Spectrum, power_spectrum, steady_stretch

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
    if signal is None:
        return None
    running = [(phase.start_s, phase.end_s) for phase in trial.phases if phase.kind == "running"]
    stretches = []
    for start, end in running or [(-np.inf, np.inf)]:
        gaps = [gap for gap in signal.gaps if gap.end_s > start and gap.start_s < end]
        starts = [start, *(gap.end_s for gap in gaps)]
        stretches += list(zip(starts, [*(gap.start_s for gap in gaps), end], strict=True))
    masks = [(signal.time_s >= start) & (signal.time_s <= end) for start, end in stretches]
    inside = max(masks, key=np.count_nonzero)
    time_s, values = signal.time_s[inside], signal.values[inside]
    if len(time_s) < _LEAST_SAMPLES or float(np.ptp(values)) == 0.0:
        return None
    uniform, rate_hz = steady_stretch(time_s, values, *band_hz)
    return None if len(uniform) < _LEAST_SAMPLES else power_spectrum(uniform, rate_hz)
