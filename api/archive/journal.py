"""A batch whose results are files: a journal beside them says what is done, so that nothing is done twice."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sawbench.archive.batch import Workers, run_batch
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.storage.json_lines import append_line
from sawbench.storage.places import JOURNAL


@dataclass(frozen=True, kw_only=True, slots=True)
class Piece:
    """One piece of a batch.

    Attributes
    ----------
    name : str
        Of its row; unique in the batch.
    key : str
        Hash of everything that its result depends on; see `key_of`.
    target : Path
        File or folder that it writes, and nothing else does.
    request : object
        What the work takes.
    """

    name: str
    key: str
    target: Path
    request: Any

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """What became of a piece.

    Attributes
    ----------
    name : str
    result : mapping
        What the work returned, plain values; empty where it failed.
    error, remedy : str
        Why it failed, and what to do; empty where it did not.
    exit_code : int
        0 where it did not fail.
    was_done : bool
        Whether it was done in an earlier run.
    """

    name: str
    result: Mapping[str, Any]
    error: str = ""
    remedy: str = ""
    exit_code: int = 0
    was_done: bool = False

    def checked(self) -> Mapping[str, Any]:
        """Return the result, or raise the error."""
        if self.exit_code:
            error = SawbenchError(self.error, where=self.name, remedy=self.remedy or None)
            error.exit_code = self.exit_code
            raise error
        return self.result


def key_of(*parts: Any) -> str:
    """Return a hash of plain values.

    Examples
    --------
    >>> key_of("a", 1) == key_of("a", 1), key_of("a", 1) == key_of("a", 2)
    (True, False)
    """
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


class Journal:
    """The journal `batch.jsonl` of a folder of results; one batch at a time writes to it.

    Parameters
    ----------
    folder : Path
        Made when the first line is written.
    retries : bool
        Do again what failed before.
    overwrites : bool
        Replace targets also where they are not of this batch, and do everything again.
    """

    def __init__(self, folder: Path, *, retries: bool = False, overwrites: bool = False) -> None:
        self._path = folder / JOURNAL
        self._retries, self._overwrites = retries, overwrites

    def run(
        self, work: Callable[[Any], Mapping[str, Any]], pieces: Sequence[Piece], workers: Workers | None = None
    ) -> Iterator[Row]:
        """Work on the pieces that are not done yet, and yield the row of every piece, those done before first.

        A target that is half written, because an earlier run was broken off, is written again.

        Parameters
        ----------
        work : callable
            Takes the request of a piece and returns plain values.
        pieces : sequence of Piece
        workers : Workers, optional

        Raises
        ------
        InputError
            If two pieces have one name, or a target is there that no run of this batch made.
        """
        planned, done = self._read()
        self._refuse(pieces, planned)
        waiting = []
        for piece in pieces:
            line = done.get(piece.name, {})
            if self._holds(piece, line):
                yield _row_of(line, was_done=True)
            else:
                waiting.append(piece)
        if not waiting:
            return
        append_line(self._path, {"planned": [piece.name for piece in waiting]})
        for outcome in run_batch(work, [piece.request for piece in waiting], workers):
            piece, error = waiting[outcome.index], outcome.error
            line = {
                "name": piece.name,
                "key": piece.key,
                "done_at": datetime.now(UTC).isoformat(timespec="seconds"),
                "result": dict(outcome.value or {}),
                "error": "" if error is None else error.failure,
                "remedy": "" if error is None else error.remedy or "",
                "exit_code": 0 if error is None else error.exit_code,
            }
            append_line(self._path, line)
            yield _row_of(line)

    def _holds(self, piece: Piece, line: Mapping[str, Any]) -> bool:
        if self._overwrites or line.get("key") != piece.key:
            return False
        return not self._retries if line["exit_code"] else piece.target.exists()

    def _refuse(self, pieces: Iterable[Piece], planned: set[str]) -> None:
        seen: set[str] = set()
        for piece in pieces:
            if piece.name in seen:
                raise InputError(
                    "is named twice, so two results would be one", where=piece.name,
                    remedy="rename one, or give them in two calls with folders of their own",
                )  # fmt: skip
            seen.add(piece.name)
            if piece.target.exists() and piece.name not in planned and not self._overwrites:
                raise InputError(
                    "exists already", where=piece.target, remedy="name another folder, or overwrite with --force"
                )

    def _read(self) -> tuple[set[str], dict[str, dict[str, Any]]]:
        """Names that were ever begun, and the latest line of each that was finished; a torn line is left out."""
        planned: set[str] = set()
        done: dict[str, dict[str, Any]] = {}
        for text in self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() else ():
            try:
                line = json.loads(text)
            except ValueError:
                continue
            planned.update(line.get("planned", ()))
            if "name" in line:
                done[line["name"]] = line
        return planned, done


def _row_of(line: Mapping[str, Any], *, was_done: bool = False) -> Row:
    fields = {name: line[name] for name in ("name", "result", "error", "remedy", "exit_code")}
    return Row(**fields, was_done=was_done)
