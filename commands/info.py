"""`sawbench info`: what is in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.commands.options import json_option
from sawbench.commands.terminal import emit, table

# How an import says in the provenance which column it took for a channel.
COLUMN_OF: Final = "column of "

if TYPE_CHECKING:
    from sawbench.bench.recording import Trial
    from sawbench.storage.reader import RecordingInfo


@click.command(name="info", epilog="Example: sawbench info recordings/oak-01.mcap")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@json_option
def command(path: Path, as_json: bool) -> None:
    """Show settings, channels, rates, gaps and events of a recording, complete or not."""
    from sawbench.storage.reader import describe_recording

    info = describe_recording(path)
    emit(info, _as_text(info), as_json=as_json)


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
    lines.append(f"{info.duration_s:.3f} s, configuration {'inside' if info.has_config else 'not inside'}")
    rows = [
        [
            c.channel,
            str(c.n_samples),
            f"{c.rate_hz:.2f}",
            f"{c.start_s:.3f}",
            f"{c.duration_s:.3f}",
            str(len(c.gaps)),
            str(sum(gap.n_missing for gap in c.gaps)),
        ]
        for c in info.channels
    ]
    lines.append(table(["channel", "samples", "rate Hz", "start s", "length s", "gaps", "missing"], rows))
    lines += [f"{key.removeprefix(COLUMN_OF)} <- {words}" for key, words in info.provenance.items() if COLUMN_OF in key]
    for event in info.events:
        whose = "".join(f" {name}" for name in (event.device, event.channel) if name)
        lines.append(f"{event.time_s:9.3f} s  {event.kind}{whose}: {event.text}")
    return "\n".join(lines)


def settings_line(trial: Trial) -> str:
    """What was done in one trial, in one line."""
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
    return f"trial {trial.trial_id}: {shown}" + (f"\nnotes: {trial.notes}" if trial.notes else "")
