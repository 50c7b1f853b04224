"""How well each effect, and each pair, explains what mistuned parameters leave."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, pairwise, product

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.marginal import Marginal, Widened, side_by_side
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.log_mean import log_mean_exp, log_mean_exp_rows
from sawbench.modeling.effects.effect import Effect

_N_AMPLITUDES = 40
# Sizes are log-normal about the typical one; those that occur are 95 % of them.
_STDS_OF_RANGE = 4.0
_SAME_VALUE = 1e-6
# A cell of amplitudes that is narrower than this share of what the noise leaves is as good as its middle.
_FLAT_CELL_STDS = 1e-2


@dataclass(frozen=True, kw_only=True, slots=True)
class Explanation:
    """What one effect explains at best.

    Attributes
    ----------
    effect : Effect
    log_evidence : float
        Against the same nuisances without the effect; amplitudes and shapes integrated out.
    column : Column
        Of the best shape.
    amplitude, amplitude_std : float
        In multiples of the typical size; least squares with the nuisances.
    gain : float
        Largest fall of the whitened misfit.
    contribution : ndarray, shape (n,)
        Whitened signature at the fitted size and phase.
    shape_spread : float
        Relative standard deviation of the reported strength between the shapes, as likely as they are.
    form_share : float
        How far nature's form seems to be from the best shape, relative: one of those that were tried.
    mixture : (float, float), optional
        Size and its standard deviation over mixtures of the shapes (`diagnosis.inference.size`), in multiples of the
        typical size: what is reported, where it is there, instead of the amplitude of the best shape.
    size_temperature : float
        See `settings.Forms`.
    """

    effect: Effect
    log_evidence: float
    column: Column
    amplitude: float
    amplitude_std: float
    gain: float
    contribution: Floats
    shape_spread: float = 0.0
    form_share: float = 0.0
    mixture: tuple[float, float] | None = None
    size_temperature: float = SETTINGS.forms.size_temperature

    @property
    def strength(self) -> float:
        """Reported parameter."""
        if self.mixture is not None:
            return self.mixture[0] * self.effect.strength.typical
        return self.effect.reported_strength(self.amplitude * self.effect.strength.typical, self.column.shape)

    @property
    def absent(self) -> float:
        """What the reported parameter is where there is no effect: 0, but 1 of the exponent of the speed.

        0 too where it grows without bound (a stiffness) or belongs to the form (a frequency).
        """
        if self.mixture is not None:
            return 0.0
        without = self.effect.strength_without(self.column.shape)
        return 0.0 if without is None or without == self.strength else without

    @property
    def strength_std(self) -> float:
        """Its standard uncertainty: from the noise, between the shapes, and from what nature's form differs.

        From the noise: half of what one standard deviation of the amplitude either way changes; with what nature's form
        differs, tempered as sizes are. Forms disagree by factors, not by sums: with them a magnitude is right to a
        factor of two, unless the noise alone hides it. So is one that is read off a free wave.
        """
        size, most = abs(self.strength - self.absent), SETTINGS.forms.most_std
        if self.effect.size_of is not None and self.mixture is None:
            return most * size
        by_form = self.form_share if self.mixture is not None else np.hypot(self.shape_spread, self.form_share)
        with_form = float(np.hypot(self._by_noise(self.size_temperature), by_form * size))
        return max(self._by_noise(), min(with_form, most * size))

    @property
    def in_typical_sizes(self) -> tuple[float, float]:
        """Size and its standard deviation, in multiples of the typical size."""
        if self.mixture is not None:
            return self.mixture
        if self.effect.strength.usual is not None:
            over_usual = self.effect.strength.over_usual
            size = over_usual(self.strength)
            return size, abs(over_usual(self.strength + self.strength_std) - size)
        if self.effect.size_of is not None:
            return self.amplitude, self.strength_std / self.effect.strength.typical
        return self.amplitude, self.amplitude_std

    def _by_noise(self, temperature: float = 1.0) -> float:
        """Standard deviation of the strength from the noise."""
        if self.mixture is not None:
            return self.mixture[1] * self.effect.strength.typical
        typical, step = self.effect.strength.typical, np.sqrt(temperature) * self.amplitude_std
        high, low = (
            self.effect.reported_strength(typical * max(self.amplitude + sign * step, 1e-6), self.column.shape)
            for sign in (1.0, -1.0)
        )
        return 0.5 * abs(high - low)


@lru_cache(maxsize=256)
def amplitudes(low: float, high: float) -> Floats:
    """Grid of amplitudes in multiples of the typical size; the cells between them are equally likely."""
    from scipy.special import ndtr, ndtri

    if high / low < 5.0:
        return np.linspace(low, high, 15)
    std = np.log(high / low) / _STDS_OF_RANGE
    first, last = ndtr(np.log([max(low, SETTINGS.forms.least_amplitude), high]) / std)
    return np.exp(std * ndtri(np.linspace(first, last, _N_AMPLITUDES)))


def explain(marginal: Marginal, columns: Sequence[Column]) -> Explanation | None:
    """Integrate amplitude and shape of one effect out.

    Parameters
    ----------
    marginal : Marginal
    columns : sequence of Column
        All shapes of one effect.

    Returns
    -------
    Explanation or None
        None where the campaign shows nothing of it.
    """
    if not columns:
        return None
    inner = marginal.grams([column.columns for column in columns])
    return _explanation(columns, inner, marginal.settings.forms.size_temperature)


class Catalogue:
    """All columns side by side, with the inner products that no choice of nuisances changes.

    Parameters
    ----------
    columns : dict of str to list of Column
        By effect.
    data : ndarray, shape (n,)
    stacked : ndarray, shape (n, q), optional
        The columns side by side, where they are parts of that already.
    """

    def __init__(self, columns: dict[str, list[Column]], data: Floats, stacked: Floats | None = None) -> None:
        self.columns = columns
        entries = [column.columns for found in columns.values() for column in found]
        self.stacked = side_by_side(entries, len(data)) if stacked is None else stacked
        self.moments = self.stacked.T @ data
        self.squares = [columns.T @ columns for columns in entries]

    def rescaled(self, share: Floats, data: Floats) -> Catalogue:
        """The same columns times a share of each row, shape (n, 1), for other data."""
        stacked, start = share * self.stacked, 0
        columns: dict[str, list[Column]] = {}
        for name, entries in self.columns.items():
            columns[name] = []
            for column in entries:
                place = slice(start, start + column.columns.shape[1])
                columns[name].append(replace(column, columns=stacked[:, place]))
                start = place.stop
        return Catalogue(columns, data, stacked)

    def explain(
        self, marginal: Marginal, half: Floats | None = None, *, beside: Collection[str] = ()
    ) -> dict[str, Explanation]:
        """`explain` for every effect beside named ones, without those that show nothing.

        `half` is `Marginal.half` of `stacked`.
        """
        inner, found = iter(self.grams(marginal, half)), {}
        for name, entries in self.columns.items():
            own = zip(entries, islice(inner, len(entries)), strict=True)
            there = [(column, products) for column, products in own if column.is_there_beside(beside)]
            if there:
                columns, products = zip(*there, strict=True)
                found[name] = _explanation(columns, products, marginal.settings.forms.size_temperature)
        return found

    def grams(self, marginal: Marginal, half: Floats | None = None) -> list[tuple[Floats, Floats]]:
        """`Marginal.gram` of every column; `half` is `Marginal.half` of `stacked`."""
        half = marginal.half(self.stacked) if half is None else half
        moments = self.moments - half.T @ marginal.data_half
        ends = np.cumsum([0, *(len(square) for square in self.squares)])
        return [
            (square - half[:, a:b].T @ half[:, a:b], moments[a:b])
            for square, (a, b) in zip(self.squares, pairwise(ends), strict=True)
        ]


def _explanation(
    columns: Sequence[Column], inner: Sequence[tuple[Floats, Floats]], size_temperature: float
) -> Explanation:
    effect = columns[0].effect
    logs = np.empty(len(columns))
    fits: list[tuple[Floats, float, float]] = [(np.zeros(0), np.inf, 0.0)] * len(columns)
    widths = np.array([len(moment) for _, moment in inner])
    for width in dict.fromkeys(widths.tolist()):
        alike = np.flatnonzero(widths == width).tolist()
        grams, moments = (np.array([inner[k][part] for k in alike]) for part in (0, 1))
        logs[alike], found = _fits(effect, grams, moments)
        for k, fit in zip(alike, found, strict=True):
            fits[k] = fit
    best = int(np.argmax(logs))
    solution, std, gain = fits[best]
    strengths = [
        effect.reported_strength(effect.amplitude(fit[0]) * effect.strength.typical, column.shape)
        for column, fit in zip(columns, fits, strict=True)
    ]
    found = Explanation(
        effect=effect,
        log_evidence=log_mean_exp(logs),
        column=columns[best],
        amplitude=effect.amplitude(solution),
        amplitude_std=std,
        gain=gain,
        contribution=columns[best].columns @ solution,
        size_temperature=size_temperature,
    )
    spread = _relative_spread(np.array(strengths) - found.absent, logs, size_temperature)
    return replace(found, shape_spread=spread)


def _relative_spread(values: Floats, logs: Floats, temperature: float) -> float:
    """Standard deviation of the values about the likeliest one, over that one; likely as the tempered logs say.

    No less than the shapes that were tried can resolve: even between the likeliest and the next value.
    """
    weights = np.exp((logs - logs.max()) / temperature)
    best = float(values[np.argmax(logs)])
    if not best:
        return 0.0
    away = np.abs(values - best)
    next_one = float(np.min(away, where=away > _SAME_VALUE * abs(best), initial=np.inf))
    resolved = next_one / np.sqrt(12.0) if np.isfinite(next_one) else 0.0
    return float(np.hypot(np.sqrt(np.sum(weights * away**2) / np.sum(weights)), resolved)) / abs(best)


def explain_formed(
    marginal: Marginal,
    modes: Floats,
    columns: Sequence[Column],
    shares: Sequence[float],
    *,
    beside: Floats | None = None,
) -> tuple[float, Explanation]:
    """Integrate amplitude and shape out as `explain` does, and how far nature's form may be from the catalogue's.

    Parameters
    ----------
    marginal : Marginal
    modes : ndarray, shape (n, q)
        Of `form_modes`.
    columns : sequence of Column
        Shapes of one effect.
    shares : sequence of float
        Standard deviations of the form's error to try, equally likely.
    beside : ndarray, shape (n, r), optional
        `form_modes` of another effect, whose error is tried likewise: one form may be right where the other is not.

    Returns
    -------
    log_evidence : float
        Absolute: of the data, averaged over the shares.
    explanation : Explanation
        For the best share; its `log_evidence` is against the same nuisances and modes without the effect.
    """
    others = np.zeros((len(modes), 0)) if beside is None else beside
    widened = Widened(marginal, np.hstack([others, modes]))
    stacked = side_by_side([c.columns for c in columns], len(modes))
    half_alone = marginal.half(stacked)
    cross, own = widened.cross(stacked, half_alone), stacked.T @ marginal.data - half_alone.T @ marginal.data_half
    places = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(c.columns.shape[1] for c in columns)]))]
    squares = [stacked[:, at].T @ stacked[:, at] - half_alone[:, at].T @ half_alone[:, at] for at in places]
    found = []
    for share, other in product(shares, shares if others.size else (0.0,)):
        of_modes = np.repeat([other, share], [others.shape[1], modes.shape[1]])
        log_z, data_half, half = widened.at(of_modes, cross)
        inner = [
            (square - half[:, at].T @ half[:, at], own[at] - half[:, at].T @ data_half)
            for square, at in zip(squares, places, strict=True)
        ]
        explanation = _explanation(columns, inner, marginal.settings.forms.size_temperature)
        explanation = replace(explanation, form_share=share)
        found.append((log_z + explanation.log_evidence, explanation))
    return log_mean_exp([log_z for log_z, _ in found]), max(found, key=lambda entry: entry[0])[1]


def _fits(effect: Effect, grams: Floats, moments: Floats) -> tuple[Floats, list[tuple[Floats, float, float]]]:
    """Integrate the amplitude out of k shapes of one width.

    Parameters
    ----------
    effect : Effect
    grams : ndarray, shape (k, q, q)
    moments : ndarray, shape (k, q)

    Returns
    -------
    logs : ndarray, shape (k,)
    fits : list of (solution, its standard deviation, gain)
    """
    grid = amplitudes(effect.strength.low, effect.strength.high)
    if moments.shape[1] == 1:
        logs, solutions, stds, gains = _one(grid, grams[:, 0, 0], moments[:, 0])
        return logs, list(zip(solutions, stds, gains, strict=True))
    logs, solutions, stds, gains = _several(grid, grams, moments)
    leading = effect.leading
    if 0 < leading < moments.shape[1]:
        # Overtones without their fundamental do not count.
        bare = np.flatnonzero([effect.amplitude(solution) < grid[0] for solution in solutions])
        solutions[bare] = 0.0
        if len(bare):
            logs[bare], solutions[bare, :leading], stds[bare], gains[bare] = _several(
                grid, grams[bare, :leading, :leading], moments[bare, :leading]
            )
    return logs, list(zip(solutions, stds, gains, strict=True))


def _one(grid: Floats, squares: Floats, inner: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    is_shown = squares > 0.0
    known = np.where(is_shown, squares, 1.0)
    amplitude = np.where(is_shown, np.clip(inner / known, grid[0], grid[-1]), grid[0])
    stds = np.where(is_shown, 1.0 / np.sqrt(known), np.inf)
    logs = log_mean_exp_rows(_within_cells(grid, squares[:, None], inner[:, None]))
    return logs, amplitude[:, None], stds, 2.0 * amplitude * inner - amplitude**2 * squares


def _within_cells(grid: Floats, squares: Floats, inner: Floats) -> Floats:
    """Logarithm of the mean of exp(a inner - a^2 squares / 2) over a between neighbours of the grid, (k, n - 1).

    Where an effect stands high above the noise, its amplitude is known far better than any grid resolves.
    """
    from scipy.special import log_ndtr

    width, middle = np.diff(grid), 0.5 * (grid[1:] + grid[:-1])
    std = 1.0 / np.sqrt(np.maximum(squares, 1e-300))
    wide = width > _FLAT_CELL_STDS * std
    mean = np.where(squares > 0.0, inner * std**2, 0.0)
    # From the tail that is nearer: the difference of two numbers close to 1 would be lost.
    sign = np.where(middle > mean, -1.0, 1.0)
    ends = [np.where(wide, sign * (edge - mean) / std, 0.0) for edge in (grid[:-1], grid[1:])]
    low, high = np.minimum(*ends), np.maximum(*ends)
    share = np.where(wide, -np.expm1(log_ndtr(low) - log_ndtr(high)), 1.0)
    normal = 0.5 * inner * mean + 0.5 * np.log(2.0 * np.pi) + log_ndtr(high) + np.log(share) + np.log(std / width)
    return np.where(wide, normal, middle * inner - 0.5 * middle**2 * squares)


def _several(grid: Floats, grams: Floats, moments: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Amplitude with free phases: every part is normal with variance amplitude^2 / 2."""
    spread = 0.5 * grid**2
    values, vectors = np.linalg.eigh(grams)
    values = np.maximum(values, 0.0)
    turned = np.einsum("kji,kj->ki", vectors, moments)
    widened = 1.0 + spread[:, None] * values[:, None, :]
    logs = 0.5 * spread * np.sum(turned[:, None, :] ** 2 / widened, axis=2) - 0.5 * np.log(widened).sum(axis=2)
    width = moments.shape[1]
    regular = grams + 1e-9 * np.trace(grams, axis1=1, axis2=2)[:, None, None] * np.eye(width)
    solutions = np.linalg.solve(regular, moments[:, :, None])[:, :, 0]
    leading = np.linalg.inv(regular)[:, :2, :2]
    stds = np.sqrt(0.5 * np.trace(leading, axis1=1, axis2=2))
    return log_mean_exp_rows(logs), solutions, stds, np.sum(moments * solutions, axis=1)
