"""The recordings of a folder as the panel lists them; one is named by its place in the list, never by a path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from sawbench.acquisition.series.rejected import REJECTED
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.bench.recording import Trial, loss_in_words
from sawbench.panel.words import local
from sawbench.storage.amendments import AMENDABLE, amendments_path
from sawbench.storage.describe import RecordingInfo, describe_recording

PANEL_FOLDER: Final = "panel"
_NUMBERS: Final = ("duty", "thickness_mm", "feed_mm_s")


@dataclass(frozen=True, kw_only=True, slots=True)
class ShelfRow:
    """One recording.

    Attributes
    ----------
    key : str
        Its path relative to the folder, with "/".
    path : Path
    trial : Trial
    duration_s : float
    state : str
        "complete", or what is wrong.
    is_sound : bool
    """

    key: str
    path: Path
    trial: Trial
    duration_s: float
    state: str
    is_sound: bool

    @property
    def searched(self) -> str:
        """Everything that a search looks into."""
        trial = self.trial
        date = "" if trial.started_at is None else local(trial.started_at)
        texts = (
            self.key, trial.material, trial.blade, trial.battery, trial.operator, trial.batch, trial.notes,
            trial.source, date, self.state, "corrected" if trial.amendments else "",
        )  # fmt: skip
        numbers = [
            f"{name.split('_')[0]}={value:g}" for name in _NUMBERS if (value := getattr(trial, name)) is not None
        ]
        return " ".join(filter(None, (*texts, *numbers))).lower()


class Shelf:
    """Recordings of a folder and of the folders in it: series, imports."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[Path, tuple[tuple[int, ...], ShelfRow]] = {}

    def keys(self) -> dict[str, Path]:
        """Return the recordings there are, by key; what was rejected is not among them."""
        paths = [*self.root.glob("*.mcap"), *self.root.glob("*/*.mcap")]
        apart = {REJECTED, PANEL_FOLDER}
        return {path.relative_to(self.root).as_posix(): path for path in sorted(paths) if path.parent.name not in apart}

    def path(self, key: str) -> Path:
        """Return the recording of a key.

        Raises
        ------
        InputError
            If there is none; a key is looked up, so that it cannot lead out of the folder.
        """
        found = self.keys().get(key)
        if found is None:
            raise InputError(f"there is no recording {key!r}", where=self.root, remedy="select one from the list")
        return found

    def row(self, key: str) -> ShelfRow:
        """Return one recording, see `path`."""
        return self._row(key, self.path(key))

    def rows(self, query: str = "") -> list[ShelfRow]:
        """Return the recordings in which every word of `query` occurs, newest first."""
        words = query.lower().split()
        found = [self._row(key, path) for key, path in self.keys().items()]
        chosen = [row for row in found if all(word in row.searched for word in words)]
        return sorted(chosen, key=lambda row: (row.trial.started_at is not None and row.trial.started_at.timestamp(),
                                               row.key), reverse=True)  # fmt: skip

    def _row(self, key: str, path: Path) -> ShelfRow:
        stamp = tuple(
            n for p in (path, amendments_path(path)) if p.exists() for n in (p.stat().st_mtime_ns, p.stat().st_size)
        )
        known = self._known.get(path)
        if known is None or known[0] != stamp:
            self._known[path] = known = (stamp, _described(key, path))
        return known[1]


def _described(key: str, path: Path) -> ShelfRow:
    try:
        info = describe_recording(path)
    except SawbenchError as error:
        trial = Trial(trial_id=path.stem, source="")
        return ShelfRow(key=key, path=path, trial=trial, duration_s=0.0, state=error.what, is_sound=False)
    trial = info.trial or Trial(trial_id=path.stem, source="another program")
    problem = _problem(info)
    return ShelfRow(key=key, path=path, trial=trial, duration_s=info.duration_s, state=problem or "complete",
                    is_sound=not problem)  # fmt: skip


def _problem(info: RecordingInfo) -> str:
    if not info.is_sawbench:
        return "of another program"
    losses = (loss_in_words(c.channel, c.n_samples, sum(gap.n_missing for gap in c.gaps)) for c in info.channels)
    found = [] if info.is_complete else ["not complete"]
    return "; ".join([*found, *filter(None, losses)])


def corrections(form: Mapping[str, str], trial: Trial) -> dict[str, Any]:
    """Return what a form changes of the settings of a trial; an emptied field means that is unknown.

    Raises
    ------
    InputError
        If a number is none.
    """
    new: dict[str, Any] = {}
    for name, (words, _) in AMENDABLE.items():
        if name not in form:
            continue
        value: Any = form[name].strip() or None
        try:
            if value is not None and name in _NUMBERS:
                value = float(value.replace(",", "."))
            elif value is not None and name == "repetition":
                value = int(value)
        except ValueError:
            raise InputError(f"{words} is {value!r}, expected a number", where=trial.trial_id) from None
        if name == "notes":
            value = value or ""
        if value != getattr(trial, name):
            new[name] = value
    return new
