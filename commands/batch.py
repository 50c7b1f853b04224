"""What the commands share that take many recordings: the options, the work on all of them, what went wrong."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from sawbench.commands.failures import Failures
from sawbench.commands.options import PLACE, Decorator
from sawbench.commands.terminal import progress

if TYPE_CHECKING:
    from sawbench.archive.batch import Outcome, Workers
    from sawbench.archive.journal import Piece, Row
    from sawbench.bench.config import LoadedConfig
    from sawbench.reporting.compared import ComparedTrial
    from sawbench.storage.places import FoundFile, Place

R = TypeVar("R")

_jobs: Decorator = click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes on this machine."
)
scheduler_option: Decorator = click.option(
    "--scheduler", metavar="ADDRESS", help="Use the dask cluster of this scheduler, for example tcp://lab:8786."
)
_archive: Decorator = click.option(
    "--archive", type=PLACE, metavar="DIR",
    help="Store every result there (Parquet) and evaluate only new recordings; also s3://...",
)  # fmt: skip
_retry: Decorator = click.option("--retry", "retries", is_flag=True, help="Try again what failed before.")


@dataclass(frozen=True, kw_only=True, slots=True)
class Batch:
    """Where many recordings are worked on, and where the results are kept.

    Attributes
    ----------
    jobs : int
    scheduler : str or None
    archive : Path or StoreFile or None
    retries : bool
    """

    jobs: int = 1
    scheduler: str | None = None
    archive: Place | None = None
    retries: bool = False

    def workers(self) -> Workers:
        """Where the work is done."""
        from sawbench.archive.batch import Workers

        return Workers(jobs=self.jobs, scheduler=self.scheduler)

    def each(
        self, items: Sequence[Any], work: Callable[[Any], R], failures: Failures, description: str
    ) -> Iterator[tuple[int, R]]:
        """Work on all items; yield number and value of those that succeed, in the order in which they are finished.

        Raises
        ------
        SawbenchError
            If there is only one item and it fails.
        """
        from sawbench.archive.batch import run_batch

        if len(items) == 1 and self.scheduler is None:
            yield 0, work(items[0])
            return
        for outcome in progress(run_batch(work, items, self.workers()), description, len(items)):
            with failures.collected():
                yield outcome.index, outcome.result()

    def kept(
        self, files: Sequence[FoundFile], config: LoadedConfig | None, failures: Failures, description: str
    ) -> list[ComparedTrial]:
        """Return the evaluated trials of an archive that was brought up to date; see `outcomes`."""
        found = []
        for outcome in self.outcomes(files, config, description):
            with failures.collected():
                found.append(outcome.result())
        return found

    def rows(
        self,
        pieces: Sequence[Piece],
        work: Callable[[Any], Mapping[str, Any]],
        folder: Path,
        description: str,
        *,
        overwrites: bool,
    ) -> list[Row]:
        """Do what the journal of a folder does not hold yet; return the row of every piece, in their order."""
        from sawbench.archive.journal import Journal

        journal = Journal(folder, retries=self.retries, overwrites=overwrites)
        found = {row.name: row for row in progress(journal.run(work, pieces, self.workers()), description, len(pieces))}
        n_new = sum(not row.was_done for row in found.values())
        click.echo(f"{len(pieces)} in all: {n_new} done now, {len(pieces) - n_new} were done already", err=True)
        return [found[piece.name] for piece in pieces]

    def outcomes(
        self, files: Sequence[FoundFile], config: LoadedConfig | None, description: str
    ) -> Iterator[Outcome[Place, ComparedTrial]]:
        """Bring the archive up to date, if there is one, and yield what became of every file."""
        from sawbench.archive.batch import WORTH_COMPILING, run_batch
        from sawbench.archive.trials import Archive, evaluate_file, kept_trials

        if self.archive is None:
            places = [file.place for file in files]
            work = partial(evaluate_file, config=config, compiles=len(places) >= WORTH_COMPILING)
            yield from progress(run_batch(work, places, self.workers()), description, len(places))
            return
        archive = Archive(self.archive, config, retries=self.retries)
        files = [file.absolute() for file in files]
        waiting = archive.missing(files)
        for _ in progress(archive.evaluate(waiting, self.workers()), description, len(waiting)):
            pass
        click.echo(
            f"{len(files)} recordings: {len(waiting)} evaluated now, {len(files) - len(waiting)} were in"
            f" {self.archive} already", err=True,
        )  # fmt: skip
        yield from kept_trials(archive.table, files)


def batch_options(*, has_archive: bool = True) -> Decorator:
    """Add --jobs, --scheduler, --retry and, where there may be an archive, --archive; the command gets a `batch`."""
    options = [_jobs, scheduler_option, *([_archive] if has_archive else []), _retry]

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def called(*arguments: Any, jobs: int, scheduler: str | None, **others: Any) -> Any:
            kept = {name: others.pop(name) for name in ("archive", "retries") if name in others}
            return command(*arguments, batch=Batch(jobs=jobs, scheduler=scheduler, **kept), **others)

        result: Callable[..., Any] = called
        for option in reversed(options):
            result = option(result)
        return result

    return decorated


def named_config(config_path: Path | None) -> LoadedConfig | None:
    """Read the configuration that was named, once for all recordings; None where none was."""
    from sawbench.inputs import config_for

    return None if config_path is None else config_for(None, config_path)
