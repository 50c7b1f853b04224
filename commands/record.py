"""`sawbench record`: one trial to MCAP."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Trial
from sawbench.commands.link import current_link
from sawbench.commands.options import (
    bench_config_option,
    calibration_book_path,
    force_option,
    json_option,
    refuse_unwritable,
    setting_options,
)
from sawbench.commands.terminal import emit
from sawbench.commands.typed_lines import TypedLines, typed_lines
from sawbench.inputs import config_for, default_config_path

if TYPE_CHECKING:
    from sawbench.acquisition.pre_trigger import Touch
    from sawbench.acquisition.recording_report import RecordingStatus, RecordingSummary
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import Frame
    from sawbench.commands.live_estimate import LiveCuttingEstimate
    from sawbench.commands.recording_session import SessionOptions
    from sawbench.modeling.recursive import LiveEstimate
    from sawbench.visualization.live_process import LiveViewProcess

# What Windows refuses: recordings are passed on. A colon would put the samples where no folder shows them.
_NOT_IN_FILE_NAMES: Final = frozenset('<>:"|?*\\')
# A file name has 255 bytes at most; what is written beside a recording adds to its name.
_LONGEST_NAME_BYTES: Final = 200


@click.command(
    name="record",
    epilog="Example: sawbench record --material oak --thickness 20 --feed 4 --seconds 10 --simulated --live",
)
@click.option("--material", required=True, help="Workpiece material; 'none' for an idle run.")
@click.option("--trial", "trial_id", help="Identifier and file name; default: material and the next free number.")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), help="Duration; default: the configuration's.")
@click.option("--until-stopped", is_flag=True, help="Record until Ctrl-C.")
@click.option(
    "--touch",
    "touch_n",
    type=click.FloatRange(0, min_open=True),
    metavar="N",
    help="Start when the blade touches the workpiece: when the force exceeds this, N.",
)
@click.option(
    "--before",
    "before_s",
    type=click.FloatRange(0, 60),
    help="With --touch: seconds before the contact that are kept; default 3.",
)
@setting_options
@click.option("--operator", help="Name of the operator.")
@click.option("--repetition", type=click.IntRange(1))
@click.option("--note", "note_texts", multiple=True, help="Note stored with the trial; may be repeated.")
@click.option("--out", "directory", type=click.Path(path_type=Path, file_okay=False), help="Folder for the file.")
@bench_config_option
@click.option("--live", is_flag=True, help="Show the signals in Rerun while recording.")
@click.option(
    "--rrd", "rrd_path", type=click.Path(path_type=Path, dir_okay=False), help="Save the live view to this file."
)
@click.option("--simulated", is_flag=True, help="Record from the simulated bench instead of real instruments.")
@click.option("--seed", default=0, show_default=True, help="Seed of the simulated bench.")
@force_option
@json_option
def command(
    material: str,
    trial_id: str | None,
    seconds: float | None,
    until_stopped: bool,
    touch_n: float | None,
    before_s: float | None,
    duty: float | None,
    thickness_mm: float | None,
    feed_mm_s: float | None,
    blade: str | None,
    battery: str | None,
    operator: str | None,
    repetition: int | None,
    note_texts: tuple[str, ...],
    directory: Path | None,
    config_path: Path | None,
    live: bool,
    rrd_path: Path | None,
    simulated: bool,
    seed: int,
    force: bool,
    as_json: bool,
) -> int:
    """Record one trial. Lines typed during the recording are stored as notes; Ctrl-C ends the recording."""
    from sawbench.commands.recording_session import SessionOptions, check_devices, ports_of_trial

    if until_stopped and seconds is not None:
        raise click.UsageError("--until-stopped and --seconds exclude each other: leave out one of them")
    config_path = config_path or default_config_path()
    loaded = config_for(None, config_path)
    settings = loaded.config.recording
    path = recording_path(directory or Path(settings.directory), trial_id, material)
    touch = touch_of(touch_n, before_s)
    check_devices(loaded)
    refuse_unwritable(path, force=force, makes_folder=True)
    duty = loaded.config.converter.default_duty if duty is None else duty
    trial = Trial(
        trial_id=path.stem, material=material, duty=duty, thickness_mm=thickness_mm, feed_mm_s=feed_mm_s, blade=blade,
        battery=battery, operator=operator, notes="\n".join(note_texts), repetition=repetition,
        source="simulated bench" if simulated else "bench",
    )  # fmt: skip
    bench = ports_of_trial(config_path, trial, path.parent, simulated=simulated, seed=seed)
    book_path = calibration_book_path(config_path, simulated=simulated)
    options = SessionOptions(
        path=path, trial=trial, seconds=None if until_stopped else seconds or settings.seconds, overwrite=force,
        calibration_book=book_path, touch=touch,
    )  # fmt: skip
    say_in_force(loaded, book_path)
    if touch is not None:
        click.echo(f"the recording starts when {touch.channel} exceeds {touch.above:g}: waiting", err=True)
    typed = typed_lines()
    lines = typed if typed is not None else sys.stdin if sys.stdin is not None and sys.stdin.isatty() else ()
    with live_view(trial, loaded.config.frame, live=live, rrd_path=rrd_path, force=force) as views:
        summary, estimate = run_session(loaded, options, bench, views, iter(lines), typed)
    found = {"path": path, **summary_rows(summary), "live_estimate": live_rows(estimate)}
    emit(found, "\n".join([str(path), describe(summary), *said_live(estimate)]), as_json=as_json)
    return 1 if summary.losses or not summary.is_complete else 0


def said_live(estimate: LiveCuttingEstimate) -> list[str]:
    """What the live estimate found last, or why there is none, and its notes."""
    last = estimate.describe()
    said = f"last live estimate: {last}" if last else f"no live k_Fc: {estimate.problem or 'no steady stroke'}"
    return [said, *(f"  note: {text}" for text in estimate.notes)]


def touch_of(touch_n: float | None, before_s: float | None) -> Touch | None:
    """When the recording begins, from `--touch` and `--before`; None: at once."""
    from sawbench.acquisition.pre_trigger import Touch

    if touch_n is None:
        if before_s is not None:
            raise click.UsageError("--before needs --touch N")
        return None
    return Touch(above=touch_n) if before_s is None else Touch(above=touch_n, before_s=before_s)


def recording_path(folder: Path, trial_id: str | None, material: str) -> Path:
    """File of a trial; without an identifier the next free one of its material.

    Raises
    ------
    InputError
        If the material is blank, or the name cannot be that of a file, here or on another system.
    """
    if not material.strip():
        raise InputError("the material is empty", remedy="name it with --material; 'none' is an idle run")
    name = trial_id or f"{material}-NN"
    if name != Path(name).name or name == ".." or not name.isprintable() or set(name) & _NOT_IN_FILE_NAMES:
        raise InputError(
            f"{name!r} is not a valid trial name: it is also the file name",
            remedy="give --trial a name without slashes and the folder with --out; control characters and "
            f"{' '.join(sorted(_NOT_IN_FILE_NAMES))} are not allowed either",
        )
    n_bytes = len(name.encode())
    if n_bytes > _LONGEST_NAME_BYTES:
        raise InputError(
            f"the trial name has {n_bytes} bytes, a file name may have {_LONGEST_NAME_BYTES}: {name[:20]!r}...",
            remedy="give --trial a shorter name, and put the rest into --note",
        )
    return folder / f"{trial_id or next_trial_id(folder, material)}.mcap"


def run_session(
    loaded: LoadedConfig,
    options: SessionOptions,
    bench: contextlib.AbstractContextManager[dict[str, str]],
    views: list[LiveViewProcess],
    lines: Iterator[str],
    typed: TypedLines | None = None,
) -> tuple[RecordingSummary, LiveCuttingEstimate]:
    """Record with estimate and counters on the terminal, and in the panel where it was started there.

    Parameters
    ----------
    loaded : LoadedConfig
    options : SessionOptions
    bench : context manager
        Gives the addresses of the instruments, device name -> port, where they are not the configured ones.
    views : list of LiveViewProcess
    lines : iterator of str
        What is typed meanwhile: notes.
    typed : TypedLines, optional
        The terminal that gives the lines.
    """
    from sawbench.commands.live_counters import LiveCounters
    from sawbench.commands.recording_session import NoteBook, record_trial

    notes, link = NoteBook(), current_link()
    estimate = live_estimate(loaded, options.trial, views)
    with contextlib.ExitStack() as stack:
        if link is not None:
            link.raise_if_stopped()
            link.phase("opening the instruments …")
            lines = stack.enter_context(link.notes())
        notes.listen(lines)
        counters = stack.enter_context(
            LiveCounters(estimate, trial_id=options.trial.trial_id, seconds=options.seconds, typed=typed)
        )
        endpoints = stack.enter_context(bench)

        def show(status: RecordingStatus) -> None:
            counters(status)
            if link is not None:
                link.status(status, options.seconds, estimate)

        summary = record_trial(
            loaded,
            replace(options, endpoints=endpoints),
            observers=[*views, estimate, *([link.signals] if link is not None else [])],
            status=show,
            notes=notes,
            stop=None if link is None else link.stop,
        )
    if link is not None:
        link.stop.clear()
        link.phase("recorded")
    return summary, estimate


def say_in_force(loaded: LoadedConfig, book_path: Path) -> None:
    """Tell the operator which tares and calibrations go into the recording, how old they are, and what has none."""
    from datetime import UTC, datetime

    from sawbench.acquisition.calibration_book import build_calibrated, not_in_book, read_book, said_in_force

    book = read_book(book_path)
    _, configured = build_calibrated(loaded.config, book)
    for line in said_in_force(book, configured, datetime.now(UTC)):
        click.echo(line, err=True)
    for _, channel, what in not_in_book(book, configured, loaded.config.known_channels, book_path):
        click.echo(f"{channel}: {what}", err=True)


def next_trial_id(folder: Path, material: str) -> str:
    """Material and the lowest number that no file of the folder has, finished or not."""
    number = 1
    while any((folder / f"{material}-{number:02d}{ending}").exists() for ending in (".mcap", ".mcap.part")):
        number += 1
    return f"{material}-{number:02d}"


@contextlib.contextmanager
def live_view(
    trial: Trial, frame: Frame = "crank", *, live: bool, rrd_path: Path | None, force: bool
) -> Iterator[list[LiveViewProcess]]:
    """Give the observers that `--live` and `--rrd` ask for; trouble with them is said, never raised."""
    if not live and rrd_path is None:
        yield []
        return
    from sawbench.visualization.live_process import LiveViewProcess

    view = LiveViewProcess(
        trial,
        show="spawn" if live else "none",
        save_path=rrd_path,
        overwrite=force,
        frame=frame,
        has_estimate=frame == "crank" and not trial.is_idle,
    )
    try:
        yield [view]
    finally:
        view.close()
        if view.is_dead:
            click.echo(f"the live view ended early: {view.dead_reason} (the recording does not need it)", err=True)
        elif view.n_dropped:
            left_out = f"the live view could not keep up and left out {view.n_dropped} blocks"
            click.echo(f"{left_out} (the recording has them all)", err=True)


def live_estimate(loaded: LoadedConfig, trial: Trial, views: list[LiveViewProcess]) -> LiveCuttingEstimate:
    """Give the observer that estimates k_Fc once a stroke and shows it in the live views."""
    from sawbench.commands.live_estimate import LiveCuttingEstimate

    def show(time_s: float, found: LiveEstimate) -> None:
        for view in views:
            view.cutting_estimate(
                time_s, found.k_fc_n_s_per_m, found.std_n_s_per_m, found.remaining_s, found.remaining_std_s
            )

    return LiveCuttingEstimate(loaded, trial, show=show)


def summary_rows(summary: RecordingSummary) -> dict[str, Any]:
    """The summary as plain values, for JSON."""
    return {
        "started_at": summary.started_at,
        "duration_s": summary.duration_s,
        "end_reason": summary.end_reason,
        "is_complete": summary.is_complete,
        "losses": summary.losses,
        "channels": summary.channels,
        "devices": summary.devices,
    }


def live_rows(estimate: LiveCuttingEstimate) -> dict[str, Any]:
    """The last live estimate as plain values, for JSON."""
    from sawbench.plain import plain

    return {
        **(plain(estimate.latest) or {}),
        "n_changes_of_material": estimate.n_changes,
        "problem": estimate.problem,
    }


def describe(summary: RecordingSummary) -> str:
    """The summary in words."""
    from sawbench.commands.terminal import table

    rows = [
        [c.channel, str(c.n_samples), f"{c.rate_hz:.2f}", str(c.n_gaps), str(c.n_missing)] for c in summary.channels
    ]
    lines = [f"samples until {summary.duration_s:.3f} s; end of recording:  {summary.end_reason}"]
    lines.append(table(["channel", "samples", "rate Hz", "gaps", "missing"], rows))
    lines += [
        f"{d.device}: {d.n_discarded_bytes} damaged bytes, {d.n_reconnects} reconnects"
        for d in summary.devices
        if d.n_discarded_bytes or d.n_reconnects
    ]
    lines += [f"NOT reliable: {loss}" for loss in summary.losses]
    if not summary.is_complete:
        lines.append("INCOMPLETE: an instrument was lost, or the recording was interrupted")
    return "\n".join(lines)
