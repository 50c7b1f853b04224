"""`sawbench recover`: salvage a truncated or damaged recording."""

from __future__ import annotations

from pathlib import Path

import click
from sawbench.commands.options import force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit


@click.command(name="recover", epilog="Example: sawbench recover recordings/oak-04.mcap.part --out oak-04.mcap")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@click.option(
    "--out",
    "out_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Default: FILE with -recovered.",
)
@force_option
@json_option
def command(path: Path, out_path: Path | None, force: bool, as_json: bool) -> int:
    """Copy everything readable of FILE into a new recording; FILE itself is never changed."""
    from sawbench.storage.recover import recover_recording

    if out_path is None:
        stem = path.name.removesuffix(".part").removesuffix(".mcap")
        out_path = path.with_name(f"{stem}-recovered.mcap")
    refuse_unwritable(out_path, force=force, makes_folder=True)
    report = recover_recording(path, out_path, overwrite=force)
    lines = [str(report.path)]
    lines += [f"problem: {problem}" for problem in report.problems]
    lost = f"{report.n_messages_lost} known to be lost ({report.seconds_lost:.3f} s)"
    is_whole = not report.n_messages_lost and not report.seconds_lost
    lines.append(f"{report.n_messages_kept} messages kept, {'none of them damaged' if is_whole else lost}")
    if report.is_tail_cut:
        lines.append("the end of the file is missing: up to one more flush interval is lost")
    emit(report, "\n".join(lines), as_json=as_json)
    return 1 if report.n_messages_lost or report.seconds_lost or not report.n_messages_kept else 0
