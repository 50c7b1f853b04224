"""Cost of finding k_Fc: the global fit over time against simulated annealing on the same kernel.

    python -m benchmarks.fit_speed

Ratios from one process; both must end in the minimum that made the current.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.supplies import FixedVoltage
from sawbench.modeling.transient import simulate

from benchmarks.current_trace import current_trace, fit_current_trace

TRUTH = 240.29


def median_s(work: Callable[[], object], repeats: int) -> float:
    """Median wall time of one call."""
    work()
    spent = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    return statistics.median(spent)


def rows(repeats: int = 15) -> list[dict[str, float]]:
    """One row a length of the trace."""
    from scipy.optimize import dual_annealing

    supply = FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V)
    table = []
    for seconds in (1.0, 2.0, 5.0):
        run = simulate(
            paper.PARAMETERS,
            supply=supply,
            cutting=LinearCutting(k_fc_n_s_per_m=TRUTH),
            duration_s=seconds,
        )
        trace = current_trace(run.time_s, run.motor_current_a, parameters=paper.PARAMETERS, supply=supply)

        def fit(run=run):
            return fit_current_trace(run.time_s, run.motor_current_a, parameters=paper.PARAMETERS, supply=supply)

        def anneal(trace=trace):
            return dual_annealing(lambda k: trace.ise(float(k[0])), [(100.0, 500.0)], rng=1)

        one_s = median_s(lambda trace=trace: trace.ise(TRUTH), 50)
        fit_s, anneal_s = median_s(fit, repeats), median_s(anneal, 3)
        table.append(
            {
                "seconds": seconds,
                "simulation_us": 1e6 * one_s,
                "fit_ms": 1e3 * fit_s,
                "fit_in_simulations": fit_s / one_s,
                "annealing_ms": 1e3 * anneal_s,
                "annealing_over_fit": anneal_s / fit_s,
                "fit_error": abs(fit().k_fc_n_s_per_m - TRUTH),
                "annealing_error": abs(float(anneal().x[0]) - TRUTH),
            }
        )
    return table


def page(table: list[dict[str, float]]) -> str:
    """The table as Markdown, each goal marked."""
    lines = [
        "# Cost of the global fit of k_Fc over time",
        "",
        "Written by `python -m benchmarks.fit_speed --out docs/fit_speed.md` on"
        f" {os.cpu_count()} {platform.machine()} cores, Python {platform.python_version()}; medians of one process,"
        " only the ratios travel. Goals: at least 80 times faster than `dual_annealing` on the same kernel, right at 1, 2"  # noqa: E501
        " and 5 s, at most 35 simulation times.",
        "",
        "| trace | one simulation | fit | in simulations (<= 35) | annealing over fit (>= 80) | error of the fit |",
        "|---|---|---|---|---|---|",
    ]
    for row in table:
        cost, ratio = row["fit_in_simulations"], row["annealing_over_fit"]
        lines.append(
            f"| {row['seconds']:g} s | {row['simulation_us']:.0f} us | {row['fit_ms']:.2f} ms"
            f" | {cost:.1f} ({'met' if cost <= 35 else 'not met'}) | {ratio:.0f} ({'met' if ratio >= 80 else 'not met'})"  # noqa: E501
            f" | {row['fit_error']:.1e} N*s/m |"
        )
    spent = [1e3 * row["annealing_ms"] / row["simulation_us"] for row in table]
    lines += ["", f"Annealing costs {min(spent):.0f} to {max(spent):.0f} simulation times.", ""]
    return "\n".join(lines)


def main() -> None:
    """Print the table, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    table = rows()
    for row in table:
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()))
    if arguments.out is not None:
        arguments.out.write_text(page(table), encoding="utf-8")


if __name__ == "__main__":
    main()
