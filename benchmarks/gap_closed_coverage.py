"""How often the 95 % interval of `gap_closed` holds what repetitions of the campaign say on average.

    python benchmarks/gap_closed_coverage.py OUT [--machines 5] [--repeats 10] [--workers 1]

Each machine is one seed below 1000 of the blind check's plant with one effect of typical size. It is measured again and
again: the same constants, sensors and operating points, other noise, wood, pauses and order of trials. Every campaign
is diagnosed as far as `gap_closed` of the true effect needs, as `sawbench diagnose` states it. An interval is right
where it holds the mean of the other repetitions of its machine. That mean has an error of its own, so that a perfect
interval would be right a little less often than in 95 %; how often, is said below the table. What is done is kept in
OUT, apart for the sources that diagnosed it (one file a campaign, which takes about half a minute and a core).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np

EFFECTS: Final = (
    "brush_voltage_drop", "guide_friction", "edge_force", "windage_drag", "current_sensor_lag",
    "motor_coulomb_friction", "cutting_speed_exponent", "battery_internal_resistance", "load_dependent_friction",
    "return_stroke_rubbing", "converter_diode_drop", "force_sensor_lag",
)  # fmt: skip
FIRST_SEED, LAST_SEED = 701, 999
LEAST_REPEATS: Final = 3


def machines(n: int) -> list[tuple[int, str]]:
    """Seed and effect of each machine."""
    if not 0 < n <= LAST_SEED + 1 - FIRST_SEED:
        raise SystemExit(f"--machines is {n}, allowed is 1 to {LAST_SEED + 1 - FIRST_SEED}")
    return [(FIRST_SEED + k, EFFECTS[k % len(EFFECTS)]) for k in range(n)]


def collect_one(seed: int, effect: str, repetition: int, out_dir: Path) -> Path:
    """Simulate and diagnose one campaign, unless that was done, and write its ladder."""
    from sawbench.blindcheck.campaign import make_campaign

    path = out_dir / f"{seed}-{effect}-{repetition:03d}.json"
    if path.exists():
        return path
    folder = Path(tempfile.mkdtemp(prefix="gap-closed-"))
    try:
        make_campaign(seed, folder / "in", effects={effect: 1.0}, repetition=repetition)
        found = ladder_of(folder / "in", folder / "out", effect)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps({"seed": seed, "effect": effect, "repetition": repetition, **found}), encoding="utf-8")
    part.rename(path)
    return path


def ladder_of(campaign_dir: Path, recordings_dir: Path, effect: str) -> dict[str, Any]:
    """`gap_closed` of a known effect with its interval; None where the campaign shows nothing of it."""
    from sawbench.bench.config import load_config
    from sawbench.diagnosis.answer.hold_out import HoldOut
    from sawbench.diagnosis.inference.acts_in import acts_in
    from sawbench.diagnosis.inference.columns import catalogue_columns
    from sawbench.diagnosis.inference.evidence import explain
    from sawbench.diagnosis.inference.linear_problem import build_problem
    from sawbench.diagnosis.inference.marginal import Marginal
    from sawbench.diagnosis.plants.choice import reduce_recordings
    from sawbench.storage.importers.dispatch import import_path
    from sawbench.storage.reader import read_recording

    imported = import_path(campaign_dir / "campaign.toml", recordings_dir)
    recordings = [read_recording(file) for file in imported.paths]
    campaign = reduce_recordings(recordings, load_config(campaign_dir / "bench_config.toml"))
    problem = build_problem(campaign)
    columns = catalogue_columns(problem, [e for e in campaign.plant.effects if e.name == effect])[effect]
    best = explain(Marginal(problem), columns)
    if best is None:
        return {"gap_closed": None, "gap_closed_ci95": None}
    forms = [c for c in columns if c.columns.shape[1] == best.column.columns.shape[1]]
    high = best.effect.strength.high
    ladder = HoldOut(problem, best.column.columns * high).climb([[c.columns * high] for c in forms])
    closed, interval = ladder.closed_in(acts_in(problem, best))
    return {"gap_closed": closed, "gap_closed_ci95": list(interval)}


def count(rows: Sequence[dict[str, Any]]) -> tuple[int, int, np.ndarray, float]:
    """Intervals that hold the mean of the other repetitions, of how many, the values, and the median width."""
    told = [row for row in rows if row["gap_closed"] is not None]
    values = np.array([row["gap_closed"] for row in told])
    if len(told) < LEAST_REPEATS:
        return 0, 0, values, float("nan")
    others = (values.sum() - values) / (len(values) - 1)
    ends = np.array([row["gap_closed_ci95"] for row in told])
    hits = int(np.sum((ends[:, 0] <= others) & (others <= ends[:, 1])))
    return hits, len(told), values, float(np.median(ends[:, 1] - ends[:, 0]))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """One line a machine, and all of them."""
    from sawbench.blindcheck.score_statistics import wilson

    lines = [f"{'machine':38}{'mean':>7}{'scatter':>9}{'width':>7}{'inside':>9}{'share':>8}   95 % interval"]
    hits = total = 0
    for seed, effect in sorted({(row["seed"], row["effect"]) for row in rows}):
        inside, n, values, width = count([row for row in rows if (row["seed"], row["effect"]) == (seed, effect)])
        hits, total = hits + inside, total + n
        name = f"{seed} {effect}"
        if n == 0:
            lines.append(f"{name:38}{len(values)} repetitions that show it, {LEAST_REPEATS} are needed")
            continue
        size = f"{values.mean():7.3f}{values.std(ddof=1):9.4f}{width:7.3f}"
        lines.append(f"{name:38}{size}{_share(wilson(inside, n))}")
    return "\n".join([*lines, f"{'all':61}{_share(wilson(hits, total))}"])


def _share(found: Any) -> str:
    if found.share is None:
        return f"{'0':>9}"
    return f"{f'{found.hits}/{found.n}':>9}{found.share:8.1%}   {found.low:.1%} to {found.high:.1%}"


def of_a_perfect_interval(n_repeats: int) -> float:
    """How often an exact 95 % interval of a normal value holds the mean of the other repetitions."""
    from scipy.special import ndtr, ndtri

    return float(2.0 * ndtr(ndtri(0.975) / np.sqrt(1.0 + 1.0 / (n_repeats - 1))) - 1.0)


def main() -> int:
    """Collect what is missing and print the table."""
    from sawbench.bench.source_identity import source_fingerprint

    parser = argparse.ArgumentParser(description="How often the 95 % interval of gap_closed is right.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--machines", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.repeats < LEAST_REPEATS:
        raise SystemExit(f"--repeats is {arguments.repeats}, allowed is {LEAST_REPEATS} or more")
    # Campaigns that other sources diagnosed are not mixed with these.
    out_dir = arguments.out / source_fingerprint()[:12]
    out_dir.mkdir(parents=True, exist_ok=True)
    jobs = [(seed, effect, k) for k in range(arguments.repeats) for seed, effect in machines(arguments.machines)]
    context = multiprocessing.get_context("spawn")
    rows = []
    with ProcessPoolExecutor(max_workers=arguments.workers, mp_context=context) as pool:
        futures = [pool.submit(collect_one, *job, out_dir) for job in jobs]
        for done, future in enumerate(futures, start=1):
            rows.append(json.loads(future.result().read_text(encoding="utf-8")))
            if sys.stderr.isatty():
                print(f"\r{done} of {len(jobs)}", end="", file=sys.stderr)
    print(table(rows))
    if source_fingerprint()[:12] != out_dir.name:
        print(f"the sources changed while this ran: remove {out_dir} and run it again", file=sys.stderr)
        return 1
    print(f"a perfect interval: {of_a_perfect_interval(arguments.repeats):.1%}; sources {out_dir.name}")
    print(f"{platform.system()}, {os.cpu_count()} {platform.machine()} cores, Python {platform.python_version()}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
