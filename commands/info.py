"""`sawbench info`: what is in a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.bench.recording import HEAVY_LOSS_SHARE, loss_in_words
from sawbench.commands.failures import Failures
from sawbench.commands.options import json_option, recordings_argument
from sawbench.commands.terminal import emit, progress, table
from sawbench.inputs import find_recordings

# How an import says in the provenance which column it took for a channel.
COLUMN_OF: Final = "column of "
_GAPS_SHOWN: Final = 10

if TYPE_CHECKING:
    from sawbench.bench.recording import Event, Trial
    from sawbench.storage.describe import ChannelInfo, RecordingInfo


@click.command(name="info", epilog="Example: sawbench info recordings/oak-01.mcap")
@recordings_argument
@json_option
def command(paths: tuple[Path, ...], as_json: bool) -> int:
    """Show settings, channels, rates, gaps and events of a recording, complete or not.

    Several files, or a folder, give a table of one row each, and with --json a list of what one file gives. What is
    not finished in a folder (.mcap.part) is named.
    """
    from sawbench.storage.describe import describe_recording

    if len(paths) == 1 and not paths[0].is_dir():
        info = describe_recording(paths[0])
        emit(info, _as_text(info), as_json=as_json)
        return 0
    for part in (part for path in paths if path.is_dir() for part in sorted(path.glob("*.mcap.part"))):
        click.echo(f"{part}: not finished: being recorded, or interrupted; then `sawbench recover {part}`", err=True)
    files = find_recordings(paths)
    failures = Failures(len(files))
    infos: list[RecordingInfo] = []
    for path in progress(files, "reading"):
        with failures.collected():
            infos.append(describe_recording(path))
    emit(infos, _as_table(infos), as_json=as_json)
    return failures.exit_code(is_trusted=True)


def _as_table(infos: list[RecordingInfo]) -> str:
    """One row a file, then every loss that matters and every damage."""
    head = [
        "file",
        "trial",
        "material",
        "duty",
        "thickness mm",
        "feed mm/s",
        "length s",
        "channels",
        "missing",
        "state",
    ]
    lines = [table(head, [_row(info) for info in infos])]
    for info in infos:
        corrected = () if info.trial is None else (f"corrected: {words}" for words in info.trial.amendments)
        lines += [f"{info.path}: {words}" for words in (*_losses(info), *info.problems, *corrected)]
    n_sound = sum(_state(info) == "complete" for info in infos)
    counted = "1 recording" if len(infos) == 1 else f"{len(infos)} recordings"
    lines.append(f"{counted}, {n_sound} complete without a loss above {HEAVY_LOSS_SHARE:.0%}")
    return "\n".join(lines)


def _row(info: RecordingInfo) -> list[str]:
    """Name, settings, length and quality of one file; `-` where nobody said."""
    trial = info.trial
    said = [None] * 5
    if trial is not None:
        said = [trial.trial_id, trial.material, trial.duty, trial.thickness_mm, trial.feed_mm_s]
    settings = ["-" if value is None else f"{value:g}" if isinstance(value, float) else value for value in said]
    share = max((_n_missing(c) / (c.n_samples + _n_missing(c)) for c in info.channels), default=None)
    missing = "-" if share is None else f"{share:.2%}"
    return [info.path, *settings, f"{info.duration_s:.1f}", str(len(info.channels)), missing, _state(info)]


def _state(info: RecordingInfo) -> str:
    if not info.is_sawbench:
        return "of another program"
    if not info.is_complete:
        return "NOT complete"
    return "LOSS" if _losses(info) else "complete"


def _losses(info: RecordingInfo) -> list[str]:
    found = (loss_in_words(c.channel, c.n_samples, _n_missing(c)) for c in info.channels)
    return [words for words in found if words]


def _n_missing(channel: ChannelInfo) -> int:
    return sum(gap.n_missing for gap in channel.gaps)


def _as_text(info: RecordingInfo) -> str:
    state = "complete" if info.is_complete else "NOT complete"
    lines = [f"{info.path}: {info.size_bytes / 1e6:.2f} MB, {state}, written by {info.software}"]
    lines += [f"problem: {problem}" for problem in info.problems]
    if not info.is_sawbench:
        lines.append("an MCAP file of another program; topics:")
        lines.append(
            table(
                ["topic", "messages", "encoding", "type"],
                [[t.topic, str(t.n_messages), t.encoding, t.message_type] for t in info.topics],
            )
        )
        return "\n".join(lines)
    if info.trial is not None:
        lines.append(settings_line(info.trial))
    lines.append(f"{info.duration_s:.3f} s, configuration {'included' if info.has_config else 'not included'}")
    rows = [
        [
            c.channel,
            str(c.n_samples),
            f"{c.rate_hz:.2f}",
            f"{c.start_s:.3f}",
            f"{c.duration_s:.3f}",
            str(len(c.gaps)),
            str(_n_missing(c)),
        ]
        for c in info.channels
    ]
    lines.append(table(["channel", "samples", "rate Hz", "start s", "length s", "gaps", "missing"], rows))
    lines += [f"{key.removeprefix(COLUMN_OF)} <- {words}" for key, words in info.provenance.items() if COLUMN_OF in key]
    return "\n".join([*lines, *_event_lines(info.events)])


def _event_lines(events: Sequence[Event]) -> list[str]:
    """One line an event in the order of time; of many gaps, which the table counts, the first ones."""
    lines, n_gaps = [], 0
    for event in sorted(events, key=lambda event: event.time_s):
        n_gaps += event.kind == "gap"
        if event.kind != "gap" or n_gaps <= _GAPS_SHOWN:
            whose = "".join(f" {name}" for name in (event.device, event.channel) if name)
            lines.append(f"{event.time_s:9.3f} s  {event.kind}{whose}: {event.text}")
    if n_gaps > _GAPS_SHOWN:
        lines.append(f"{n_gaps - _GAPS_SHOWN} more gaps: --json lists them")
    return lines


def settings_line(trial: Trial) -> str:
    """What was done in one trial, in one line; notes and corrections below it."""
    said = {
        "material": trial.material,
        "duty": trial.duty,
        "thickness": None if trial.thickness_mm is None else f"{trial.thickness_mm:g} mm",
        "feed": None if trial.feed_mm_s is None else f"{trial.feed_mm_s:g} mm/s",
        "blade": trial.blade,
        "battery": trial.battery,
        "operator": trial.operator,
        "repetition": trial.repetition,
        "batch": trial.batch,
        "started": None if trial.started_at is None else trial.started_at.isoformat(timespec="seconds"),
        "source": trial.source,
    }
    shown = ", ".join(f"{key} {value}" for key, value in said.items() if value is not None)
    lines = [f"trial {trial.trial_id}: {shown}", *([f"notes: {trial.notes}"] if trial.notes else [])]
    return "\n".join([*lines, *(f"corrected: {words}" for words in trial.amendments)])
