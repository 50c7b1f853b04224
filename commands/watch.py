"""`sawbench watch`: process what arrives in a folder, unattended."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.commands.batch import Batch, batch_options, named_config
from sawbench.commands.options import PLACE, config_option, force_option, refuse_unwritable
from sawbench.storage.places import with_suffix

if TYPE_CHECKING:
    from sawbench.archive.watching import Watch
    from sawbench.storage.places import Place


@click.command(
    name="watch",
    epilog="Example: sawbench watch recordings --archive archive --out comparison.html --force",
)
@click.argument("directory", metavar="DIR", type=PLACE)
@click.option("--out", "out_path", type=PLACE, help="Comparison page that is kept up to date, with its CSV and HDF5.")
@click.option(
    "--every", "every_s", type=click.FloatRange(min=0.1), default=10.0, show_default=True,
    help="Time between two scans of the folder, s.",
)  # fmt: skip
@click.option("--once", is_flag=True, help="Process the present files and exit, for example from a timer.")
@config_option
@batch_options()
@force_option
def command(
    directory: Place, out_path: Place | None, every_s: float, once: bool, config_path: Path | None, batch: Batch,
    force: bool,
) -> int:  # fmt: skip
    """Process every recording that arrives in DIR into the archive, until stopped; keep the comparison page current.

    A file is taken when two looks found it unchanged, so a copy that is half done waits. What goes wrong with a file
    is a row of the archive; what goes wrong with the disk or the store is said, and tried again at the next look.
    """
    from sawbench.archive.trials import Archive
    from sawbench.archive.watching import Watch

    if batch.archive is None:
        raise click.UsageError("give the archive for the results: --archive DIR")
    if isinstance(directory, Path) and not directory.is_dir():
        raise InputError("no such directory", where=directory)
    pages = None if out_path is None else (out_path, with_suffix(out_path, ".csv"), with_suffix(out_path, ".h5"))
    for path in pages or ():
        refuse_unwritable(path, force=force)
    archive = Archive(batch.archive, named_config(config_path), retries=batch.retries)

    def write_page() -> None:
        from sawbench.archive.trials import kept_trials
        from sawbench.comparison import compared, save_comparison

        if pages is not None:
            save_comparison(*compared(kept_trials(archive.table)), pages, overwrite=True)

    watch = Watch(folder=directory, archive=archive, workers=batch.workers(), on_change=write_page)
    if once:
        failed = [(file, error) for file, error in watch.look(waits=False) if error]
        for file, error in failed:
            _say(f"{file.place}: {error}")
        return 1 if failed else 0
    _say(f"watching {directory} every {every_s:g} s")
    try:
        while True:
            _look(watch)
            time.sleep(every_s)
    except KeyboardInterrupt:
        _say("stopped")
        return 0


def _look(watch: Watch) -> None:
    """Look once; whatever is in the way now may be gone at the next look."""
    try:
        for file, error in watch.look():
            _say(f"{file.place}: {error or 'processed'}")
    except (SawbenchError, OSError) as error:
        _say(f"failed, will be retried: {error}")


def _say(text: str) -> None:
    click.echo(f"{datetime.now(UTC).isoformat(timespec='seconds')} {text}", err=True)
