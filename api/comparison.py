"""From recordings to the rows of a comparison."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sawbench.archive.batch import Outcome, Workers, run_batch
from sawbench.archive.trials import evaluate_file
from sawbench.bench.errors import InputError, SawbenchError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sawbench.bench.config import LoadedConfig
    from sawbench.reporting.compared import ComparedTrial, LeftOut
    from sawbench.storage.places import Place


def compare_files(
    places: Sequence[Place], config: LoadedConfig | None, workers: Workers | None = None
) -> tuple[list[ComparedTrial], list[LeftOut]]:
    """Process, fit and predict every recording, as far as each allows; see `compared`."""
    return compared(run_batch(partial(evaluate_file, config=config), places, workers))


def compared(outcomes: Iterable[Outcome[Place, ComparedTrial]]) -> tuple[list[ComparedTrial], list[LeftOut]]:
    """Take every evaluated recording for a row of the comparison, or say why it is left out.

    Parameters
    ----------
    outcomes : iterable of Outcome
        In any order.

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

    found: list[ComparedTrial] = []
    left_out: list[LeftOut] = []
    for outcome in sorted(outcomes, key=lambda one: one.index):
        try:
            trial = outcome.result()
            _refuse_axis(trial)
            found.append(trial)
        except SawbenchError as error:
            left_out.append(LeftOut(name=outcome.item.name, reason=error.what, remedy=error.remedy or ""))
    rows: list[ComparedTrial] = []
    fullest = _fullest(found)
    for trial in found:
        kept = fullest.get(_taken(trial), trial)
        if kept is trial:
            rows.append(trial)
        else:
            reason = f"is the same trial as {Path(kept.processed.source_path).name}, which has as many samples or more"
            left_out.append(LeftOut(name=Path(trial.processed.source_path).name, reason=reason, remedy=""))
    if not rows:
        reasons = "; ".join(f"{item.name}: {item.reason}" for item in left_out)
        raise InputError(f"none of {len(left_out)} recordings can be compared: {reasons}")
    return rows, left_out


def _refuse_axis(trial: ComparedTrial) -> None:
    """Refuse a trial of a machine that cuts nothing: materials are compared by what it takes to cut them."""
    if trial.processed.frame == "linear_axis":
        raise InputError(
            "is a trial of a linear axis, which cuts no material that could be compared",
            remedy="`sawbench diagnose` compares an axis with its model",
        )


def _taken(trial: ComparedTrial) -> tuple[str, datetime | None]:
    return trial.processed.trial.trial_id, trial.processed.trial.started_at


def _fullest(trials: Iterable[ComparedTrial]) -> dict[tuple[str, datetime | None], ComparedTrial]:
    """Of each trial whose start is known the file with most samples: another one, as `recover` leaves it, is a copy."""
    found: dict[tuple[str, datetime | None], ComparedTrial] = {}
    for trial in trials:
        if trial.processed.trial.started_at is not None:
            kept = found.setdefault(_taken(trial), trial)
            found[_taken(trial)] = max(kept, trial, key=_n_samples)
    return found


def _n_samples(trial: ComparedTrial) -> int:
    return sum(row.n_samples for row in trial.processed.quality)


def save_comparison(
    rows: Sequence[ComparedTrial],
    left_out: Sequence[LeftOut],
    targets: tuple[Place, Place, Place],
    *,
    overwrite: bool = False,
) -> None:
    """Write page, CSV and HDF5 of a comparison, to these places in this order.

    Raises
    ------
    InputError
        If a file exists and `overwrite` is not set, or cannot be written.
    """
    from sawbench.reporting.compared import compare
    from sawbench.reporting.comparison_data import comparison_table, write_comparison_hdf5
    from sawbench.reporting.comparison_page import write_comparison_page
    from sawbench.storage.output import write_whole

    page, csv, hdf5 = targets
    write_comparison_page(page, rows, left_out=left_out, overwrite=overwrite)
    write_whole(csv, comparison_table(rows).to_csv(index=False), overwrite=overwrite)
    write_comparison_hdf5(hdf5, rows, compare(rows, left_out), overwrite=overwrite)
