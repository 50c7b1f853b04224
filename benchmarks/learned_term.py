"""How far a learned term closes the gap of effects that no catalogue lists, and whether it names what they depend on.

    python -m benchmarks.learned_term [--size 1.0] [--intact 6] [--length 1.0]

Campaigns come from the blind check's plant: one for each effect outside the catalogue whose mean stroke shows it, at
`size` times its typical size, and some without an effect. The term is learned whatever the verdict, which is printed
beside it; on intact campaigns it is what `diagnose` would say. "Closed" is the share of what re-tuned parameters leave
above the noise, at withheld operating points. Effects that are asynchronous with the stroke have no such term and are
left out. About 30 s a campaign.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.diagnosis.answer.learned_term import LearnedAnswer, learned_answer
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.refining import effect_columns

from benchmarks.blind_campaigns import blind_campaign

FIRST_SEED: Final = 801
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


def main() -> None:
    """Print one line a campaign, and the two shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=float, default=1.0, help="of the effect, in typical ones")
    parser.add_argument("--intact", type=int, default=6, help="campaigns without an effect")
    parser.add_argument("--length", type=float, default=1.0, help="factor on the duration of every trial")
    chosen = parser.parse_args()
    closed, right, silent = [], [], 0
    for k, effect in enumerate([*TRUE, *[None] * chosen.intact]):
        verdict, answer = answer_of(FIRST_SEED + k, effect, chosen.size, chosen.length)
        said = "nothing learned" if answer is None else f"closes {answer.ladder.gap_closed:.0%}: {answer.words()}"
        print(f"{effect or 'none'} ({verdict}): {said}", flush=True)
        if effect is None:
            silent += answer is None
            continue
        closed.append(0.0 if answer is None else answer.ladder.gap_closed)
        right.append(answer is not None and is_right(effect, answer))
    print(f"{np.mean(np.array(closed) >= 0.8):.0%} close 80 % or more, {np.mean(right):.0%} name what it depends on")
    print(f"silent on {silent} of {chosen.intact} intact campaigns")


if __name__ == "__main__":
    main()
