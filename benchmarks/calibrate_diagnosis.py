"""Fit the constants of `inference.settings.Weights` on development campaigns, and say how well it does on them.

    python -m benchmarks.calibrate_diagnosis collect OUT [--cases N] [--pairs N] [--intact N] [--forms own|plain]
                                                         [--benches own|foreign] [--workers N]
    python -m benchmarks.calibrate_diagnosis fit OUT [--fixed | --temperature T]
    python -m benchmarks.calibrate_diagnosis leave-out OUT [--by effect|shift]
    python -m benchmarks.calibrate_diagnosis compare OUT OTHER
    python -m benchmarks.calibrate_diagnosis sample OUT FILE

`collect` simulates campaigns of the seeds 1 to 999 with the blind check's plant, weighs every hypothesis and keeps the
log evidences (resumable, about 14 s a campaign and core). `fit` maximises the weighted log-likelihood of the truth over
the nine constants, which all effects share; `--temperature` holds that one where it is put (the product takes a higher
one than the fit asks for, to claim less), and with `--fixed` it only reports on the constants as they are. Weights of
the kinds: 20 % none, 10 % parameters, 50 % one effect, 10 % two, 10 % outside the catalogue, all at 0.5 to 2 times
typical. Seeds above 999 are for claims and are refused.

One simulator is one choice of functional forms. `leave-out` fits the constants once for every effect, without the
campaigns in which nature's form of that effect plays a part, and answers these: the difference to the constants that
have seen them says how much the fit leans on any one form. With `--by shift` the same for every kind of bench: each
faulty sensor, strong noise, another machine (collect `--benches own` and `--benches foreign` into one folder).
`compare` sets the answers to the same campaigns with other forms (`collect --forms plain`) beside each other, effect by
effect. `sample` keeps the best hypotheses of each one, in one small file: the tests of the constants rest on it.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.blindcheck.effects.table import CATALOGUE, OUTSIDE
from sawbench.blindcheck.shifts import shifts_of
from sawbench.diagnosis.inference.hypothesis import AND, OTHERS, named
from sawbench.diagnosis.inference.settings import SETTINGS, Weights
from sawbench.diagnosis.inference.weighing import weigh

from benchmarks.blind_campaigns import LAST_SEED, blind_campaign, severity

KIND_WEIGHTS = {"none": 0.2, "parameters": 0.1, "effect": 0.5, "pair": 0.1, "outside": 0.1}
N_EFFECTS = len(CATALOGUE)
_ROUNDS = 4
_SAMPLED = 12
# Further campaigns of two effects, and of none, have seeds of their own.
_FIRST_PAIR_SEED, _FIRST_INTACT_SEED = 500, 700
# A probability of the truth below that counts as that.
_LEAST = 1e-4


def _two_effects(rng: np.random.Generator) -> dict[str, float]:
    first, second = rng.choice(list(CATALOGUE), 2, replace=False)
    return {str(first): severity(rng), str(second): severity(rng)}


def plan(n_cases: int) -> list[dict[str, Any]]:
    """Draw what each development campaign hides: every effect once a round, beside the other kinds."""
    rng = np.random.default_rng(20)
    rows: list[dict[str, Any]] = []

    def add(kind: str, effects: dict[str, float], parameters: str = "within") -> None:
        rows.append({"seed": len(rows) + 1, "kind": kind, "effects": effects, "parameters": parameters})

    while len(rows) < n_cases:
        for effect in CATALOGUE:
            add("effect", {effect: severity(rng)})
        for _ in range(8):
            add("none", {})
        for _ in range(6):
            add("parameters", {}, "beyond")
        for effect in OUTSIDE:
            add("outside", {effect: severity(rng)})
        for _ in range(10):
            add("pair", _two_effects(rng))
    return rows[:n_cases]


def more_pairs(n_cases: int) -> list[dict[str, Any]]:
    """Draw further campaigns of two effects, which are the hardest to tell."""
    rng = np.random.default_rng(77)
    return [
        {"seed": _FIRST_PAIR_SEED + k, "kind": "pair", "effects": _two_effects(rng), "parameters": "within"}
        for k in range(n_cases)
    ]


def more_intact(n_cases: int) -> list[dict[str, Any]]:
    """Further campaigns without any effect: few of them show how far luck goes."""
    return [
        {"seed": _FIRST_INTACT_SEED + k, "kind": "none", "effects": {}, "parameters": "within"} for k in range(n_cases)
    ]


def collect_one(row: dict[str, Any], out_dir: Path) -> str:
    """Simulate one campaign, weigh its hypotheses and write what the fit needs."""
    from sawbench.diagnosis.inference.linear_problem import build_problem
    from sawbench.diagnosis.inference.posterior import judge
    from sawbench.diagnosis.inference.refining import effect_columns

    path = out_dir / f"case-{row['benches']}-{row['seed']:04d}.json"
    if path.exists():
        return path.name
    made = blind_campaign(
        row["seed"], row["effects"], parameters=row["parameters"], forms=row["forms"], benches=row["benches"]
    )
    problem = build_problem(made.reduced())
    posterior = judge(problem, effect_columns(problem))
    found = {
        **row,
        "shifts": shifts_of(made.truth),
        "log_evidence": {h.name: h.log_evidence for h in posterior.hypotheses},
        "left_over": {h.name: h.left_over for h in posterior.hypotheses},
        "shared": {h.name: h.shared for h in posterior.hypotheses},
        "quiet": problem.quiet,
    }
    part = path.with_suffix(".part")
    part.write_text(json.dumps(found), encoding="utf-8")
    part.rename(path)
    return path.name


def truth(row: dict[str, Any]) -> str:
    """Name of the hypothesis that is right."""
    words = {"none": "no_gap", "parameters": "parameters", "outside": "unknown"}
    return words.get(row["kind"], AND.join(sorted(row["effects"])))


def weights_of(x: np.ndarray) -> Weights:
    """Constants from unbounded numbers."""
    prior = np.exp(np.append(x[6:9], 0.0))
    prior /= prior.sum()
    sizes = np.exp(x[:6])
    return Weights(
        temperature=float(sizes[0]),
        pair_gain=float(sizes[1]),
        pair_least=float(sizes[2]),
        pair_share=float(sizes[3]),
        open_gain=float(sizes[4]),
        open_share=float(sizes[5]),
        prior_no_gap=float(prior[0]),
        prior_parameters=float(prior[1]),
        prior_unknown=float(prior[2]),
    )


def numbers_of(weights: Weights) -> np.ndarray:
    """Unbounded numbers from constants: what `weights_of` undoes."""
    w = weights
    rest = 1.0 - w.prior_no_gap - w.prior_parameters - w.prior_unknown
    sizes = [w.temperature, w.pair_gain, w.pair_least, w.pair_share, w.open_gain, w.open_share]
    return np.log(np.array([*sizes, *(p / rest for p in (w.prior_no_gap, w.prior_parameters, w.prior_unknown))]))


def weighed(row: dict[str, Any], weights: Weights) -> dict[str, float]:
    """Probabilities of one record, most probable first."""
    hypotheses = [
        named(name, value, left_over=row["left_over"].get(name, np.inf), shared=row["shared"].get(name, 1.0))
        for name, value in row["log_evidence"].items()
    ]
    found = weigh(hypotheses, n_effects=N_EFFECTS, quiet=row["quiet"], weights=weights)
    return {h.name: h.probability for h in found}


def loss_of(row: dict[str, Any], probabilities: dict[str, float]) -> float:
    """Negative log-probability of the truth, at least that of `_LEAST`."""
    return -float(np.log(max(probabilities.get(truth(row), 0.0), _LEAST)))


def log_loss(rows: list[dict[str, Any]], weights: Weights) -> float:
    """Weighted mean of `loss_of`, every kind with its share."""
    counts = {kind: sum(r["kind"] == kind for r in rows) for kind in KIND_WEIGHTS}
    total = sum(KIND_WEIGHTS[kind] for kind, count in counts.items() if count)
    loss = 0.0
    for row in rows:
        share = KIND_WEIGHTS[row["kind"]] / counts[row["kind"]] / total
        loss += share * loss_of(row, weighed(row, weights))
    return loss


def fit(rows: list[dict[str, Any]], temperature: float | None = None, *, near: Weights | None = None) -> Weights:
    """Maximise the likelihood of the truth, the constants drawn a little to where they start.

    Parameters
    ----------
    rows : list of dict
        Of `collect_one`.
    temperature : float, optional
        Held there.
    near : Weights, optional
        Search from there and a quarter as long: for rows that are nearly the same.
    """
    from scipy.optimize import minimize

    start = np.log(np.array([6.0, 3.0, 20.0, 0.8, 3.0, 0.35, 0.3 / 0.45, 0.15 / 0.45, 0.1 / 0.45]))

    held = None if temperature is None else np.log(temperature)

    def cost(x: np.ndarray) -> float:
        x = x if held is None else np.append(held, x[1:])
        return log_loss(rows, weights_of(x)) + 0.003 * float(np.sum((x - start) ** 2))

    options = {"maxiter": 900 if near is None else 225, "xatol": 0.02, "fatol": 1e-5, "adaptive": True}
    begin = start if near is None else numbers_of(near)
    found = minimize(cost, begin, method="Nelder-Mead", options=options).x
    return weights_of(found if held is None else np.append(held, found[1:]))


def report(rows: list[dict[str, Any]], weights: Weights) -> str:
    """Say how often each kind is answered rightly, and how sure the answers are."""
    lines = [f"{len(rows)} campaigns, log-loss {log_loss(rows, weights):.3f}"]
    tops: list[tuple[str, bool, str, float]] = []
    for row in rows:
        probability = weighed(row, weights)
        top = next(iter(probability))
        tops.append((row["kind"], top == truth(row), top, probability[top]))
    for kind in KIND_WEIGHTS:
        of = [t for t in tops if t[0] == kind]
        if of:
            right = sum(t[1] for t in of)
            claimed = sum(t[2] not in OTHERS for t in of)
            lines.append(f"{kind:10} {right} of {len(of)} right, {claimed} claim an effect")
    sure = np.array([t[3] for t in tops])
    right = np.array([t[1] for t in tops])
    for low, high in ((0.0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.01)):
        inside = (sure >= low) & (sure < high)
        if inside.any():
            lines.append(
                f"stated {low:.2f} to {min(high, 1):.2f}: {inside.sum():3d} cases, right {right[inside].mean():.2f}"
            )
    return "\n".join(lines)


def by_effect(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Campaigns that hide each effect of the catalogue."""
    return {effect: [row for row in rows if effect in row["effects"]] for effect in CATALOGUE}


