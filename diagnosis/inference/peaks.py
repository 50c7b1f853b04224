"""Narrow lines in the spectrum of what a channel has beside its mean stroke, over time or over the stroke."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS

# Bins of a spectrum: of its floor, of a line, beside a line, and from the middle of a line to where its window ends.
_FLOOR_BINS, _LINE_BINS, _FOOT_BINS, _WINDOW_BINS = 40, 3, (5, 8), 2
_PEAKS = 4
# Steps on which samples are placed, for one at the highest line: so fine that they are as good as where they were.
_FINER = 4
# A line of time is smeared over the cycles a stroke by as much as the speed changes in a trial, and its peak is lower.
_SMEARED, _SHARPER = 0.05, 1.2
_NUMBERS: Final = SETTINGS.off_stroke


@dataclass(frozen=True, kw_only=True, slots=True)
class Peak:
    """One line in the spectrum of one channel of one trial.

    Attributes
    ----------
    place : float
        Hz, or cycles a stroke.
    width : float
        Resolution of the spectrum, in the same unit.
    power : float
        Over the floor around it.
    share : float
        Of the variance that does not follow the stroke.
    amplitude : float
        In the unit of the channel.
    """

    place: float
    width: float
    power: float
    share: float
    amplitude: float


def near_harmonic(n_strokes: float) -> float:
    """Cycles a stroke that a harmonic takes: as it scatters, or as the window spreads it over so many strokes."""
    return max(_NUMBERS.near_harmonic, _WINDOW_BINS / n_strokes)


@dataclass(frozen=True, kw_only=True, slots=True)
class Spectrum:
    """Of a series, through a Hann window.

    Attributes
    ----------
    place, power : ndarray, shape (n,)
        Hz or cycles a stroke, and the squares of the transform there.
    gain : float
        Sum of the window at the samples.
    sample_rate : float
        Samples a second, or a stroke: around its multiples stand the images of lines.
    total : float
        Power of all up to half of the sample rate.
    """

    place: Floats
    power: Floats
    gain: float
    sample_rate: float
    total: float

    @classmethod
    def of(cls, at: Floats, values: Floats, span: float, sample_rate: float, highest: float) -> Spectrum:
        """Transform samples where they were taken, each shape (n,).

        Nothing stands between samples, so nothing is interpolated, and over the stroke, in which they are not even, a
        line above half of the samples a stroke is where it is; only its images are blurred.

        Parameters
        ----------
        at : ndarray
            Seconds, or strokes; what is not within 0 and `span` is left out.
        values : ndarray
        span, sample_rate : float
        highest : float
            Place up to which lines are looked for.
        """
        from scipy.fft import next_fast_len

        n_steps = next_fast_len(int(_FINER * span * highest), real=True)
        steps = at * (n_steps / span)
        inside = (steps >= 0.0) & (steps < n_steps - 1)
        steps = steps[inside]
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi / n_steps * steps)
        weighed = window * values[inside]
        # The two steps beside a sample share it.
        before = steps.astype(np.int64)
        behind = (steps - before) * weighed
        placed = np.bincount(before, weights=weighed - behind, minlength=n_steps)
        placed += np.bincount(before + 1, weights=behind, minlength=n_steps)
        n_lines = int(span * highest) + 1
        return cls(
            place=np.arange(n_lines) / span,
            power=np.abs(np.fft.rfft(placed)[:n_lines]) ** 2,
            gain=float(window.sum()),
            sample_rate=sample_rate,
            total=0.5 * len(weighed) * float(weighed @ weighed),
        )

    def sampled(self, place: Floats | float) -> Floats:
        """Where a line of an even clock stands, seen no finer than the samples do: its place, or that of its image."""
        return np.abs(place - self.sample_rate * np.round(place / self.sample_rate))

    def between(self, k: int) -> float:
        """Place of a line whose largest bin is k, by the larger of its neighbours."""
        before, middle, behind = np.sqrt(self.power[k - 1 : k + 2])
        ratio = max(before, behind) / middle
        off = min(max((2.0 * ratio - 1.0) / (ratio + 1.0), 0.0), 0.5)
        return float((k + (off if behind > before else -off)) * self.place[1])

    def amplitude(self, k: int) -> float:
        """Amplitude of a sine of all that stands in the line around bin k."""
        # One of unit amplitude puts gain^2 / 4 into the middle of its line.
        return 2.0 * float(np.sqrt(self.power[_around(k)].sum() / (1.5 * self.gain**2)))

    def amplitudes_at(self, places: Floats, per_stroke: float) -> Floats:
        """Amplitudes at some places; NaN beyond the spectrum, and where a harmonic of the stroke stood and was taken.

        `per_stroke` is a stroke's own place.
        """
        bins = np.round(places / self.place[1]).astype(np.int64)
        off = np.abs(places - per_stroke * np.round(places / per_stroke))
        seen = (bins < len(self.power)) & (off > _WINDOW_BINS * self.place[1])
        return np.array([self.amplitude(k) if one else np.nan for k, one in zip(bins.tolist(), seen, strict=True)])


def peaks_of(spectrum: Spectrum, per_stroke: float) -> tuple[Peak, ...]:
    """Largest lines of a series, away from the harmonics of the stroke; `per_stroke` is a stroke's own place."""
    from scipy.ndimage import median_filter

    place, power = spectrum.place, spectrum.power
    order = place / per_stroke
    floor = median_filter(power, 2 * _FLOOR_BINS + 1) / np.log(2.0)
    slow = order <= _NUMBERS.lowest_order
    total = spectrum.total - float(power[slow].sum())
    if total <= 0:
        return ()
    ratio = power / np.maximum(floor, 1e-12 * total)
    width = float(place[1])
    is_locked = np.zeros(len(order), dtype=bool)
    for one in (order, spectrum.sampled(place) / per_stroke):
        is_locked |= np.abs(one - np.round(one)) < near_harmonic(1.0 / order[1])
    ratio[slow | is_locked | ~_is_narrow(power)] = 0.0
    ratio[-1] = 0.0  # one half of a line
    found: list[Peak] = []
    while len(found) < _PEAKS:
        k = int(np.argmax(ratio))
        if ratio[k] < _NUMBERS.seen_power:
            break
        at, height = spectrum.between(k), float(ratio[k])
        ratio[_around(k)] = 0.0
        share = float(power[_around(k)].sum()) / total
        peak = Peak(place=at, width=width, power=height, share=share, amplitude=spectrum.amplitude(k))
        images = [p for p in found if abs(spectrum.sampled(at) - spectrum.sampled(p.place)) < _LINE_BINS * width]
        # Of a line and its images the lowest that is not blurred: an even speed blurs none, and all are alike.
        if not images:
            found.append(peak)
        elif at < images[0].place and images[0].power < _SHARPER * height:
            found[found.index(images[0])] = peak
    return tuple(found)


