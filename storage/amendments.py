"""Corrections of the settings of a recording, kept beside it; the recording itself is never changed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from sawbench.bench.errors import InputError, RecordingError
from sawbench.bench.recording import Trial
from sawbench.storage.digest import sha256_of
from sawbench.storage.json_lines import append_line
from sawbench.storage.places import AMENDMENTS

# Setting -> words and unit.
AMENDABLE: Final[Mapping[str, tuple[str, str]]] = {
    "material": ("material", ""),
    "duty": ("duty", ""),
    "thickness_mm": ("thickness", "mm"),
    "feed_mm_s": ("feed", "mm/s"),
    "blade": ("blade", ""),
    "battery": ("battery", ""),
    "operator": ("operator", ""),
    "repetition": ("repetition", ""),
    "batch": ("batch", ""),
    "notes": ("notes", ""),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Amendment:
    """One correction.

    Attributes
    ----------
    at : datetime
        UTC.
    by : str
        Who corrected it.
    because : str
    sha256 : str
        Of the recording that it belongs to.
    old, new : mapping of str to value
        The settings that changed, before and after.
    """

    at: datetime = field(default_factory=lambda: datetime.now(UTC))
    by: str
    because: str
    sha256: str
    old: Mapping[str, Any]
    new: Mapping[str, Any]

    @property
    def words(self) -> str:
        """One line.

        Examples
        --------
        >>> at = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
        >>> Amendment(at=at, by="Kim", because="", sha256="", old={"duty": 0.35}, new={"duty": 0.55}).words
        'duty 0.55 instead of 0.35 (Kim, 2026-03-02 09:30 UTC)'
        """
        changes = [f"{AMENDABLE[name][0]} {_said(name, self.new[name])} instead of {_said(name, old)}"
                   for name, old in self.old.items()]  # fmt: skip
        because = f": {self.because}" if self.because else ""
        return f"{', '.join(changes)} ({self.by}, {self.at:%Y-%m-%d %H:%M} UTC{because})"


def amendments_path(recording: Path) -> Path:
    """Return the file with the amendments of a recording: beside it, its name with `.amendments.jsonl` behind."""
    return recording.with_name(recording.name + AMENDMENTS)


def read_amendments(recording: Path) -> list[Amendment]:
    """Return the amendments of a recording, oldest first; none where there is no such file.

    Raises
    ------
    RecordingError
        If they cannot be read, or belong to a recording of other content.
    """
    path = amendments_path(recording)
    try:
        lines = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", where=path) from error
    found = [one for number, line in enumerate(lines, 1) if (one := _amendment(line, f"{path}: line {number}"))]
    if found and {one.sha256 for one in found} != {sha256_of(recording)}:
        raise RecordingError(
            "belongs to a recording of other content: the recording was changed or replaced after the amendment",
            where=path,
            remedy=f"move {path.name} to another folder, then `sawbench amend` {recording.name} if needed",
        )
    return found


def amended(trial: Trial, recording: Path) -> Trial:
    """Return the settings of a recording with its amendments in them.

    Parameters
    ----------
    trial : Trial
        As the recording has it.
    recording : Path

    Raises
    ------
    RecordingError
        As `read_amendments`.
    """
    for one in read_amendments(recording):
        trial = _changed(trial, one.new, words=one.words, where=amendments_path(recording))
    return trial


def amend(recording: Path, trial: Trial, new: Mapping[str, Any], *, by: str, because: str = "") -> Amendment | None:
    """Keep a correction of the settings of a recording.

    Parameters
    ----------
    recording : Path
        A finished recording.
    trial : Trial
        Its settings as they are in force now, see `reader.read_recording`.
    new : mapping of str to value
        Setting, one of `AMENDABLE`, to what is right; None: is unknown.
    by : str
        Who corrects it.
    because : str

    Returns
    -------
    Amendment or None
        None where all of it is in force already.

    Raises
    ------
    InputError
        If a value is not allowed, nobody is named, or nothing can be written beside the recording.
    """
    if recording.suffix != ".mcap":
        raise InputError(
            "is not a finished recording", where=recording, remedy="wait until it is finished, or `sawbench recover` it"
        )
    if not by.strip():
        raise InputError("an amendment needs the name of its author", where=recording, remedy="give it with --by")
    changes = {name: value for name, value in new.items() if getattr(trial, name) != value}
    if not changes:
        return None
    _changed(trial, changes, words="", where=recording)
    made = Amendment(
        by=by.strip(),
        because=" ".join(because.split()),
        sha256=sha256_of(recording),
        old={name: getattr(trial, name) for name in changes},
        new=changes,
    )
    fields = {"at": made.at.isoformat(), "by": made.by, "because": made.because, "sha256": made.sha256,
              "changes": {name: {"old": made.old[name], "new": value} for name, value in changes.items()}}  # fmt: skip
    path = amendments_path(recording)
    try:
        append_line(path, fields)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", where=path) from error
    return made


def _changed(trial: Trial, new: Mapping[str, Any], *, words: str, where: Path) -> Trial:
    try:
        return replace(trial, **new, amendments=(*trial.amendments, words))
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy or "give a value that is allowed") from error
    except TypeError as error:
        raise InputError(f"a value is not allowed: {error}", where=where, remedy="give a number or a text") from error


def _amendment(line: bytes, where: str) -> Amendment | None:
    """Read one line; None where it is empty or was torn by a crash."""
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        return None
    try:
        changes = fields["changes"]
        if not set(changes) <= set(AMENDABLE):
            raise KeyError(sorted(set(changes) - set(AMENDABLE))[0])
        return Amendment(
            at=datetime.fromisoformat(fields["at"]),
            by=str(fields["by"]),
            because=str(fields.get("because", "")),
            sha256=str(fields["sha256"]),
            old={name: change["old"] for name, change in changes.items()},
            new={name: change["new"] for name, change in changes.items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordingError(
            f"is not an amendment: {type(error).__name__} {error}",
            where=where,
            remedy="correct or delete the line; `sawbench amend` writes such lines",
        ) from error


def _said(name: str, value: Any) -> str:
    if value is None or value == "":
        return "not stated"
    unit = AMENDABLE[name][1]
    return (f"{value:g}" if isinstance(value, float) else repr(value) if name == "notes" else str(value)) + (
        f" {unit}" if unit else ""
    )
