"""`sawbench series plan | run | status | repeat`: a series of trials instead of single ones."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import InputError
from sawbench.commands.options import (
    bench_config_option,
    calibration_book_path,
    force_option,
    json_option,
    plan_config_option,
    refuse_unwritable,
)
from sawbench.commands.terminal import emit, table
from sawbench.inputs import config_for, default_config_path

if TYPE_CHECKING:
    from sawbench.acquisition.series.plan import LoadedPlan, SeriesPlan
    from sawbench.acquisition.series.progress import SeriesProgress, TrialProgress
    from sawbench.bench.config import LoadedConfig

_EXAMPLE: Final = "Example: sawbench series run wood.toml --operator Kim"
_plan_argument = click.argument("plan_path", metavar="PLAN", type=click.Path(path_type=Path, dir_okay=False))


@click.group(name="series", epilog=_EXAMPLE)
def command() -> None:
    """Plan a series of trials, be led through it, go on after a break: plan, run, status, repeat."""


@command.command(
    name="plan",
    epilog="Example: sawbench series plan --material oak --material nylon --feed 2 --feed 4 --seed 7 --out wood.toml",
)
@click.option("--material", "materials", multiple=True, required=True, help="Workpiece material; may be repeated.")
@click.option(
    "--duty", "duties", multiple=True, type=click.FloatRange(0, 1, min_open=True), help="PWM duty; may be repeated."
)
@click.option("--feed", "feeds_mm_s", multiple=True, type=click.FloatRange(0), help="Feed, mm/s; may be repeated.")
@click.option("--thickness", "thicknesses_mm", multiple=True, type=click.FloatRange(0, min_open=True), help="mm")
@click.option(
    "--repetitions",
    type=click.IntRange(1),
    default=3,
    show_default=True,
    help="Number of repetitions of every setting.",
)
@click.option(
    "--block", type=click.Choice(["setting", "repetition"]), default="setting", show_default=True,
    help="A block is one setting with all its repetitions (as in the paper), or every setting once.",
)  # fmt: skip
@click.option("--idle", "has_idle", is_flag=True, help="Start with an idle run at each duty.")
@click.option("--seed", default=0, show_default=True, help="Seed of the random order.")
@click.option("--seconds", type=click.FloatRange(0.5), default=10.0, show_default=True, help="Of one trial.")
@click.option(
    "--battery-seconds", type=click.FloatRange(1), default=600.0, show_default=True, help="Change a battery before."
)
@click.option("--batch", "batch_texts", metavar="MATERIAL=BATCH", multiple=True, help="Batch of a material.")
@click.option("--operator", help="Name of the operator; may be given to `run` instead.")
@click.option(
    "--require", "required", multiple=True, type=click.Choice(["operator", "blade", "battery", "material", "batch"]),
    default=["operator", "blade", "battery", "material"], show_default=True, help="Required metadata.",
)  # fmt: skip
@click.option("--recordings", help="Folder of the recordings, relative to the plan; default: its name.")
@click.option("--out", "out_path", required=True, type=click.Path(path_type=Path, dir_okay=False), help="The plan.")
@bench_config_option
@force_option
@json_option
def plan_command(out_path: Path, config_path: Path | None, force: bool, as_json: bool, **options: Any) -> int:
    """Write a plan: materials x duties x feeds x thicknesses x repetitions, in random order within blocks.

    The plan is a text file with one line per trial: read it, edit it, then `sawbench series run` it.
    """
    from sawbench.acquisition.series.plan import departures, load_plan
    from sawbench.acquisition.series.plan_design import SeriesDesign, designed_plan, plan_text
    from sawbench.storage.output import write_whole

    if out_path.suffix.lower() == ".csv":
        raise InputError("--out is a table, the plan is TOML", where=out_path, remedy="give a .toml file")
    refuse_unwritable(out_path, force=force)
    batches = dict(_batch(text, options["materials"]) for text in options.pop("batch_texts"))
    stated = {key: options.pop(key) for key in ("operator", "required", "recordings")}
    design = SeriesDesign(batches=batches, **options)
    config = None if config_path is None else os.path.relpath(config_path, out_path.parent)
    plan = designed_plan(design, config=config, **stated)
    write_whole(out_path, plan_text(plan), overwrite=force)
    loaded = load_plan(out_path)
    said = [*(f"note: {text}" for text in departures(plan)), *_extent(plan), str(out_path)]
    emit(
        {"plan": out_path, "trials": [trial.model_dump() for trial in loaded.plan.trial]},
        "\n".join(said),
        as_json=as_json,
    )
    return 0


@command.command(name="run", epilog="Example: sawbench series run wood.toml --operator Kim")
@_plan_argument
@click.option("--operator", help="Name of the operator; default: that of the plan.")
@plan_config_option
@click.option("--live", is_flag=True, help="Show the signals in Rerun while recording.")
@click.option("--simulated", is_flag=True, help="Record from the simulated bench instead of real instruments.")
@click.option("--yes", "is_unattended", is_flag=True, help="Ask no questions; with --simulated only.")
@json_option
def run_command(
    plan_path: Path,
    operator: str | None,
    config_path: Path | None,
    live: bool,
    simulated: bool,
    is_unattended: bool,
    as_json: bool,
) -> int:
    """Lead through the trials of PLAN that are not kept yet: what to mount, clamp and set, tare, check, record, judge.

    A line that begins with `n ` is a note. `q` or Ctrl-C ends the sitting; the same command continues with it, after a
    crash and on another day too. PLAN is what `series plan` wrote, or a table (CSV) with a row for each trial. The exit
    code is 1 where a trial was kept although something is wrong with it.
    """
    from sawbench.acquisition.series.journal import Journal
    from sawbench.acquisition.series.plan import load_plan
    from sawbench.acquisition.series.progress import progress_of
    from sawbench.commands.recording_session import check_devices
    from sawbench.commands.series_dialogue import SeriesStopped
    from sawbench.commands.series_run import Bench, SeriesRun

    plan = load_plan(plan_path)
    _refuse_missing_metadata(plan, operator)
    loaded = _config_of(plan, config_path)
    check_devices(loaded)
    refuse_unwritable(plan.folder / "x.mcap", force=True, makes_folder=True)
    bench = Bench(
        loaded=loaded,
        config_path=Path(loaded.path),
        book=calibration_book_path(Path(loaded.path), simulated=simulated),
        operator=operator or plan.plan.operator,
        simulated=simulated,
        live=live,
    )
    dialogue = _dialogue(is_unattended=is_unattended, simulated=simulated)
    journal = Journal(plan.folder)
    with journal.held():
        try:
            SeriesRun(plan, bench, dialogue).run()
        except (SeriesStopped, KeyboardInterrupt) as stopped:
            journal.add("stopped", because=str(stopped) or "Ctrl-C")
            click.echo(f"\nstopped; continue with: sawbench series run {plan_path}", err=True)
            if isinstance(stopped, KeyboardInterrupt):
                raise
    progress = progress_of(plan, journal.read())
    emit(status_rows(progress), describe(progress), as_json=as_json)
    return 1 if progress.doubtful else 0


@command.command(name="status", epilog="Example: sawbench series status wood.toml")
@_plan_argument
@json_option
def status_command(plan_path: Path, as_json: bool) -> int:
    """Show how far a series is: every trial with its result, wear of the blades, what comes next."""
    from sawbench.acquisition.series.journal import Journal
    from sawbench.acquisition.series.plan import load_plan
    from sawbench.acquisition.series.progress import progress_of

    plan = load_plan(plan_path)
    progress = progress_of(plan, Journal(plan.folder).read())
    emit(status_rows(progress), describe(progress), as_json=as_json)
    return 0


@command.command(name="repeat", epilog="Example: sawbench series repeat wood.toml 05-oak --because 'clamp was loose'")
@_plan_argument
@click.argument("trial_id", metavar="TRIAL")
@click.option("--because", required=True, help="Reason, stored in the journal.")
@plan_config_option
def repeat_command(plan_path: Path, trial_id: str, because: str, config_path: Path | None) -> int:
    """Reject the recording of TRIAL, kept or not; `series run` records it again. The file is moved, not deleted."""
    from sawbench.acquisition.series.journal import Journal
    from sawbench.acquisition.series.plan import load_plan
    from sawbench.acquisition.series.progress import progress_of
    from sawbench.commands.series_run import set_aside

    plan = load_plan(plan_path)
    planned, journal = plan.trial(trial_id), Journal(plan.folder)
    second_copy = _config_of(plan, config_path).config.recording.second_copy
    with journal.held():
        row = next(t for t in progress_of(plan, journal.read()).trials if t.planned == planned)
        if not row.path.exists():
            raise InputError(
                f"trial {trial_id} has no recording yet", where=plan_path, remedy="continue with `series run`"
            )
        click.echo(f"moved to {set_aside(journal, row, because=because, second_copy=second_copy)}")
    return 0


def describe(progress: SeriesProgress) -> str:
    """A table with a line for each trial, then wear, rejected recordings and what comes next."""
    from sawbench.acquisition.series.plan import departures
    from sawbench.acquisition.series.verdict import blade_growth

    headers = ("trial", "block", "duty", "feed", "thick", "rep", "blade", "state", "Hz", "peak N", "k_Fc")
    lines = [table(headers, [_row(progress, row) for row in progress.trials]), ""]
    blades = dict.fromkeys(measures.blade for measures in progress.kept if measures.blade)
    for growth in (blade_growth(progress.kept, blade) for blade in blades):
        lines += [] if growth is None else [f"{growth.words} (limit {progress.plan.blade_growth_limit:.0%})"]
    for row in progress.trials:
        faults = () if row.measures is None else row.measures.faults
        lines += [f"{row.planned.id} BAD: {text}" for text in (*faults, *row.disagrees)]
        lines += [f"{row.planned.id} rejected: {because}" for because in row.rejected]
        lines += [f"{row.planned.id} note: {text}" for text in row.notes]
    lines += [f"{name} does not belong to a trial of the plan" for name in progress.strangers]
    lines += [f"note: {text}" for text in departures(progress.plan)]
    n_kept = sum(row.state == "kept" for row in progress.trials)
    following = progress.next
    lines.append(
        f"{n_kept} of {len(progress.trials)} trials kept"
        + (f", {len(progress.doubtful)} of them not reliable" if progress.doubtful else "")
        + ("" if following is None else f"; next: {following.planned.id} ({following.state})")
    )
    return "\n".join(lines)


def status_rows(progress: SeriesProgress) -> dict[str, Any]:
    """The same as plain values."""
    trials = [
        {
            **row.planned.model_dump(),
            "state": row.state,
            "path": row.path,
            "measures": row.measures,
            "disagrees": row.disagrees,
            "rejected": row.rejected,
            "notes": row.notes,
        }
        for row in progress.trials
    ]
    following = progress.next
    return {
        "n_trials": len(trials),
        "n_kept": len(progress.kept),
        "next": None if following is None else following.planned.id,
        "trials": trials,
        "strangers": progress.strangers,
    }


def _row(progress: SeriesProgress, row: TrialProgress) -> list[str]:
    planned, measures = row.planned, row.measures
    blade = (measures.blade if measures is not None else None) or (
        None if planned.blade is None else progress.identity("blade", planned.blade) or planned.blade
    )
    numbers = (
        (planned.duty, "{:.4g}"),
        (planned.feed_mm_s, "{:g}"),
        (planned.thickness_mm, "{:g}"),
        (planned.repetition, "{:d}"),
        (blade, "{}"),
        (row.state, "{}"),
        (None if measures is None else measures.stroke_rate_hz, "{:.2f}"),
        (None if measures is None else measures.peak_force_n, "{:.0f}"),
        (None if measures is None else measures.k_fc_n_s_per_m, "{:.1f}"),
    )
    return [planned.id, str(planned.block), *("-" if value is None else form.format(value) for value, form in numbers)]


def _dialogue(*, is_unattended: bool, simulated: bool) -> Any:
    from sawbench.commands.link import current_link
    from sawbench.commands.series_dialogue import Dialogue, PanelDialogue
    from sawbench.commands.typed_lines import typed_lines

    link = current_link()
    if link is not None:
        return PanelDialogue(link)
    if is_unattended:
        if not simulated:
            raise InputError(
                "--yes asks no questions, but an operator has to clamp the workpiece and switch the tool on",
                remedy="leave out --yes, or record from the simulated bench with --simulated",
            )
        return Dialogue(None)
    if sys.stdin is None:
        raise InputError("there is no standard input to read answers from", remedy="run it in a terminal")
    typed = typed_lines()
    return Dialogue(sys.stdin if typed is None else typed, is_typed=sys.stdin.isatty())


def _config_of(plan: LoadedPlan, config_path: Path | None) -> LoadedConfig:
    """Return the configuration that is asked for, else that of the plan, else the usual one."""
    return config_for(None, config_path or plan.config_path or default_config_path())


def _refuse_missing_metadata(plan: LoadedPlan, operator: str | None) -> None:
    from sawbench.acquisition.series.plan import missing_metadata

    if missing := missing_metadata(plan.plan, operator):
        raise InputError(
            f"required metadata is missing: {missing}",
            where=plan.path,
            remedy="state them in the plan, the operator with --operator",
        )


def _batch(text: str, materials: tuple[str, ...]) -> tuple[str, str]:
    material, _, lot = text.partition("=")
    if material not in materials or not lot:
        raise InputError(
            f"--batch is {text!r}, expected MATERIAL=BATCH", remedy=f"materials are {', '.join(materials)}"
        )
    return material, lot


def _extent(plan: SeriesPlan) -> list[str]:
    """Say how much work a plan is."""
    seconds = sum(trial.seconds or plan.seconds or 0.0 for trial in plan.trial)
    counts = [
        f"{words}: {len({getattr(trial, name) for trial in plan.trial})}"
        for name, words in (("setting", "settings"), ("blade", "blades"), ("battery", "batteries"))
    ]
    return [f"trials: {len(plan.trial)}, {', '.join(counts)}; {seconds / 60:.1f} min of recording"]
