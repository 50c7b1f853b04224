"""From recordings to the rows of a comparison."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from sawbench.analysis import AnalysedTrial, evaluate, load_and_process
from sawbench.bench.errors import InputError, SawbenchError

if TYPE_CHECKING:
    from sawbench.reporting.compared import ComparedTrial, LeftOut


def compare_files(paths: Iterable[Path], config_path: Path | None) -> tuple[list[ComparedTrial], list[LeftOut]]:
    """Process, fit and predict every recording, as far as each allows.

    Parameters
    ----------
    paths : iterable of Path
    config_path : Path, optional

    Returns
    -------
    rows : list of ComparedTrial
    left_out : list of LeftOut

    Raises
    ------
    InputError
        If no recording is left to compare.
    """
    from sawbench.reporting.compared import LeftOut

    rows: list[ComparedTrial] = []
    left_out: list[LeftOut] = []
    seen: dict[tuple[str, datetime], Path] = {}
    for path in paths:
        try:
            trial = load_and_process(path, config_path)
            _refuse_twin(trial, seen)
            rows.append(_compared(trial))
        except SawbenchError as error:
            left_out.append(LeftOut(name=path.name, reason=error.what, remedy=error.remedy or ""))
    if not rows:
        reasons = "; ".join(f"{item.name}: {item.reason}" for item in left_out)
        raise InputError(f"none of {len(left_out)} recordings can be compared: {reasons}")
    return rows, left_out


def _refuse_twin(trial: AnalysedTrial, seen: dict[tuple[str, datetime], Path]) -> None:
    """Refuse a second file of the same trial, as `recover` leaves it: it is no second repetition."""
    own = trial.recording.trial
    if own.started_at is None:
        return
    path = Path(trial.recording.path)
    first = seen.setdefault((own.trial_id, own.started_at), path)
    if first != path:
        raise InputError(f"is the same trial as {first.name} ({own.trial_id}, {own.started_at.isoformat()})")


def _compared(trial: AnalysedTrial) -> ComparedTrial:
    from sawbench.reporting.compared import ComparedTrial

    found = evaluate(trial)
    return ComparedTrial(processed=trial.processed, fit=found.fit, runtime=found.runtime, note=found.note)
