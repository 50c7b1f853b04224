"""Answering a sealed set: one process a case, which sees a copy of the campaign and nothing else of the set."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from sawbench.bench.errors import InputError
from sawbench.blindcheck.sealing import COMMITMENTS, file_hashes, read_json, sha256_of, write_json

INDEX = "answers.json"
SCHEMA_VERSION = 1
_KEPT_VARIABLES = frozenset(
    {"PATH", "HOME", "LANG", "LC_ALL", "TZ", "TMPDIR", "TEMP", "TMP", "SYSTEMROOT", "USERPROFILE", "VIRTUAL_ENV",
     "PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH", "XDG_CACHE_HOME", "MPLCONFIGDIR", "NUMBA_CACHE_DIR"}
)  # fmt: skip
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMBA")}
_MESSAGE_CHARS = 2000


@dataclass(frozen=True, kw_only=True, slots=True)
class Program:
    """What answers a case.

    Attributes
    ----------
    steps : tuple of tuple of str
        Commands, run one after another in the folder of the case's copy; its parent is theirs to write in.
        The time of the last one counts as the time of the answer.
    report : str
        Where the last step leaves its gap report, relative to the folder of the case's copy.
    software : mapping
        What answers, for the record; `source_sha256` in it decides whether two runs are the same.
    fingerprint : callable
        Returns `source_sha256` as it is now: a change during the run is found.
    environment : mapping of str to str
        Added to the few variables that the processes inherit.
    """

    steps: tuple[tuple[str, ...], ...]
    report: str
    software: Mapping[str, Any]
    fingerprint: Callable[[], str]
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class Answered:
    """What a run of `answer` comes to.

    Attributes
    ----------
    answers_dir : Path
    n_cases, n_new, n_failed : int
        Cases in the set, answered in this run, and without an answer because the program failed.
    index_sha256 : str
        Of `answers.json`; whoever writes it down before the key is opened can prove that nothing was changed.
    """

    answers_dir: Path
    n_cases: int
    n_new: int
    n_failed: int
    index_sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class SealedCase:
    """A case that waits for its answer.

    Attributes
    ----------
    folder : Path
    files : mapping of str to str
        SHA-256 of each of its files, as it was sealed.
    """

    folder: Path
    files: Mapping[str, str]

    def __str__(self) -> str:
        return str(self.folder)


# Yields number and answer of every case as it is finished.
Elsewhere = Callable[
    [Callable[[SealedCase], dict[str, Any]], Sequence[SealedCase]], Generator[tuple[int, dict[str, Any]]]
]


# Size: options by name: who answers, where, for how long, what is kept.
def answer(
    set_dir: Path,
    program: Program,
    *,
    answers_dir: Path | None = None,
    workers: int | None = None,
    timeout_s: float = 3600.0,
    force: bool = False,
    on_progress: Callable[[int, int, str], None] | None = None,
    elsewhere: Elsewhere | None = None,
) -> Answered:
    """Answer every case of a sealed set that has no valid answer yet.

    Parameters
    ----------
    set_dir : Path
        Of `sealing.make`. No key may lie inside.
    program : Program
    answers_dir : Path, optional
        `answers` inside the set unless given.
    workers : int, optional
        Cases at a time; one a core unless given.
    timeout_s : float
        For one step of one case; a case that takes longer has failed.
    force : bool
        Discard the answers of other software and begin again.
    on_progress : callable, optional
        (done, wanted, case).
    elsewhere : callable, optional
        Has the cases answered by other machines, which reach the set under the same name and run the same software.

    Raises
    ------
    InputError
        If the set holds a key or was changed, or the answers there are by other software or for another set.
    """
    set_dir = Path(set_dir).resolve()
    answers_dir = Path(answers_dir).resolve() if answers_dir else set_dir / "answers"
    cases: dict[str, Any] = read_json(set_dir / COMMITMENTS).get("cases", {})
    refuse_key_inside(set_dir)
    index = _open_index(answers_dir, set_dir, program, force=force)
    waiting = [name for name in sorted(cases) if not _is_valid(answers_dir, name, index["answers"].get(name))]
    work = [SealedCase(folder=set_dir / name, files=cases[name]["files"]) for name in waiting]
    if elsewhere is None:
        found = _answered_here(work, program, timeout_s, workers or os.cpu_count() or 1)
    else:
        found = elsewhere(partial(answer_case, program=program, timeout_s=timeout_s), work)
    with closing(found):
        for done, (number, one) in enumerate(found, start=len(cases) - len(waiting) + 1):
            _keep(answers_dir, index, waiting[number], one, program)
            if on_progress is not None:
                on_progress(done, len(cases), waiting[number])
    answers = read_answers(set_dir, answers_dir)[1]
    return Answered(
        answers_dir=answers_dir,
        n_cases=len(cases),
        n_new=len(waiting),
        n_failed=sum(found["report"] is None for found in answers.values()),
        index_sha256=sha256_of(answers_dir / INDEX),
    )


def answer_case(case: SealedCase, *, program: Program, timeout_s: float) -> dict[str, Any]:
    """Answer one case, in whatever process this is called; see `answer`.

    Raises
    ------
    InputError
        If the case was changed after sealing.
    """
    return _Runner(program=program, timeout_s=timeout_s).run(case.folder, case.files)


def _answered_here(
    cases: Sequence[SealedCase], program: Program, timeout_s: float, workers: int
) -> Generator[tuple[int, dict[str, Any]]]:
    """Yield number and answer of every case as it is finished; what runs is ended when the caller stops."""
    runner = _Runner(program=program, timeout_s=timeout_s)
    with ThreadPoolExecutor(max_workers=workers) as pool:
        futures = {pool.submit(runner.run, case.folder, case.files): number for number, case in enumerate(cases)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            runner.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def read_answers(set_dir: Path, answers_dir: Path | None = None) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Read the answers of a set and check that they are those that were given.

    Parameters
    ----------
    set_dir : Path
    answers_dir : Path, optional
        `answers` inside the set unless given.

    Returns
    -------
    index : dict
        `answers.json`: `software`, `started_at`, `finished_at`, `commitments_sha256`, `answers` (hash by case).
    answers : dict of str to dict
        By case: `status` ("answered", "failed" or "timed_out"), `report`, `exit_code`, `message`, `time_s`.

    Raises
    ------
    InputError
        If answers are missing, were changed, or belong to another set; the message names all that was found.
    """
    set_dir = Path(set_dir)
    answers_dir = Path(answers_dir) if answers_dir else set_dir / "answers"
    if not (answers_dir / INDEX).exists():
        raise InputError("there are no answers", where=answers_dir, remedy="run `sawbench blind answer` first")
    index = read_json(answers_dir / INDEX)
    found: list[str] = []
    if index.get("commitments_sha256") != sha256_of(set_dir / COMMITMENTS):
        found.append(f"{INDEX} belongs to another {COMMITMENTS}")
    hashes: dict[str, str] = index.get("answers", {})
    cases = sorted(read_json(set_dir / COMMITMENTS).get("cases", {}))
    missing = [name for name in cases if name not in hashes]
    if missing:
        raise InputError(
            f"{len(missing)} of {len(cases)} cases are not answered, the first is {missing[0]}",
            where=answers_dir,
            remedy="run `sawbench blind answer` again, it continues where it stopped",
        )
    found += [f"{name}.json is for no case of this set" for name in sorted(set(hashes) - set(cases))]
    found += [f"{name}.json was changed or removed" for name in cases if not _is_valid(answers_dir, name, hashes[name])]
    if found:
        raise InputError(
            "these are not the answers that were given:\n  " + "\n  ".join(found),
            where=answers_dir,
            remedy="answer the set again; do not score it",
        )
    return index, {name: read_json(answers_dir / f"{name}.json") for name in cases}


