"""How far a series is: derived from its plan, the recordings in its folder, and its journal; nothing else is kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from sawbench.acquisition.series.journal import JournalEntry
from sawbench.acquisition.series.plan import LoadedPlan, PlannedTrial, SeriesPlan
from sawbench.acquisition.series.rejected import REJECTED
from sawbench.acquisition.series.verdict import BladeGrowth, TrialMeasures, blade_growth, outliers
from sawbench.bench.errors import InputError
from sawbench.bench.wear_rule import is_worn

State = Literal["to do", "kept", "undecided", "interrupted", "to set aside"]
Part = Literal["blade", "battery"]


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialProgress:
    """One trial of the plan, and what has become of it.

    Attributes
    ----------
    planned : PlannedTrial
    state : str
        "undecided": recorded, but nobody said keep or repeat; "interrupted": the recorder died; "to set aside":
        rejected, but its file is still among the recordings.
    path : Path
        Of the recording.
    measures : TrialMeasures or None
        Of the recording that is there.
    disagrees : tuple of str
        Where it disagrees with its repetitions.
    rejected : tuple of str
        Why earlier recordings of it were rejected.
    notes : tuple of str
    """

    planned: PlannedTrial
    state: State
    path: Path
    measures: TrialMeasures | None = None
    disagrees: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def part_path(self) -> Path:
        """The file while it is written."""
        return self.path.with_name(self.path.name + ".part")


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesProgress:
    """The whole series.

    Attributes
    ----------
    plan : SeriesPlan
    trials : tuple of TrialProgress
        In the order of the plan.
    kept : tuple of TrialMeasures
        In the order in which they were kept.
    strangers : tuple of str
        Recordings in the folder that belong to no trial of the plan.
    entries : tuple of JournalEntry
    """

    plan: SeriesPlan
    trials: tuple[TrialProgress, ...]
    kept: tuple[TrialMeasures, ...]
    strangers: tuple[str, ...]
    entries: tuple[JournalEntry, ...]

    @property
    def next(self) -> TrialProgress | None:
        """The first trial that is not kept yet."""
        return next((trial for trial in self.trials if trial.state != "kept"), None)

    @property
    def doubtful(self) -> tuple[TrialProgress, ...]:
        """Trials that were kept although something is wrong with them."""
        return tuple(t for t in self.trials if t.state == "kept" and t.measures is not None and t.measures.faults)

    def others(self, trial_id: str) -> list[TrialMeasures]:
        """Return the trials that were kept, but one."""
        return [measures for measures in self.kept if measures.trial_id != trial_id]

    def mounted(self, part: Part) -> str | None:
        """Return the identity of the blade or battery that is on the tool."""
        return next((e.facts["identity"] for e in reversed(self._mountings(part))), None)

    def identity(self, part: Part, planned: str) -> str | None:
        """Return the identity of what was last mounted for a name of the plan; None where nothing was yet."""
        return next(
            (e.facts["identity"] for e in reversed(self._mountings(part)) if e.facts["planned"] == planned), None
        )

    def identities(self, part: Part) -> set[str]:
        """Return every blade or battery that was mounted in the series."""
        return {e.facts["identity"] for e in self._mountings(part)}

    def worn(self, blade: str) -> BladeGrowth | None:
        """Return the growth on a blade where it has reached the plan's limit."""
        growth = blade_growth(self.kept, blade)
        return growth if growth is not None and is_worn(growth.growth, self.plan.blade_growth_limit) else None

    def _mountings(self, part: Part) -> list[JournalEntry]:
        return [e for e in self.entries if e.kind == "mounted" and e.facts.get("part") == part]


