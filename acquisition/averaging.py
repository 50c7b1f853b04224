"""Mean of a resting value: how sure it is, and whether it rested at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.correlated import autocorrelation_time
from sawbench.bench.errors import InputError

Floats = NDArray[np.float64]
_N_BLOCKS: Final = 10
_MIN_SAMPLES: Final = 50


@dataclass(frozen=True, kw_only=True, slots=True)
class RestingMean:
    """Mean of one channel over a while, in the unit of the values.

    Attributes
    ----------
    mean, mean_std : float
        Standard uncertainty of the mean from the scatter alone, autocorrelation respected.
    noise_std : float
        Of single samples about the straight line through them.
    n_samples : int
    n_effective : float
        Independent samples that would give the same uncertainty.
    drift_per_s, drift_std_per_s : float
        Slope of the straight line and its standard uncertainty.
    block_spread : float
        Largest minus smallest mean of ten blocks, the line taken out.
    block_std : float
        Standard uncertainty of one block's mean, from the scatter within the blocks: slow motion does not hide itself.
    seconds : float
    """

    mean: float
    mean_std: float
    noise_std: float
    n_samples: int
    n_effective: float
    drift_per_s: float
    drift_std_per_s: float
    block_spread: float
    block_std: float
    seconds: float

    @property
    def drift(self) -> float:
        """Change over the whole time, by the straight line."""
        return self.drift_per_s * self.seconds

    @property
    def std(self) -> float:
        """Standard uncertainty of the mean, the remaining drift included (as a rectangle, /sqrt 12)."""
        return float(np.hypot(self.mean_std, self.drift / 12**0.5))


def resting_mean(time_s: Floats, values: Floats) -> RestingMean:
    """Average a value that should stand still.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
    values : ndarray, shape (n,)

    Raises
    ------
    InputError
        If there are fewer than 50 samples.
    """
    n = len(values)
    if n < _MIN_SAMPLES:
        raise InputError(f"{n} samples are too few to average, {_MIN_SAMPLES} are needed", remedy="give more --seconds")
    t = time_s - time_s.mean()
    spread = float(t @ t)
    slope = float(t @ values) / spread
    residual = values - values.mean() - slope * t
    tau = autocorrelation_time(residual, may_alternate=True)
    noise = float(np.sqrt(residual @ residual / max(n - 2, 1)))
    blocks = np.array_split(residual, _N_BLOCKS)
    block_means = np.array([block.mean() for block in blocks])
    within = np.concatenate([block - block.mean() for block in blocks])
    return RestingMean(
        mean=float(values.mean()),
        mean_std=noise * (tau / n) ** 0.5,
        noise_std=noise,
        n_samples=n,
        n_effective=n / tau,
        drift_per_s=slope,
        drift_std_per_s=noise * (tau / spread) ** 0.5,
        block_spread=float(np.ptp(block_means)),
        block_std=float(within.std()) * (autocorrelation_time(within, may_alternate=True) * _N_BLOCKS / n) ** 0.5,
        seconds=float(time_s[-1] - time_s[0]),
    )


def unsteady(found: RestingMean, *, tolerance: float, unit: str) -> str:
    """Say why a value did not rest; empty where it did.

    Parameters
    ----------
    found : RestingMean
    tolerance : float
        Change that does not matter, in `unit`. Single samples may scatter ten times as much.
    unit : str

    Notes
    -----
    A drift is one that matters (beyond the tolerance) and is no chance (beyond three standard uncertainties). Ten
    block means of pure noise spread over about three of their standard uncertainties; five and the tolerance are
    allowed.
    """
    if abs(found.drift) > max(tolerance, 3.0 * found.drift_std_per_s * found.seconds):
        return f"it drifts by {found.drift:+.3g} {unit} in {found.seconds:.1f} s ({tolerance:.3g} {unit} are allowed)"
    if found.block_spread > tolerance + 5.0 * found.block_std:
        return f"it moves by {found.block_spread:.3g} {unit} while it is averaged ({tolerance:.3g} {unit} are allowed)"
    if found.noise_std > 10.0 * tolerance:
        return f"it vibrates:  {found.noise_std:.3g} {unit} (1 std; {10.0 * tolerance:.3g} {unit} are allowed)"
    return ""
