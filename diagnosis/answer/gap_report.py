"""The gap report as plain values: the file `gap_report.json` that other people's scripts read."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from sawbench.bench.config import LoadedConfig
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.answer.channel_gap import ChannelGap
from sawbench.diagnosis.answer.claim import carried_by_strokes
from sawbench.diagnosis.answer.contradiction import contradiction
from sawbench.diagnosis.answer.detection_limits import DetectionLimit, detection_limits
from sawbench.diagnosis.answer.gap_detail import detail
from sawbench.diagnosis.answer.improved_model import improved_model, magnitudes, retuned_with
from sawbench.diagnosis.answer.ladder import RUNGS, Ladder, Rungs
from sawbench.diagnosis.answer.learned_term import learned_answer, learned_warnings
from sawbench.diagnosis.answer.next_trial import next_trial
from sawbench.diagnosis.answer.prediction import Predictions
from sawbench.diagnosis.answer.signals import signal_findings
from sawbench.diagnosis.answer.trial_plan import plan_report
from sawbench.diagnosis.answer.until_closed import Pass, closing_table, held
from sawbench.diagnosis.answer.until_closed import until_closed as close
from sawbench.diagnosis.answer.where import locate
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.acts_in import equations_of
from sawbench.diagnosis.inference.cell_resonance import with_cell_resonance
from sawbench.diagnosis.inference.dispersion import stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.gain_drift import GainDrift, gain_drifts
from sawbench.diagnosis.inference.hypothesis import OTHERS, Hypothesis
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior, judge_weighed
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.vibration_read import Vibration, vibration_of
from sawbench.diagnosis.inference.weighing import missed_by
from sawbench.diagnosis.plants.choice import reduce_recordings
from sawbench.modeling.machines.table import machine_of

SCHEMA_VERSION = 1
# A longer plan is worth less than a new diagnosis on the way.
MOST_PLANNED = 20
_METRIC = (
    "root mean square of the equation residuals over their noise, on {held_out}; by_channel: measured minus predicted"
    " mean {cycle} in the unit of the channel, over the harmonics compared{simulated}{fitted}"
)
_FITTED = "; k_Fc of a workpiece is always fitted to its own trial"
_HELD_OUT = {
    "operating points": "withheld operating points",
    "trials": "withheld trials (few operating points, or only one cuts or shows the effect)",
    "nothing": "the only trial, which was used in the fit (no withheld data)",
}
# Where the parts of the work stand on the progress bar, of 100.
_REDUCED, _SIGNED, _JUDGED = 40, 50, 80
# Where a line that no equation explains is first to be looked for.
_EQUATION_OF_CHANNEL = {
    "motor_current_a": "electrical", "force_n": "cutting", "battery_voltage_v": "supply", "battery_current_a": "supply",
}  # fmt: skip
_LEAST_SHOWN, _MOST_SHOWN = 2, 5
_NONE_YET = "none before channels, units and configuration are checked"


def diagnose(
    recordings: Sequence[Recording],
    loaded: LoadedConfig,
    *,
    provenance: Mapping[str, Any],
    until_closed: bool = False,
    n_planned: int = 0,
    on_step: Callable[[int, int, str], None] | None = None,
) -> dict[str, Any]:
    """Diagnose the sim-to-real gap of a campaign.

    Parameters
    ----------
    recordings : sequence of Recording
    loaded : LoadedConfig
    provenance : mapping
        Goes into the report as it is.
    until_closed : bool
        Add causes one by one until nothing more closes; see `diagnosis.answer.until_closed`.
    n_planned : int
        Trials to propose; see `diagnosis.answer.trial_plan`.
    on_step : callable, optional
        (done, total, what).

    Returns
    -------
    dict
        `gap_report.json`.

    Raises
    ------
    InputError
        If nothing can be diagnosed; the message says why for every trial. If a plan is asked for that cannot be made.
    """
    say = on_step or (lambda done, total, what: None)
    _refuse_plan(n_planned, loaded)
    campaign = reduce_recordings(
        recordings, loaded, on_trial=lambda done, total, name: say(_REDUCED * done // total, 100, f"reading {name}")
    )
    say(_REDUCED, 100, "computing the signature of every effect")
    weighed = with_cell_resonance(campaign)
    say(_SIGNED, 100, "weighing causes")
    answer = held(weighed.problem, weighed.columns, judge_weighed(weighed))
    del weighed  # large, and nothing of it is needed any more
    further: dict[str, Any] = {}
    if until_closed:
        closing = close(
            answer, on_pass=lambda _, found: say(_SIGNED, 100, f"weighing further causes in addition to {found}")
        )
        answer, further["until_closed"] = closing.answer, closing_table(closing)
    if n_planned:
        say(_JUDGED, 100, "planning trials")
        trials = [recording.trial for recording in recordings]
        further["plan"] = plan_report(answer.problem, answer.posterior, n_planned, trials)
    say(_JUDGED, 100, "predicting withheld operating points")
    return _report(answer, loaded, provenance, further)


def _refuse_plan(n_planned: int, loaded: LoadedConfig) -> None:
    """Refuse a plan that nobody can run, before anything is read."""
    if not 0 <= n_planned <= MOST_PLANNED:
        raise InputError(f"{n_planned} trials cannot be planned", remedy=f"give 1 to {MOST_PLANNED}")
    if n_planned and machine_of(loaded.config, path=loaded.path).frame != "crank":
        raise InputError(
            "trials are planned for a saw; this configuration describes another machine", where=loaded.path,
            remedy="leave out the plan; `next_trial` of the report describes the missing trial in words",
        )  # fmt: skip


def _report(
    answer: Pass, loaded: LoadedConfig, provenance: Mapping[str, Any], further: Mapping[str, Any]
) -> dict[str, Any]:
    """Put an answer into the words of the contract, and further tables beside it."""
    problem, columns, posterior, predictions = answer.problem, answer.columns, answer.posterior, answer.predictions
    campaign = problem.campaign
    shown_causes = _shown_causes(posterior)
    learned = learned_answer(problem, columns, posterior)
    first = shown_causes[0] if shown_causes else posterior.of("no_gap")
    channels = predictions.channels_of(first)

    def of_causes() -> list[dict[str, Any]]:
        return [_cause(problem, posterior, predictions, hypothesis) for hypothesis in shown_causes]

    def where() -> list[dict[str, Any]]:
        return [] if posterior.verdict == "no_gap" else _where(problem, posterior)

    def detectable() -> dict[str, DetectionLimit]:
        return detection_limits(problem, columns, posterior, SETTINGS.report.shown_log_odds)

    # This process takes the first one, for which it knows the predictions already; the other one the last, the longest.
    parts: list[Callable[[], Any]] = [of_causes, where, detectable, lambda: detail(problem, posterior, channels)]
    causes, places, limits, details = on_two_cores(operator.call, parts)
    members = predictions.sized(posterior.best)
    shifts = _shifts(problem, posterior, members)
    retuned = {name: shift["value"] for name, shift in shifts.items()}
    by_direction, asymmetry = campaign.plant.asymmetry(campaign.states, posterior.best.effects, retuned)
    if by_direction:
        causes[0]["by_direction"] = by_direction
    gap = _gap(predictions.of(first).ladder, channels, campaign)
    contradicted = contradiction(posterior.verdict, shifts, gap, campaign.plant.measured_rms(campaign.states))
    improved = None if contradicted else improved_model(problem, posterior, members, causes, loaded, learned)
    return {
        "schema_version": SCHEMA_VERSION,
        "verdict": posterior.verdict,
        "where": places,
        "causes": causes,
        "probabilities": {name: posterior.of(name).probability for name in OTHERS},
        "parameter_shifts": shifts,
        "gap": gap,
        "signals": signal_findings(campaign, problem.wander, *_of_sensors(problem, posterior)),
        "learned_term": None if learned is None else learned.report(),
        "improved_model": improved,
        "next_trial": _NONE_YET if contradicted else next_trial(problem, posterior),
        "warnings": [
            *([contradicted] if contradicted else []), *([asymmetry] if asymmetry else []),
            *_warnings(campaign, limits, posterior, channels), *learned_warnings(problem, posterior, learned),
        ],
        **further,
        "detail": {
            **details, "held_out": predictions.of(first).ladder.held_out, "contradiction": contradicted,
            "log_odds_at_typical_size": {name: limit.log_odds for name, limit in limits.items()},
            "detection_limit_log_odds": SETTINGS.report.shown_log_odds,
            "detection_limits": {name: _limit(limit) for name, limit in limits.items() if limit.name},
        },
        "provenance": dict(provenance),
    }  # fmt: skip


def _of_sensors(
    problem: LinearProblem, posterior: Posterior
) -> tuple[Mapping[str, GainDrift], Vibration | None]:  # fmt: skip
    """Estimate by the noise of this bench, together with the likeliest cause and background effects."""
    noise = posterior.dispersion
    beside = [posterior.small, *(m.column.of_any_size for m in posterior.best.members)]
    noisy = with_noise(problem, noise)
    marginal = Marginal(noisy, extra=stacked_with_noise(problem, beside, noise))
    return gain_drifts(noisy, marginal), vibration_of(noisy, marginal)


def _shown_causes(posterior: Posterior) -> list[Hypothesis]:
    """Claims that the report lists; what has most evidence, where hardly any is probable."""
    chosen = [h for h in posterior.claims if h.probability > SETTINGS.report.shown_probability][:_MOST_SHOWN]
    names = [e.effect.name for e in posterior.explanations if (e.effect.name,) not in {h.effects for h in chosen}]
    return chosen + [posterior.of(name) for name in names[: max(_LEAST_SHOWN - len(chosen), 0)]]


def _cause(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions, hypothesis: Hypothesis
) -> dict[str, Any]:  # fmt: skip
    """Entry of the report."""
    closed, interval = predictions.of(hypothesis).ladder.closed_in(equations_of(problem, hypothesis.members))
    forms = {m.effect.name.replace("_", " "): m.effect.form_words(m.column.shape) for m in hypothesis.members}
    return {
        "effects": list(hypothesis.effects),
        "indistinguishable_from": _alike(problem, hypothesis, posterior),
        "probability": hypothesis.probability,
        "parameters": magnitudes(problem, predictions.sized(hypothesis)),
        "form": [words if len(forms) == 1 else f"{name} {words}" for name, words in forms.items() if words],
        "gap_closed": closed,
        "gap_closed_ci95": list(interval),
        "carried_by_strokes": carried_by_strokes(posterior, hypothesis),
    }


def _alike(problem: LinearProblem, cause: Hypothesis, posterior: Posterior) -> list[str]:
    """Effects that this campaign cannot tell from one of the cause: in its place, they have nearly its evidence.

    By less than the standard deviation of a log evidence, its square root, or by odds below `settings.Report.odds`:
    forms that are not nature's decide by that much between rivals that both explain the gap. Beside other effects of
    the cause, of what each adds to these, less what their forms may add to it.
    """
    found = dict.fromkeys(name for m in cause.members for name in m.effect.same_as)
    claims = sorted(posterior.claims, key=lambda h: -h.log_evidence)
    for name in cause.effects:
        rest = cause.without(name)
        base = next((h for h in claims if h.effects == rest), None)
        added = {
            h.effects: h.log_evidence - (0.0 if base is None else base.log_evidence + missed_by(base, h))
            for h in claims
            if len(h.effects) == len(cause.effects) and set(rest) < set(h.effects)
        }
        own = added[cause.effects]
        scatter = max(np.sqrt(max(own, 0.0)), np.log(problem.settings.report.odds))
        for effects, value in added.items():
            if value > own - scatter:
                found.update(dict.fromkeys(set(effects) - set(rest)))
    return [name for name in found if name not in cause.effects]


def _where(problem: LinearProblem, posterior: Posterior) -> list[dict[str, Any]]:
    sensing = [m for m in posterior.best.members if m.effect.place == "sensing"]
    ringing = [m.strength for m in sensing if m.effect.strength.unit == "Hz"]
    found: list[dict[str, Any]] = [
        {
            "equation": spot.equation,
            "channel": spot.channel,
            "share": spot.share,
            "crank_angle_rad": [list(sector) for sector in spot.crank_angle_rad],
            "frequency_hz": ringing if ringing and spot.equation == "sensing" else None,
            "grows_with": list(spot.grows_with),
        }
        for spot in locate(problem, posterior)
    ]
    beside = posterior.finding
    if beside is None or not (beside.lines_hz or beside.equation):
        return found
    # Mean strokes, and so the shares, hold nothing of it. It is the place where they hold no gap, or it is the answer.
    is_answer = posterior.verdict == "unknown" and posterior.resembles == beside.text
    is_all = is_answer or posterior.of("parameters").left_over < problem.quiet
    line = {
        "equation": beside.equation or _EQUATION_OF_CHANNEL.get(beside.channel, "sensing"), "channel": beside.channel,
        "share": 1.0 if is_all else 0.0, "crank_angle_rad": [], "frequency_hz": list(beside.lines_hz) or None,
        "grows_with": [],
    }  # fmt: skip
    return [line] if is_all else [*found, line]


def _shifts(problem: LinearProblem, posterior: Posterior, members: Sequence[Explanation]) -> dict[str, Any]:
    """Re-tuned parameters: beside a declared cause within what is stated of them, else those free that pay for it.

    A model that lacks the cause bends its parameters towards it; beside the cause they are those of the machine.
    """
    found = retuned_with(problem, members, freed=() if members else posterior.freed)
    place = {name: k for k, name in enumerate(found.names)}
    shifts = {}
    for nuisance in problem.campaign.plant.nuisances():
        if nuisance.is_plant and nuisance.name in place:
            k = place[nuisance.name]
            shift = float(found.values[k] * found.width[k])
            shifts[nuisance.name] = {
                "value": nuisance.nominal + shift, "std": float(found.stds[k] * found.width[k]),
                "nominal": nuisance.nominal, "sigmas": shift / nuisance.std,
            }  # fmt: skip
    return shifts


def _gap(ladder: Ladder, channels: ChannelGap | None, campaign: Campaign) -> dict[str, Any]:
    by_channel = ladder.by_channel if channels is None or not channels.by_channel else channels.by_channel
    simulated = "" if by_channel is ladder.by_channel else ", predicted by the simulated model"
    found = {
        "metric": _METRIC.format(
            held_out=_HELD_OUT[ladder.held_out],
            cycle=campaign.plant.machine.words.cycle,
            simulated=simulated,
            fitted=_FITTED if campaign.k_guess_n_s_per_m else "",
        ),
        **_rungs(ladder.whitened),
        "by_channel": {name: {**_rungs(r), "unit": unit} for name, (r, unit) in by_channel.items()},
    }
    if channels is not None and channels.runtime_s:
        found["runtime_s"] = dict(channels.runtime_s)
    return found


def _rungs(rungs: Rungs) -> dict[str, float]:
    return {name: getattr(rungs, name) for name in RUNGS}


def _warnings(
    campaign: Campaign, limits: Mapping[str, DetectionLimit], posterior: Posterior, channels: ChannelGap | None
) -> list[str]:
    return [
        *campaign.warnings, *_weaknesses(campaign), *_hidden(limits, posterior.best.effects), *_of_strokes(posterior),
        *([] if posterior.finding is None else [posterior.finding.text]),
        *(() if channels is None else channels.warnings),
    ]  # fmt: skip


def _limit(limit: DetectionLimit) -> dict[str, Any]:
    return {"name": limit.name, "unit": limit.unit, "change": limit.change, "without_effect": limit.without}


def _hidden(limits: Mapping[str, DetectionLimit], named: Sequence[str]) -> list[str]:
    """Say what this campaign could not show, before it is taken for absent; not of a cause that it does show."""
    least = SETTINGS.report.shown_log_odds
    names = [name.replace("_", " ") for name, limit in limits.items() if limit.log_odds < least and name not in named]
    return [f"below the detection limit here, at their typical magnitude: {', '.join(names)}"] if names else []


def _of_strokes(posterior: Posterior) -> list[str]:
    """Say what single strokes have found that mean strokes do not show."""
    found = [posterior.strokes[name].words for name in posterior.best.effects if name in posterior.strokes]
    return [
        f"{words}, detected in single strokes; the gap is computed from mean strokes, which it barely changes"
        for words in found
        if words
    ]


def _weaknesses(campaign: Campaign) -> list[str]:
    running = [s for s in campaign.states if s.kind == "running"]
    said = campaign.plant.weaknesses(running)
    points = [s.setting.operating_point for s in running]
    if len(set(points)) == len(points):
        said.append("no operating point was repeated: the repeatability is unknown, so no gap beyond it can be claimed")
    if len({s.setting.label for s in running}) == 1:
        said.append("only one trial: none was withheld, so every error stated is that of the fit")
    if len(set(points)) == 1:
        said.append("only one operating point: re-tuned parameters can hide most effects")
    return said
