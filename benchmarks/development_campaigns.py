"""Campaigns for development: every hypothesis weighed on each, and how well the answers do, kind of bench by kind.

    python -m benchmarks.development_campaigns collect OUT [--cases N] [--pairs N] [--intact N] [--forms own|plain]
                                                           [--benches own|foreign] [--workers N]
    python -m benchmarks.development_campaigns score OUT
    python -m benchmarks.development_campaigns compare OUT OTHER

`collect` simulates campaigns of the seeds 1 to 999 with the blind check's plant, weighs every hypothesis and keeps the
log evidences (resumable, about 14 s a campaign and core). `score` says how often each kind is answered rightly, how
sure the answers are, and the same for every kind of bench: each faulty sensor, strong noise, another machine (collect
`--benches own` and `--benches foreign` into one folder). No number of the weighing is fitted to them. Weights of the
kinds in the log-loss: 20 % none, 10 % parameters, 50 % one effect, 10 % two, 10 % outside the catalogue, all at 0.5 to
2 times typical. Seeds above 999 are for claims and are refused. Answers are those of the weighing, before claims are
held to what they predict.

One simulator is one choice of functional forms: `compare` sets the answers to the same campaigns with other forms
(`collect --forms plain`) beside each other, effect by effect.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Mapping, Sequence
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
    from sawbench.diagnosis.inference.effect_columns import effect_columns
    from sawbench.diagnosis.inference.linear_problem import build_problem
    from sawbench.diagnosis.inference.posterior import judge

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


def by_shift(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Campaigns of each kind of bench, of which others are not."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        for shift, kind in row["shifts"].items():
            if kind not in {"without", "none"}:
                found.setdefault(f"{shift}: {kind}", []).append(row)
    return {name: own for name, own in sorted(found.items()) if len(own) < len(rows)}


COUNTED = "right  claims  of them right  accused  log-loss"


def counted(answers: Sequence[tuple[Mapping[str, Any], Mapping[str, float]]]) -> str:
    """Count answers under the columns of `COUNTED`: each a record, and the probability of every hypothesis."""
    tops = [(row, max(said, key=lambda name, said=said: said[name])) for row, said in answers]
    claims = [(row, top) for row, top in tops if top not in OTHERS]
    right, exact = (sum(truth(dict(row)) == top for row, top in these) for these in (tops, claims))
    accused = sum(row["kind"] in {"none", "parameters"} for row, _ in claims)
    loss = float(np.mean([loss_of(dict(row), dict(said)) for row, said in answers]))
    harmless = sum(row["kind"] in {"none", "parameters"} for row, _ in tops)
    return f"{right:5}  {len(claims):6}  {exact:13}  {accused:3} of {harmless:2} {loss:8.2f}"


def shift_table(rows: list[dict[str, Any]]) -> str:
    """How the campaigns of each kind of bench are answered, beside all of them."""
    lines = [f"{'bench':38} cases  {COUNTED}"]
    for name, own in {"all of them": rows, **by_shift(rows)}.items():
        lines.append(f"{name:38} {len(own):5}  {counted([(row, weighed(row, SETTINGS.weights)) for row in own])}")
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


def records(folder: Path) -> list[dict[str, Any]]:
    """What `collect` wrote."""
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("case-*.json"))]
    if not rows:
        raise SystemExit(f"{folder}: no case-*.json; run collect first")
    return rows


def main() -> None:
    """Collect, score or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("collect", "score", "compare"))
    parser.add_argument("out", type=Path)
    parser.add_argument("other", type=Path, nargs="?", help="the folder to compare with")
    parser.add_argument("--cases", type=int, default=_ROUNDS * 68)
    parser.add_argument("--pairs", type=int, default=0, help="further campaigns of two effects")
    parser.add_argument("--intact", type=int, default=0, help="further campaigns of no effect")
    parser.add_argument("--forms", choices=("own", "plain"), default="own")
    parser.add_argument("--benches", choices=("own", "foreign"), default="own")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
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
    elif told.step == "score":
        rows = records(told.out)
        print(report(rows, SETTINGS.weights))
        print(shift_table(rows))
    elif told.other is None:
        parser.error("compare needs a second folder")
    else:
        print(compare(records(told.out), records(told.other)))


if __name__ == "__main__":
    main()
