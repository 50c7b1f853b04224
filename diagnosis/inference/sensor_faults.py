"""What faults of sensors leave in the features: coarse steps that nothing blurs, hum in step with the stroke.

A converter reads a value that stays within a step always equally wrong; strokes that scatter blur that
(`bench.converter.rounding_variance`). For the mean of a trial that is one error, however many strokes it has. Hum that
is measured in a channel averages out over strokes, but not where the stroke rate is nearly a fraction of its frequency:
n strokes take 1 / (pi n d) of a line that is d orders off one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sawbench.bench.converter import rounding_variance
from sawbench.bench.recording import Floats
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.asynchronous import Line, hum_lines
from sawbench.diagnosis.inference.features import N_BLOCKS, Layout
from sawbench.diagnosis.inference.nuisance import Nuisance, Reading
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import TWO_PI, State

# Before the name of a channel and of a trial.
ROUNDING = "rounding of "


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
        for line in hum_lines(campaign.off_stroke):
            self._hum.setdefault(line.channel, []).append(line)

    def variance(self, layout: Layout, state: State) -> Floats:
        """Of every feature of a time block of a state, in the squared unit of its equation, shape (layout.size,)."""
        found = np.zeros(layout.size)
        for channel, reading in self._plant.readings().items():
            values, step = reading.of(state), self._steps.get(channel, 0.0)
            hum = self._hum.get(channel, [])
            if values is None or not (step or hum):
                continue
            stepped = _unblurred(values, step, state)
            orders = layout.orders
            for equation, power in reading.power(self._plant.model, state, orders).items():
                rounded = np.full(len(power), stepped)
                if _stays(values, step, state):
                    rounded[0] = 0.0  # see `roundings`
                found[layout.slices[equation]] += power * (rounded + _hum(hum, orders[equation], state))
        return found

    def roundings(self, state: State) -> list[Nuisance]:
        """What rounding does to the mean of a trial whose readings stay within a step: one error, of one size."""
        found = []
        for channel, reading in self._plant.readings().items():
            values, step = reading.of(state), self._steps.get(channel, 0.0)
            if values is not None and _stays(values, step, state):
                found.append(_rounding(channel, reading, state, float(np.sqrt(_unblurred(values, step, state)))))
        return found


def _stays(values: Floats, step: float, state: State) -> bool:
    """Whether the mean of a stroke stays within a step of the converter all over the trial."""
    return state.kind == "running" and float(np.ptp(values.mean(axis=1))) < step


def _rounding(channel: str, reading: Reading, state: State, std: float) -> Nuisance:
    label = state.setting.label

    def signature(baseline: Baseline, at: State) -> Signature:
        return reading.signature(baseline, at) if at.kind == "running" and at.setting.label == label else {}

    return Nuisance(
        name=f"{ROUNDING}{channel}, {label}", std=std, signature=signature
    )  # fmt: skip


def _unblurred(values: Floats, step: float, state: State) -> float:
    """Mean square error of mean strokes by the converter's step."""
    if not step:
        return 0.0
    # From unit to unit: what drifts over a trial blurs no mean of a part of it.
    change = np.diff(values, axis=0) if len(values) > 1 else np.zeros((1, values.shape[1]))
    scatter = np.sqrt(0.5 * np.mean(change**2, axis=0) * float(state.n_strokes.mean()))
    return float(np.mean(rounding_variance(step, scatter)))


def _hum(lines: Sequence[Line], order: Floats, state: State) -> Floats:
    """Mean square of what strokes leave of hum at each harmonic, shape of `order`.

    Over the crank angle a line of one frequency is spread to the harmonics beside it, as the speed changes within the
    stroke; from one stroke to the next it goes on by as many turns as it is off a harmonic.
    """
    if state.kind == "start_up":
        return np.full(len(order), sum(0.5 * line.amplitude**2 for line in lines))
    angle_rad = state.angle_rad[0]
    seconds = TWO_PI / len(angle_rad) / state.speed_rad_s.mean(axis=0)
    at_s, period_s = np.cumsum(seconds) - 0.5 * seconds, float(seconds.sum())
    n_strokes = float(state.n_strokes.sum()) / N_BLOCKS
    found = np.zeros(len(order))
    for line in lines:
        of_stroke = np.exp(1j * (TWO_PI * line.frequency_hz * at_s - np.outer(order, angle_rad))).mean(axis=1)
        turns = line.frequency_hz * period_s
        kept = 1.0 / (1.0 + (np.pi * n_strokes * (turns - round(turns))) ** 2)
        found += 0.5 * line.amplitude**2 * kept * np.abs(of_stroke) ** 2
    return found
