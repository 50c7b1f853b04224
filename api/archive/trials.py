"""From a recording to its row in the table of an archive, and back to what a comparison needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

from sawbench.analysis import AnalysedTrial, evaluate, load_and_process
from sawbench.archive.batch import WORTH_COMPILING, Outcome, Workers, run_batch
from sawbench.archive.detail import as_json, from_json
from sawbench.archive.table import ResultTable
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.bench.source_identity import analysis_identity
from sawbench.bench.units import BATTERY_CURRENT, FORCE, MOTOR_CURRENT
from sawbench.inputs import config_for
from sawbench.reporting.compared import ComparedTrial
from sawbench.storage.digest import sha256_of
from sawbench.storage.places import FoundFile, Place, place_of

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.modeling.results import CuttingFit

# Rows are written out when there are this many, or when the oldest has waited this long.
_ROWS_AT_ONCE: Final = 500
_WAIT_S: Final = 10.0
_KEY_COLUMNS: Final = (
    "source",
    "source_sha256",
    "size_bytes",
    "stamp",
    "config_key",
    "software",
    "exit_code",
    "is_amended",
)
# In place of the hash of a configuration: the recording brings its own.
OWN: Final = "own"


def fit_or_reason(trial: ComparedTrial) -> CuttingFit | None:
    """Return the fit of an evaluated trial; None where the blade ran in air.

    Raises
    ------
    InputError
        If there is no fit, with the reason.
    """
    if trial.fit is None and not trial.is_idle:
        raise InputError(trial.note, where=trial.processed.source_path)
    return trial.fit


def evaluate_file(place: Place, config: LoadedConfig | None, *, compiles: bool = False) -> ComparedTrial:
    """Process a recording, fit it and predict its runtime as far as it allows.

    Parameters
    ----------
    place : Path or StoreFile
    config : LoadedConfig, optional
        Default: the recording's own.
    compiles : bool
        Worth it for many recordings; see `evaluate`.

    Raises
    ------
    InputError
        If it is not a recording, or the configuration is not valid.
    """
    return evaluated(load_and_process(place, config), compiles=compiles)


def evaluated(trial: AnalysedTrial, *, compiles: bool = False) -> ComparedTrial:
    """Fit a processed trial and predict its runtime as far as it allows."""
    found = evaluate(trial, compiles=compiles)
    analysis = trial.loaded.config.analysis
    gains = {
        FORCE.name: analysis.force_gain_rel_std,
        MOTOR_CURRENT.name: analysis.current_gain_rel_std,
        BATTERY_CURRENT.name: analysis.current_gain_rel_std,
    }
    return ComparedTrial(
        processed=light(trial.processed),
        fit=None if found.fit is None else found.fit.in_outline,
        runtime=found.runtime,
        note=found.note,
        gain_rel_std=gains,
    )


def light(processed: ProcessedTrial) -> ProcessedTrial:
    """Leave out what is as long as the recording: angle and channels."""
    return replace(processed, angle=None, channels={})


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """A recording that waits to be evaluated.

    Attributes
    ----------
    file : FoundFile
    config : LoadedConfig or None
        The one that was named for all.
    compiles : bool
        Worth it for many recordings; see `evaluate`.
    """

    file: FoundFile
    config: LoadedConfig | None
    compiles: bool = False

    def __str__(self) -> str:
        return str(self.file.place)


def evaluated_row(task: Task) -> dict[str, Any]:
    """Return the row of a recording; one that cannot be evaluated has its error in it."""
    place = task.file.place
    try:
        opened = load_and_process(place, task.config)
        found = evaluated(opened, compiles=task.compiles)
    except SawbenchError as error:
        return failed_row(task, error) | {"source_sha256": _hash_if_readable(place)}
    is_default = task.config is None and not opened.recording.config_toml
    key = _key(task) | ({"config_key": opened.loaded.sha256} if is_default else {})
    return key | _columns(found) | {"exit_code": 0}


def failed_row(task: Task, error: SawbenchError) -> dict[str, Any]:
    """Return the row of a recording that could not be evaluated."""
    return _key(task) | {
        "quality": "failed", "error": error.what, "remedy": error.remedy, "exit_code": error.exit_code
    }  # fmt: skip


def _hash_if_readable(place: Place) -> str | None:
    try:
        return sha256_of(place)
    except SawbenchError:
        return None


def _key(task: Task) -> dict[str, Any]:
    return {
        "source": str(task.file.place),
        "size_bytes": task.file.size_bytes,
        "stamp": task.file.stamp,
        "is_amended": task.file.is_amended,
        "config_key": OWN if task.config is None else task.config.sha256,
        "software": analysis_identity(),
        "evaluated_at": datetime.now(UTC),
    }


def _columns(trial: ComparedTrial) -> dict[str, Any]:
    """Columns that are known of an evaluated trial."""
    from sawbench.storage.results import summary_row

    processed, fit, runtime = trial.processed, trial.fit, trial.runtime
    row: dict[str, Any] = dict(summary_row(processed))
    # What is drawn of a trial in a comparison is its cutting force; the other channels' cycles are not kept.
    kept = replace(trial, processed=replace(processed, folded={}))
    row |= {
        "started_at": processed.trial.started_at,
        "operator": processed.trial.operator,
        "batch": processed.trial.batch,
        "quality": quality_of(trial),
        "detail": as_json(kept),
    }
    if fit is not None:
        row |= {"fit_status": fit.status, "k_fc_n_s_per_m": fit.k_fc_n_s_per_m, "k_fc_std_n_s_per_m": fit.std_n_s_per_m}
    if runtime is not None:
        row |= {"runtime_status": runtime.status, "runtime_s": runtime.runtime_s, "runtime_std_s": runtime.std_s}
    return row


def quality_of(trial: ComparedTrial) -> str:
    """Say in a word or two whether the results of a trial can be relied on: "good", or what is against it."""
    processed = trial.processed
    if processed.losses:
        return "samples lost"
    if any(channel.doubts for channel in processed.quality):
        return "doubted channel"
    if processed.period is None:
        return processed.status.replace("_", " ")
    if processed.period.confidence == "low":
        return "low confidence"
    if trial.fit is None:
        is_done = processed.status == "moving" or (processed.status == "no_cutting" and trial.is_idle)
        return "good" if is_done else "no fit"
    return "good" if trial.fit.status == "ok" else "fit not reliable"


class Archive:
    """Evaluated recordings, kept in a table and evaluated only once.

    Parameters
    ----------
    root : Path or StoreFile
    config : LoadedConfig, optional
        Configuration for every recording; default: each recording's own.
    retries : bool
        Evaluate again what failed before.
    """

    def __init__(self, root: Place, config: LoadedConfig | None = None, *, retries: bool = False) -> None:
        self.table = ResultTable(root)
        self._config = config
        self._retries = retries

    def missing(self, files: Sequence[FoundFile]) -> list[Task]:
        """Return what has to be evaluated: no row of the same file, configuration and software is there.

        A file of the same size and the same hash as one that is there takes over its row.
        """
        rows = self.table.read(_KEY_COLUMNS).to_dict("records") if self.table.exists() else []
        valid = [row for row in rows if self._is_valid(row)]
        of_source = {row["source"]: row for row in valid}
        of_size: dict[int, list[Any]] = {}
        for row in valid:
            if not row["is_amended"]:
                of_size.setdefault(row["size_bytes"], []).append(row)
        waiting, same = [], {}
        for file in files:
            row = of_source.get(str(file.place))
            if row is not None and (row["size_bytes"], row["stamp"]) == (file.size_bytes, file.stamp):
                continue
            twins = () if file.is_amended else of_size.get(file.size_bytes, ())
            digest = _hash_if_readable(file.place) if twins else None
            twin = next((row["source"] for row in twins if digest and row["source_sha256"] == digest), None)
            if twin is None:
                waiting.append(Task(file=file, config=self._config))
            else:
                same[file] = twin
        self._take_over(same)
        return waiting

    def evaluate(self, waiting: Sequence[Task], workers: Workers | None = None) -> Iterator[Outcome[Task, Any]]:
        """Evaluate recordings and keep their rows; one is yielded as soon as it is finished.

        Rows are on the disk at the latest ten seconds after they are known, and when the caller stops.
        """
        rows, since = [], monotonic()
        tasks = [replace(task, compiles=len(waiting) >= WORTH_COMPILING) for task in waiting]
        try:
            for outcome in run_batch(evaluated_row, tasks, workers):
                rows.append(outcome.value if outcome.error is None else failed_row(outcome.item, outcome.error))
                yield outcome
                if len(rows) >= _ROWS_AT_ONCE or monotonic() - since > _WAIT_S:
                    self.table.add(rows)
                    rows, since = [], monotonic()
        finally:
            self.table.add(rows)
        self.table.tidy()

    def _is_valid(self, row: Mapping[Any, Any]) -> bool:
        if row["software"] != analysis_identity() or (self._retries and row["exit_code"]):
            return False
        if self._config is not None:
            return row["config_key"] == self._config.sha256
        return row["config_key"] == OWN or row["config_key"] == self._default_sha256

    @cached_property
    def _default_sha256(self) -> str:
        return config_for(None, None).sha256

    def _take_over(self, same: Mapping[FoundFile, str]) -> None:
        """Give files the rows of others that hold the same bytes."""
        if not same:
            return
        whole = {row["source"]: row for row in self.table.rows()}
        self.table.add(
            whole[twin] | _key(Task(file=file, config=self._config)) | {"config_key": whole[twin]["config_key"]}
            for file, twin in same.items()
        )


def kept_trials(
    table: ResultTable, files: Sequence[FoundFile] | None = None
) -> Iterator[Outcome[Place, ComparedTrial]]:
    """Yield what a table holds, in the order of the places.

    Parameters
    ----------
    table : ResultTable
    files : sequence of FoundFile, optional
        Only these.

    Yields
    ------
    Outcome
        Of each place the trial, or the error that it failed with.

    Raises
    ------
    InputError
        If there is no table, or a row is of another sawbench.
    """
    wanted = None if files is None else {str(file.place) for file in files}
    rows = (row for row in table.rows() if wanted is None or row["source"] in wanted)
    for index, row in enumerate(rows):
        source, error, trial = row["source"], None, None
        if row["exit_code"]:
            error = SawbenchError(row["error"], where=source, remedy=row["remedy"])
            error.exit_code = row["exit_code"]
        else:
            trial = _restored(row)
        yield Outcome(index=index, item=place_of(source), value=trial, error=error)


def _restored(row: Mapping[str, Any]) -> ComparedTrial:
    try:
        trial = from_json(ComparedTrial, row["detail"])
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"its row in the archive was written by another version of sawbench ({row['software']})",
            where=row["source"],
            remedy="evaluate it again: sawbench process RECORDINGS --archive DIR",
        ) from error
    # The same bytes may lie at several places.
    return replace(trial, processed=replace(trial.processed, source_path=row["source"]))