def by_shift(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Campaigns of each kind of bench, of which others are not."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        for shift, kind in row["shifts"].items():
            if kind not in {"without", "none"}:
                found.setdefault(f"{shift}: {kind}", []).append(row)
    return {name: own for name, own in sorted(found.items()) if len(own) < len(rows)}


def leave_out(rows: list[dict[str, Any]], groups: dict[str, list[dict[str, Any]]]) -> str:
    """For every group of campaigns: how these are answered by constants that were fitted without them."""
    lines = [f"{'left out':38} cases  right, all seen  right, left out  log-loss, all seen  log-loss, left out"]

    def say(name: str, found: np.ndarray) -> None:
        cases, right, right_out, loss, loss_out = found
        lines.append(
            f"{name:38} {int(cases):5}  {int(right):15}  {int(right_out):15}"
            f"  {loss / cases:18.3f}  {loss_out / cases:18.3f}"
        )

    seen = fit(rows, SETTINGS.weights.temperature)
    total = np.zeros(5)
    for name, own in groups.items():
        if not own:
            continue
        rest = [row for row in rows if row not in own]
        both = (seen, fit(rest, SETTINGS.weights.temperature, near=seen))
        answers = [[(row, weighed(row, weights)) for row in own] for weights in both]
        right = [sum(next(iter(said)) == truth(row) for row, said in answer) for answer in answers]
        loss = [sum(loss_of(row, said) for row, said in answer) for answer in answers]
        found = np.array([len(own), *right, *loss])
        total += found
        say(name, found)
    say("all of them", total)
    return "\n".join(lines)


def compare(rows: list[dict[str, Any]], others: list[dict[str, Any]]) -> str:
    """Answers to the same campaigns with two kinds of functional forms, side by side; the truth's probability too."""
    by_seed = {row["seed"]: row for row in others}
    pairs = [(row, by_seed[row["seed"]]) for row in rows if row["seed"] in by_seed]
    if not pairs:
        raise SystemExit("the two folders share no campaign: collect both with the same --cases, --pairs and --intact")
    names = [f"{of[0]['forms']} forms" for of in zip(*pairs, strict=True)]
    lines = [f"{'hidden':54} | {names[0]:46} | {names[1]}"]
    right = np.zeros(2, dtype=int)
    for both in pairs:
        hidden = truth(both[0])
        cells = []
        for k, row in enumerate(both):
            answer = weighed(row, SETTINGS.weights)
            top = next(iter(answer))
            right[k] += top == hidden
            said = "right" if top == hidden else top
            cells.append(f"{said[:34]:34} {answer.get(hidden, 0.0):.2f}")
        size = " + ".join(f"{name} {size:.2f}" for name, size in both[0]["effects"].items()) or hidden
        lines.append(f"{size[:54]:54} | {cells[0]:46} | {cells[1]}")
    lines.append(f"{len(pairs)} campaigns: {right[0]} right with {names[0]}, {right[1]} with {names[1]}")
    return "\n".join(lines)


def sample(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Records with their best hypotheses alone, the members of pairs among them."""
    found = []
    for row in rows:
        evidence = row["log_evidence"]
        best = {*sorted(evidence, key=lambda name: -evidence[name])[:_SAMPLED], *OTHERS, truth(row)} & set(evidence)
        kept = best | {member for name in best for member in name.split(AND) if member in evidence}
        of_kept = {
            key: {name: round(value, 4) for name, value in row[key].items() if name in kept and np.isfinite(value)}
            for key in ("log_evidence", "left_over", "shared")
        }
        known = {key: row[key] for key in ("seed", "kind", "effects", "parameters", "forms")}
        found.append({**known, "quiet": round(row["quiet"], 4), **of_kept})
    return found


def records(folder: Path) -> list[dict[str, Any]]:
    """What `collect` wrote."""
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("case-*.json"))]
    if not rows:
        raise SystemExit(f"{folder}: no case-*.json; run collect first")
    return rows


def main() -> None:
    """Collect, fit, leave out or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("collect", "fit", "leave-out", "compare", "sample"))
    parser.add_argument("out", type=Path)
    parser.add_argument("other", type=Path, nargs="?", help="the folder to compare with, or the file to write")
    parser.add_argument("--cases", type=int, default=_ROUNDS * 68)
    parser.add_argument("--pairs", type=int, default=0, help="further campaigns of two effects")
    parser.add_argument("--intact", type=int, default=0, help="further campaigns of no effect")
    parser.add_argument("--forms", choices=("own", "plain"), default="own")
    parser.add_argument("--benches", choices=("own", "foreign"), default="own")
    parser.add_argument("--by", choices=("effect", "shift"), default="effect", help="what is left out")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--temperature", type=float, help="hold the temperature there")
    parser.add_argument("--fixed", action="store_true", help="report on the constants as they are")
    told = parser.parse_args()
    if told.step == "collect":
        most = {
            "cases": _FIRST_PAIR_SEED - 1,
            "pairs": _FIRST_INTACT_SEED - _FIRST_PAIR_SEED,
            "intact": LAST_SEED - _FIRST_INTACT_SEED + 1,
        }
        for name, limit in most.items():
            if getattr(told, name) > limit:
                parser.error(f"--{name} goes to {limit}: seeds above {LAST_SEED} are for claims")
        told.out.mkdir(parents=True, exist_ok=True)
        planned = plan(told.cases) + more_pairs(told.pairs) + more_intact(told.intact)
        rows = [row | {"forms": told.forms, "benches": told.benches} for row in planned]
        with multiprocessing.get_context("spawn").Pool(told.workers) as pool:
            jobs = [pool.apply_async(collect_one, (row, told.out)) for row in rows]
            for k, job in enumerate(jobs, start=1):
                print(k, job.get(), flush=True)
    elif told.step == "fit":
        rows = records(told.out)
        weights = SETTINGS.weights if told.fixed else fit(rows, told.temperature)
        print(json.dumps(asdict(weights), indent=2))
        print(report(rows, weights))
    elif told.step == "leave-out":
        rows = records(told.out)
        print(leave_out(rows, by_effect(rows) if told.by == "effect" else by_shift(rows)))
    elif told.other is None:
        parser.error(f"{told.step} needs a second path")
    elif told.step == "sample":
        lines = [json.dumps(row) for row in sample(records(told.out))]
        told.other.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")
    else:
        print(compare(records(told.out), records(told.other)))


if __name__ == "__main__":
    main()
