"""The gap report as plain values: the file `gap_report.json` that other people's scripts read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bench.config import LoadedConfig
from bench.recording import Recording
from diagnosis.campaign import Campaign
from diagnosis.channel_gap import ChannelGap, forecast
from diagnosis.evidence import Column, Explanation, catalogue_columns
from diagnosis.gap_detail import detail, log_odds_at_typical_size
from diagnosis.ladder import RUNGS, HoldOut, Ladder, Rungs
from diagnosis.linear_problem import LinearProblem, Marginal, build_problem
from diagnosis.next_trial import next_trial
from diagnosis.plants.choice import reduce_recordings
from diagnosis.posterior import GRAIN, Posterior, judge, sized_by_strokes, wide_scale
from diagnosis.size import sized, together
from diagnosis.weighing import AND, LEFT_BY_AN_INTACT_MACHINE, VERDICTS
from diagnosis.where import locate

SCHEMA_VERSION = 1
_METRIC = (
    "root mean square of the equation residuals over their noise, on {held_out}; by_channel: measured less predicted"
    " mean stroke in the unit of the channel{simulated}; how hard a piece of wood is, is fitted on its own trial for"
    " all rungs alike"
)
_HELD_OUT = {
    "operating points": "operating points held out of every fit in turn",
    "trials": "trials held out of every fit in turn (there is only one operating point)",
    "nothing": "the only trial, which the fits have seen (nothing could be held out)",
}
# Where the parts of the work stand on the progress bar, of 100.
_REDUCED, _SIGNED, _JUDGED, _CLIMBED = 40, 50, 80, 85
_ODDS = 20.0
# Where a line that no equation explains is first to be looked for.
_EQUATION_OF_CHANNEL = {
    "motor_current_a": "electrical", "force_n": "cutting", "battery_voltage_v": "supply", "battery_current_a": "supply",
}  # fmt: skip
# Log odds against no gap below which an effect of typical size would probably not be named.
_SHOWN_LOG_ODDS = 16.0
_SHOWN_PROBABILITY = 0.001


def diagnose(
    recordings: Sequence[Recording],
    loaded: LoadedConfig,
    *,
    provenance: Mapping[str, Any],
    on_step: Callable[[int, int, str], None] | None = None,
) -> dict[str, Any]:
    """Diagnose the sim-to-real gap of a campaign.

    Parameters
    ----------
    recordings : sequence of Recording
    loaded : LoadedConfig
    provenance : mapping
        Goes into the report as it is.
    on_step : callable, optional
        (done, total, what).

    Returns
    -------
    dict
        `gap_report.json`.

    Raises
    ------
    InputError
        If nothing can be diagnosed; the message says why for every trial.
    """
    say = on_step or (lambda done, total, what: None)
    campaign = reduce_recordings(
        recordings, loaded, on_trial=lambda done, total, name: say(_REDUCED * done // total, 100, f"reading {name}")
    )
    problem = build_problem(campaign)
    say(_REDUCED, 100, "computing what every effect would do")
    columns = catalogue_columns(problem, campaign.plant.effects)
    say(_SIGNED, 100, "weighing causes")
    shown = log_odds_at_typical_size(problem, columns)
    posterior = judge(problem, columns)
    say(_JUDGED, 100, "predicting held-out operating points")
    causes, hold_out, ladder, forms = _causes(problem, columns, posterior)
    say(_CLIMBED, 100, "predicting held-out operating points")
    channels = forecast(
        hold_out, ladder, forms,
        on_trial=lambda done, total, name: say(
            _CLIMBED + (100 - _CLIMBED) * done // total, 100, f"predicting {name}"
        ),
    )  # fmt: skip
    return {
        "schema_version": SCHEMA_VERSION,
        "verdict": posterior.verdict,
        "where": [] if posterior.verdict == "no_gap" else _where(problem, posterior),
        "causes": causes,
        "probabilities": {k: posterior.probabilities[k] for k in VERDICTS},
        "parameter_shifts": _shifts(problem),
        "gap": _gap(ladder, channels),
        "next_trial": next_trial(problem, posterior),
        "warnings": [
            *campaign.warnings, *_weaknesses(campaign), *_hidden(shown), *_of_grain(posterior),
            *([] if posterior.off_stroke is None else [posterior.off_stroke.text]),
            *(() if channels is None else channels.warnings)
        ],
        "detail": {**detail(problem, posterior, channels), "log_odds_at_typical_size": shown},
        "provenance": dict(provenance),
    }  # fmt: skip


def _causes(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], posterior: Posterior
) -> tuple[list[dict[str, Any]], HoldOut, Ladder, list[tuple[Column, ...]]]:
    """Entries of the report; with the ladder of the first one and the forms it was climbed with."""
    by_name = {e.effect.name: e for e in posterior.explanations}
    chosen = [
        (name, p) for name, p in posterior.probabilities.items() if name not in VERDICTS and p > _SHOWN_PROBABILITY
    ][:5]
    if len(chosen) < 2:
        more = [e.effect.name for e in posterior.explanations if e.effect.name not in dict(chosen)]
        chosen += [(name, posterior.probabilities[name]) for name in more[: 2 - len(chosen)]]
    causes: list[dict[str, Any]] = []
    hold_out: HoldOut | None = None
    first: tuple[Ladder, list[tuple[Column, ...]]] | None = None
    for name, probability in chosen:
        members = _members(problem, name, posterior, by_name)
        best = _stacked([m.column for m in members])
        if hold_out is None:
            hold_out = HoldOut(problem, best)
        # The form of a single effect is chosen anew in every fit; of two together, the best ones are kept.
        width = best.shape[1]
        forms = [(c,) for c in columns[name] if c.columns.shape[1] == width] if len(members) == 1 else []
        forms = forms or [tuple(m.column for m in members)]
        ladder = hold_out.climb([_stacked(form) for form in forms])
        if first is None:
            first = (ladder, forms)
        causes.append(
            {
                "effects": [m.effect.name for m in members],
                "indistinguishable_from": _alike(members[0], posterior) if len(members) == 1 else [],
                "probability": probability,
                "parameters": {
                    m.effect.strength.name: {
                        "value": m.strength,
                        "std": float(np.hypot(m.strength_std, problem.campaign.plant.scale_rel_std * m.strength)),
                        "unit": m.effect.strength.unit
                    }
                    for m in sized(problem, members, columns, small=posterior.little, dispersion=posterior.dispersion)
                },
                "gap_closed": ladder.gap_closed,
                "gap_closed_ci95": list(ladder.gap_closed_ci95),
            }
        )  # fmt: skip
    if hold_out is None or first is None:
        hold_out = HoldOut(problem)
        first = (hold_out.climb([]), [])
    return causes, hold_out, *first


def _stacked(columns: Sequence[Column]) -> Any:
    """Columns side by side, at the largest amplitude that occurs."""
    return np.hstack([c.columns * c.effect.strength.high for c in columns])


def _members(
    problem: LinearProblem, name: str, posterior: Posterior, by_name: Mapping[str, Explanation]
) -> list[Explanation]:
    """Effects of a hypothesis; of two together, each with its form and size in the presence of the other."""
    parts = name.split(AND)
    pair = next((p for p in posterior.pairs if {p.first.effect.name, p.second.effect.name} == set(parts)), None)
    if pair is None:
        return [by_name[part] for part in parts]
    found = sorted((pair.first, pair.second), key=lambda e: parts.index(e.effect.name))
    sized = together(problem, found, dispersion=posterior.dispersion)
    return [sized_by_strokes(member, posterior.grain, posterior.trend) for member in sized]


def _alike(cause: Explanation, posterior: Posterior) -> list[str]:
    """Effects that this campaign cannot tell from the cause: less than twenty times less likely."""
    least = posterior.probabilities.get(cause.effect.name, 0.0) / _ODDS
    others = [e.effect.name for e in posterior.explanations if e.effect.name != cause.effect.name]
    return [*cause.effect.same_as, *(n for n in others if posterior.probabilities.get(n, 0.0) > max(least, 1e-6))]


def _where(problem: LinearProblem, posterior: Posterior) -> list[dict[str, Any]]:
    top = next(iter(posterior.probabilities)).split(AND)
    named = [e for e in posterior.explanations if e.effect.name in top]
    # What a sensor gets wrong is not the machine's equation that its reading enters.
    wrong = {channel for e in named if e.effect.place == "sensing" for channel in e.effect.needs}
    ringing = [e.strength for e in named if e.effect.strength.unit == "Hz"]
    found: list[dict[str, Any]] = [
        {
            "equation": "sensing" if spot.channel in wrong else spot.equation,
            "channel": spot.channel,
            "share": spot.share,
            "crank_angle_rad": [list(sector) for sector in spot.crank_angle_rad],
            "frequency_hz": ringing if ringing and spot.channel in wrong else None,
            "grows_with": list(spot.grows_with),
        }
        for spot in locate(problem)
    ]
    beside = posterior.off_stroke
    if beside is None or not beside.lines_hz:
        return found
    # Mean strokes, and so the shares, hold nothing of a line; where they hold no gap, it is all there is.
    is_all = posterior.left_over["parameters"] < LEFT_BY_AN_INTACT_MACHINE * problem.quiet
    line = {
        "equation": _EQUATION_OF_CHANNEL.get(beside.channel, "sensing"), "channel": beside.channel,
        "share": 1.0 if is_all else 0.0, "crank_angle_rad": [], "frequency_hz": list(beside.lines_hz),
        "grows_with": [],
    }  # fmt: skip
    return [line] if is_all else [*found, line]


def _shifts(problem: LinearProblem) -> dict[str, Any]:
    """Re-tuned parameters, with priors five times as wide as stated."""
    marginal = Marginal(problem, scale=wide_scale(problem))
    mean, std = marginal.estimate()
    width = wide_scale(problem) * problem.prior_std
    place = {name: k for k, name in enumerate(problem.names)}
    shifts = {}
    for nuisance in problem.campaign.plant.nuisances():
        if nuisance.is_plant and nuisance.name in place:
            k = place[nuisance.name]
            shift = float(mean[k] * width[k])
            shifts[nuisance.name] = {
                "value": nuisance.nominal + shift, "std": float(std[k] * width[k]), "nominal": nuisance.nominal,
                "sigmas": shift / nuisance.std,
            }  # fmt: skip
    return shifts


def _gap(ladder: Ladder, channels: ChannelGap | None) -> dict[str, Any]:
    by_channel = ladder.by_channel if channels is None or not channels.by_channel else channels.by_channel
    simulated = "" if by_channel is ladder.by_channel else ", predicted by the simulated model"
    found = {
        "metric": _METRIC.format(held_out=_HELD_OUT[ladder.held_out], simulated=simulated),
        **_rungs(ladder.whitened),
        "by_channel": {name: {**_rungs(r), "unit": unit} for name, (r, unit) in by_channel.items()},
    }
    if channels is not None and channels.runtime_s:
        found["runtime_s"] = dict(channels.runtime_s)
    return found


def _rungs(rungs: Rungs) -> dict[str, float]:
    return {name: getattr(rungs, name) for name in RUNGS}


def _hidden(shown: Mapping[str, float]) -> list[str]:
    """Say what this campaign could not show, before it is taken for absent."""
    names = [name for name, odds in shown.items() if odds < _SHOWN_LOG_ODDS]
    return [f"this campaign would hardly show, at its typical size: {', '.join(names)}"] if names else []


def _of_grain(posterior: Posterior) -> list[str]:
    if GRAIN not in next(iter(posterior.probabilities)).split(AND):
        return []
    return [
        f"grain of the wood: waves of {1e3 * posterior.grain.wavelength_m:.1f} mm along the feed, found from stroke to"
        " stroke; the gap is that of mean strokes, which grain hardly moves"
    ]


def _weaknesses(campaign: Campaign) -> list[str]:
    running = [s for s in campaign.states if s.kind == "running"]
    said = campaign.plant.weaknesses(running)
    points = [s.setting.operating_point for s in running]
    if len(set(points)) == len(points):
        said.append("no operating point was repeated: a gap beyond what repeats differ by cannot be claimed")
    if len(set(points)) == 1:
        said.append("only one operating point: re-tuned parameters can hide most effects")
    return said