def progress_of(loaded: LoadedPlan, entries: Sequence[JournalEntry]) -> SeriesProgress:
    """Derive how far a series is.

    Parameters
    ----------
    loaded : LoadedPlan
    entries : sequence of JournalEntry
        Oldest first.

    Raises
    ------
    InputError
        If the plan says other settings of a kept trial than it was recorded with.
    """
    by_trial: dict[str, list[JournalEntry]] = {}
    for entry in entries:
        by_trial.setdefault(entry.trial, []).append(entry)
    rows = [
        _trial(trial, loaded.folder / f"{trial.id}.mcap", by_trial.get(trial.id, ())) for trial in loaded.plan.trial
    ]
    _refuse_changed(rows, loaded.path)
    order = {entry.trial: number for number, entry in enumerate(entries) if entry.kind == "kept"}
    done = [row.measures for row in rows if row.state == "kept" and row.measures is not None]
    kept = tuple(sorted(done, key=lambda measures: order[measures.trial_id]))
    own = {row.path.name for row in rows}
    return SeriesProgress(
        plan=loaded.plan,
        trials=tuple(_compared(row, kept, loaded.plan) for row in rows),
        kept=kept,
        strangers=tuple(path.name for path in sorted(loaded.folder.glob("*.mcap")) if path.name not in own),
        entries=tuple(entries),
    )


def as_facts(measures: TrialMeasures) -> dict[str, Any]:
    """Return measures as plain values for the journal; what is no finite number is not known."""
    found = {field.name: getattr(measures, field.name) for field in fields(measures)}
    known = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in found.items()}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in known.items()}


def from_facts(facts: Mapping[str, Any]) -> TrialMeasures:
    """Return the measures that `as_facts` wrote; keys of other versions are passed over."""
    known: dict[str, Any] = {field.name: facts[field.name] for field in fields(TrialMeasures) if field.name in facts}
    lists = {key: tuple(value) for key, value in known.items() if isinstance(value, list)}
    return TrialMeasures(**{**known, **lists})


def _trial(planned: PlannedTrial, path: Path, entries: Sequence[JournalEntry]) -> TrialProgress:
    starts = [number for number, entry in enumerate(entries) if entry.kind == "started"]
    latest = entries[starts[-1] :] if starts else entries
    state: State = "to do"
    if path.exists():
        state = _state_of_recorded(path, [e for e in latest if e.kind in {"kept", "rejected"}])
    elif path.with_name(path.name + ".part").exists():
        state = "interrupted"
    judged = [e for e in latest if e.kind == "judged"] if state in {"kept", "undecided"} else []
    return TrialProgress(
        planned=planned,
        state=state,
        path=path,
        measures=from_facts(judged[-1].facts) if judged else None,
        rejected=tuple(str(e.facts.get("because", "")) for e in entries if e.kind == "rejected"),
        notes=tuple(str(e.facts.get("text", "")) for e in entries if e.kind == "note"),
    )


def _state_of_recorded(path: Path, decisions: Sequence[JournalEntry]) -> State:
    if not decisions:
        return "undecided"
    if decisions[-1].kind == "kept":
        return "kept"
    # Where the rejected file has arrived, the one that is here now is another recording.
    is_moved = (path.parent / REJECTED / str(decisions[-1].facts.get("file"))).exists()
    return "undecided" if is_moved else "to set aside"


def _compared(row: TrialProgress, kept: Sequence[TrialMeasures], plan: SeriesPlan) -> TrialProgress:
    if row.measures is None:
        return row
    others = [measures for measures in kept if measures.trial_id != row.planned.id]
    return replace(row, disagrees=outliers(row.measures, others, plan.repeatability))


def _refuse_changed(rows: Sequence[TrialProgress], path: Path) -> None:
    for row in rows:
        if row.state == "kept" and row.measures is not None and row.measures.setting != row.planned.setting:
            raise InputError(
                f"has {_words(row.planned.setting)} of trial {row.planned.id}, which was recorded with "
                f"{_words(row.measures.setting)}",
                where=path,
                remedy="restore the previous values, and add another trial with its own id",
            )


def _words(setting: tuple[str, float | None, float | None, float | None]) -> str:
    material, *numbers = setting
    named = zip(("duty", "feed", "thickness"), numbers, ("", " mm/s", " mm"), strict=True)
    return ", ".join([material, *(f"{name} {value:g}{unit}" for name, value, unit in named if value is not None)])
