"""Cost of finding k_Fc: the global fit over time against simulated annealing on the same kernel.

    python -m benchmarks.fit_speed

Ratios from one process; both must end in the minimum that made the current.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from modeling.cutting_forces.linear import LinearCutting
from modeling.parameter_sets import paper_jigsaw as paper
from modeling.supplies import FixedVoltage
from modeling.trace_fit import current_trace, fit_current_trace
from modeling.transient import simulate

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
            return fit_current_trace(
                run.time_s, run.motor_current_a, parameters=paper.PARAMETERS, supply=supply
            )

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


def main() -> None:
    """Print the table."""
    for row in rows():
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()))


if __name__ == "__main__":
    main()
