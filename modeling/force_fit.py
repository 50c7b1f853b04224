"""k_Fc straight from the measured force and the measured blade speed, no motor model in between.

F = k_Fc * v on the cutting half, v = r_c |g(a)| W: a regression through the load cell's zero, stroke by
stroke.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import PlantConfig
from sawbench.bench.correlated import std_of_mean
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_statistics import FEWEST_STROKES
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.modeling.parts.linear import CuttingHalf, coefficient, sign_of
from sawbench.modeling.parts.mechanism import Mechanism

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class ForceFit:
    """Result of `fit_force`.

    Attributes
    ----------
    k_fc_n_s_per_m, statistical_std_n_s_per_m : float
    offset_n : float
        Mean force on the return half: the zero of the load cell.
    per_stroke_n_s_per_m : ndarray, shape (n_strokes,)
    rmse_n : float
        Of the mean stroke.
    rms_n : float
        Of the measured mean stroke itself, its offset taken off.
    uses_mean_speed : bool
        True where the crank speed within the stroke was not measured.
    """

    k_fc_n_s_per_m: float
    statistical_std_n_s_per_m: float
    offset_n: float
    per_stroke_n_s_per_m: Floats
    rmse_n: float
    rms_n: float
    uses_mean_speed: bool


def fit_force(cycles: MeasuredCycles, *, plant: PlantConfig, cutting_half: CuttingHalf) -> ForceFit:
    """Regress the force on the blade speed; the offset comes from the return half.

    Without a measured crank speed the mean speed of the stroke stands for it. The speed dips where the blade
    cuts, so k_Fc then comes out low by that dip (4 % for the paper's jigsaw).

    Parameters
    ----------
    cycles : MeasuredCycles
    plant : PlantConfig
        Only the mechanism is used.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}

    Raises
    ------
    InputError
        If there is no force, or the strokes are too few.
    """
    _check(cycles)
    lever_m = Mechanism.of(plant).lever(cycles.angle_rad)
    cuts = sign_of(cutting_half) * lever_m > 0
    speed = cycles.crank_speed_rad_s
    if speed is None:
        speed = np.repeat((2.0 * np.pi / cycles.period_s)[:, None], cycles.n_bins, axis=1)
    blade_m_s = speed * np.abs(lever_m) * cuts
    assert cycles.force_n is not None
    present = np.isfinite(cycles.force_n) & np.isfinite(blade_m_s)
    force = np.where(present, cycles.force_n, 0.0)
    blade_m_s = np.where(present, blade_m_s, 0.0)
    at_rest = present & ~cuts
    if not at_rest.any() or not blade_m_s.any():
        raise InputError("force_n is empty on one half of the stroke", where=cycles.label)
    offset_n = float(force[at_rest].mean())
    k_fc = float(coefficient(force - offset_n, blade_m_s))
    per_stroke = coefficient(force - offset_n, blade_m_s, axis=1)
    square = (blade_m_s**2).sum(axis=1)
    offset_share = blade_m_s.sum(axis=1).mean() / square.mean()
    offsets = np.where(at_rest, force - offset_n, 0.0).sum(axis=1) / at_rest.sum(axis=1).mean()
    influence = (per_stroke - k_fc) * square / square.mean() - offset_share * offsets

    def rms_of_mean(values: Floats) -> float:
        mean = np.where(present, values, 0.0).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
        return float(np.sqrt(np.mean(mean**2)))

    return ForceFit(
        k_fc_n_s_per_m=k_fc,
        statistical_std_n_s_per_m=std_of_mean(influence)[0],
        offset_n=offset_n,
        per_stroke_n_s_per_m=per_stroke,
        rmse_n=rms_of_mean(force - offset_n - k_fc * blade_m_s),
        rms_n=rms_of_mean(force - offset_n),
        uses_mean_speed=cycles.crank_speed_rad_s is None,
    )


def _check(cycles: MeasuredCycles) -> None:
    if cycles.force_n is None:
        raise InputError(
            "method 'force' needs force_n, which this trial does not have",
            where=cycles.label,
            remedy="choose method 'current', or record the force",
        )
    if cycles.n_cycles < FEWEST_STROKES:
        raise InputError(
            f"{cycles.n_cycles} complete strokes are not enough, {FEWEST_STROKES} are needed", where=cycles.label
        )
