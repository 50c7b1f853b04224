"""What each heuristic of the weighing is worth: the same campaigns answered without it.

    python -m benchmarks.ablation OUT [--cases 48] [--minutes 60]

Every second campaign is of the paper's jigsaw on a clean bench, every other one of a foreign bench with faulty sensors;
what they hide is drawn as for `development_campaigns`. Each is reduced once and weighed with the settings as they are,
and once for every row of `ABLATIONS` with one of them neutral; its claims are held to their predictions once for every
row of `PREDICTIONS`. Then one line a row: how many campaigns are answered rightly, how many claims are made and are
right, how many campaigns without an effect are accused, and the log-loss of the truth. Resumable: one file a campaign
in OUT; about a minute of one core each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sawbench.diagnosis.answer.until_closed import held
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import Posterior, judge
from sawbench.diagnosis.inference.settings import SETTINGS, Settings

from benchmarks.blind_campaigns import blind_campaign, kept_cases
from benchmarks.development_campaigns import COUNTED, counted, plan, truth

AS_IT_IS: Final = "as it is"
HELD: Final = "held to predictions: the answer"
_HELD_BUT: Final = "held, but"
# Of the plan of the calibration: every kind and effect comes up within a few dozen of them.
_EVERY: Final = 3


def _with(topic: str, **numbers: Any) -> Settings:
    return replace(SETTINGS, **{topic: replace(getattr(SETTINGS, topic), **numbers)})


# Thirty effects of a saw and three answers without one, all alike.
_EVEN: Final = 1.0 / 33.0
# Numbers of the weighing, and numbers that change the noise and therefore all signatures.
ABLATIONS: Final[Mapping[str, Settings]] = MappingProxyType(
    {
        AS_IT_IS: SETTINGS,
        "prior odds of no gap, parameters and unknown as of any effect": _with(
            "weights", prior_no_gap=_EVEN, prior_parameters=_EVEN, prior_unknown=_EVEN
        ),
        "unknown by its own evidence alone": _with("weights", floor_gap=1e9),
        "forms are nature's": _with("forms", shares=(0.0,)),
        "harmonics of a form miss together": _with("forms", harmonic_factor=1e-6),
    }
)
NOISES: Final[Mapping[str, Settings]] = MappingProxyType(
    {
        "blocks are independent": _with("noise", correlation_factor=1.0),
        "no floor under what an intact machine leaves": _with("weights", quiet=0.0),
    }
)
# Numbers of what a claim must predict, each without which it may do less.
PREDICTIONS: Final[Mapping[str, Settings]] = MappingProxyType(
    {
        HELD: SETTINGS,
        f"{_HELD_BUT} what is small counts as what is large": _with(
            "forms", background_amplitude=0.0, least_amplitude=0.0
        ),
        f"{_HELD_BUT} of a gap hardly any need be removed": _with("ladder", least_added=0.0, most_of_a_gap=0.0),
        f"{_HELD_BUT} of hardly a gap a tenth is enough": _with("ladder", most_of_a_gap=SETTINGS.ladder.least_added),
        f"{_HELD_BUT} the channels may be missed by any amount": _with("ladder", most_harm=1e9),
    }
)


def rows(n_cases: int) -> list[dict[str, Any]]:
    """What each campaign hides, and where."""
    drawn = plan(_EVERY * n_cases)[::_EVERY]
    return [row | {"benches": "foreign" if k % 2 else "own"} for k, row in enumerate(drawn)]


def case(row: Mapping[str, Any]) -> dict[str, Any]:
    """Probabilities of one campaign, by row of the table."""
    made = blind_campaign(row["seed"], row["effects"], parameters=row["parameters"], benches=row["benches"])
    campaign = made.reduced()
    problem = build_problem(campaign)
    columns = effect_columns(problem)
    found = {words: judge(replace(problem, settings=settings), columns) for words, settings in ABLATIONS.items()}
    found |= {words: _in_other_noise(campaign, settings) for words, settings in NOISES.items()}
    found |= {
        words: held(replace(problem, settings=settings), columns, found[AS_IT_IS]).posterior
        for words, settings in PREDICTIONS.items()
    }
    return {**row, "answers": {words: _probabilities(one) for words, one in found.items()}}


def _in_other_noise(campaign: Campaign, settings: Settings) -> Posterior:
    problem = build_problem(campaign, settings=settings)
    return judge(problem, effect_columns(problem))


def _probabilities(posterior: Posterior) -> dict[str, float]:
    return {h.name: h.probability for h in posterior.hypotheses if h.probability > 1e-6}


def table(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a row, the likeliest answer of each campaign against its truth."""
    lines = [f"{'':60}  {COUNTED}"]
    for words in found[0]["answers"]:
        lines.append(f"{words:60}  {counted([(row, row['answers'][words]) for row in found])}")
    return lines


def main() -> None:
    """Answer the campaigns and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=48)
    parser.add_argument("--minutes", type=float, default=60.0, help="of processor time, after which no case is begun")
    told = parser.parse_args()
    planned, found = rows(told.cases), []

    def made(number: int) -> dict[str, Any]:
        return case(planned[number])

    def has_time() -> bool:
        return time.process_time() < 60.0 * told.minutes

    for row in kept_cases(told.out, "ablation", range(told.cases), made, may_begin=has_time):
        found.append(row)
        print(len(found), row["seed"], row["benches"], truth(row), flush=True)
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
