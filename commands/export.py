"""`sawbench export`: recordings at full rate for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from sawbench.commands.failures import Failures
from sawbench.commands.options import (
    force_option,
    json_option,
    recordings_argument,
    refuse_same_result,
    refuse_unwritable,
)
from sawbench.commands.terminal import emit, progress
from sawbench.inputs import find_recordings


@click.command(name="export", epilog="Example: sawbench export recordings/*.mcap --format parquet --out tables")
@recordings_argument
@click.option(
    "--format", "file_format", type=click.Choice(["csv", "parquet", "mf4"]), default="csv", show_default=True,
    help="Parquet and MF4 store every value exactly, CSV with 17 significant digits.",
)  # fmt: skip
@click.option(
    "--out", "out_dir", type=click.Path(path_type=Path, file_okay=False), default=Path("exported"), show_default=True,
    help="Folder for the tables; created if missing.",
)  # fmt: skip
@click.option("--raw", "with_raw", is_flag=True, help="Also the raw values of the instruments, before calibration.")
@force_option
@json_option
def command(
    paths: tuple[Path, ...], file_format: str, out_dir: Path, with_raw: bool, force: bool, as_json: bool
) -> int:
    """Write every sample of every channel, not resampled, with the metadata as JSON beside it.

    Channels that share their sample times share a table; CSV and Parquet are one file a table, MF4 is one file. A gap
    is one row without values (docs/recording_format.md). The exit code is 1 where a recording is incomplete or
    misses more than a hundredth of the samples of a channel: what there is is written all the same.
    """
    from sawbench.storage.digest import sha256_of
    from sawbench.storage.export import export_recording, metadata_path

    files = find_recordings(paths)
    targets = {path: metadata_path(path, out_dir, file_format) for path in files}
    refuse_same_result(targets)
    for target in targets.values():
        refuse_unwritable(target, force=force, makes_folder=True)
    failures = Failures(len(files))
    rows: list[dict[str, Any]] = []
    for path in progress(files, "exporting"):
        with failures.collected():
            report = export_recording(
                path, out_dir, file_format=file_format, with_raw=with_raw, sha256=sha256_of(path), overwrite=force
            )
            rows.append(
                {"recording": path, "files": report.paths, "n_samples": report.n_samples, "losses": list(report.losses)}
            )
    emit(rows, "\n".join(_as_text(row) for row in rows), as_json=as_json)
    return failures.exit_code(is_trusted=not any(row["losses"] for row in rows))


def _as_text(row: dict[str, Any]) -> str:
    lines = [f"{row['recording']}: {row['n_samples']} samples"]
    return "\n".join([*lines, *(f"  missing: {words}" for words in row["losses"]), *(f"  {p}" for p in row["files"])])
