"""Inner products of a whitened problem once its nuisances are integrated out, and beside further ones.

M = I + B B' of whitened noise and nuisances B is never formed (Woodbury).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.patchwork import Patchwork


class Marginal:
    """Inner products under M = I + B B' (whitened noise plus nuisances), for a subset of rows and scaled priors.

    Parameters
    ----------
    problem : LinearProblem
    scale : ndarray, shape (p,), optional
        Factor on the prior standard deviations (5 for a plant that is retuned freely).
    rows : ndarray of bool, shape (n,), optional
    extra : ndarray, shape (n, q), optional
        Further nuisance columns, already times their prior standard deviation.
    """

    def __init__(
        self,
        problem: LinearProblem,
        *,
        scale: Floats | None = None,
        rows: np.ndarray | None = None,
        extra: Floats | None = None,
    ) -> None:
        self.settings = problem.settings
        self._rows = slice(None) if rows is None else rows
        self.data = problem.data[self._rows]
        design = problem.nuisance if scale is None else problem.nuisance * scale
        design = design[self._rows]
        self._blocks: tuple[Patchwork, ...] = (Patchwork(design),)
        self._root = _root_of(self._inner(design))
        self._without: Marginal | None = None
        if extra is not None:
            self._extend(extra[self._rows])

    def beside(self, extra: Floats) -> Marginal:
        """With further nuisance columns, shape (n, q), times their prior standard deviation: what is known is kept."""
        found = Marginal.__new__(Marginal)
        found.settings, found.data, found._rows = self.settings, self.data, self._rows
        found._blocks, found._root, found._without = self._blocks, self._root, self
        found._extend(extra[self._rows])
        return found

    def _extend(self, extra: Floats) -> None:
        """Add columns: the Cholesky factor of all has that of the first ones in its corner."""
        taken = self.half(extra)
        own = _root_of(extra.T @ extra - taken.T @ taken)
        self._blocks = (*self._blocks, Patchwork(extra))
        self._root = np.block([[self._root, np.zeros_like(taken)], [taken.T, own]])

    @cached_property
    def data_half(self) -> Floats:
        """`half` of the data."""
        return self.half(self.data, None if self._without is None else self._without.data_half)

    @property
    def misfit(self) -> float:
        """What the nuisances leave of the data, squared, and they themselves, both in standard deviations."""
        return float(self.data @ self.data - self.data_half @ self.data_half)

    @property
    def log_determinant(self) -> float:
        """Of M."""
        return 2.0 * float(np.log(np.diag(self._root)).sum())

    @property
    def log_evidence(self) -> float:
        """Of the data, absolute."""
        return -0.5 * (self.misfit + self.log_determinant)

    def half(self, columns: Floats, known: Floats | None = None) -> Floats:
        """What of columns, shape (n,) or (n, q), the nuisances take up: h with S' M^-1 T = S' T - h(S)' h(T), (p, q).

        `known` is `half` of the same columns without the nuisances that were added last.
        """
        from scipy.linalg import solve_triangular

        if known is None:
            return solve_triangular(self._root, self._inner(columns), lower=True)
        n = len(known)
        rest = self._blocks[-1].transposed_times(columns) - self._root[n:, :n] @ known
        return np.concatenate([known, solve_triangular(self._root[n:, n:], rest, lower=True)])

    def taken_up(self) -> Floats:
        """What the nuisances take up of every feature: H, shape (p, n), with M^-1 = I - H' H."""
        from scipy.linalg import solve_triangular

        whole = np.hstack([block.times(np.eye(block.shape[1])) for block in self._blocks])
        return solve_triangular(self._root, whole.T, lower=True)

    def gram(self, columns: Floats) -> tuple[Floats, Floats]:
        """S' M^-1 S, shape (q, q), and S' M^-1 y, shape (q,), for full-length columns S, shape (n, q)."""
        return self.grams([columns])[0]

    def square(self, column: Floats) -> float:
        """S' M^-1 S of one full-length column, shape (n,)."""
        shown = column[self._rows]
        half = self.half(shown)
        return float(shown @ shown - half @ half)

    def grams(self, several: Sequence[Floats]) -> list[tuple[Floats, Floats]]:
        """`gram` of each of several sets of columns, in one pass over the nuisances."""
        stacked = side_by_side(several, len(several[0]))[self._rows]
        half = self.half(stacked)
        ends = np.cumsum([0, *(columns.shape[1] for columns in several)])
        pairs = [(stacked[:, a:b], half[:, a:b]) for a, b in pairwise(ends)]
        return [(s.T @ s - h.T @ h, s.T @ self.data - h.T @ self.data_half) for s, h in pairs]

    def rest(self, columns: Floats) -> Floats:
        """What the best nuisances leave of columns, shape (n,) or (n, q)."""
        return self.split(columns)[1]

    @cached_property
    def data_split(self) -> tuple[Floats, Floats]:
        """`split` of the data."""
        return self.split(self.data)

    def split(self, columns: Floats) -> tuple[Floats, Floats]:
        """Best nuisances of columns, shape (n,) or (n, q), in units of their prior std, and what they leave."""
        from scipy.linalg import cho_solve

        best = cho_solve((self._root, True), self._inner(columns))
        ends = np.cumsum([block.shape[1] for block in self._blocks])[:-1]
        taken = sum(block.times(part) for block, part in zip(self._blocks, np.split(best, ends), strict=True))
        return best, columns - taken

    def weighted_sum(self, weights: Floats) -> tuple[float, float]:
        """Posterior mean and standard deviation of a weighted sum of the first nuisances, in units of their prior std.

        `weights`, shape (k,): the others do not count.
        """
        from scipy.linalg import solve_triangular

        whole = np.zeros(len(self._root))
        whole[: len(weights)] = weights
        half = solve_triangular(self._root, whole, lower=True)
        return float(whole @ self.data_split[0]), float(np.sqrt(half @ half))

    def estimate(self) -> tuple[Floats, Floats]:
        """Posterior mean and standard deviation of the nuisances, in units of their (scaled) prior std."""
        from scipy.linalg import cho_solve

        std = np.sqrt(np.diag(cho_solve((self._root, True), np.eye(len(self._root)))))
        return self.data_split[0], std

    def _inner(self, columns: Floats) -> Floats:
        """Inner products of the nuisances with columns, shape (n,) or (n, q)."""
        return np.concatenate([block.transposed_times(columns) for block in self._blocks])