def _around(k: int) -> slice:
    """Bins of the line in the middle of which bin k is."""
    return slice(max(k - _LINE_BINS, 0), k + _LINE_BINS + 1)


def not_sharper_in(other: Sequence[Peak], peaks: Sequence[Peak], to_other: float) -> tuple[Peak, ...]:
    """Lines without those with more power in the other spectrum: while the speed changes, a line is narrow in one.

    Parameters
    ----------
    other, peaks : sequence of Peak
    to_other : float
        Place in the other spectrum of what is at 1 in this one, at the mean stroke rate.
    """
    return tuple(
        p
        for p in peaks
        if not any(
            abs(p.place * to_other - q.place) < _SMEARED * q.place and q.power > _SHARPER * p.power for q in other
        )
    )


def _is_narrow(power: Floats) -> np.ndarray:
    """Bins that are the largest nearby and far above their surroundings on either side."""
    from scipy.ndimage import maximum_filter1d

    near = maximum_filter1d(power, 2 * _LINE_BINS + 1)
    first, last = _FOOT_BINS
    padded = np.pad(power, last, mode="reflect")
    n = len(power)
    left, right = (
        np.mean([padded[last + sign * k : last + sign * k + n] for k in range(first, last + 1)], axis=0)
        for sign in (-1, 1)
    )
    return (power >= near) & (np.maximum(left, right) < _NUMBERS.foot_share * power)
