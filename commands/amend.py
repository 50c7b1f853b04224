"""`sawbench amend`: corrects the settings of recordings; the recordings themselves stay as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import click
from sawbench.bench.errors import InputError
from sawbench.commands.failures import Failures
from sawbench.commands.options import json_option, recordings_argument, setting_options
from sawbench.commands.terminal import emit
from sawbench.inputs import find_recordings

# Option -> setting, for --unset.
_SETTING_OF: Final = {
    "thickness": "thickness_mm", "feed": "feed_mm_s", "blade": "blade", "battery": "battery", "operator": "operator",
    "repetition": "repetition", "batch": "batch",
}  # fmt: skip


@click.command(
    name="amend", epilog="Example: sawbench amend wood/05-oak.mcap --duty 0.55 --by Kim --because 'mistyped'"
)
@recordings_argument
@click.option("--material", help="Workpiece material; 'none' for an idle run.")
@setting_options
@click.option("--operator", help="Who recorded.")
@click.option("--repetition", type=click.IntRange(1))
@click.option("--batch", help="Batch of the workpiece material.")
@click.option("--notes", help="Replaces the notes of the trial.")
@click.option("--unset", multiple=True, type=click.Choice(list(_SETTING_OF)), help="Set to unknown; may be repeated.")
@click.option("--by", help="Name of the person who corrects; default: login name.")
@click.option("--because", default="", help="Why.")
@json_option
def command(
    paths: tuple[Path, ...], unset: tuple[str, ...], by: str | None, because: str, as_json: bool, **settings: Any
) -> int:
    """Correct wrong settings of recordings. Every command then uses the corrected settings.

    The correction is a line in FILE.amendments.jsonl beside the recording, with time, name, old and new value and the
    SHA-256 of the recording, which stays as it is. Keep the two files together.
    """
    from sawbench.storage.amendments import amend, amendments_path
    from sawbench.storage.reader import read_recording

    new = {name: value for name, value in settings.items() if value is not None}
    both = [name for name in unset if _SETTING_OF[name] in new]
    if both:
        raise InputError(f"--{both[0]} is given and unset", remedy="leave out one of the two")
    new |= {_SETTING_OF[name]: None for name in unset}
    if not new:
        raise InputError("no correction is given", remedy="give the setting, for example --duty 0.55")
    files = find_recordings(paths)
    failures, rows = Failures(len(files)), []
    for path in files:
        with failures.collected():
            made = amend(path, read_recording(path).trial, new, by=by or _login(), because=because)
            words = "these corrections are already in effect" if made is None else made.words
            rows.append({"path": str(path), "amendments": str(amendments_path(path)), "is_new": bool(made),
                         "words": words})  # fmt: skip
    emit(rows, "\n".join(f"{row['path']}: {row['words']}" for row in rows), as_json=as_json)
    return failures.exit_code(is_trusted=True)


def _login() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return ""
