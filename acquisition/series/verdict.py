"""Whether a trial is good, agrees with its repetitions, and what the trials say about the wear of their blade."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sawbench.acquisition.series.plan import Setting

# What a repetition is compared by: attribute -> words.
COMPARED: Final = {"k_fc_n_s_per_m": "k_Fc", "peak_force_n": "peak force", "rms_motor_current_a": "motor current"}
# One repetition in a hundred is called an outlier wrongly.
_FALSE_ALARMS: Final = 0.01
# Degrees of freedom that the stated repeatability counts as.
_PRIOR_FREEDOM: Final = 12.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialMeasures:
    """What a trial gave, as far as the series needs it.

    Attributes
    ----------
    trial_id : str
    setting : tuple
        Material, duty, feed (mm/s), thickness (mm).
    blade : str
    stroke_rate_hz, peak_force_n, rms_motor_current_a : float or None
    k_fc_n_s_per_m, k_fc_std_n_s_per_m : float or None
        With its standard uncertainty.
    k_fc_statistical_std_n_s_per_m : float or None
        The part that differs from trial to trial.
    faults : tuple of str
        Why the trial is not to be kept; empty where it is good.
    remarks : tuple of str
    """

    trial_id: str
    setting: Setting
    blade: str
    stroke_rate_hz: float | None = None
    peak_force_n: float | None = None
    rms_motor_current_a: float | None = None
    k_fc_n_s_per_m: float | None = None
    k_fc_std_n_s_per_m: float | None = None
    k_fc_statistical_std_n_s_per_m: float | None = None
    faults: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class BladeGrowth:
    """Growth of the specific force on one blade, at one setting.

    Attributes
    ----------
    blade, first_trial, last_trial : str
    growth, growth_std : float
        Relative, with its statistical standard uncertainty.
    """

    blade: str
    first_trial: str
    last_trial: str
    growth: float
    growth_std: float

    @property
    def words(self) -> str:
        """One line."""
        return (
            f"specific force on blade {self.blade}: {100 * self.growth:+.1f} ± {100 * self.growth_std:.1f} % from "
            f"{self.first_trial} to {self.last_trial}"
        )


def outliers(trial: TrialMeasures, others: Sequence[TrialMeasures], repeatability: float) -> tuple[str, ...]:
    """Say in which quantities a trial disagrees with the repetitions of its setting.

    Parameters
    ----------
    trial : TrialMeasures
    others : sequence of TrialMeasures
        The trials of the series that were kept, of every setting, without `trial`.
    repeatability : float
        Relative standard deviation expected between repetitions.

    Returns
    -------
    tuple of str
        Empty where it agrees or there is no repetition.

    Notes
    -----
    The logarithm of the value is compared with the mean of its n repetitions by a t-test at 1 % with variance
    s^2 (1 + 1/n). s pools the scatter of all settings of the series with the stated repeatability, which counts as 12
    degrees of freedom. Fails: a wrong first trial makes the right second one look wrong as well; three tell which.
    """
    from scipy.special import stdtrit

    found = []
    for name, words in COMPARED.items():
        value = _log(getattr(trial, name))
        groups: dict[Setting, list[float]] = {}
        for other in others:
            if (logarithm := _log(getattr(other, name))) is not None:
                groups.setdefault(other.setting, []).append(logarithm)
        same = groups.get(trial.setting, [])
        if value is None or not same:
            continue
        freedom = _PRIOR_FREEDOM + sum(len(group) - 1 for group in groups.values())
        squares = _PRIOR_FREEDOM * repeatability**2 + sum(_squares(group) for group in groups.values())
        mean = sum(same) / len(same)
        scale = math.sqrt(squares / freedom * (1.0 + 1.0 / len(same)))
        allowed = float(stdtrit(freedom, 1.0 - 0.5 * _FALSE_ALARMS)) * scale
        if abs(value - mean) > allowed:
            found.append(
                f"{words} is {100 * math.expm1(value - mean):+.0f} % from the mean of its "
                f"{'repetition' if len(same) == 1 else f'{len(same)} repetitions'} (allowed ± {100 * allowed:.0f} %)"
            )
    return tuple(found)


def blade_growth(kept: Sequence[TrialMeasures], blade: str) -> BladeGrowth | None:
    """Return how far the specific force has grown on a blade, the paper's measure of wear.

    Parameters
    ----------
    kept : sequence of TrialMeasures
        In the order in which they were recorded.
    blade : str

    Returns
    -------
    BladeGrowth or None
        k_Fc of the latest trial on it that repeats a setting, against the first of that setting; at one setting the
        specific force is proportional to k_Fc. None where no setting was cut twice with it.
    """
    cut = [trial for trial in kept if trial.blade == blade and trial.k_fc_n_s_per_m]
    for last in reversed(cut):
        first = next(trial for trial in cut if trial.setting == last.setting)
        if first is last:
            continue
        assert first.k_fc_n_s_per_m and last.k_fc_n_s_per_m
        ratio = last.k_fc_n_s_per_m / first.k_fc_n_s_per_m
        return BladeGrowth(
            blade=blade,
            first_trial=first.trial_id,
            last_trial=last.trial_id,
            growth=ratio - 1.0,
            growth_std=ratio * math.hypot(_relative_std(first), _relative_std(last)),
        )
    return None


def _relative_std(trial: TrialMeasures) -> float:
    return (trial.k_fc_statistical_std_n_s_per_m or 0.0) / (trial.k_fc_n_s_per_m or 1.0)


def _log(value: float | None) -> float | None:
    return math.log(value) if value is not None and value > 0 and math.isfinite(value) else None


def _squares(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values)
