"""One group of withheld trials, with all that does not depend on the cause that is tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class WithheldGroup:
    """One group of trials, with all that does not depend on the cause that is tried.

    Attributes
    ----------
    rows : ndarray of bool, shape (n,)
    data : ndarray, shape (n_rows,)
    base : ndarray, shape (n_rows, p)
        Nuisances.
    root : ndarray, shape (p, p)
        Cholesky factor of the normal matrix of the nuisances by the kept trials.
    pull : ndarray, shape (p,)
        What the kept trials say of the nuisances, solved by `root`.
    half : ndarray, shape (p, n_rows)
        `base`, solved by `root`.
    own, own_fit : ndarray, shape (n_rows, q), (q, n_rows)
        Nuisances of the withheld trials themselves, and what fits them to a residual.
    """

    rows: np.ndarray
    data: Floats
    base: Floats
    root: Floats
    pull: Floats
    half: Floats
    own: Floats
    own_fit: Floats

    @classmethod
    def of(
        cls, rows: np.ndarray, base: Floats, data: Floats, kept: Floats, moment: Floats, is_own: np.ndarray
    ) -> WithheldGroup:  # fmt: skip
        """Solve what does not depend on the cause; `moment`, shape (p,): nuisances times data, over all trials."""
        from scipy.linalg import solve_triangular

        root, own = np.linalg.cholesky(kept), base[:, is_own]
        return cls(
            rows=rows, data=data, base=base, root=np.asarray(root, dtype=np.float64),
            pull=solve_triangular(root, moment - base.T @ data, lower=True),
            half=solve_triangular(root, base.T, lower=True),
            own=own,
            own_fit=np.asarray(np.linalg.solve(np.eye(own.shape[1]) + own.T @ own, own.T), dtype=np.float64),
        )  # fmt: skip

    def error(self, held: Floats, cross: Floats, gram: Floats, moment: Floats) -> float:
        """Sum of squares that nuisances and columns leave, which the kept trials alone know.

        Parameters
        ----------
        held : ndarray, shape (n_rows, m)
            The columns.
        cross, gram, moment : ndarray, shape (p, m), (m, m), (m,)
            Their inner products with nuisances, each other and the data, over all trials.
        """
        from scipy.linalg import solve_triangular

        half = solve_triangular(self.root, cross - self.base.T @ held, lower=True)
        normal = np.eye(gram.shape[1]) + gram - held.T @ held - half.T @ half
        amplitudes = np.linalg.solve(normal, moment - held.T @ self.data - half.T @ self.pull)
        rest = self.data - held @ amplitudes - (self.pull - half @ amplitudes) @ self.half
        rest -= self.own @ (self.own_fit @ rest)
        return float(rest @ rest)
