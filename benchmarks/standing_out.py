"""Count the places of the gap that stand out, on campaigns without a gap and on campaigns with one effect.

    python -m benchmarks.standing_out [--quiet 8] [--length 0.6] [--benches own|foreign]

Campaigns come from the blind check's plant: seeds from 601 on without an effect, then one for each effect of its
catalogue at severity 1. Prints one line a campaign, and how many campaigns and places there were with finds. About 10 s
a campaign.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.diagnosis.answer.standing_out import Cell, find_cells
from sawbench.diagnosis.inference.columns import catalogue_columns, little_of_each
from sawbench.diagnosis.inference.linear_problem import build_problem

from benchmarks.blind_campaigns import blind_campaign

FIRST_SEED = 601


def cells_of(seed: int, effect: str | None, length: float, benches: str) -> tuple[Cell, ...]:
    """Cells of one simulated campaign."""
    made = blind_campaign(seed, {} if effect is None else {effect: 1.0}, length=length, benches=benches)
    problem = build_problem(made.reduced())
    little = little_of_each(problem, catalogue_columns(problem, problem.campaign.plant.effects))
    return find_cells(problem, np.hstack([np.zeros((len(problem.data), 0)), *little.values()]))


def main() -> None:
    """Print what stands out in every campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quiet", type=int, default=8, help="campaigns without an effect")
    parser.add_argument("--length", type=float, default=0.6, help="factor on the duration of every trial")
    parser.add_argument("--benches", choices=("own", "foreign"), default="own")
    chosen = parser.parse_args()
    for kind, effects in (("no effect", [None] * chosen.quiet), ("one effect", list(CATALOGUE))):
        n_campaigns, n_found, n_cells = 0, 0, 0
        for k, effect in enumerate(effects):
            cells = cells_of(FIRST_SEED + k, effect, chosen.length, chosen.benches)
            found = [cell for cell in cells if cell.stands_out]
            n_campaigns, n_found, n_cells = n_campaigns + bool(found), n_found + len(found), n_cells + len(cells)
            equations = ", ".join(f"{name} {n}" for name, n in Counter(cell.equation for cell in found).items())
            print(f"{effect or 'none'}: {len(found)} of {len(cells)} {equations}", flush=True)
        print(f"{kind}: {n_found} of {n_cells} places, in {n_campaigns} of {len(effects)} campaigns", flush=True)


if __name__ == "__main__":
    main()
