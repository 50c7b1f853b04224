"""The offset in time between instruments, estimated from the strokes that they share: a check on the stated alignment.

What the strokes tell, from the surest to the least sure: that a channel moves against the crank within the trial
(`stroke_waves`), and by how much the motor current comes too early or too late against the displacement. The second is
read from the circuit of the motor, L di/dt + R i = v - k_e w: the ripple of the crank's speed, which the displacement
shows, makes that of the current, at any load. The lag of the circuit is known as well as L / R is; a lag that is
not in it, such as that of a filter in front of the instrument, is confounded with an offset of its clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BenchConfig, PlantConfig
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import CrankAngle, StrokeOffset
from sawbench.bench.recording import Alignment, Floats, Signal
from sawbench.processing.folding import Cycles
from sawbench.processing.stroke_clock import DISPLACEMENT, stroke_waves

_FORCE: Final = "force_n"
_CURRENT: Final = "motor_current_a"
_N_HARMONICS: Final = 6
_N_POINTS: Final = 256
# Offsets that are tried: up to this share of a stroke either way, and how finely.
_MOST_TURNS: Final = 0.25
_N_TRIED: Final = 401
# Scatter of the harmonics that the circuit explains at best, of the largest: fold, fit of the angle, sensor.
_LEAST_MISFIT: Final = 0.005
# Smaller than so many standard deviations of its noise, a ripple tells nothing.
_LEAST_RIPPLE_STDS: Final = 10.0
# An offset that cannot be told to better than this says nothing about an alignment.
_USELESS_STD_S: Final = 0.005
_FEWEST_STROKES: Final = 12
_SAME_AMPLITUDE: Final = 0.1
# What contradicts the stated alignment: so many standard uncertainties, and so much on top.
_SIGMAS: Final = 4.0
_LEAST_CONTRADICTION_S: Final = 0.001

Waves = NDArray[np.complex128]


def stroke_offsets(
    signals: Mapping[str, Signal],
    channels: Mapping[str, tuple[Floats, Floats]],
    folded: Mapping[str, FoldedCycle],
    cycles: Mapping[str, Cycles],
    angle: CrankAngle,
    config: BenchConfig,
) -> tuple[StrokeOffset, ...]:
    """Estimate the offset of every channel that another instrument than the displacement's delivers.

    Parameters
    ----------
    signals : mapping of str to Signal
        As recorded: which instrument each channel is from, and its stated alignment.
    channels : mapping of str to (time_s, values)
        Without spikes.
    folded : mapping of str to FoldedCycle
    cycles : mapping of str to Cycles
        Complete strokes of each channel.
    angle : CrankAngle
        From the displacement.
    config : BenchConfig
        Without a plant only the change within the trial is estimated.
    """
    if not angle.is_absolute or DISPLACEMENT not in signals:
        return ()
    reference = signals[DISPLACEMENT]
    found = []
    for name in (_FORCE, _CURRENT):
        signal, own = signals.get(name), cycles.get(name)
        if signal is None or own is None or name not in folded or signal.device == reference.device:
            continue
        change = _change(angle, *channels[name], own)
        told = _Told(reason="the cutting force itself is unknown, so the strokes show only a change")
        if name == _CURRENT:
            told = _offset_of_current(folded[name], own, angle, config)
        found.append(_judged(name, change, told, signal, reference))
    return tuple(found)


def changed_between(trials: Sequence[tuple[str, Sequence[StrokeOffset]]]) -> list[str]:
    """Say where the offset of a channel differs between trials of one session by more than their strokes can explain.

    What the model does not know is the same in all of them, so a difference is known better than an offset.

    Parameters
    ----------
    trials : sequence of (trial_id, offsets)

    Returns
    -------
    list of str
        A sentence for each trial and channel that lies apart from the median of all.
    """
    by_link: dict[tuple[str, str, str], list[tuple[str, float, float]]] = {}
    for trial_id, offsets in trials:
        for o in offsets:
            if o.offset_s is not None and o.repeat_std_s is not None:
                link = (o.channel, o.device, o.against)
                by_link.setdefault(link, []).append((trial_id, o.offset_s, o.repeat_std_s))
    said = []
    for (channel, _, against), found in by_link.items():
        middle_s = float(np.median([offset_s for _, offset_s, _ in found]))
        middle_std_s = float(np.median([std_s for _, _, std_s in found]))
        for trial_id, offset_s, std_s in found:
            apart_s, apart_std_s = offset_s - middle_s, float(np.hypot(std_s, middle_std_s))
            if abs(apart_s) > _LEAST_CONTRADICTION_S + _SIGMAS * apart_std_s:
                said.append(
                    f"{trial_id}: {channel} comes {1e3 * apart_s:+.1f} ± {1e3 * apart_std_s:.1f} ms later against "
                    f"{against} than in the other trials: wrong times, or another setting of a filter"
                )
    return said


@dataclass(frozen=True, kw_only=True, slots=True)
class _Told:
    """An offset, its standard uncertainty and the part of that which differs between trials; or why there is none."""

    offset_s: float | None = None
    std_s: float | None = None
    repeat_std_s: float | None = None
    reason: str = ""


def _judged(
    name: str, change: tuple[float, float] | None, told: _Told, signal: Signal, reference: Signal
) -> StrokeOffset:
    stated_s = _stated_s(signal.alignment, reference.alignment)
    problem = ""
    if stated_s is not None:
        latency_s, std_s = stated_s
        if change is not None and abs(change[0]) > _LEAST_CONTRADICTION_S + _SIGMAS * float(np.hypot(change[1], std_s)):
            problem = (
                f"{name} moves by {1e3 * change[0]:+.2f} ± {1e3 * change[1]:.2f} ms against the strokes from the first "
                f"to the last, its alignment is stated to ± {1e3 * std_s:.2f} ms: a clock that drifts, or a load that "
                "changes"
            )
        elif told.offset_s is not None and told.std_s is not None:
            allowed_s = latency_s + _LEAST_CONTRADICTION_S + _SIGMAS * float(np.hypot(told.std_s, std_s))
            if abs(told.offset_s) > allowed_s:
                problem = (
                    f"{name} comes {1e3 * abs(told.offset_s):.1f} ± {1e3 * told.std_s:.1f} ms too "
                    f"{'late' if told.offset_s > 0 else 'early'} against the strokes, its alignment is stated to "
                    f"± {1e3 * std_s:.2f} ms and {1e3 * latency_s:.1f} ms of latency: wrong times, or a lag that the "
                    "configuration does not state (a filter)"
                )
    return StrokeOffset(
        channel=name,
        device=signal.device,
        against=reference.device,
        offset_s=told.offset_s,
        offset_std_s=told.std_s,
        repeat_std_s=told.repeat_std_s,
        change_s=None if change is None else change[0],
        change_std_s=None if change is None else change[1],
        stated_std_s=None if stated_s is None else stated_s[1],
        stated_latency_s=None if stated_s is None else stated_s[0],
        reason=told.reason,
        problem=problem,
    )


def _stated_s(one: Alignment | None, other: Alignment | None) -> tuple[float, float] | None:
    """Largest difference of the latencies and standard uncertainty of the difference of the alignments, s."""
    if one is None or other is None:
        return None
    return max(one.latency_s, other.latency_s), float(np.hypot(one.std_s, other.std_s))


def _change(angle: CrankAngle, time_s: Floats, values: Floats, cycles: Cycles) -> tuple[float, float] | None:
    """How much later a channel comes at the end of the trial than at its beginning, and its standard uncertainty, s.

    A straight line through the phases of the single strokes; None with few strokes, where the amplitude changes
    too, because then the load did, or where the strokes cannot tell.
    """
    waves = stroke_waves(angle, time_s, values, cycles)
    size = np.abs(waves)
    if len(waves) < _FEWEST_STROKES or not size.min() > 0:
        return None
    third = len(waves) // 3
    if abs(np.log(np.median(size[-third:]) / np.median(size[:third]))) > _SAME_AMPLITUDE:
        return None
    phase_rad = np.angle(waves / size * np.conj(np.sum(waves / size)))
    late_s = -phase_rad * cycles.period_s / (2.0 * np.pi)
    place = (cycles.start_s - cycles.start_s[0]) / (cycles.start_s[-1] - cycles.start_s[0]) - 0.5
    slope = float(np.sum(place * late_s) / np.sum(place**2))
    off_s = late_s - late_s.mean() - slope * place
    # Neighbours vary together: the scatter counts as that of blocks.
    n_block = max(1, len(off_s) // _FEWEST_STROKES)
    blocks = off_s[: len(off_s) // n_block * n_block].reshape(-1, n_block).mean(axis=1)
    std_s = float(np.sqrt(np.sum(blocks**2) / max(1, len(blocks) - 2) / (np.sum(place**2) / n_block)))
    return (slope, max(std_s, 1e-6)) if std_s <= _USELESS_STD_S else None


def _offset_of_current(folded: FoldedCycle, cycles: Cycles, angle: CrankAngle, config: BenchConfig) -> _Told:
    """Offset of the motor current against the displacement from the circuit of the motor; see the module."""
    plant = config.plant
    if plant is None:
        return _Told(reason="needs the constants of the motor, [plant]")
    if len(angle.ripple_std_rad) < _N_HARMONICS:
        return _Told(reason="the speed within a stroke is not known: too few settled strokes")
    stroke = _mean_stroke(angle, cycles)
    if stroke is None or not np.isfinite(folded.mean).all():
        return _Told(reason="no stroke is whole in both channels")
    time_s, speed, turned = stroke
    period_s = time_s[-1] + time_s[1]
    measured = _harmonics(np.interp(turned, folded.angle_rad, folded.mean, period=2.0 * np.pi))
    circuit = _circuit(plant, _harmonics(speed), angle.ripple_std_rad[:_N_HARMONICS], period_s)
    noise = np.hypot(circuit.std, _harmonic_std(folded))
    if not np.abs(measured[0]) > _LEAST_RIPPLE_STDS * noise[0]:
        return _Told(reason="the current hardly varies within a stroke")
    return _shift_of(measured, circuit, noise, period_s)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Circuit:
    """Harmonics of the current that the speed asks for, their noise, and columns with a prior of 1 each."""

    expected: Waves
    std: Floats
    columns: Waves


def _circuit(plant: PlantConfig, speed: Waves, ripple_std_rad: Floats, period_s: float) -> _Circuit:
    order = np.arange(1, _N_HARMONICS + 1)
    rate_rad_s = 2.0 * np.pi * order / period_s
    resistance, inductance = plant.resistance_ohm, plant.inductance_h
    back_emf = plant.back_emf_constant_v_s_per_rad
    impedance = resistance.nominal + 1j * rate_rad_s * inductance.nominal
    per_speed = -back_emf.nominal * plant.gear_ratio / impedance
    expected = per_speed * speed
    columns = np.stack(
        [
            -expected * resistance.std / impedance,
            -expected * 1j * rate_rad_s * inductance.std / impedance,
            expected * (back_emf.std / back_emf.nominal),
        ],
        axis=1,
    )
    return _Circuit(expected=expected, std=np.abs(per_speed) * rate_rad_s * ripple_std_rad, columns=columns)


def _shift_of(measured: Waves, circuit: _Circuit, noise: Floats, period_s: float) -> _Told:
    """Profile over the shift: for each, the constants of the motor are fitted within what is stated of them."""
    order = np.arange(1, _N_HARMONICS + 1)
    tried_s = np.linspace(-_MOST_TURNS, _MOST_TURNS, _N_TRIED) * period_s
    sigma = np.hypot(noise, _LEAST_MISFIT * float(np.abs(measured).max()))
    turns = tried_s / period_s
    costs = np.array([_cost(measured * np.exp(2j * np.pi * order * turn), circuit, sigma) for turn in turns])
    best = int(np.argmin(costs))
    if best in {0, _N_TRIED - 1}:
        return _Told(reason="no offset below a quarter of a stroke brings the current into line with the speed")
    step_s = float(tried_s[1] - tried_s[0])
    before, least, after = (float(cost) for cost in costs[best - 1 : best + 2])
    bend = max(before - 2.0 * least + after, 1e-12)
    # What the circuit does not explain counts as scatter: 12 numbers, of which the shift and the constants take four.
    misfit = max(1.0, least / (2 * _N_HARMONICS - circuit.columns.shape[1] - 1))
    std_s = step_s * float(np.sqrt(2.0 * misfit / bend))
    if std_s > _USELESS_STD_S:
        return _Told(reason=f"the strokes tell it to ± {1e3 * std_s:.0f} ms only")
    offset_s = float(tried_s[best]) + 0.5 * step_s * (before - after) / bend
    slope = 2.0 * np.pi * order / period_s * np.abs(measured)
    return _Told(offset_s=offset_s, std_s=std_s, repeat_std_s=float(1.0 / np.sqrt(np.sum((slope / noise) ** 2))))


def _cost(measured: Waves, circuit: _Circuit, sigma: Floats) -> float:
    """Least sum of squares of residuals (in sigma) and of the columns' coefficients (in their priors)."""
    left = (measured - circuit.expected) / sigma
    columns = circuit.columns / sigma[:, None]
    n = columns.shape[1]
    rows = np.concatenate([columns.real, columns.imag, np.eye(n)])
    wanted = np.concatenate([left.real, left.imag, np.zeros(n)])
    fitted = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    return float(np.sum((wanted - rows @ fitted) ** 2))


