"""The journal of a series: what was done, in the order it was done; lines are added, none is ever changed."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

from sawbench.bench.errors import InputError
from sawbench.storage.json_lines import append_line

NAME: Final = "series_journal.jsonl"
Kind = Literal["opened", "mounted", "started", "judged", "kept", "rejected", "note", "stopped"]


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalEntry:
    """One line.

    Attributes
    ----------
    kind : str
        One of `Kind`.
    trial : str
        Empty where it belongs to none.
    at : datetime
        UTC.
    facts : mapping
        Plain values, by kind: what was mounted, what was measured, why it was rejected.
    """

    kind: Kind
    trial: str = ""
    at: datetime = field(default_factory=lambda: datetime.now(UTC))
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))


class Journal:
    """The file `series_journal.jsonl` of a folder.

    A line is written in one piece and waited for until it is on the disk, so that a crash leaves it whole or, at worst,
    torn at the very end; a torn line is passed over and the next one restarts.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME

    def read(self) -> list[JournalEntry]:
        """Return all entries, oldest first; none where there is no file yet.

        Raises
        ------
        InputError
            If the file cannot be read.
        """
        try:
            lines = self.path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", where=self.path) from error
        return [entry for line in lines if (entry := _entry(line)) is not None]

    def add(self, kind: Kind, trial: str = "", **facts: Any) -> JournalEntry:
        """Append one entry and wait until it is on the disk."""
        entry = JournalEntry(kind=kind, trial=trial, facts=facts)
        fields = {"at": entry.at.isoformat(), "kind": kind, **({"trial": trial} if trial else {}), **facts}
        append_line(self.path, fields)
        return entry

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Keep every other run of the series out; the lock ends with this process, however that ends.

        Raises
        ------
        InputError
            If another process holds it.
        """
        try:
            import fcntl
        except ImportError:
            # Not on this system: the `.part` file of a recording still keeps two recorders apart.
            yield
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    "another `sawbench series` is running this series",
                    where=self.path.parent,
                    remedy="continue there, or stop it first",
                ) from None
            yield


def _entry(line: bytes) -> JournalEntry | None:
    """Read one line; None where it was torn by a crash."""
    try:
        fields = json.loads(line)
        return JournalEntry(
            kind=fields.pop("kind"),
            trial=fields.pop("trial", ""),
            at=datetime.fromisoformat(fields.pop("at")),
            facts=fields,
        )
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return None
