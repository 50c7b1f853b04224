"""How hard each stock is to cut, and each piece of it, by regression of the force on the speed of the blade."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.parts.linear import coefficient
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import State

# Known effects of the cut and the coefficient that they scale with: each time some per cent of the last change is left.
_REGRESSIONS = 6
# Of the largest force of a campaign: less is on no preload's edge.
_FAR_BELOW = 0.7
# Running trials of each stock, with the force less known effects, N, and the cutting speed, m/s.
_Cuts = dict[str, list[tuple[State, Floats, Floats]]]


def with_guesses(baseline: Baseline, states: Sequence[State]) -> tuple[list[State], dict[str, float]]:
    """Regress k_Fc of each stock and piece; return states with it and the campaign's extremes, and k_Fc by stock.

    Known effects of the cut are taken off the force; most scale with the coefficient, so it is found again with them.
    """
    peak_n = top_a = 0.0
    for state in states:
        if state.kind == "running" and not state.setting.is_idle and state.force_n is not None:
            peak_n = max(peak_n, float(state.force_n.mean(axis=0).max()))
        if state.current_a is not None:
            # Recordings that begin on a running machine hold no start-up: a limit acts in their cuts.
            current_a = state.current_a if state.kind == "start_up" else state.current_a.mean(axis=0)
            top_a = max(top_a, float(current_a.max()))
    below = {s.setting.label: _below(baseline, s, peak_n) for s in states if s.kind == "running"}
    found = [
        replace(state, peak_force_n=peak_n, top_current_a=top_a, k_below_n_s_per_m=below.get(state.setting.label, 0.0))
        for state in states
    ]
    guesses: dict[str, float] = {}
    for _ in range(_REGRESSIONS if baseline.known else 1):
        cuts = _cuts(baseline, found)
        regressed, hardness = _regressed(cuts), _hardness(cuts)
        guesses = {stock: k_fc for stock, (k_fc, _) in regressed.items()}
        none = (0.0, 0.0)
        for at, state in enumerate(found):
            k_fc, rad_s = none if state.setting.is_idle else regressed.get(state.setting.stock, none)
            harder = hardness.get(state.setting.label, 1.0)
            found[at] = replace(state, k_guess_n_s_per_m=k_fc, regressed_at_rad_s=rad_s, hardness=harder)
    return found, guesses


def _below(baseline: Baseline, state: State, peak_n: float) -> float:
    """Regress force on cutting speed where the mean stroke's force is far below a peak; 0 where nothing is cut."""
    if state.setting.is_idle or state.force_n is None:
        return 0.0
    force_n, speed_m_s = state.force_n.mean(axis=0), baseline.cutting_speed(state).mean(axis=0)
    low = (speed_m_s > 0.0) & (force_n < _FAR_BELOW * peak_n)
    return max(float(coefficient(force_n[low], speed_m_s[low])), 0.0) if low.any() else 0.0


def _regressed(cuts: _Cuts) -> dict[str, tuple[float, float]]:
    """Regress force on cutting speed over the running trials of each stock: k_Fc, and the crank speed that counts."""
    found: dict[str, tuple[float, float]] = {}
    for stock, trials in cuts.items():
        force_n, speed_m_s, rad_s = (
            np.concatenate(of) for of in zip(*((*cut, state.speed_rad_s) for state, *cut in trials), strict=True)
        )
        at_rad_s = float(np.sum(rad_s * speed_m_s**2) / max(float(np.sum(speed_m_s**2)), 1e-300))
        found[stock] = (max(float(coefficient(force_n, speed_m_s)), 0.0), at_rad_s)
    return found


def _hardness(cuts: _Cuts) -> dict[str, float]:
    """Cutting coefficient of each trial over that of its stock, by label.

    By regression with an intercept over the whole mean stroke: a zero of the load cell makes no piece harder.
    """
    found: dict[str, float] = {}
    for trials in cuts.values():
        slopes, squares = [], []
        for _, force_n, speed_m_s in trials:
            mean_n, mean_m_s = force_n.mean(axis=0), speed_m_s.mean(axis=0)
            away_m_s = mean_m_s - mean_m_s.mean()
            squares.append(max(float(away_m_s @ away_m_s), 1e-300))
            slopes.append(float(away_m_s @ mean_n) / squares[-1])
        of_stock = float(np.average(slopes, weights=squares))
        for (state, *_), slope in zip(trials, slopes, strict=True):
            found[state.setting.label] = slope / of_stock if min(slope, of_stock) > 0.0 else 1.0
    return found


def _cuts(baseline: Baseline, states: Sequence[State]) -> _Cuts:
    found: _Cuts = {}
    for state in states:
        if state.kind == "running" and not state.setting.is_idle and state.force_n is not None:
            force_n = state.force_n - baseline.known_signature(state).get("cutting", 0.0)
            found.setdefault(state.setting.stock, []).append((state, force_n, baseline.cutting_speed(state)))
    return found
