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

    rows: list[ComparedTrial] = []
    left_out: list[LeftOut] = []
    seen: dict[tuple[str, datetime], str] = {}
    for outcome in sorted(outcomes, key=lambda one: one.index):
        try:
            trial = outcome.result()
            _refuse_axis(trial)
            _refuse_twin(trial, seen)
            rows.append(trial)
        except SawbenchError as error:
            left_out.append(LeftOut(name=outcome.item.name, reason=error.what, remedy=error.remedy or ""))
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


def _refuse_twin(trial: ComparedTrial, seen: dict[tuple[str, datetime], str]) -> None:
    """Refuse a second file of the same trial, as `recover` leaves it: it is no second repetition."""
    own, path = trial.processed.trial, trial.processed.source_path
    if own.started_at is None:
        return
    first = seen.setdefault((own.trial_id, own.started_at), path)
    if first != path:
        raise InputError(f"is the same trial as {Path(first).name} ({own.trial_id}, {own.started_at.isoformat()})")


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
