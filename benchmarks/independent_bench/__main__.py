"""Campaigns of an independent simulator, diagnosed as a user would and scored.

    python -m benchmarks.independent_bench make OUT --seed N [--cases 44] [--jobs 2]
    python -m benchmarks.independent_bench answer OUT [--jobs 2]
    python -m benchmarks.independent_bench score OUT --key OUT.key.json

`make` writes OUT/case-01, OUT/case-02, ... and the key beside the folder, OUT.key.json, so that nobody reads it by
accident. `answer` runs `sawbench diagnose` on every case that has no answer yet and leaves
OUT/answers/case-01/gap_report.json; what the command printed is in OUT/answers/case-01.log. `score` prints two tables.
Machine, woods, instruments, plan and forms of the effects are drawn at random. The generator shares no code with the
diagnosis, nor with that of `sawbench blind`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.independent_bench.campaign import CONFIG, write_case
from benchmarks.independent_bench.cases import DEFAULT_CASES, draw_case
from benchmarks.independent_bench.scoring import ANSWERS, REPORT, read_answers, score_page

_Named = TypeVar("_Named", bound=tuple[str, Any])


def make(out: Path, seed: int, n_cases: int, jobs: int) -> Path:
    """Write a set and its key; returns the path of the key.

    Parameters
    ----------
    out : Path
        Folder that does not exist yet.
    seed, n_cases, jobs : int
    """
    key = out.with_name(out.name + ".key.json")
    for path in (out, key):
        if path.exists():
            raise FileExistsError(f"{path} is there already: choose another name, or remove it")
    out.mkdir(parents=True)
    with ProcessPoolExecutor(jobs) as pool:
        entries = _in_turns(pool, partial(_written, seed, out), range(1, n_cases + 1))
    in_order = dict(sorted(entries, key=lambda entry: (len(entry[0]), entry[0])))
    text = json.dumps({"seed": seed, "cases": in_order}, indent=1)
    key.write_text(text + "\n", encoding="utf-8")
    return key


def _written(seed: int, out: Path, number: int) -> tuple[str, dict[str, Any]]:
    case = draw_case(seed, number)
    return case.name, write_case(seed, case, out)


def answer(out: Path, jobs: int) -> list[str]:
    """Diagnose every case that has no answer yet; returns the names of those that still have none.

    Parameters
    ----------
    out : Path
        Of `make`.
    jobs : int
    """
    cases = sorted(path.parent for path in out.glob(f"case-*/{CONFIG}"))
    if not cases:
        raise FileNotFoundError(f"{out} has no cases: run `make` first")
    (out / ANSWERS).mkdir(exist_ok=True)
    waiting = [case for case in cases if not _report_of(case).exists()]
    with ThreadPoolExecutor(jobs) as pool:
        _in_turns(pool, _diagnosed, waiting)
    return [case.name for case in cases if not _report_of(case).exists()]


def _report_of(case: Path) -> Path:
    return case.parent / ANSWERS / case.name / REPORT


def _diagnosed(case: Path) -> tuple[str, int]:
    """Run the command in a process of its own, as a user would."""
    out = _report_of(case).parent
    command = [_sawbench(), "diagnose", str(case), "--config", str(case / CONFIG), "--out", str(out), "--force"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    out.with_suffix(".log").write_text(done.stdout + done.stderr, encoding="utf-8")
    return case.name, done.returncode


def _sawbench() -> str:
    """Command of this installation, or the one that is found."""
    beside = Path(sys.executable).with_name("sawbench")
    return str(beside) if beside.exists() else shutil.which("sawbench") or "sawbench"


def _in_turns(pool: Executor, work: Callable[[Any], _Named], cases: Iterable[Any]) -> list[_Named]:
    """Do the work for every case and say which one is done."""
    waiting = [pool.submit(work, case) for case in cases]
    found = []
    for n_done, future in enumerate(as_completed(waiting), start=1):
        found.append(future.result())
        print(f"{n_done}/{len(waiting)} {found[-1][0]}", file=sys.stderr, flush=True)
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.independent_bench", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    steps = parser.add_subparsers(dest="step", required=True)
    make_step = steps.add_parser("make", help="write a set and its key")
    make_step.add_argument("--seed", type=int, required=True)
    make_step.add_argument("--cases", type=int, default=DEFAULT_CASES)
    answer_step = steps.add_parser("answer", help="diagnose every case; a call that was broken off goes on")
    score_step = steps.add_parser("score", help="print the tables")
    score_step.add_argument("--key", type=Path, required=True)
    for step in (make_step, answer_step, score_step):
        step.add_argument("out", type=Path)
    for step in (make_step, answer_step):
        step.add_argument("--jobs", type=int, default=2)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run one step; returns the exit code."""
    given = _parser().parse_args(arguments)
    try:
        if given.step == "make":
            print(make(given.out, given.seed, given.cases, given.jobs))
        elif given.step == "score":
            print(score_page(read_answers(given.out, given.key)))
        elif missing := answer(given.out, given.jobs):
            print(f"without an answer: {', '.join(missing)}; see their logs", file=sys.stderr)
            return 1
    except (FileExistsError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
