"""How often the 95 % interval of k_Fc holds the truth, over synthetic trials with everything drawn at random.

Each trial has its own plant (nominals off by their rel_std), sensor gains, zeros and noise, stroke-to-stroke
variation of 4-5 % with random correlation, duty, k_Fc and length. Trials that are done are kept in the
results file, so a stopped run continues where it was.

    python -m benchmarks.fit_coverage --trials 400 --results coverage.jsonl
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

METHODS = ("current_and_force", "current", "force")


def one_trial(seed: int) -> dict:
    """Truth and fits of one synthetic trial."""
    from sawbench.bench.config import BatteryConfig, PlantConfig
    from sawbench.modeling.fit import fit_cutting_coefficient
    from sawbench.processing.measured_cycles import cycles_from_samples

    from benchmarks.synthetic_trials import NOMINAL, synthetic_trial

    rng = np.random.default_rng([seed, 7])
    trial = synthetic_trial(
        seed,
        seconds=rng.uniform(5.0, 10.0),
        k_fc=rng.uniform(120.0, 400.0),
        spread=rng.uniform(0.04, 0.05),
        correlation=rng.uniform(0.0, 0.6),
        duty=rng.uniform(0.35, 0.6),
    )
    plant = PlantConfig.model_validate(
        {name: {"nominal": value, "rel_std": std} for name, (value, std) in NOMINAL.items()} | {"gear_ratio": 56 / 6}
    )
    battery = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02)
    cycles = cycles_from_samples(
        trial.angle_time_s,
        trial.angle_rad,
        trial.speed_rad_s,
        trial.channels,
        start_s=1.5,
        duty=trial.duty,
        label=f"synthetic {seed}",
    )
    row: dict = {"seed": seed, "truth": trial.true_k_fc, "n_cycles": cycles.n_cycles}
    for method in METHODS:
        fit = fit_cutting_coefficient(cycles, plant=plant, battery=battery, method=method)
        row[method] = [
            fit.k_fc_n_s_per_m,
            fit.std_n_s_per_m,
            fit.statistical_std_n_s_per_m,
            fit.status,
            len(fit.notes),
        ]
    return row


def run(n_trials: int, results: Path | None, workers: int) -> list[dict]:
    """Trials 0 to `n_trials`, those in `results` not again."""
    rows: dict[int, dict] = {}
    if results is not None and results.exists():
        for line in results.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            rows[row["seed"]] = row
    missing = [seed for seed in range(n_trials) if seed not in rows]
    with ProcessPoolExecutor(workers) as pool:
        for row in pool.map(one_trial, missing):
            rows[row["seed"]] = row
            if results is not None:
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    return [rows[seed] for seed in range(n_trials)]


def coverage(rows: list[dict], method: str) -> dict[str, float]:
    """Share of intervals that hold the truth, its own standard error, and how wide they are."""
    z = np.array([(row[method][0] - row["truth"]) / row[method][1] for row in rows])
    held = float(np.mean(np.abs(z) <= 1.959964))
    return {
        "coverage": held,
        "standard_error": float(np.sqrt(held * (1 - held) / len(z))),
        "mean_z": float(z.mean()),
        "std_z": float(z.std()),
        "median_rel_std": float(np.median([row[method][1] / row["truth"] for row in rows])),
        "n_misfit": float(sum(row[method][4] > 0 for row in rows)),
        "n_ok": float(sum(row[method][3] == "ok" for row in rows)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--results", type=Path, help="JSON lines; kept and continued")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    rows = run(options.trials, options.results, options.workers)
    print(f"{len(rows)} trials; the goal is a coverage of 93-97 %")
    print(f"{'method':20} coverage, mean z, std z, median std, status ok, misfit noted")
    for method in METHODS:
        c = coverage(rows, method)
        held = f"{c['coverage']:.1%} +- {c['standard_error']:.1%}"
        print(
            f"{method:20} {held}   {c['mean_z']:+.3f}   {c['std_z']:.3f}   {c['median_rel_std']:.2%}   "
            f"{c['n_ok']:.0f}   {c['n_misfit']:.0f}"
        )


if __name__ == "__main__":
    main()
