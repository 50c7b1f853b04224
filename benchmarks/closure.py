"""Whether the gap closes once the true effect stands in the model: every effect of the catalogue, one campaign each.

    python -m benchmarks.closure OUT [--length 0.6] [--first-seed 801] [--effects NAME ...]

Campaigns come from the blind check's plant, each with one effect at a size drawn between 0.5 and 2 times the typical
one. The true magnitude is put into the model in the catalogue's own form: the one that leaves least of the campaign,
with its phase. Then the campaign is diagnosed: "no_gap" and "parameters" are closed. Nature's forms are not those of
the catalogue, so an effect can stay open; what is left of its gap is printed beside it, and how far the predicted
runtime then misses. Resumable: one file an effect in OUT; about 25 s of one core each.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.diagnosis.answer.channel_gap import forecast
from sawbench.diagnosis.answer.until_closed import Pass, held
from sawbench.diagnosis.campaign import Campaign, with_known
from sawbench.diagnosis.inference.columns import Column, catalogue_columns
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.linear_problem import LinearProblem, build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import judge
from sawbench.modeling.effects.known import KnownEffect

from benchmarks.blind_campaigns import blind_campaign, severity

# Nobody knows a magnitude better than that, relative.
_REL_STD = 0.05


def reduced(seed: int, effect: str, size: float, length: float) -> tuple[Campaign, float | None]:
    """Simulate and reduce one campaign; with the true value of the effect's parameter, where its form has one."""
    made = blind_campaign(seed, {effect: size}, length=length)
    reported = made.truth["reported_parameters"].get(effect)
    return made.reduced(), None if reported is None else float(reported["value"])


def known_in_best_form(problem: LinearProblem, columns: Sequence[Column], value: float | None) -> KnownEffect:
    """Return the effect at its true magnitude, in the catalogue's form that leaves least of the campaign.

    Without a true value the magnitude is what fits best.
    """
    marginal, model = Marginal(problem), problem.campaign.plant.model
    best: tuple[float, KnownEffect] | None = None
    for column in columns:
        effect = column.effect
        gram, moment = marginal.gram(column.columns)
        sizes = np.linalg.lstsq(gram, moment, rcond=None)[0]
        if column.columns.shape[1] == 1:
            sizes = np.maximum(sizes, 1e-3)
        fitted = effect.reported_strength(effect.amplitude(sizes) * effect.strength.typical, column.shape)
        carried = [key for key in effect.carries if key in column.shape]
        magnitude = fitted if value is None else value
        known = KnownEffect(
            effect=effect,
            value=magnitude,
            std=_REL_STD * abs(magnitude),
            form={key: number for key, number in column.shape.items() if key not in carried},
            direction=(1.0,) if len(sizes) == 1 else tuple(float(s) for s in sizes / np.abs(sizes).max()),
        )
        rest = problem.data - problem.project(lambda state, k=known: k.signature(model, state))
        left = float(rest @ marginal.rest(rest))
        if best is None or left < best[0]:
            best = left, known
    if best is None:
        raise SystemExit(f"a campaign shows nothing of {columns}")
    return best[1]


def diagnosed(campaign: Campaign) -> Pass:
    """Weigh a reduced campaign and hold the answer to its predictions."""
    problem = build_problem(campaign)
    columns = effect_columns(problem)
    return held(problem, columns, judge(problem, columns))


def closure_of(effect: str, seed: int, length: float) -> dict[str, Any]:
    """Diagnose one campaign with its true effect in the model."""
    rng = np.random.default_rng([seed, zlib.crc32(effect.encode())])
    size = severity(rng)
    campaign, value = reduced(seed, effect, size, length)
    problem = build_problem(campaign)
    columns = catalogue_columns(problem, [e for e in campaign.plant.effects if e.name == effect])[effect]
    known = known_in_best_form(problem, columns, value)
    before = float(problem.data @ Marginal(problem).rest(problem.data)) / len(problem.data)
    answer = diagnosed(with_known(campaign, (replace(known, std=_REL_STD * abs(known.value)),)))
    best = answer.posterior.best
    found = {
        "effect": effect, "severity": size, "seed": seed, "value": known.value, "form": dict(known.form),
        "is_true_value": value is not None, "verdict": answer.posterior.verdict, "named": list(best.effects),
        "probability": best.probability, "left_before": before,
        "left": answer.posterior.of("no_gap").left_over, "quiet": answer.problem.quiet,
        "resembles": answer.posterior.resembles,
    }  # fmt: skip
    if not is_closed(found):
        prediction = answer.predictions.of(answer.posterior.of("no_gap"))
        channels = forecast(prediction.hold_out, prediction.ladder, prediction.forms)
        times = {} if channels is None else dict(channels.runtime_s)
        found["runtime_miss"] = times["nominal"] / times["measured"] - 1.0 if times.get("measured") else None
    return found


def is_closed(found: dict[str, Any]) -> bool:
    """Whether nothing but parameters is left to explain."""
    return found["verdict"] in {"no_gap", "parameters"}


def line(found: dict[str, Any]) -> str:
    """One effect in words."""
    said = f"{found['effect']:30} {found['severity']:5.2f}  {'closed' if is_closed(found) else 'OPEN':6}"
    said += (
        f"  {found['verdict']:10} left {found['left']:.3g} of {found['left_before']:.3g} (intact {found['quiet']:.2g})"
    )
    if not is_closed(found):
        miss = found["runtime_miss"]
        said += f"  {' + '.join(found['named']) or found['resembles'] or 'no particular form'}"
        said += "" if miss is None else f"; runtime {100 * miss:+.1f} %"
    return said


def main() -> None:
    """Go through the catalogue and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--length", type=float, default=0.6, help="factor on the duration of every trial")
    parser.add_argument("--first-seed", type=int, default=801)
    parser.add_argument("--effects", nargs="+", choices=list(CATALOGUE), default=list(CATALOGUE))
    told = parser.parse_args()
    told.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for number, effect in enumerate(CATALOGUE):
        if effect not in told.effects:
            continue
        path = told.out / f"{effect}.json"
        if not path.exists():
            path.write_text(json.dumps(closure_of(effect, told.first_seed + number, told.length)), encoding="utf-8")
        rows.append(json.loads(path.read_text(encoding="utf-8")))
        print(line(rows[-1]), flush=True)
    print(f"{sum(map(is_closed, rows))} of {len(rows)} closed")


if __name__ == "__main__":
    main()
