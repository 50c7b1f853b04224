"""Peers of the diagnosis on the cases of the blind check.

Run: python -m benchmarks.diagnosis_peers develop | train | features | answer | isolability | score  (--help each)
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

# Before numpy is imported: the machine's cores are for cases, not for linear algebra.
for _name in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")


def main(arguments: list[str] | None = None) -> int:
    """Run one step; returns the exit code."""
    from sawbench.bench.errors import InputError

    given = _parser().parse_args(arguments)
    try:
        return given.run(given)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosis_peers", description=__doc__)
    steps = parser.add_subparsers(required=True)

    develop = steps.add_parser("develop", help="make development campaigns, keep only their features; resumable")
    develop.add_argument("--seed", type=int, required=True, help="1 to 999")
    develop.add_argument("--cases", type=int, required=True)
    develop.add_argument("--out", type=Path, required=True)
    develop.add_argument("--terms", type=int, default=60, help="so many cases also get the dictionary of terms")
    develop.add_argument("--length", type=float, default=1.0, help="factor on the duration of every trial")
    develop.add_argument("--first", type=int, default=0)
    develop.add_argument("--every", type=int, default=1, help="with --first: share the work among processes")
    develop.set_defaults(run=_develop)

    train = steps.add_parser("train", help="train the peers on development cases")
    train.add_argument("folders", type=Path, nargs="+")
    train.add_argument("--models", type=Path, required=True)
    train.add_argument("--peer", help="only this one")
    train.set_defaults(run=_train)

    features = steps.add_parser("features", help="reduce the cases of a sealed set; resumable")
    features.add_argument("set", type=Path)
    features.add_argument("--cases", type=int, help="only the first so many by name")
    features.add_argument("--first", type=int, default=0)
    features.add_argument("--every", type=int, default=1, help="with --first: share the work among processes")
    features.set_defaults(run=_features)

    answer = steps.add_parser("answer", help="let the trained peers answer a set")
    answer.add_argument("set", type=Path)
    answer.add_argument("--models", type=Path, required=True)
    answer.add_argument("--peer", help="only this one")
    answer.set_defaults(run=_answer)

    isolability = steps.add_parser("isolability", help="structural and computed isolability")
    isolability.add_argument("set", type=Path)
    isolability.add_argument("--cases", type=int, default=3)
    isolability.set_defaults(run=_isolability)

    score = steps.add_parser("score", help="score the diagnosis and the peers on the same cases")
    score.add_argument("set", type=Path)
    score.add_argument("--cases", type=int, help="only the first so many by name, for all methods alike")
    score.add_argument("--key", type=Path, required=True)
    score.add_argument("--answers", type=Path, help="of `sawbench blind answer`; default: SET/answers")
    score.add_argument("--out", type=Path, help="Markdown page")
    score.set_defaults(run=_score)
    return parser


def _show(done: int, wanted: int, name: str) -> None:
    print(f"\r{done}/{wanted} {name}", end="" if done < wanted else "\n", file=sys.stderr, flush=True)


def _develop(given: argparse.Namespace) -> int:
    from benchmarks.diagnosis_peers.cases import develop

    develop(
        given.seed, given.cases, given.out, n_with_terms=given.terms, length=given.length, first=given.first,
        every=given.every, on_progress=_show,
    )  # fmt: skip
    return 0


def _train(given: argparse.Namespace) -> int:
    from benchmarks.diagnosis_peers.training import PEERS, train

    for peer in [given.peer] if given.peer else PEERS:
        print(peer, json.dumps(train(peer, given.folders, given.models)), flush=True)
    return 0


def _features(given: argparse.Namespace) -> int:
    from benchmarks.diagnosis_peers.cases import features_of_set

    failed = features_of_set(
        given.set, n_cases=given.cases, first=given.first, every=given.every, on_progress=_show
    )  # fmt: skip
    for line in failed:
        print(line, file=sys.stderr)
    return 1 if failed else 0


def _answer(given: argparse.Namespace) -> int:
    from benchmarks.diagnosis_peers.table import answer_set
    from benchmarks.diagnosis_peers.training import PEERS

    answer_set(given.set, given.models, [given.peer] if given.peer else list(PEERS), on_progress=_show)
    return 0


def _isolability(given: argparse.Namespace) -> int:
    from sawbench.blindcheck.sealing import COMMITMENTS, read_json, write_json

    from benchmarks.diagnosis_peers.cases import peers_dir
    from benchmarks.diagnosis_peers.isolability import computed_isolability, isolability_rows, structural_isolability
    from benchmarks.diagnosis_peers.reduction import read_campaign, reduce

    names = sorted(read_json(given.set / COMMITMENTS)["cases"])[: given.cases]
    found = [computed_isolability(reduce(*read_campaign(given.set / name)).problem) for name in names]
    rows = isolability_rows(structural_isolability(), found)
    peers_dir(given.set).mkdir(exist_ok=True)
    write_json(peers_dir(given.set) / "isolability.json", {"cases": names, "rows": rows})
    for row in rows:
        print(*row, sep="  ")
    return 0


def _score(given: argparse.Namespace) -> int:
    from sawbench.blindcheck.sealing import read_json

    from benchmarks.diagnosis_peers.cases import peers_dir
    from benchmarks.diagnosis_peers.page import page
    from benchmarks.diagnosis_peers.table import score_set, table

    scores, about = score_set(given.set, given.key, answers_dir=given.answers, n_cases=given.cases)
    print(table(scores))
    isolability = peers_dir(given.set) / "isolability.json"
    rows = read_json(isolability)["rows"] if isolability.exists() else None
    if given.out:
        given.out.write_text(page(scores, about, rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
