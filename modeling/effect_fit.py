"""The cutting coefficient of a saw with known effects: what they make of the measured strokes is taken off first.

The share of the effects is the difference of two periodic strokes, with and without them, at the coefficient that is
fitted; what is left is fitted by the baseline. The coefficient and the share are found in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import NAME, out_of_range
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.operating_point import OperatingPoint, check_scales, mean_over_time, periodic_stroke
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.results import CuttingFit, ParameterEstimates
from sawbench.modeling.state import TWO_PI

Fitted = tuple[CuttingFit, ParameterEstimates | None]
_PASSES: Final = 4
_SETTLED: Final = 1e-4


@dataclass(frozen=True, kw_only=True, slots=True)
class EffectShare:
    """What known effects change in a periodic stroke.

    Attributes
    ----------
    current_a, force_n, crank_speed_rad_s : ndarray, shape (n_angles,)
    period_s, battery_current_a : float
    """

    current_a: Floats
    force_n: Floats
    crank_speed_rad_s: Floats
    period_s: float
    battery_current_a: float


def effect_share(baseline: Baseline, point: OperatingPoint, angle_rad: Floats) -> EffectShare:
    """Predict a stroke with the known effects and one without, and take the difference.

    Parameters
    ----------
    baseline : Baseline
    point : OperatingPoint
    angle_rad : ndarray, shape (n_angles,)

    Raises
    ------
    InputError
        If the model with or without the effects has no periodic stroke there.
    """
    check_scales(baseline)
    bare = periodic_stroke(replace(baseline, known=()), point)
    full = periodic_stroke(baseline, point, start=bare if bare.is_settled else None)
    if not (bare.is_settled and full.is_settled):
        raise InputError(
            f"the model finds no steady stroke at k_Fc = {point.k_fc_n_s_per_m:.0f} N*s/m with its [effects]",
            remedy="check [effects], [plant] and the duty",
        )
    grid = full.state.angle_rad[0]

    def change(name: str) -> Floats:
        wave = getattr(full.state, name)[0] - getattr(bare.state, name)[0]
        return np.interp(angle_rad, grid, wave, period=TWO_PI)

    periods = [float(np.mean(TWO_PI / one.state.speed_rad_s)) for one in (full, bare)]
    drawn = [mean_over_time(one.state, one.state.battery_current_a) for one in (full, bare)]
    return EffectShare(
        current_a=change("current_a"),
        force_n=change("force_n"),
        crank_speed_rad_s=change("speed_rad_s"),
        period_s=periods[0] - periods[1],
        battery_current_a=drawn[0] - drawn[1],
    )


def without_effects(cycles: MeasuredCycles, share: EffectShare) -> MeasuredCycles:
    """Measured strokes as the machine would have made them without its known effects."""

    def less(values: Floats | None, taken: Floats | float) -> Floats | None:
        return None if values is None else values - taken

    return replace(
        cycles,
        period_s=cycles.period_s - share.period_s,
        current_a=less(cycles.current_a, share.current_a),
        force_n=less(cycles.force_n, share.force_n),
        crank_speed_rad_s=less(cycles.crank_speed_rad_s, share.crank_speed_rad_s),
        battery_current_a=less(cycles.battery_current_a, share.battery_current_a),
    )


def fit_with_effects(
    cycles: MeasuredCycles, fit: Callable[[MeasuredCycles], Fitted], baseline: Baseline, point: OperatingPoint
) -> Fitted:
    """Fit k_Fc with the known effects taken off; their uncertainty goes into that of the fit.

    Parameters
    ----------
    cycles : MeasuredCycles
    fit : callable
        Strokes of a saw without effects -> its fit.
    baseline : Baseline
        With the known effects.
    point : OperatingPoint
        Of the trial; its coefficient is where the search starts.

    Returns
    -------
    fit : CuttingFit
    estimates : ParameterEstimates or None
        The magnitudes of the effects are among them, correlated with the rest.

    Raises
    ------
    InputError
        If the model has no periodic stroke at the fitted coefficient.
    """
    found, k_fc = None, point.k_fc_n_s_per_m

    def fitted(model: Baseline) -> Fitted:
        share = effect_share(model, replace(point, k_fc_n_s_per_m=k_fc), cycles.angle_rad)
        return fit(without_effects(cycles, share))

    for _ in range(_PASSES):
        found = fitted(baseline)
        if found[0].status == "stalled":
            return found
        before, k_fc = k_fc, max(found[0].k_fc_n_s_per_m, 0.0)
        if abs(k_fc - before) <= _SETTLED * k_fc:
            break
    assert found is not None
    uncertain = [known for known in baseline.known if known.std > 0.0]
    shifted = [fitted(model) for model in by_one_std(baseline)]
    notes = (*history_note(baseline), *_range_notes(baseline, replace(point, k_fc_n_s_per_m=k_fc)))
    return _combined(found, uncertain, shifted, notes)


def by_one_std(baseline: Baseline) -> list[Baseline]:
    """Models in which one uncertain effect each is larger by its standard uncertainty."""
    return [
        replace(baseline, known=tuple(k.at(k.value + k.std) if k is one else k for k in baseline.known))
        for one in baseline.known
        if one.std > 0.0
    ]


def _range_notes(baseline: Baseline, point: OperatingPoint) -> tuple[str, ...]:
    """Say where a learned term is beyond its range; the stroke is solved again only for one."""
    if all(known.effect.name != NAME for known in baseline.known):
        return ()
    return out_of_range(baseline.known, baseline, [periodic_stroke(baseline, point).state])


def history_note(baseline: Baseline) -> tuple[str, ...]:
    """Say which effects are taken as they are at the beginning of a campaign."""
    names = [
        known.effect.name for known in baseline.known if known.effect.memories or "time" in known.effect.grows_with
    ]
    if not names:
        return ()
    return (
        f"{', '.join(names)}: evaluated for a cold motor, a new blade and a full battery; one trial gives no"
        " more information",
    )


def _combined(found: Fitted, uncertain: list[KnownEffect], shifted: list[Fitted], notes: tuple[str, ...]) -> Fitted:
    """Add to the covariance what one standard uncertainty of each effect moves."""
    cutting, estimates = found
    moved = [one.k_fc_n_s_per_m - cutting.k_fc_n_s_per_m for one, _ in shifted]
    cutting = replace(
        cutting,
        std_n_s_per_m=math.hypot(cutting.std_n_s_per_m, *moved),
        notes=(*cutting.notes, *notes),
    )
    if estimates is None:
        return cutting, None
    shifts = np.array([other.values - estimates.values for _, other in shifted if other is not None])
    stds = np.array([known.std for known in uncertain])
    if len(shifts) != len(stds):
        raise InputError("k_Fc cannot be fitted within the uncertainty of [effects]", remedy="check their std")
    shifts = shifts.reshape(len(stds), len(estimates.values))
    return cutting, ParameterEstimates(
        names=(*estimates.names, *(known.name for known in uncertain)),
        values=np.concatenate([estimates.values, [known.value for known in uncertain]]),
        prior_std=np.concatenate([estimates.prior_std, stds]),
        covariance=np.block(
            [
                [estimates.covariance + shifts.T @ shifts, shifts.T * stds],
                [(shifts.T * stds).T, np.diag(stds**2)],
            ]
        ),
        by_stroke=tuple(np.pad(series, ((0, 0), (0, len(stds)))) for series in estimates.by_stroke),
    )
