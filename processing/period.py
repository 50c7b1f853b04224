"""Stroke period: which line of the spectrum is the stroke, and how long a stroke lasts on average.

The displacement has one line per stroke and is believed, after a look at half and twice the rate. Force and
currents may have their strongest line at any order (belts at 0.27, alternating strokes at 0.5, torque ripple
from 2 up): without displacement the answer is at most of moderate confidence, from a current alone always of
low confidence. A force is ambiguous between a rate and its multiples as well (a machine that cuts both ways, or teeth):
only a nominal rate decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.correlated import std_of_mean
from sawbench.bench.processed import Confidence, CrankAngle, PeriodCandidate, PeriodEstimate
from sawbench.bench.recording import Floats
from sawbench.processing.folding import Cycles
from sawbench.processing.spectrum import Line, Spectrum, find_lines, power_near

_MIN_PROMINENCE = 40.0
_RIVAL_SHARE = 0.02
_SERIOUS_SHARE = 0.25
_MOST_REL_STD = 0.025  # what is doubted and known worse is of low confidence, so that moderate is right within 1 %
_DOUBTED_OFF = 0.01  # of the spectrum's rate: what is doubted has to agree with it within what moderate promises
_NARROW_SHARE = 0.5  # second harmonic over first; a half sine has 0.18
_MAX_RIVALS = 8


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeLine:
    """What the spectrum of one channel says about the stroke rate.

    Attributes
    ----------
    channel : str
    rate_hz : float
        Most likely stroke rate.
    order : int
        Strongest line over `rate_hz`.
    noise_power : float
        Floor near the line, as squared amplitude at 1 Hz resolution.
    doubts : tuple of str
        Why it might be another one; empty where nothing speaks against it.
    rivals : tuple of PeriodCandidate
    """

    channel: str
    rate_hz: float
    order: int
    noise_power: float
    doubts: tuple[str, ...]
    rivals: tuple[PeriodCandidate, ...]


def find_stroke_line(spectrum: Spectrum, channel: str, min_rate_hz: float, max_rate_hz: float) -> StrokeLine | None:
    """Most likely stroke rate in the spectrum of one channel.

    Parameters
    ----------
    spectrum : Spectrum
    channel : str
    min_rate_hz, max_rate_hz : float
        Allowed stroke rates.

    Returns
    -------
    StrokeLine or None
        None where no line exceeds the noise by a factor of 40 in power, or where the stretch holds
        fewer than two cycles of it.

    Notes
    -----
    The strongest line is taken as the stroke, or as its second harmonic where half its rate is also present
    with at least a quarter of its power and the odd multiples of that half rate are present too. Failure: a
    machine whose strongest line is of another order (belt, alternating strokes, ripple); that is what
    `doubts` and `rivals` are for.
    """
    lowest = max(min_rate_hz, 2.0 * spectrum.resolution_hz)
    lines = [line for line in find_lines(spectrum, lowest, max_rate_hz) if line.prominence > _MIN_PROMINENCE]
    if not lines:
        return None
    top = lines[0]
    rate, order = top.frequency_hz, 1
    half, odd = power_near(spectrum, np.array([0.5 * rate, 1.5 * rate])) / top.power
    is_resolved = 0.5 * rate >= max(lowest, 3.0 * spectrum.resolution_hz)
    if is_resolved and half > _SERIOUS_SHARE and odd > _RIVAL_SHARE:
        rate, order = 0.5 * rate, 2
    rivals, doubts = _rivals(spectrum, lines, rate, top, (min_rate_hz, max_rate_hz))
    twice = float(power_near(spectrum, 2 * rate)[0]) / top.power
    if order == 1 and twice > _NARROW_SHARE:
        doubts = (*doubts, f"the line at twice the rate ({2 * rate:.4g} Hz) has nearly the same amplitude")
    if order == 2:
        doubts = (f"the line at twice the rate ({top.frequency_hz:.4g} Hz) has the larger amplitude", *doubts)
    floor = float(np.interp(rate * order, spectrum.frequency_hz, spectrum.floor))
    return StrokeLine(
        channel=channel,
        rate_hz=rate,
        order=order,
        noise_power=floor / np.log(2) / spectrum.resolution_hz,
        doubts=doubts,
        rivals=rivals,
    )


def _rivals(
    spectrum: Spectrum, lines: Sequence[Line], rate: float, top: Line, band: tuple[float, float]
) -> tuple[tuple[PeriodCandidate, ...], tuple[str, ...]]:
    """Lines that are no harmonic of the rate, and sub-multiples of it."""
    found: list[PeriodCandidate] = []
    doubts: list[str] = []
    for line in lines:
        share = line.power / top.power
        multiple = line.frequency_hz / rate
        off = abs(line.frequency_hz - round(multiple) * rate)
        near = max(spectrum.resolution_hz, 2e-3 * line.frequency_hz)
        if share < _RIVAL_SHARE or off < near:
            continue
        found.append(
            PeriodCandidate(
                period_s=1 / line.frequency_hz,
                relative_power=share,
                reason=f"at {multiple:.3f} times the rate, not one of its harmonics: {_order_words(multiple)}",
            )
        )
        if share > _SERIOUS_SHARE:
            doubts.append(
                f"a line at {line.frequency_hz:.4g} Hz ({multiple:.3g} times the rate) has nearly the same amplitude"
            )
    for divisor in (2, 3):
        share = float(power_near(spectrum, rate / divisor)[0]) / top.power
        if rate / divisor < max(band[0], 3.0 * spectrum.resolution_hz):  # hidden under the foot of the main line
            continue
        known = any(abs(c.period_s * rate / divisor - 1) < 0.02 for c in found)
        floor = float(np.interp(rate / divisor, spectrum.frequency_hz, spectrum.floor))
        is_line = share * top.power > _MIN_PROMINENCE * floor
        if share > _RIVAL_SHARE and is_line and not known:
            found.append(
                PeriodCandidate(
                    period_s=divisor / rate,
                    relative_power=share,
                    reason=f"every {divisor}. cycle differs from the others",
                )
            )
            if share > _SERIOUS_SHARE:
                doubts.append(f"every {divisor}. cycle differs strongly")
    found.sort(key=lambda candidate: -candidate.relative_power)
    return tuple(found[:_MAX_RIVALS]), tuple(doubts)


def _order_words(multiple: float) -> str:
    if abs(multiple - 0.5) < 0.01 or abs(multiple - 1.5) < 0.01:
        return "every second cycle differs"
    if multiple < 1:
        return "a belt or another slower part, or the stroke"
    return "a gear, motor or structural line, or the stroke"


def possible_orders(stroke: StrokeLine, band_hz: tuple[float, float]) -> tuple[PeriodCandidate, ...]:
    """Rivals that no spectrum of a motor current can exclude: the line may be any order of the stroke.

    Parameters
    ----------
    stroke : StrokeLine
    band_hz : tuple of float
        Allowed stroke rates.

    Returns
    -------
    tuple of PeriodCandidate
        The measured rivals first, then twice, half, three times, a third of the rate as far as allowed.
    """
    rivals = list(stroke.rivals)
    for factor, words in (
        (2.0, "the line would be every second stroke"),
        (0.5, "the line would be the second harmonic, caused by the inertia of the plunger"),
        (3.0, "the line would be every third stroke"),
        (1 / 3, "the line would be the third harmonic"),
    ):
        rate = stroke.rate_hz * factor
        is_known = any(abs(rate * candidate.period_s - 1) < 0.02 for candidate in rivals)
        if band_hz[0] <= rate <= band_hz[1] and not is_known:
            rivals.append(PeriodCandidate(period_s=1 / rate, relative_power=0.0, reason=words))
    return tuple(rivals)


def mean_period(
    angle: CrankAngle, stretches: Sequence[tuple[float, float]], cycles: Cycles
) -> tuple[float, float, float, int]:
    """Mean period, its standard uncertainty, the spread from stroke to stroke, and the number of strokes.

    Parameters
    ----------
    angle : CrankAngle
    stretches : sequence of (start_s, end_s)
        Running, without gaps.
    cycles : Cycles
        Strokes from dead centre to dead centre, for the spread.

    Returns
    -------
    period_s, period_std_s, spread_s : float
    n_cycles : int
        Whole turns, from any angle to the same angle; 0 where there is none.

    Notes
    -----
    The mean is time over whole turns, stretch by stretch, averaged over the starting angles that a stretch
    allows, so only its ends carry the error of the angle and the ripple within a stroke drops out. Where the
    strokes differ by more than that error, `std_of_mean` of them is added: the strokes are then a sample of how the
    saw runs (standard uncertainty of type A). The gain of averaging over the starting angles is
    not claimed, so that at a constant rate the uncertainty is conservative by up to a factor of two. A scale
    error of the clock is not contained.
    """
    total_s, variance, n = 0.0, 0.0, 0
    rising = angle.angle_rad + 1e-12 * np.arange(len(angle.angle_rad))
    for start, end in stretches:
        first, last = np.interp([start, end], angle.time_s, rising)
        turns = int((last - first) / (2 * np.pi) + 1e-9)
        if turns < 1:
            continue
        begin = np.linspace(first, max(last - 2 * np.pi * turns, first), 33)
        times = np.interp(np.stack([begin, begin + 2 * np.pi * turns]), rising, angle.time_s)
        lasted = np.asarray(times[1] - times[0])
        duration = float(np.mean(lasted))
        if len(cycles.index) < 3:  # too few to show a spread; that over the starting angles stands for it
            variance += float(np.var(lasted))
        std = np.interp(times, angle.time_s, angle.angle_std_rad)
        variance += float(np.mean(std**2)) * 2 * (duration / turns / (2 * np.pi)) ** 2
        total_s, n = total_s + duration, n + turns
    if n == 0:
        return 0.0, 0.0, 0.0, 0
    mean, variance = total_s / n, variance / n**2
    periods = cycles.period_s
    spread = float(np.std(periods, ddof=1)) if len(periods) > 1 else 0.0
    if len(periods) > 2:
        std = np.interp([cycles.start_s, cycles.end_s], angle.time_s, angle.angle_std_rad)
        of_angle = 2 * float(np.mean(std**2)) * (mean / (2 * np.pi)) ** 2
        if spread**2 > of_angle * (1 + 4 * np.sqrt(2 / len(periods))):
            # What is wrong of a dead centre makes one stroke longer and the next one shorter.
            variance += std_of_mean(periods, may_alternate=True)[0] ** 2
    return mean, float(np.sqrt(variance)), spread, n


def from_displacement(
    angle: CrankAngle,
    stretches: Sequence[tuple[float, float]],
    cycles: Cycles,
    stroke: StrokeLine | None,
    band_hz: tuple[float, float],
    doubt: str = "",
) -> PeriodEstimate | None:
    """Period from the crank angle, checked against the spectrum of the displacement.

    Parameters
    ----------
    angle : CrankAngle
    stretches : sequence of (start_s, end_s)
        Running, without gaps.
    cycles : Cycles
        From dead centre to dead centre.
    stroke : StrokeLine or None
        From the displacement's spectrum; None where it is too short for one.
    band_hz : tuple of float
    doubt : str
        What else speaks against full confidence; empty if nothing does.

    Returns
    -------
    PeriodEstimate or None
        None without a whole turn.
    """
    period, std, spread, n = mean_period(angle, stretches, cycles)
    if n == 0:
        return None
    confidence: Confidence = "high"
    reason = f"{n} complete strokes of the displacement, one line per stroke"
    rivals = stroke.rivals if stroke is not None else ()
    allowed = _DOUBTED_OFF if doubt else max(0.03, 3 * spread / period)
    if stroke is not None and abs(stroke.rate_hz * period - 1) > allowed:
        confidence = "low"
        reason = f"the stroke count differs from the spectrum, which gives {stroke.rate_hz:.4g} Hz"
        reason = f"{doubt}; {reason}" if doubt else reason
        found = PeriodCandidate(
            period_s=1 / stroke.rate_hz, relative_power=1.0, reason="strongest line of the spectrum"
        )
        rivals = (found, *rivals)
    elif stroke is not None and stroke.doubts:
        confidence, reason = "moderate", f"in the displacement {stroke.doubts[0]}"
    elif doubt:
        confidence, reason = "moderate", doubt
    if not band_hz[0] <= 1 / period <= band_hz[1]:
        confidence = "low"
        reason = (
            f"{1 / period:.4g} Hz is outside of {band_hz[0]:g} to {band_hz[1]:g} Hz, the rates that [analysis] allows"
        )
    if n < 3:
        confidence, reason = ("low" if n == 1 else "moderate"), f"only {n} complete stroke(s)"
    if confidence == "moderate" and std > _MOST_REL_STD * period:
        confidence, reason = "low", f"{reason}; the period is known to {100 * std / period:.2g} % only"
    return PeriodEstimate(
        period_s=period,
        period_std_s=std,
        spread_s=spread,
        n_cycles=n,
        confidence=confidence,
        reason=reason,
        channel=angle.source,
        rivals=rivals,
    )


def from_line(
    angle: CrankAngle,
    stretches: Sequence[tuple[float, float]],
    cycles: Cycles,
    stroke: StrokeLine,
    others: Sequence[StrokeLine],
    band_hz: tuple[float, float],
    nominal_hz: tuple[float, float] | None = None,
) -> PeriodEstimate | None:
    """Period from the phase of a line of the force or of a current.

    Parameters
    ----------
    angle : CrankAngle
        From `demodulation.angle_from_line`.
    stretches : sequence of (start_s, end_s)
        Running, without gaps.
    cycles : Cycles
        From dead centre to dead centre.
    stroke : StrokeLine
    others : sequence of StrokeLine
        What the other channels say.
    band_hz : tuple of float
        Allowed stroke rates.
    nominal_hz : tuple of float, optional
        Between which rates the machine runs at its supply, the upper below twice the lower one; it alone decides
        between a rate and its multiples.

    Returns
    -------
    PeriodEstimate or None
        Confidence "moderate" of a force at a nominal rate, else "low"; None without a whole turn.
    """
    period, std, spread, n = mean_period(angle, stretches, cycles)
    if n == 0:
        return None
    confidence: Confidence = "moderate"
    agreeing = [o.channel for o in others if abs(o.rate_hz * period - 1) < 0.02]
    reason = "from the force, without displacement"
    if agreeing:
        reason += f"; {' and '.join(agreeing)} agree"
    if stroke.channel != "force_n":
        confidence = "low"
        reason = (
            f"from {stroke.channel} alone: its strongest line may belong to a belt, a harmonic or every "
            "second stroke; a displacement or force signal is needed to decide"
        )
    elif stroke.doubts:
        confidence, reason = "low", f"in the force {stroke.doubts[0]}"
    elif n < 3:
        confidence, reason = "low", f"only {n} complete cycle(s) of the force"
    elif nominal_hz is None:
        confidence = "low"
        reason += "; no nominal rate tells it from its multiples: the configuration needs [plant], the trial its duty"
    elif not nominal_hz[0] <= 1 / period <= nominal_hz[1]:
        confidence = "low"
        reason += f"; at its supply the machine runs at {nominal_hz[0]:.3g} to {nominal_hz[1]:.3g} Hz"
    elif std > _MOST_REL_STD * period:
        confidence, reason = "low", f"{reason}; the period is known to {100 * std / period:.2g} % only"
    return PeriodEstimate(
        period_s=period,
        period_std_s=std,
        spread_s=spread,
        n_cycles=n,
        confidence=confidence,
        reason=reason,
        channel=stroke.channel,
        rivals=possible_orders(stroke, band_hz),
    )


def line_noise_power(stroke: StrokeLine, window_cycles: float, values: Floats) -> float:
    """Noise as squared amplitude through a Hann window of so many cycles, for the phase's uncertainty.

    Parameters
    ----------
    stroke : StrokeLine
    window_cycles : float
    values : ndarray, shape (n,)
        The signal, for a floor that rounding alone would make 0.

    Returns
    -------
    float
        Unit of the signal squared.
    """
    resolution_hz = stroke.rate_hz * stroke.order / window_cycles
    return max(stroke.noise_power * resolution_hz, 1e-24 * float(np.var(values)))
