"""Count the places of the gap that stand out, on campaigns without a gap and on campaigns with one effect.

    python -m benchmarks.standing_out [--quiet 8] [--length 0.6]

Campaigns come from the blind check's plant: seeds from 601 on without an effect, then one for each effect of its
catalogue at severity 1. Prints one line a campaign, and how many campaigns and places there were with finds. About 10 s
a campaign.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

from sawbench.bench.config import load_config
from sawbench.blindcheck.campaign import make_campaign
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.diagnosis.answer.standing_out import Cell, find_cells
from sawbench.diagnosis.inference.evidence import background
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.plants.choice import reduce_recordings
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

FIRST_SEED = 601


def cells_of(seed: int, effect: str | None, length: float) -> tuple[Cell, ...]:
    """Cells of one simulated campaign."""
    with tempfile.TemporaryDirectory() as folder:
        tables, recorded = Path(folder) / "tables", Path(folder) / "mcap"
        make_campaign(seed, tables, effects={} if effect is None else {effect: 1.0}, length=length)
        recordings = [read_recording(path) for path in import_path(tables / "campaign.toml", recorded).paths]
        problem = build_problem(reduce_recordings(recordings, load_config(tables / "bench_config.toml")))
        return find_cells(problem, background(problem, problem.campaign.plant.effects))


def main() -> None:
    """Print what stands out in every campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quiet", type=int, default=8, help="campaigns without an effect")
    parser.add_argument("--length", type=float, default=0.6, help="factor on the duration of every trial")
    chosen = parser.parse_args()
    for kind, effects in (("no effect", [None] * chosen.quiet), ("one effect", list(CATALOGUE))):
        n_campaigns, n_found, n_cells = 0, 0, 0
        for k, effect in enumerate(effects):
            cells = cells_of(FIRST_SEED + k, effect, chosen.length)
            found = [cell for cell in cells if cell.stands_out]
            n_campaigns, n_found, n_cells = n_campaigns + bool(found), n_found + len(found), n_cells + len(cells)
            equations = ", ".join(f"{name} {n}" for name, n in Counter(cell.equation for cell in found).items())
            print(f"{effect or 'none'}: {len(found)} of {len(cells)} {equations}", flush=True)
        print(f"{kind}: {n_found} of {n_cells} places, in {n_campaigns} of {len(effects)} campaigns", flush=True)


if __name__ == "__main__":
    main()