def refuse_key_inside(set_dir: Path) -> None:
    """Refuse a set with a key in it.

    Raises
    ------
    InputError
    """
    for path in sorted(set_dir.rglob("*")):
        if not path.is_file() or path.suffix in {".csv", ".mcap"}:
            continue
        if b'"salt"' in path.read_bytes():
            raise InputError(
                "is a key, inside the set that it opens", where=path, remedy="move it away before answering"
            )


# What the software on record must agree in: its sources, and whether it was asked for causes one by one.
_DECIDING = ("source_sha256", "until_closed")


def _open_index(answers_dir: Path, set_dir: Path, program: Program, *, force: bool) -> dict[str, Any]:
    commitments = sha256_of(set_dir / COMMITMENTS)
    path = answers_dir / INDEX
    if path.exists():
        index = read_json(path)
        is_same_set = index.get("commitments_sha256") == commitments
        theirs = index.get("software", {})
        if is_same_set and all(theirs.get(key) == program.software.get(key) for key in _DECIDING):
            return index
        if not force:
            whose = f"software {theirs.get('version')}, commit {theirs.get('commit')}" if is_same_set else "another set"
            raise InputError(
                f"the answers there are of {whose}, not of this one",
                where=answers_dir,
                remedy="give another folder with --answers, or discard them with --force",
            )
        shutil.rmtree(answers_dir)
    answers_dir.mkdir(parents=True, exist_ok=True)
    index = {
        "schema_version": SCHEMA_VERSION,
        "software": dict(program.software),
        "commitments_sha256": commitments,
        "started_at": _now(),
        "finished_at": None,
        "answers": {},
    }
    write_json(path, index)
    return index


