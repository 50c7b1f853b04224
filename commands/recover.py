"""`sawbench recover`: salvage a truncated or damaged recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.commands.options import force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit

if TYPE_CHECKING:
    from sawbench.storage.describe import RecordingInfo
    from sawbench.storage.recover import RecoveryReport


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
    from sawbench.storage.describe import describe_recording
    from sawbench.storage.recover import recover_recording

    if out_path is None:
        stem = path.name.removesuffix(".part").removesuffix(".mcap")
        out_path = path.with_name(f"{stem}-recovered.mcap")
    refuse_unwritable(out_path, force=force, makes_folder=True)
    report = recover_recording(path, out_path, overwrite=force)
    lines = [str(report.path), *(f"problem: {problem}" for problem in report.problems)]
    lines += _what_is_left(report, describe_recording(report.path))
    emit(report, "\n".join(lines), as_json=as_json)
    return 1 if report.n_messages_lost or report.seconds_lost or not report.n_messages_kept else 0


def _what_is_left(report: RecoveryReport, info: RecordingInfo) -> list[str]:
    """Say in samples and seconds what was kept and what is gone; an MCAP of another program has messages alone."""
    kept = f"{report.n_messages_kept} messages"
    if info.channels:
        counted = "1 channel" if len(info.channels) == 1 else f"{len(info.channels)} channels"
        kept = f"{sum(channel.n_samples for channel in info.channels)} samples of {counted}"
    n_missing = sum(gap.n_missing for channel in info.channels for gap in channel.gaps)
    numbers = ((n_missing, "samples in gaps"), (report.n_messages_lost, "messages"))
    lost = [f"{number} {what}" for number, what in numbers if number]
    lost += [f"{report.seconds_lost:.2f} s"] if report.seconds_lost else []
    lines = [f"{kept} kept, {'none of them damaged' if not lost else 'known to be lost: ' + ', '.join(lost)}"]
    stops = [event.time_s for event in info.events if event.kind == "stop"]
    if report.is_tail_cut and stops and not lost:
        lines.append(f"the recording had stopped at {stops[-1]:.2f} s; only the end of the file is missing")
    elif report.is_tail_cut:
        ends = [f"ends at {event.time_s:.2f} s" for event in info.events if event.kind == "interrupted"]
        lines.append(f"the recording {' and '.join(ends) or 'is cut off'}; what came after is lost")
    return lines