class Widened:
    """Further nuisance columns whose prior standard deviation is tried at several sizes.

    The inner products of all columns are computed once; each size costs one small Cholesky factor.

    Parameters
    ----------
    alone : Marginal
        Without them; of all rows.
    extra : ndarray, shape (n, q)
    """

    def __init__(self, alone: Marginal, extra: Floats) -> None:
        self._alone, self._extra = alone, extra
        self._taken = alone.half(extra)
        self._gram = extra.T @ extra - self._taken.T @ self._taken
        self._moment = extra.T @ alone.data - self._taken.T @ alone.data_half

    def cross(self, columns: Floats, half: Floats) -> Floats:
        """Inner products with other columns, shape (q, columns), of which the nuisances alone take up `half`."""
        return self._extra.T @ columns - self._taken.T @ half

    def at(self, size: float | Floats, cross: Floats | None = None) -> tuple[float, Floats, Floats]:
        """Log evidence, and what is taken up beyond `alone` of the data, (r,), and of those of `cross`, (r, columns).

        `size` is that of all columns, or of each.
        """
        from scipy.linalg import solve_triangular

        scale = np.broadcast_to(size, self._moment.shape)
        kept = scale > 0
        scale = scale[kept]
        root = _root_of(scale[:, None] * self._gram[np.ix_(kept, kept)] * scale)
        data_half = solve_triangular(root, scale * self._moment[kept], lower=True)
        taken = np.zeros((len(self._moment), 0)) if cross is None else cross
        half = solve_triangular(root, scale[:, None] * taken[kept], lower=True)
        gained = 0.5 * float(data_half @ data_half) - float(np.log(np.diag(root)).sum())
        return self._alone.log_evidence + gained, data_half, half


def best_within(gram: Floats, moment: Floats, limits: Floats) -> Floats:
    """Likeliest sizes of columns with a unit prior, none beyond its limit, shape (q,).

    Parameters
    ----------
    gram : ndarray, shape (q, q)
    moment : ndarray, shape (q,)
        Of `Marginal.gram`.
    limits : ndarray, shape (q,)
        Largest size of either sign; inf where there is none, 0 leaves a column out.

    Examples
    --------
    >>> best_within(np.array([[3.0, 2.0], [2.0, 3.0]]), np.array([6.0, 6.0]), np.array([0.5, np.inf])).round(6).tolist()
    [0.5, 1.25]
    >>> best_within(np.array([[3.0, 2.0], [2.0, 3.0]]), np.array([6.0, 6.0]), np.array([0.0, np.inf])).round(6).tolist()
    [0.0, 1.5]
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    sizes = np.zeros(len(moment))
    free = limits > 0.0
    root = _root_of(gram[np.ix_(free, free)])
    half = solve_triangular(root, moment[free], lower=True)
    sizes[free] = lsq_linear(root.T, half, bounds=(-limits[free], limits[free])).x
    return sizes


def side_by_side(columns: Sequence[Floats], n: int) -> Floats:
    """Columns of shape (n, q) each as one matrix, column by column in memory: many narrow ones are copied whole."""
    return np.concatenate([np.zeros((0, n)), *(part.T for part in columns)]).T


def _root_of(gram: Floats) -> Floats:
    """Cholesky factor of the inner products of columns with their unit prior."""
    return np.linalg.cholesky(np.eye(len(gram)) + gram)
