"""How far a learned term closes the gap of effects that no catalogue lists, and whether it names what they depend on.

    python -m benchmarks.learned_term OUT [--rounds 3] [--intact 6] [--length 1.0]

Campaigns come from the blind check's plant: in every round one for each effect outside the catalogue whose mean stroke
shows it, at 0.5 to 2 times its typical size, and some without an effect. The term is learned whatever the verdict,
which is printed beside it; on intact campaigns it is what `diagnose` would say. "Closed" is the share of what re-tuned
parameters leave above the noise, at withheld operating points. Effects that are asynchronous with the stroke have no
such term and are left out. Resumable: one file a campaign in OUT; about 30 s each.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from sawbench.diagnosis.answer.learned_term import LearnedAnswer, learned_answer
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import judge

from benchmarks.blind_campaigns import blind_campaign, kept_cases, severity

FIRST_SEED: Final = 801
# A term closes much of a gap where it closes that share.
_MUCH: Final = 0.8
# Quantities of which the term must name one at least, and whose equation it must stand in: as the effect's formula has
# them. Heat and time both stand for a machine that warms up; position and angle are one.
TRUE: Final = MappingProxyType(
    {
        "current_crosstalk": ({"cutting", "sensing"}, {"motor_current_a"}),
        "grease_warming": ({"mechanical"}, {"time_s", "friction_heat_rad2_s2", "motor_heat_a2"}),
        "blade_whip": ({"cutting", "sensing", "mechanical"}, {"crank_angle_rad", "blade_position_m"}),
        "displacement_bow": (
            {"sensing", "mechanical", "electrical", "cutting"}, {"crank_angle_rad", "blade_position_m"},
        ),
    }
)  # fmt: skip


def answer_of(seed: int, effect: str | None, size: float, length: float) -> tuple[str, LearnedAnswer | None]:
    """Verdict, and the term that is learned for one simulated campaign."""
    campaign = blind_campaign(seed, {} if effect is None else {effect: size}, length=length).reduced()
    problem = build_problem(campaign)
    columns = effect_columns(problem)
    posterior = judge(problem, columns)
    verdict = posterior.verdict
    if effect is not None and verdict != "unknown":
        unknown = Hypothesis(other="unknown", log_evidence=0.0, probability=1.0)
        posterior = replace(posterior, hypotheses=(unknown,))
    return verdict, learned_answer(problem, columns, posterior)


def is_right(effect: str, answer: LearnedAnswer) -> bool:
    """Whether the term stands where the effect acts and names what it depends on."""
    places, quantities = TRUE[effect]
    found = answer.report()
    return found["equation"] in places and any(q["name"] in quantities for q in found["quantities"])


def case(seed: int, effect: str | None, length: float) -> dict[str, Any]:
    """Learn the term of one campaign, and keep what is said of it."""
    size = severity(np.random.default_rng([seed, 8]))
    verdict, answer = answer_of(seed, effect, size, length)
    found: dict[str, Any] = {"effect": effect, "size": size, "verdict": verdict, "words": None, "closed": 0.0}
    if answer is None:
        return found | {"is_right": False}
    return found | {
        "words": answer.words(), "closed": answer.ladder.closed[0], "interval": answer.ladder.closed[1],
        "is_right": effect is not None and is_right(effect, answer),
    }  # fmt: skip


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Count over all campaigns."""
    hidden = [row for row in rows if row["effect"] is not None]
    learned = [row for row in hidden if row["words"] is not None]
    intact = [row for row in rows if row["effect"] is None]
    much, none, right = (
        sum(row["closed"] >= _MUCH for row in hidden),
        sum(row["closed"] <= 0.0 for row in learned),
        sum(row["is_right"] for row in hidden),
    )
    return [
        f"{len(hidden)} campaigns with an effect: {len(learned)} learn a term, {much} close {_MUCH:.0%} or more, {none}"
        f" close nothing; {right} name what it depends on",
        f"silent on {sum(row['words'] is None for row in intact)} of {len(intact)} intact campaigns",
    ]


def main() -> None:
    """Print one line a campaign, and the two shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--intact", type=int, default=6, help="campaigns without an effect")
    parser.add_argument("--length", type=float, default=1.0, help="factor on the duration of every trial")
    told = parser.parse_args()
    hidden: list[str | None] = [*[*TRUE] * told.rounds, *[None] * told.intact]
    seeds, rows = range(FIRST_SEED, FIRST_SEED + len(hidden)), []

    def made(seed: int) -> dict[str, Any]:
        return case(seed, hidden[seed - FIRST_SEED], told.length)

    for row in kept_cases(told.out, "learned", seeds, made, may_begin=lambda: True):
        rows.append(row)
        said = "nothing learned" if row["words"] is None else f"closes {row['closed']:.0%}: {row['words']}"
        print(f"{row['effect'] or 'none'} {row['size']:.2f} ({row['verdict']}): {said}", flush=True)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
