"""The gap report as plain values: the file `gap_report.json` that other people's scripts read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bench.config import LoadedConfig
from bench.recording import Recording
from diagnosis.campaign import Campaign
from diagnosis.evidence import Explanation, catalogue_columns
from diagnosis.ladder import Ladder, climb
from diagnosis.linear_problem import LinearProblem, Marginal, build_problem
from diagnosis.plants.choice import reduce_recordings
from diagnosis.posterior import Posterior, judge, wide_scale
from diagnosis.where import locate

SCHEMA_VERSION = 1
METRIC = (
    "root mean square of the equation residuals over their noise, on operating points held out of every fit in turn"
)
_ALIKE = 0.95
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
    campaign = reduce_recordings(recordings, loaded, on_trial=on_step)
    problem = build_problem(campaign)
    columns = catalogue_columns(problem, campaign.plant.effects)
    posterior = judge(problem, columns)
    causes = _causes(problem, posterior)
    ladder = causes[0].pop("_ladder") if causes else climb(problem, None)
    for cause in causes:
        cause.pop("_ladder", None)
    return {
        "schema_version": SCHEMA_VERSION,
        "verdict": posterior.verdict,
        "where": [] if posterior.verdict == "no_gap" else _where(problem),
        "causes": causes,
        "probabilities": {k: posterior.probabilities[k] for k in ("no_gap", "parameters", "unknown")},
        "parameter_shifts": _shifts(problem),
        "gap": _gap(ladder),
        "next_trial": _next_trial(campaign, posterior),
        "warnings": list(campaign.warnings) + _weaknesses(campaign),
        "provenance": dict(provenance),
    }


def _causes(problem: LinearProblem, posterior: Posterior) -> list[dict[str, Any]]:
    by_name = {e.effect.name: e for e in posterior.explanations}
    chosen = [
        (name, p)
        for name, p in posterior.probabilities.items()
        if name not in {"no_gap", "parameters", "unknown"} and p > _SHOWN_PROBABILITY
    ][:5]
    if len(chosen) < 2:
        more = [e.effect.name for e in posterior.explanations if e.effect.name not in dict(chosen)]
        chosen += [(name, posterior.probabilities[name]) for name in more[: 2 - len(chosen)]]
    causes = []
    for name, probability in chosen:
        members = [by_name[part] for part in name.split(" + ")]
        columns = np.hstack([m.column.columns * m.effect.strength.high for m in members])
        ladder = climb(problem, columns)
        causes.append(
            {
                "effects": [m.effect.name for m in members],
                "indistinguishable_from": _alike(problem, members[0], posterior) if len(members) == 1 else [],
                "probability": probability,
                "parameters": {
                    m.effect.strength.name: {
                        "value": m.strength,
                        "std": float(np.hypot(m.strength_std, problem.campaign.plant.scale_rel_std * m.strength)),
                        "unit": m.effect.strength.unit
                    }
                    for m in members
                },
                "gap_closed": ladder.gap_closed,
                "gap_closed_ci95": list(ladder.gap_closed_ci95),
                "_ladder": ladder,
            }
        )  # fmt: skip
    return causes


def _alike(problem: LinearProblem, cause: Explanation, posterior: Posterior) -> list[str]:
    """Effects whose best signature points nearly the same way once the nuisances are taken out."""
    marginal = Marginal(problem)
    alike = list(cause.effect.same_as)
    for other in posterior.explanations:
        if other.effect.name == cause.effect.name:
            continue
        both = np.hstack([cause.column.columns[:, :1], other.column.columns[:, :1]])
        gram, _ = marginal.gram(both)
        size = np.sqrt(gram[0, 0] * gram[1, 1])
        if size > 0 and gram[0, 1] / size > _ALIKE:
            alike.append(other.effect.name)
    return alike


def _where(problem: LinearProblem) -> list[dict[str, Any]]:
    return [
        {
            "equation": spot.equation,
            "channel": spot.channel,
            "share": spot.share,
            "crank_angle_rad": [list(sector) for sector in spot.crank_angle_rad],
            "frequency_hz": None,
            "grows_with": list(spot.grows_with),
        }
        for spot in locate(problem)
    ]


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


def _gap(ladder: Ladder) -> dict[str, Any]:
    def rungs(r: Any) -> dict[str, float]:
        return {k: getattr(r, k) for k in ("nominal", "retuned", "with_effect", "noise_floor")}

    return {
        "metric": METRIC,
        **rungs(ladder.whitened),
        "by_channel": {name: {**rungs(r), "unit": unit} for name, (r, unit) in ladder.by_channel.items()},
    }


def _next_trial(campaign: Campaign, posterior: Posterior) -> str:
    lacking = campaign.plant.next_trial(campaign.states)
    if lacking is not None:
        return lacking
    top = next((e for e in posterior.explanations), None)
    if top is not None and top.effect.told_apart_by:
        return f"{top.effect.told_apart_by}: it separates {top.effect.name} from what it is taken for"
    return "a long trial at the highest load: it shows heat, wear and the battery"


def _weaknesses(campaign: Campaign) -> list[str]:
    running = [s for s in campaign.states if s.kind == "running"]
    said = campaign.plant.weaknesses(running)
    points = [s.setting.operating_point for s in running]
    if len(set(points)) == len(points):
        said.append("no operating point was repeated: a gap beyond what repeats differ by cannot be claimed")
    if len(set(points)) == 1:
        said.append("only one operating point: re-tuned parameters can hide most effects")
    return said
