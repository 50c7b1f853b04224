"""Where the load cell rings by itself: looked for in the mean strokes of some cuts, with all that shapes a force.

A late bite, an edge force, teeth: whatever shapes the force of the cut goes through the load cell, and excites it.
Beside the ring of the linear law alone their edges are taken for another ring. So every form is shown through the ring
that is tried, each of any size; what they leave of the mean strokes says how likely the ring is.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.plain_digits import rounded
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.transfer import Spectrum, TransferFunction
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import State
from sawbench.modeling.stroke import mean_stroke

# Cuts in which it is looked for, from the slowest to the fastest, and forms of each effect.
_FEW, _FORMS = 5, 3
# Harmonics of each trial that are anything: of its zero, of what the carriage's guide takes.
_FREE: Final = 2
# Frequencies that are a usual damping apart, dampings, and parts of the largest share, from which a search begins, and
# how many go on.
_APART, _DAMPINGS, _PARTS, _N_SEARCHED = 1.05, (0.02, 0.06), (1.0, 0.5), 3
# Error of a gain.
_GAIN_STD: Final = 0.03
# First steps of a search in the logarithms of frequency and damping and in the part, and those of a second difference.
_FIRST, _SECOND = np.vstack([np.zeros(3), np.diag([0.02, 0.3, -0.15])]), np.array([1e-3, 2e-2, 1e-2])
# Where a search ends: as close in these, and in nats.
_CLOSE = {"xatol": 3e-4, "fatol": 0.03}
# How far below the lowest frequency a search may go, in the logarithm; a place without a share.
_BELOW, _NO_SHARE = 0.1, np.array([1.0, 1.0, 0.0])
# Of the largest direction of all forms: those that are smaller are none.
_LEAST_DIRECTION: Final = 1e-6
# N^2: what forms leave of a force without noise.
_NOTHING: Final = 1e-12


def likeliest_ring(campaign: Campaign, resonance: Effect, highest_hz: float) -> KnownEffect | None:
    """Ring that the mean strokes show most.

    Parameters
    ----------
    campaign : Campaign
    resonance : Effect
        Of the load cell.
    highest_hz : float
        Up to which the force was sampled.

    Returns
    -------
    KnownEffect or None
        None where nothing is cut, where none shows, and where the best one is at an end: what rings is beyond.
    """
    strokes = _strokes(campaign)
    searched = [_found(strokes, resonance, limits) for limits in _limits(resonance, highest_hz)] if strokes else []
    return max((one for one in searched if one), key=operator.itemgetter(0), default=(0.0, None))[1]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Limits:
    """Where a ring of some largest share of the force may be: logarithms of frequency and damping, and shares."""

    log_hz: tuple[float, float]
    log_damping: tuple[float, float]
    share: tuple[float, float]


def _limits(resonance: Effect, highest_hz: float) -> list[_Limits]:
    """Of every largest share: a light mode may be where one of all of the force may not."""
    damping = sorted(shape["damping"] for shape in resonance.shapes)
    least, *largest = sorted({shape["share"] for shape in resonance.shapes if "share" in shape})
    of_share = {
        share: [shape["frequency_hz"] for shape in resonance.shapes if shape.get("share") == share]
        for share in largest
    }  # fmt: skip
    return [
        _Limits(
            log_hz=(np.log(min(of_hz)), np.log(min(max(of_hz), highest_hz))),
            log_damping=(np.log(damping[0]), np.log(damping[-1])), share=(least, share),
        )
        for share, of_hz in of_share.items() if min(of_hz) < highest_hz
    ]  # fmt: skip


def _found(strokes: list[_Stroke], resonance: Effect, limits: _Limits) -> tuple[float, KnownEffect] | None:
    """What the likeliest ring within limits gains, in nats, and the ring."""
    from scipy.optimize import minimize

    (low, high), largest = limits.log_hz, limits.share[1]
    n_begun = 1 + int(np.ceil((high - low) / np.log(_APART)))
    begun = [
        np.array([log_hz, np.log(damping), largest * part])
        for log_hz in np.linspace(low, high, n_begun) for damping in _DAMPINGS for part in _PARTS
    ]  # fmt: skip

    def cost(place: Floats) -> float:
        return _lacking(strokes, resonance, place)

    costs = np.array(on_two_cores(cost, begun))
    without = cost(begun[0] * _NO_SHARE)
    if costs.min() > without:
        return None
    bounds = [(low - _BELOW, high), limits.log_damping, limits.share]
    simplexes = [begun[at] + _FIRST * [1.0, 1.0, largest] for at in np.argsort(costs)[:_N_SEARCHED]]
    searched = [
        minimize(cost, one[0], method="Nelder-Mead", bounds=bounds, options={"initial_simplex": one, **_CLOSE})
        for one in simplexes
    ]
    best = min(searched, key=lambda one: one.fun)
    gained, least = without - best.fun, np.log(len(begun)) + np.log(SETTINGS.report.odds)
    is_light = largest < 1.0
    is_beyond = not low < best.x[0] < high - _SECOND[0] or (is_light and best.x[2] > (1.0 - _SECOND[2]) * largest)
    if gained < least or is_beyond:
        return None
    std = float(np.exp(best.x[0])) * _std(cost, best.x)
    return gained, replace(_ring(resonance, best.x), std=rounded(std))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Stroke:
    """Mean stroke of one cut.

    Attributes
    ----------
    state : State
    force_n : ndarray, shape (n_points,)
    law : Spectrum
        Of the linear law.
    shaped : Spectrum
        Of what each form of the effects of the cut adds to it, a row each.
    free : ndarray, shape (n_points, 1 + 2 _FREE)
    """

    state: State
    force_n: Floats
    law: Spectrum
    shaped: Spectrum
    free: Floats


def _strokes(campaign: Campaign) -> list[_Stroke]:
    running = [s for s in campaign.states if s.kind == "running" and not s.setting.is_idle and s.force_n is not None]
    cuts = sorted(running, key=lambda s: float(s.speed_rad_s.mean()))
    some = [cuts[k] for k in np.unique(np.linspace(0, len(cuts) - 1, _FEW).astype(int))] if cuts else []
    effects = [e for e in campaign.plant.effects if e.place == "cutting" and e.strokes is None]
    return [_stroke(campaign.baseline, mean_stroke(state), effects) for state in some]


def _stroke(baseline: Baseline, state: State, effects: list[Effect]) -> _Stroke:
    shaped: list[Floats] = []
    for effect in effects:
        some = effect.shapes[:: max(len(effect.shapes) // _FORMS, 1)]
        forms = [*(shape for shape, _ in effect.background or ()), *some]
        for signatures in effect.signatures_of(baseline, state, forms):
            shaped += [one.get("cutting", 0.0 * state.angle_rad) for one in signatures]
    turned = np.outer(state.angle_rad[0], np.arange(1, _FREE + 1))
    assert state.force_n is not None
    return _Stroke(
        state=state, force_n=state.force_n[0], law=Spectrum(baseline.expected_force(state), state),
        shaped=Spectrum(np.concatenate(shaped) if shaped else np.zeros((0, state.angle_rad.shape[1])), state),
        free=np.hstack([np.ones((len(turned), 1)), np.cos(turned), np.sin(turned)]),
    )  # fmt: skip


def _lacking(strokes: list[_Stroke], resonance: Effect, place: Floats) -> float:
    """Negative log likelihood of a ring, its noise and all that shapes the force free, and what its share costs.

    All of the force rings but for the error of a gain, or any share of it.
    """
    from scipy.linalg import lstsq

    known = _ring(resonance, place)
    columns, data, n_free = [], [], strokes[0].free.shape[1]
    for at, stroke in enumerate(strokes):
        transfer: TransferFunction = known.transfers(stroke.state)["cutting"]
        own = np.zeros((len(stroke.force_n), len(strokes) * (1 + n_free)))
        here = slice(at * (1 + n_free), (at + 1) * (1 + n_free))
        own[:, here] = np.column_stack([stroke.law.through(transfer)[0], stroke.free])
        columns.append(np.hstack([own, stroke.shaped.through(transfer).T]))
        data.append(stroke.force_n)
    whole, force_n = np.vstack(columns), np.concatenate(data)
    scale = np.sqrt(np.sum(whole**2, axis=0))
    whole = whole[:, scale > 0.0] / scale[scale > 0.0]
    solved = lstsq(whole, force_n, cond=_LEAST_DIRECTION, lapack_driver="gelsy", check_finite=False)
    assert solved is not None
    left = force_n - whole @ solved[0]
    cost = float(np.log1p(((1.0 - place[2]) / _GAIN_STD) ** 2)) if place[2] else 0.0
    return 0.5 * len(left) * float(np.log(max(left @ left, _NOTHING))) + cost


def _std(cost: Callable[[Floats], float], best: Floats) -> float:
    """Standard uncertainty of the logarithm of the frequency, by the curvature of the cost."""
    steps = np.diag(_SECOND)
    bends = [
        (cost(best + a + b) - cost(best + a - b) - cost(best - a + b) + cost(best - a - b)) / 4.0
        for a in steps for b in steps
    ]  # fmt: skip
    hessian = np.reshape(bends, (3, 3)) / np.outer(_SECOND, _SECOND)
    return float(np.sqrt(max(np.linalg.pinv(hessian)[0, 0], 0.0)))


def _ring(resonance: Effect, place: Floats) -> KnownEffect:
    """Ring of a logarithm of a frequency in Hz, a logarithm of a damping ratio, and a share."""
    form = {"damping": rounded(float(np.exp(place[1]))), "share": rounded(float(place[2]))}
    return KnownEffect(effect=resonance, value=rounded(float(np.exp(place[0]))), form=form)