def _mean_stroke(angle: CrankAngle, cycles: Cycles) -> tuple[Floats, Floats, Floats] | None:
    """Equally spaced times within the mean stroke (s), and there crank speed (rad/s) and crank angle (rad)."""
    edges = np.arange(_N_POINTS + 1) * 2.0 * np.pi / _N_POINTS
    turned = 2.0 * np.pi * cycles.index[:, None] + edges
    inside = (turned[:, 0] >= angle.angle_rad[0]) & (turned[:, -1] <= angle.angle_rad[-1])
    if not inside.any():
        return None
    passed_s = np.interp(turned[inside], angle.angle_rad, angle.time_s)
    mean_s = (passed_s - passed_s[:, :1]).mean(axis=0)
    if not np.diff(mean_s).min() > 0:
        return None
    time_s = np.arange(_N_POINTS) * mean_s[-1] / _N_POINTS
    at_rad = np.interp(time_s, mean_s, edges)
    # The angle beyond its mean slope is periodic: its harmonics give the speed without the noise of a difference.
    order = np.arange(1, _N_HARMONICS + 1)
    rate_rad_s = 2.0 * np.pi / mean_s[-1]
    ripple = _harmonics(at_rad - rate_rad_s * time_s)
    waves = np.exp(1j * np.outer(rate_rad_s * time_s, order))
    return time_s, rate_rad_s + np.real(waves @ (1j * order * rate_rad_s * ripple)), at_rad


def _harmonics(values: Floats) -> Waves:
    """Harmonics 1 to `_N_HARMONICS` of equally spaced values over one stroke."""
    order = np.arange(1, _N_HARMONICS + 1)
    turns = np.arange(len(values)) / len(values)
    return np.asarray(2.0 / len(values) * (np.exp(-2j * np.pi * np.outer(order, turns)) @ values), dtype=np.complex128)


def _harmonic_std(cycle: FoldedCycle) -> float:
    """Standard deviation of the real or imaginary part of a harmonic of the mean stroke.

    Strokes differ as a whole, not sample by sample: the scatter of a tenth of the stroke counts as one.
    """
    of_mean = cycle.std / np.sqrt(np.maximum(cycle.count, 1))
    return float(np.sqrt(2.0 * np.nanmean(of_mean**2) / 10.0))
