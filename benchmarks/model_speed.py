"""Simulation, discharge and fit: our kernels, the limit kernels and the peers, timed in turns.

Every solver first gets the loosest tolerance of a list with which it reaches the accuracy of its row; then it is
timed. Peers that are not installed are left out and named; `pip install -e .[peers]` brings them (numbalsoda builds
with a Fortran compiler).
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from sawbench.modeling import averaging_kernel, discharge_kernel, slots, stroke_kernel, transient_kernel
from sawbench.modeling.discharge import discharge
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.steady_state import steady_state
from sawbench.modeling.supplies import FixedDuty, FixedVoltage
from sawbench.modeling.transient import NO_TABLE, Method, simulate

from benchmarks import limit_kernels as limit
from benchmarks import peers
from benchmarks.current_trace import current_trace, fit_current_trace
from benchmarks.measuring import Clock, Goal, Plot, Section, Table, Timing, time_words

VOLTAGE, K_FC = paper.MOTOR_VOLTAGE_V, 240.29
LIMIT_ONE_SECOND_THERE = 0.040e-3  # the table that set the goals, on its own machine
LIMIT_MULTI_SCALE_THERE = 24e-6
PEERS = ("heyoka", "numbalsoda", "diffrax", "casadi")
RK4, OURS, OUR_KERNEL = "limit: RK4 1 ms, rotations", "sawbench: `simulate`", "sawbench: kernel (4 outputs, energies)"
LIMIT_STROKES, OUR_STROKES = "limit: every stroke, DP5 8 steps", "sawbench: every stroke (kernel)"
OUR_AVERAGED, OUR_DISCHARGE = "sawbench: averaged (kernel)", "sawbench: `discharge`"


@dataclass(frozen=True, kw_only=True)
class Solver:
    """Something that computes one row, and its error."""

    work: Callable[[], object]
    error: float


def rms(a, b) -> float:
    """Relative RMS difference."""
    return float(np.sqrt(np.mean((np.asarray(a) - b) ** 2) / np.mean(b**2)))


def tuned(solve, error_of, goal: float, tolerances=peers.TOLERANCES) -> Solver | None:
    """The solver at the loosest tolerance that reaches the goal."""
    for tolerance in tolerances:
        try:
            error = error_of(solve(tolerance))
        except Exception as failure:  # a peer may refuse a tolerance; the next may do
            print(f"  refused {tolerance}: {failure}", file=sys.stderr)
            continue
        if error <= goal:
            return Solver(work=partial(solve, tolerance), error=error)
    return None


def one_second(clock: Clock) -> dict[str, Solver | None]:
    """Solvers of the 1 s simulation at 1e-6."""
    times = np.arange(1001) / 1000.0
    exact = peers.reference(VOLTAGE, K_FC, times)
    out = np.empty(1001)
    solvers: dict[str, Solver | None] = {}
    for name, kernel in ((RK4, limit.one_second_rotations), ("naive numba RK4", limit.one_second_naive)):
        kernel(VOLTAGE, K_FC, 1001, out)
        solvers[name] = Solver(work=lambda kernel=kernel: kernel(VOLTAGE, K_FC, 1001, out), error=rms(out, exact))
    source = FixedVoltage(voltage_v=VOLTAGE)

    def ours():
        return simulate(paper.PARAMETERS, supply=source, cutting=paper.CUTTING, duration_s=1.0)

    run = ours()
    all_out, record = np.empty((4, 1001)), np.empty(transient_kernel.N_RECORD)
    start = np.array([0.0, 0.0, 0.0, 1.0])

    def kernel():
        transient_kernel.simulate_transient(
            run.vector, NO_TABLE, NO_TABLE, run.time_s, start, 16, (1e-6, 1e-7), all_out, record
        )

    kernel()
    solvers[OUR_KERNEL] = Solver(work=kernel, error=rms(all_out[0], exact))
    solvers[OURS] = Solver(work=ours, error=rms(run.motor_current_a, exact))
    for name, solve in peers.one_second(VOLTAGE, K_FC, times):
        if not (clock.quick and "Radau" in name):
            solvers[name] = tuned(solve, lambda current: rms(current, exact), 1e-6)
    return solvers


def whole_discharge(clock: Clock) -> dict[str, Solver | None]:
    """Solvers of the discharge: 1.5 Ah, beta 0.95, 0.02 Ohm, fixed duty, cutting on 0..pi."""
    battery = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.95, internal_resistance_ohm=0.02)
    supply = FixedDuty(duty=paper.DUTY, battery=battery)
    cutting = LinearCutting(k_fc_n_s_per_m=K_FC, cutting_half="zero_to_pi")
    vector = paper.PARAMETERS.to_vector()
    supply.fill(vector)
    cutting.fill(vector)
    start = np.array([0.0, 0.0, 0.0, 1.0])
    none = np.empty((0, discharge_kernel.N_CURVES))

    def brute(n, tolerance=1e-5):
        return discharge_kernel.brute_force(vector, NO_TABLE, NO_TABLE, start, (n, tolerance, 0.2, -1.0), none)[0]

    exact = brute(96, 1e-11)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    gauss = np.array([nodes[::-1], weights[::-1]])
    table, result = np.zeros((8, averaging_kernel.N_COLUMNS)), np.zeros(averaging_kernel.N_RESULT)

    def averaged():
        averaging_kernel.discharge_averaged(
            vector, NO_TABLE, NO_TABLE, start, (10, 1e-5, 0.2, -1.0), gauss, table, result
        )
        return result[averaging_kernel.RUNTIME]

    settled = steady_state(paper.PARAMETERS, supply=supply, cutting=cutting)
    i, w = settled.start_current_a, settled.start_motor_speed_rad_s

    def limit_brute(n=8):
        return limit.discharge_every_stroke(i, w, 0.95, paper.DUTY, 0.02, K_FC, True, 0.2, n)

    # The limit starts at speed; what the start-up takes is the difference at the finest steps.
    start_up = exact - limit_brute(96)
    whole = discharge(paper.PARAMETERS, supply=supply, cutting=cutting)
    solvers: dict[str, Solver | None] = {
        LIMIT_STROKES: Solver(work=limit_brute, error=abs((limit_brute() + start_up) / exact - 1)),
        OUR_STROKES: Solver(work=lambda: brute(10), error=abs(brute(10) / exact - 1)),
        OUR_AVERAGED: Solver(work=averaged, error=abs(averaged() / exact - 1)),
        OUR_DISCHARGE: Solver(
            work=lambda: discharge(paper.PARAMETERS, supply=supply, cutting=cutting),
            error=abs(whole.runtime_s / exact - 1),
        ),
    }
    for name, solve in peers.whole_discharge(paper.DUTY, K_FC, 0.95, 0.02, 1.0, exact):
        if not (clock.quick and "scipy" in name):
            solvers[name] = tuned(solve, lambda runtime: abs(runtime / exact - 1), 3e-6, (1e-7, 1e-8, 1e-9))
    return solvers


def periodic(clock: Clock) -> str:
    """Stroke time, time of a cold periodic state and the error of its mean current, in words."""
    source = FixedDuty(duty=paper.DUTY, battery=paper.BATTERY)
    vector = paper.PARAMETERS.to_vector()
    source.fill(vector)
    paper.CUTTING.fill(vector)
    result, fine, n, n_strokes = np.zeros(stroke_kernel.N_PERIODIC), np.zeros(stroke_kernel.N_PERIODIC), 10, 1000

    def cold():
        stroke_kernel.periodic_state(vector, NO_TABLE, NO_TABLE, 1.0, n, 1.0, stroke_kernel.ACCEPT, result)

    cold()
    stroke_kernel.periodic_state(vector, NO_TABLE, NO_TABLE, 1.0, 256, 1e9, 1e-7, fine)
    mean, exact = (r[stroke_kernel.MOTOR_CHARGE] / r[stroke_kernel.PERIOD] for r in (result, fine))
    i, w = result[stroke_kernel.START_CURRENT], result[stroke_kernel.START_SPEED] * vector[slots.GEAR]
    stroke_s = clock(lambda: limit.strokes(i, w, VOLTAGE, K_FC, n, n_strokes)).median_s / n_strokes
    cold_s = clock(cold).median_s
    return (
        f"Periodic stroke: one stroke of the limit kernel {time_words(stroke_s)}; a cold periodic state, called from "
        f"Python, {time_words(cold_s)}, {cold_s / stroke_s:.2g} stroke times; its mean current is off by "
        f"{abs(mean / exact - 1):.0e}."
    )


def orders() -> list[tuple[int, float]]:
    """Error of the current over the steps a turn."""
    times = np.arange(1001) / 1000.0
    exact = peers.reference(VOLTAGE, K_FC, times)
    found = []
    for n in (8, 16, 32, 64):
        run = simulate(
            paper.PARAMETERS,
            supply=FixedVoltage(voltage_v=VOLTAGE),
            cutting=paper.CUTTING,
            duration_s=1.0,
            method=Method(steps_per_turn=n, angle_tolerance=np.inf, time_tolerance=1e-12),
        )
        found.append((n, rms(run.motor_current_a, exact)))
    return found


def fits(clock: Clock) -> tuple[Table, list[Goal]]:
    """The global fit of k_Fc over time against simulated annealing on the same kernel, a row a length of the trace."""
    from scipy.optimize import dual_annealing

    supply, rows, goals = FixedVoltage(voltage_v=VOLTAGE), [], []
    for seconds in (1.0, 2.0, 5.0):
        run = simulate(paper.PARAMETERS, supply=supply, cutting=paper.CUTTING, duration_s=seconds)
        trace = current_trace(run.time_s, run.motor_current_a, parameters=paper.PARAMETERS, supply=supply)

        def fit(run=run):
            return fit_current_trace(run.time_s, run.motor_current_a, parameters=paper.PARAMETERS, supply=supply)

        def anneal(trace=trace):
            return dual_annealing(lambda k: trace.ise(float(k[0])), [(100.0, 500.0)], rng=1)

        found = clock.together({"one": lambda trace=trace: trace.ise(K_FC), "fit": fit}, seconds=0.3)
        annealed = clock(anneal, seconds=0.0)
        one, own = found["one"], found["fit"]
        in_simulations, ahead = own.median_s / one.median_s, annealed.median_s / own.median_s
        error = abs(fit().k_fc_n_s_per_m - K_FC)
        rows.append(
            (f"{seconds:g} s", str(one), str(own), f"{in_simulations:.1f}", f"{ahead:.0f}", f"{error:.1e} N*s/m")
        )
        goals += [
            Goal(what=f"fit of {seconds:g} s, in simulations", value=in_simulations, bound=35.0),
            Goal(what=f"fit of {seconds:g} s ahead of annealing", value=ahead, bound=80.0, at_least=True),
        ]
    head = ("trace", "one simulation", "fit", "in simulations", "annealing over fit", "error of the fit")
    return Table(title="Global fit of k_Fc over time, against `dual_annealing`", head=head, rows=rows), goals


def solver_table(title: str, solvers: dict[str, Solver | None], found: dict[str, Timing], base: str) -> Table:
    """Times, ratios to the limit, errors."""
    rows = []
    for name, solver in solvers.items():
        if solver is None:
            rows.append((name, "accuracy not reached", "", ""))
            continue
        ratio = found[name].median_s / found[base].median_s
        rows.append((name, str(found[name]), f"{ratio:.3g}", f"{solver.error:.1e}"))
    return Table(title=title, head=("solver", "time", "× limit", "error"), rows=rows)


def goals(second: dict[str, Timing], whole: dict[str, Timing]) -> list[Goal]:
    """How far ahead of the peers, how near the limit."""

    def ratio(found: dict[str, Timing], over: str | None, under: str) -> float | None:
        return found[over].median_s / found[under].median_s if over in found else None

    foreign = {name: t.median_s for name, t in whole.items() if not name.startswith(("sawbench", "limit"))}
    best = min(foreign, key=foreign.__getitem__, default=None)
    limit_averaged_s = LIMIT_MULTI_SCALE_THERE * second[RK4].median_s / LIMIT_ONE_SECOND_THERE
    ahead, near = {"at_least": True}, {"at_least": False}
    return [
        Goal(what=what, value=value, bound=bound, **side)
        for what, value, bound, side in (
            ("1 s simulation ahead of heyoka", ratio(second, "heyoka (Taylor, events)", OURS), 2.0, ahead),
            ("1 s simulation ahead of odeint", ratio(second, "scipy odeint, Python rhs", OURS), 100.0, ahead),
            ("1 s simulation over the limit kernel", ratio(second, OURS, RK4), 2.0, near),
            ("discharge, every stroke, ahead of the best peer", ratio(whole, best, OUR_STROKES), 10.0, ahead),
            ("discharge, every stroke, over the limit kernel", ratio(whole, OUR_STROKES, LIMIT_STROKES), 1.5, near),
            ("averaged discharge ahead of the best peer", ratio(whole, best, OUR_AVERAGED), 2000.0, ahead),
            ("averaged discharge ahead of every stroke", ratio(whole, OUR_STROKES, OUR_AVERAGED), 100.0, ahead),
            ("averaged discharge over the limit", whole[OUR_AVERAGED].median_s / limit_averaged_s, 2.0, near),
        )
    ]


def measure(clock: Clock) -> Section:
    """Times, goals and orders of convergence."""
    second, whole = one_second(clock), whole_discharge(clock)
    times, times_whole = (
        clock.together({name: solver.work for name, solver in rows.items() if solver is not None})
        for rows in (second, whole)
    )
    fit_table, fit_goals = fits(clock)
    order_rows, before = [], None
    for n, error in orders():
        order_rows.append((str(n), f"{error:.1e}", "" if before is None else f"{np.log2(before / error):.2f}"))
        before = error
    missing = [name for name in PEERS if importlib.util.find_spec(name) is None]
    return Section(
        title="Simulation, discharge, fit",
        words=[
            "The limit kernels (`benchmarks/limit_kernels.py`) have the paper's constants folded in, give one output "
            "and check nothing. For the averaged discharge the limit is the 24 µs of the table that set the goals, "
            "scaled by the RK4 kernel of this run. FMPy is not run: it needs an FMU of the model, and its CVode is "
            "casadi's." + (f" Not installed here, so not measured: {', '.join(missing)}." if missing else ""),
            periodic(clock),
        ],
        tables=[
            solver_table("One second from rest, 1 kHz output: error of the current, relative", second, times, RK4),
            solver_table(
                "A whole discharge, 13 114 strokes: error of the runtime, relative", whole, times_whole, LIMIT_STROKES
            ),
            fit_table,
            Table(title="Order of convergence", head=("steps a turn", "error", "order"), rows=order_rows),
        ],
        goals=goals(times, times_whole) + fit_goals,
        plots=[
            Plot(name="one_second", title="One second from rest at 1e-6: time", x_label="time / ms",
                 bars={name.replace("`", ""): 1e3 * timing.median_s for name, timing in times.items()}),
            Plot(name="discharge", title="A whole discharge at 3e-6: time", x_label="time / ms",
                 bars={name.replace("`", ""): 1e3 * timing.median_s for name, timing in times_whole.items()}),
        ],
    )  # fmt: skip
