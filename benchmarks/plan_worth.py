"""Whether the trial that `diagnose --plan` proposes settles a confused campaign sooner than others do.

    python -m benchmarks.plan_worth OUT [--cases 40] [--first-seed 401] [--minutes 15]

Each case is a short campaign of the blind check's plant: the tool in air once and three cuts, one effect of the
catalogue at 0.5 to 2 times its typical size. "Unknown" makes no prediction that a trial could test: what is judged is
the share of an answer in what the others have together. Where no answer has 95 % of that, the campaign is confused, and
one more trial is simulated on the same bench: the proposed one, one drawn at random from the same candidates, and a
repeat of the last cut. Then the campaign is diagnosed again with each. "Settled": the hidden effect alone has 95 %.
Campaigns that are sure already are counted and left. Resumable: one file a case in OUT; `--minutes` ends between two
cases.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.blindcheck.campaign import write_campaign
from sawbench.blindcheck.drawing import CampaignDraw, draw_campaign
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.blindcheck.plans import TrialPlan
from sawbench.diagnosis.answer.candidate_trials import Candidate, candidates
from sawbench.diagnosis.answer.trial_plan import trial_plan
from sawbench.diagnosis.answer.until_closed import Pass, held
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.plants.choice import reduce_recordings

from benchmarks.blind_campaigns import kept_cases, read_back, severity

WAYS: Final = ("proposed", "random", "repeat")


def short_campaign(seed: int, effects: Mapping[str, float]) -> CampaignDraw:
    """Draw a campaign of four trials: in air, a cut, a cut at the highest duty, a cut of other stock."""
    draw = draw_campaign(seed, effects=effects)
    cuts = [trial for trial in draw.trials if trial.feed_mm_s > 0.0]
    middle, high = draw.bench.duties[1], max(trial.duty for trial in cuts)
    usual = next(trial for trial in cuts if trial.duty == middle and trial.thickness_mm == 20.0)
    fast = next(trial for trial in cuts if trial.duty == high)
    other = next(trial for trial in cuts if trial.thickness_mm != 20.0)
    return replace(draw, trials=(draw.trials[0], usual, fast, other))


def diagnosed(draw: CampaignDraw) -> tuple[Pass, dict[str, str]]:
    """Measure and diagnose a campaign; with the material of each trial."""
    with tempfile.TemporaryDirectory() as folder:
        tables = Path(folder) / "tables"
        write_campaign(draw, tables)
        recordings, loaded = read_back(tables)
    problem = build_problem(reduce_recordings(recordings, loaded))
    columns = effect_columns(problem)
    materials = {r.trial.trial_id: r.trial.material for r in recordings if r.trial.material}
    return held(problem, columns, judge(problem, columns)), materials


def with_one_more(draw: CampaignDraw, trial: TrialPlan) -> CampaignDraw:
    """Return the same campaign with one more trial at its end."""
    return replace(draw, trials=(*draw.trials, trial))


def planned(candidate: Candidate) -> TrialPlan:
    """Return a candidate as the bench runs it."""
    return TrialPlan(
        duty=candidate.duty, workpiece=candidate.material, thickness_mm=candidate.thickness_mm or 0.0,
        feed_mm_s=candidate.feed_mm_s or 0.0, seconds=candidate.seconds,
        rest_s=candidate.rest_s + SETTINGS.planning.handling_s,
    )  # fmt: skip


def case(number: int, seed: int) -> dict[str, Any]:
    """Diagnose one campaign, and again with one more trial of each way where it is not sure."""
    rng = np.random.default_rng([seed, 5])
    effect = list(CATALOGUE)[number % len(CATALOGUE)]
    draw = short_campaign(seed, {effect: severity(rng)})
    answer, materials = diagnosed(draw)
    found: dict[str, Any] = {"seed": seed, "hidden": effect, "severity": draw.effects[effect], **_said(answer, effect)}
    if found["share"] >= SETTINGS.report.settled:
        return found
    plan = trial_plan(answer.problem, answer.posterior, 1, materials)
    assert plan is not None
    found["considered"], found["expected"] = [name for name, _ in plan.considered], plan.expected_probability
    if not plan.chosen:
        return found | {"after": {}}
    offered = candidates(answer.problem, materials)
    trials = {
        "proposed": planned(plan.chosen[0].trial),
        "random": planned(offered[int(rng.integers(len(offered)))]),
        "repeat": replace(draw.trials[-1], rest_s=SETTINGS.planning.handling_s),
    }
    found["expected_after"] = plan.chosen[0].expected_probability
    found["after"] = {
        way: _said(diagnosed(with_one_more(draw, trial))[0], effect) | {"minutes": (trial.rest_s + trial.seconds) / 60}
        for way, trial in trials.items()
    }
    return found


def _said(answer: Pass, effect: str) -> dict[str, Any]:
    """What is answered, with its share in all answers but "unknown", and the share of the truth."""
    posterior = answer.posterior
    known = [h for h in posterior.hypotheses if h.other != "unknown"]
    total = max(sum(float(h.probability) for h in known), 1e-12)
    best = max(known, key=lambda h: h.probability)
    truth = next((float(h.probability) for h in known if h.effects == (effect,)), 0.0)
    return {"answer": best.name, "share": float(best.probability) / total, "of_truth": truth / total}


def is_settled(said: Mapping[str, Any], effect: str) -> bool:
    """Whether the truth is named for sure."""
    return said["answer"] == effect and said["share"] >= SETTINGS.report.settled


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Count over the cases that were confused."""
    confused = [row for row in rows if "after" in row]
    told = [row for row in confused if row["after"]]
    said = [
        f"{len(rows)} campaigns, {len(rows) - len(confused)} sure at once, {len(confused) - len(told)} for which no"
        f" trial is proposed, {len(told)} with one more trial; the truth had"
        f" {np.mean([row['of_truth'] for row in told] or [np.nan]):.2f} before"
    ]
    for way in WAYS:
        after = [(row["after"][way], row["hidden"]) for row in told]
        if after:
            settled, named = sum(is_settled(*one) for one in after), sum(one["answer"] == e for one, e in after)
            of_truth, minutes = (float(np.mean([one[key] for one, _ in after])) for key in ("of_truth", "minutes"))
            said.append(
                f"{way:9} settles {settled} of {len(after)}, names the truth in {named}; the truth has {of_truth:.2f};"
                f" {minutes:.1f} min"
            )
    return said


def main() -> None:
    """Go through the cases and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=401)
    parser.add_argument("--minutes", type=float, default=15.0, help="of processor time, after which no case is begun")
    told = parser.parse_args()
    seeds, rows = range(told.first_seed, told.first_seed + told.cases), []

    def has_time() -> bool:
        return time.process_time() < 60.0 * told.minutes

    for row in kept_cases(told.out, "case", seeds, lambda s: case(s - told.first_seed, s), may_begin=has_time):
        rows.append(row)
        after = {way: f"{one['answer']} {one['of_truth']:.2f}" for way, one in row.get("after", {}).items()}
        print(
            told.first_seed + len(rows) - 1, row["hidden"], row["answer"], f"{row['of_truth']:.2f}", after, flush=True
        )
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
