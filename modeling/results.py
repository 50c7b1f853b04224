"""What a fit and a runtime prediction return."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.correlated import covariance_of_means, std_of_mean

FitStatus = Literal["ok", "at_bound", "not_identifiable", "not_converged", "stalled", "contradicted"]
RuntimeStatus = Literal["ok", "stalled", "cannot_start", "never_reached"]


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterEstimates:
    """Everything a fit estimated together, with its joint covariance.

    Attributes
    ----------
    names : tuple of str
        Plant constants, `k_fc_n_s_per_m` and sensor gains, SI units in the names.
    values, prior_std : ndarray, shape (p,)
        `prior_std` is infinite where nothing was known before.
    covariance : ndarray, shape (p, p)
    by_stroke : tuple of ndarray, shape (n_strokes, p)
        By how much each stroke of a trial moves the estimates, their mean taken off; one array a trial.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    prior_std: NDArray[np.float64]
    covariance: NDArray[np.float64]
    by_stroke: tuple[NDArray[np.float64], ...] = ()

    def value(self, name: str) -> float:
        """Return the estimate of one parameter."""
        return float(self.values[self.names.index(name)])

    def std(self, name: str) -> float:
        """Return the standard uncertainty of one parameter."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def std_along(self, slopes: Mapping[str, float]) -> float:
        """Return the standard uncertainty of what changes with the estimates by `slopes`, 0 for names not there.

        Strokes are correlated in some quantities more than in others, and where the noise of single strokes cancels,
        the rest is the most correlated: the scatter of the strokes counts as it is in this quantity.
        """
        slope = np.array([slopes.get(name, 0.0) for name in self.names])
        rest = self.covariance - sum(covariance_of_means(series) for series in self.by_stroke)
        scatter = sum(std_of_mean(series @ slope)[0] ** 2 for series in self.by_stroke)
        return float(np.sqrt(max(slope @ rest @ slope, 0.0) + scatter))

    def correlation(self, first: str, second: str) -> float:
        """Return the correlation of the errors of two parameters, -1..1."""
        i, j = self.names.index(first), self.names.index(second)
        scale = self.std(first) * self.std(second)
        return float(self.covariance[i, j] / scale) if scale > 0 else 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class CuttingFit:
    """Linear cutting coefficient k_Fc with its uncertainty.

    Attributes
    ----------
    k_fc_n_s_per_m : float
    std_n_s_per_m : float
        Combined standard uncertainty: scatter, autocorrelation of the residuals, nominal parameters, gains.
    statistical_std_n_s_per_m : float
        The part that more data would shrink.
    method : str
        "current", "force", "current_and_force".
    status : FitStatus
        "contradicted": found, but only with plant constants or gains far off their nominal values, with a stroke that
        misses the measured one by more than a quarter of its rms, or from channels that are clipped, swapped,
        reversed, in another unit or moved in time; the notes say which.
    rmse_a : float or None
        Root mean square residual of the motor current, A.
    rmse_n : float or None
        Root mean square residual of the force, N.
    n_simulations : int
    identifiability : str
        One sentence: what the data can tell apart and what they cannot.
    notes : tuple of str
    estimates : ParameterEstimates or None
        The parameters that were estimated along with k_Fc; None where the method estimates k_Fc alone.
    """

    k_fc_n_s_per_m: float
    std_n_s_per_m: float
    statistical_std_n_s_per_m: float
    method: str
    status: FitStatus
    rmse_a: float | None
    rmse_n: float | None
    n_simulations: int
    identifiability: str
    notes: tuple[str, ...] = ()
    estimates: ParameterEstimates | None = None

    @property
    def in_outline(self) -> CuttingFit:
        """Without what is as long as the recording: what each stroke moves, which a runtime takes."""
        if self.estimates is None:
            return self
        return replace(self, estimates=replace(self.estimates, by_stroke=()))


@dataclass(frozen=True, kw_only=True, slots=True)
class RuntimePrediction:
    """Battery runtime from full charge to the cut-off.

    Attributes
    ----------
    runtime_s : float
        nan only where status is not "ok".
    std_s : float
        Standard uncertainty from k_Fc and plant.
    mean_battery_current_a, mean_motor_current_a : float
        Over the discharge.
    appendix_a_runtime_s : float or None
        Usable charge over the mean battery current of the measurement (Eq. A.2).
    ended_by : {"soc", "voltage"}
    numerical_error_s : float
        Estimated error of the cycle averaging.
    status : RuntimeStatus
    contributions_s : mapping of str to float
        Standard deviation contributed by each parameter, s.
    notes : tuple of str
        Where the model is used outside the range that it holds in: a learned term, a fitted battery.
    battery_basis : str
        What the battery was fitted to, in one line; empty where its configuration does not say.
    """

    runtime_s: float
    std_s: float
    mean_battery_current_a: float
    mean_motor_current_a: float
    appendix_a_runtime_s: float | None
    ended_by: Literal["soc", "voltage"]
    numerical_error_s: float
    status: RuntimeStatus
    contributions_s: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    battery_basis: str = ""
