"""The whole loop on simulated campaigns: diagnose until closed, improve the model, diagnose a fresh campaign with it.

    python -m benchmarks.closed_loop OUT [--kind three|one] [--cases 12] [--first-seed 901] [--length 1.0]

`three` hides three effects of different equations, each 0.5 to 2 times its typical size; `one` goes through the
catalogue. The same machine is then measured again with other pieces of wood, and diagnosed with `improved_model.toml`:
"no_gap" and "parameters" are closed. The runtime is that of the fresh campaign, as its report states it, beside the
model as configured; the 95 % interval is that of `runtime` for its longest cutting trial. Seeds above 999 are for
claims and are refused. Resumable: one file a case in OUT; two minutes of one core each.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.analysis import OpenedTrial, evaluate, process_opened
from sawbench.bench.config import LoadedConfig, parse_config
from sawbench.bench.recording import Recording
from sawbench.blindcheck.effects.table import ACTS_IN, CATALOGUE
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.diagnosis.inference.settings import Z95

from benchmarks.blind_campaigns import blind_campaign, kept_cases, severity

N_TOGETHER: Final = 3
_CLOSED: Final = frozenset({"no_gap", "parameters"})


def hidden_in(kind: str, number: int, seed: int) -> dict[str, float]:
    """Draw what a case hides: effects that act in different equations, or one of the catalogue in turn."""
    rng = np.random.default_rng([seed, N_TOGETHER])
    names = list(CATALOGUE)
    chosen = [names[number % len(names)]]
    while kind == "three" and (len(chosen) < N_TOGETHER or not _are_apart(chosen)):
        chosen = [str(name) for name in rng.choice(names, N_TOGETHER, replace=False)]
    return {name: severity(rng) for name in chosen}


def _are_apart(effects: Sequence[str]) -> bool:
    return not any(ACTS_IN[one] & ACTS_IN[other] for one, other in combinations(effects, 2))


def case(seed: int, effects: Mapping[str, float], length: float) -> dict[str, Any]:
    """Diagnose one campaign until it is closed, and a fresh one of the same machine with the improved model."""
    first = blind_campaign(seed, effects, length=length)
    report = diagnose(first.recordings, first.loaded, provenance={}, until_closed=True)
    cause = report["causes"][0] if report["verdict"] in {"effect", "effects"} else None
    found: dict[str, Any] = {
        "seed": seed, "hidden": dict(effects), "verdict": report["verdict"],
        "named": [] if cause is None else cause["effects"],
        "probability": None if cause is None else cause["probability"],
        "gap_closed": None if cause is None else cause["gap_closed"],
        "stopped": report["until_closed"]["stopped"], "n_passes": report["until_closed"]["n_passes"],
        "nominal_miss": miss(report, "nominal"),
    }  # fmt: skip
    if report["improved_model"] is None:
        return found
    loaded = parse_config(report["improved_model"], where="improved_model.toml")
    again = blind_campaign(seed, effects, length=length, repetition=1)
    after = diagnose(again.recordings, loaded, provenance={})
    return found | {
        "fresh_verdict": after["verdict"],
        "fresh_named": after["causes"][0]["effects"] if after["verdict"] in {"effect", "effects"} else [],
        "fresh_miss": miss(after, "nominal"),
        "runtime_rel_std": runtime_rel_std(again.recordings, loaded),
    }


def miss(report: Mapping[str, Any], rung: str) -> float | None:
    """Relative error of the predicted runtime."""
    times = report["gap"].get("runtime_s")
    return times[rung] / times["measured"] - 1.0 if times else None


def runtime_rel_std(recordings: Sequence[Recording], loaded: LoadedConfig) -> float | None:
    """Relative standard uncertainty that `runtime` states for the longest cutting trial."""
    cutting = [one for one in recordings if not one.trial.is_idle]
    longest = max(cutting, key=lambda one: one.signal("battery_current_a").time_s[-1])
    runtime = evaluate(process_opened(OpenedTrial(recording=longest, loaded=loaded))).runtime
    return None if runtime is None else runtime.std_s / runtime.runtime_s


def line(found: Mapping[str, Any]) -> str:
    """One case in words."""
    hidden, named = set(found["hidden"]), set(found["named"])
    said = f"{found['seed']}  found {len(hidden & named)} of {len(hidden)}"
    said += (
        f", false {', '.join(sorted(named - hidden)) or 'none'}, missed {', '.join(sorted(hidden - named)) or 'none'}"
    )
    said += f" ({found['verdict']}, {found['n_passes']} passes, {found['stopped']})"
    if found.get("fresh_verdict"):
        said += f"; fresh campaign: {found['fresh_verdict']} {' + '.join(found['fresh_named'])}".rstrip()
    if found.get("fresh_miss") is not None and found["nominal_miss"] is not None:
        said += f"; runtime {100 * found['nominal_miss']:+.1f} % -> {100 * found['fresh_miss']:+.2f} %"
    return said


def score(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Count over all cases."""
    hits = [(len(set(r["hidden"]) & set(r["named"])), len(r["hidden"])) for r in rows]
    is_exact = [set(r["hidden"]) == set(r["named"]) for r in rows]
    said = [
        f"all effects {sum(a == n for a, n in hits)}, all but one {sum(a >= max(n - 1, 1) for a, n in hits)}, exactly"
        f" these {sum(is_exact)}, a false one in {sum(bool(set(r['named']) - set(r['hidden'])) for r in rows)}, of"
        f" {len(rows)} cases"
    ]
    right = [r for r, exact in zip(rows, is_exact, strict=True) if exact]
    improved = [r for r in rows if r.get("fresh_verdict")]
    for words, chosen in (("correct claims", right), ("improved models", improved)):
        fresh = [r for r in chosen if r.get("fresh_verdict")]
        timed = [r for r in fresh if r["fresh_miss"] is not None]
        stated = [r for r in timed if r["runtime_rel_std"]]
        said.append(
            f"{words}: fresh campaign closed {sum(r['fresh_verdict'] in _CLOSED for r in fresh)} of {len(fresh)};"
            f" runtime within 1 % {sum(abs(r['fresh_miss']) < 0.01 for r in timed)} of {len(timed)}; 95 % interval"
            f" holds {sum(abs(r['fresh_miss']) < Z95 * r['runtime_rel_std'] for r in stated)} of {len(stated)}"
        )
    return said


def main() -> None:
    """Go through the cases and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kind", choices=("three", "one"), default="three")
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=901)
    parser.add_argument("--length", type=float, default=1.0, help="factor on the duration of every trial")
    told = parser.parse_args()
    seeds, rows = range(told.first_seed, told.first_seed + told.cases), []

    def made(seed: int) -> dict[str, Any]:
        return case(seed, hidden_in(told.kind, seed - told.first_seed, seed), told.length)

    for row in kept_cases(told.out, told.kind, seeds, made, may_begin=lambda: True):
        rows.append(row)
        print(line(row), flush=True)
    print("\n".join(score(rows)))


if __name__ == "__main__":
    main()