def _keep(answers_dir: Path, index: dict[str, Any], name: str, found: dict[str, Any], program: Program) -> None:
    """Write one answer and its hash, unless the software is no longer the one that is on record."""
    if program.fingerprint() != program.software["source_sha256"]:
        raise InputError(
            "the software changed while it was answering",
            where=name,
            remedy="run it from a copy that nobody edits; give another folder with --answers",
        )
    path = answers_dir / f"{name}.json"
    write_json(path, {"schema_version": SCHEMA_VERSION, "case": name, **found})
    index["answers"][name] = sha256_of(path)
    index["finished_at"] = _now()
    write_json(answers_dir / INDEX, index)


def _is_valid(answers_dir: Path, name: str, digest: str | None) -> bool:
    path = answers_dir / f"{name}.json"
    return digest is not None and path.is_file() and sha256_of(path) == digest


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


class _StoppedError(Exception):
    """The run was broken off; what the case would have answered is not known."""


class _Runner:
    """Runs cases in processes of their own, and ends them when the run is broken off."""

    def __init__(self, *, program: Program, timeout_s: float) -> None:
        self._program = program
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._is_stopped = False
        kept = {name: value for name, value in os.environ.items() if name.upper() in _KEPT_VARIABLES}
        self._environment = kept | _ONE_THREAD | dict(program.environment)

    def run(self, case_dir: Path, sealed_files: Mapping[str, str]) -> dict[str, Any]:
        """Answer one case; a program that fails is an answer of its own kind."""
        if file_hashes(case_dir) != dict(sealed_files):
            raise InputError("was changed after sealing", where=case_dir, remedy="make the set again")
        with tempfile.TemporaryDirectory(prefix="sawbench-case-", ignore_cleanup_errors=True) as folder:
            copy = Path(folder) / "campaign"
            shutil.copytree(case_dir, copy)
            seconds: list[float] = []
            code: int | None = None
            output = ""
            for step in self._program.steps:
                begun = time.monotonic()
                code, output = self._step(step, copy)
                seconds.append(time.monotonic() - begun)
                if code not in (0, 1):
                    break
            status = "timed_out" if code is None else "failed"
            report, problem = self._report(copy) if code in (0, 1) else (None, "")
            return {
                "status": status if report is None else "answered",
                "report": report,
                "exit_code": code,
                "message": (problem + output)[-_MESSAGE_CHARS:] if report is None else "",
                "time_s": round(seconds[-1], 3),
                "step_times_s": [round(value, 3) for value in seconds],
                "case_sha256": hashlib.sha256(json.dumps(dict(sealed_files), sort_keys=True).encode()).hexdigest(),
            }

    def stop(self) -> None:
        """End what runs and start nothing more."""
        with self._lock:
            self._is_stopped = True
            for process in self._running:
                process.kill()

    def _step(self, command: tuple[str, ...], folder: Path) -> tuple[int | None, str]:
        """Return the exit code (None: took too long) and what was said on standard error."""
        with self._lock:
            if self._is_stopped:
                raise _StoppedError
            # A session of its own: Ctrl-C ends the run, it does not make every running case a failed one.
            process = subprocess.Popen(
                command, cwd=folder, env=self._environment, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            )  # fmt: skip
            self._running.add(process)
        code: int | None
        try:
            errors = process.communicate(timeout=self._timeout_s)[1]
            code = process.returncode
        except subprocess.TimeoutExpired:
            process.kill()
            errors, code = process.communicate()[1], None
        finally:
            with self._lock:
                self._running.discard(process)
        if self._is_stopped:
            raise _StoppedError
        return code, errors.decode(errors="replace")

    def _report(self, copy: Path) -> tuple[dict[str, Any] | None, str]:
        try:
            return read_json((copy / self._program.report).resolve()), ""
        except InputError as error:
            return None, f"no readable report: {error}\n"
