"""What faults of sensors leave in the features, as noise: coarse steps that nothing blurs, hum in step with the stroke.

A converter reads a value that stays within a step always equally wrong; strokes that scatter blur that
(`bench.converter.rounding_variance`). Hum that is measured in a channel averages out over strokes, but not where the
stroke rate is nearly a fraction of its frequency: n strokes take 1 / (pi n d) of a line that is d orders off one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sawbench.bench.converter import rounding_variance
from sawbench.bench.recording import Floats
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.features import N_BLOCKS, Layout, orders
from sawbench.diagnosis.inference.off_stroke import Line, fixed_lines, is_mains
from sawbench.modeling.state import TWO_PI, State


class SensorFaults:
    """Variance that the faults of a campaign's sensors add to its features.

    Parameters
    ----------
    campaign : Campaign
    """

    def __init__(self, campaign: Campaign) -> None:
        self._plant = campaign.plant
        self._steps: dict[str, float] = {}
        for one in campaign.health:
            self._steps[one.channel] = max(self._steps.get(one.channel, 0.0), one.step)
        self._hum: dict[str, list[Line]] = {}
        for line in fixed_lines(campaign.off_stroke):
            if is_mains(line.frequency_hz):
                self._hum.setdefault(line.channel, []).append(line)

    def variance(self, layout: Layout, state: State) -> Floats:
        """Of every feature of a time block of a state, in the squared unit of its equation, shape (layout.size,)."""
        found = np.zeros(layout.size)
        for channel, reading in self._plant.readings().items():
            values, step = reading.of(state), self._steps.get(channel, 0.0)
            hum = self._hum.get(channel, [])
            if values is None or not (step or hum):
                continue
            moved: dict[str, Floats] = {**reading.signature(self._plant.model, state)}
            stepped = _unblurred(values, step, state)
            for equation, place in layout.slices.items():
                if equation in moved:
                    square = float(np.mean(moved[equation] ** 2))
                    found[place] += square * (stepped + _hum(hum, place.stop - place.start, state))
        return found


def _unblurred(values: Floats, step: float, state: State) -> float:
    """Mean square error of mean strokes by the converter's step."""
    if not step:
        return 0.0
    # From unit to unit: what drifts over a trial blurs no mean of a part of it.
    change = np.diff(values, axis=0) if len(values) > 1 else np.zeros((1, values.shape[1]))
    scatter = np.sqrt(0.5 * np.mean(change**2, axis=0) * float(state.n_strokes.mean()))
    return float(np.mean(rounding_variance(step, scatter)))


def _hum(lines: Sequence[Line], size: int, state: State) -> Floats:
    """Mean square of what strokes leave of hum at each harmonic, shape (size,)."""
    if state.kind == "start_up":
        return np.full(size, sum(0.5 * line.amplitude**2 for line in lines))
    order = orders((size - 1) // 2)
    rate_hz, found = float(state.speed_rad_s.mean()) / TWO_PI, np.zeros(size)
    n_strokes = float(state.n_strokes.sum()) / N_BLOCKS
    for line in lines:
        off = np.abs(line.frequency_hz / rate_hz - order)
        found += 0.5 * line.amplitude**2 / (1.0 + (np.pi * n_strokes * off) ** 2)
    return found
