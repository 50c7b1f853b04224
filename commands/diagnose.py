"""`sawbench diagnose`: the sim-to-real gap of a campaign."""

from __future__ import annotations

import importlib
import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import SawbenchError
from sawbench.bench.second_core import on_two_cores, second_core
from sawbench.commands.batch import Batch, batch_options
from sawbench.commands.failures import Failures
from sawbench.commands.options import (
    config_option,
    force_option,
    json_option,
    refuse_unwritable,
    refuse_unwritable_folder,
)
from sawbench.commands.terminal import emit, stepper, table
from sawbench.inputs import default_config_file, find_recordings, without_own_files
from sawbench.storage.digest import sha256_of
from sawbench.storage.places import AMENDMENTS

if TYPE_CHECKING:
    from sawbench.archive.journal import Piece

RESULTS: Final = ("gap_report.json", "gap_report.html", "improved_model.toml", "plan.csv")
_NEEDED: Final = (
    "sawbench.diagnosis.answer.gap_report", "sawbench.processing.process", "sawbench.reporting.gap_page",
    "matplotlib.figure", "scipy.fft", "scipy.interpolate", "scipy.ndimage",
)  # fmt: skip
# Share of the progress bar, of 100, at which everything is read and at which the page is drawn.
_OPENED, _DRAWING = 10, 95


@click.command(
    name="diagnose",
    epilog="Example: sawbench diagnose recordings/campaign --config bench_config.toml --out gap",
)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@config_option
@click.option("--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@click.option(
    "--until-closed", is_flag=True,
    help="Add causes to the model one by one until the error at withheld operating points no longer decreases.",
)  # fmt: skip
@click.option(
    "--plan", "n_planned", metavar="N", type=click.IntRange(1, 20), default=None,
    help="For saws: propose the N trials with the most information per recording time: OUT/plan.csv, for `series run`.",
)  # fmt: skip
@click.option(
    "--each", "is_each", is_flag=True,
    help="Every FILE... is a campaign of its own, with a folder of its own in OUT; a call that was broken off goes on.",
)  # fmt: skip
@batch_options(has_archive=False)
@force_option
@json_option
def command(
    paths: tuple[Path, ...], config_path: Path | None, out_dir: Path, until_closed: bool, n_planned: int | None,
    is_each: bool, batch: Batch, force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Say where the model misses the measurement, which unmodelled effect causes it, and how far it closes.

    The exit code is 1 where there is no answer, because recordings and configuration do not describe the same machine.
    """
    request = DiagnosisRequest(
        paths=paths, out_dir=out_dir, config_path=config_path, until_closed=until_closed, n_planned=n_planned or 0
    )
    if is_each:
        return _diagnose_each(request, batch, force=force, as_json=as_json)
    if batch != Batch():
        raise click.UsageError("--jobs, --scheduler and --retry are for many campaigns: add --each")
    for name in RESULTS:
        refuse_unwritable(out_dir / name, force=force, makes_folder=True)
    with second_core(), stepper("diagnosing:") as step:
        report = diagnosed(request, step)
    from sawbench.reporting.cause_words import improved_command

    improved_path, plan_path = out_dir / "improved_model.toml", out_dir / "plan.csv"
    lines = [_as_text(report), "", *(str(out_dir / name) for name in RESULTS[:2])]
    if report.get("improved_model"):
        lines.append(f"{improved_path}: use it, for example, with `{improved_command(report, str(improved_path))}`")
    if plan_path.exists():
        lines.append(f"{plan_path}: record it with `sawbench series run {plan_path}`")
    emit(report, "\n".join(lines), as_json=as_json)
    return 1 if report["detail"]["contradiction"] else 0


@dataclass(frozen=True, kw_only=True, slots=True)
class DiagnosisRequest:
    """One campaign and what is asked about it.

    Attributes
    ----------
    paths : tuple of Path
        Its recordings, or folders that hold them.
    out_dir : Path
    config_path : Path or None
    until_closed : bool
    n_planned : int
    """

    paths: tuple[Path, ...]
    out_dir: Path
    config_path: Path | None
    until_closed: bool
    n_planned: int

    def __str__(self) -> str:
        return ", ".join(map(str, self.paths))


def diagnosed(
    request: DiagnosisRequest, on_step: Callable[[int, int, str], None] = lambda done, total, what: None
) -> dict[str, Any]:
    """Diagnose one campaign and write its results; return the report.

    Raises
    ------
    InputError
        If nothing can be diagnosed.
    """
    from sawbench.acquisition.series.rejected import uncounted
    from sawbench.analysis import open_trial
    from sawbench.gap import diagnose_trials
    from sawbench.results import GapReport

    on_step(0, 100, "reading")
    recordings = find_recordings(request.paths)
    readings = [partial(open_trial, path, request.config_path) for path in recordings]
    _, *trials = on_two_cores(operator.call, [_import, *readings])
    report = diagnose_trials(
        trials,
        until_closed=request.until_closed,
        plan=request.n_planned,
        on_step=lambda done, total, what: on_step(_OPENED + (_DRAWING - _OPENED) * done // total, 100, what),
    )
    report["warnings"] += uncounted(recordings)
    on_step(_DRAWING, 100, "writing the page")
    GapReport(report=report).save(request.out_dir, overwrite=True)
    return report


def _import() -> None:
    """Load what a diagnosis and its page need, while the other core begins to read: once, and not in either process."""
    for module in _NEEDED:
        importlib.import_module(module)


def _diagnose_each(request: DiagnosisRequest, batch: Batch, *, force: bool, as_json: bool) -> int:
    """Diagnose every campaign that the journal of the folder does not hold yet."""
    refuse_unwritable_folder(request.out_dir)
    from sawbench.reporting.cause_words import name_of
    from sawbench.reporting.quantities import format_share

    campaigns = without_own_files(request.paths)
    failures, rows = Failures(len(campaigns)), []
    pieces = [_piece(request, path) for path in campaigns]
    for row in batch.rows(pieces, diagnosed_row, request.out_dir, "diagnosing", overwrites=force):
        with failures.collected():
            rows.append({"campaign": row.name, **row.checked()})
    shown = [
        (row["campaign"], "no answer" if row["contradiction"] else row["verdict"].replace("_", " "),
         " + ".join(map(name_of, row["effects"])),
         format_share(row["probability"]),
         "-" if row["gap_closed"] is None else f"{round(100 * row['gap_closed'])} %")
        for row in rows
    ]  # fmt: skip
    text = table(("campaign", "verdict", "most probable cause", "probability", "gap closed"), shown)
    text += f"\n{len(rows)} of {len(pieces)} campaigns, each in a folder of its own in {request.out_dir}"
    emit(rows, text, as_json=as_json)
    return failures.exit_code(is_trusted=not any(row["contradiction"] for row in rows))


def diagnosed_row(request: DiagnosisRequest) -> dict[str, Any]:
    """Diagnose one campaign; return what a table says of it."""
    report = diagnosed(request)
    causes = [(c["probability"], c["effects"], c["gap_closed"]) for c in report["causes"]]
    causes += [(p, [name.replace("_", " ")], None) for name, p in report["probabilities"].items()]
    probability, effects, closed = max(causes, key=lambda cause: cause[0])
    return {
        "verdict": report["verdict"], "effects": effects, "probability": probability, "gap_closed": closed,
        "report": str(request.out_dir / RESULTS[0]), "contradiction": report["detail"]["contradiction"],
    }  # fmt: skip


def _piece(request: DiagnosisRequest, path: Path) -> Piece:
    """One of the campaigns as a piece of a batch; its key holds the bytes of its recordings and their amendments."""
    from sawbench.archive.journal import Piece, key_of
    from sawbench.bench.source_identity import source_fingerprint

    path = path.absolute()
    name = path.stem if path.is_file() else path.name
    config_path = None if request.config_path is None else request.config_path.absolute()
    out_dir = request.out_dir.absolute() / name
    try:
        recordings = find_recordings([path])
        beside = [place for file in recordings if (place := Path(f"{file}{AMENDMENTS}")).exists()]
        used = [*recordings, *beside, config_path or default_config_file()]
        hashes = [sha256_of(file) for file in used]
    except SawbenchError:
        hashes = []  # the diagnosis will say what is wrong with it
    return Piece(
        name=name,
        key=key_of(source_fingerprint(), hashes, request.until_closed, request.n_planned),
        target=out_dir,
        request=replace(request, paths=(path,), out_dir=out_dir, config_path=config_path),
    )


def _as_text(report: dict[str, Any]) -> str:
    from sawbench.reporting.cause_words import in_words_of, withheld_words
    from sawbench.reporting.gap_page import closest_description, known_effects, notes_of, verdict_sentence
    from sawbench.reporting.quantities import format_number

    gap = report["gap"]
    lines = [verdict_sentence(report), *closest_description(report), *known_effects(report), ""]
    lines += [table(("cause", "probability", "gap closed", "95 %"), _cause_rows(report))]
    if "until_closed" in report:
        lines += ["", *_closing_lines(report)]
    rungs = ("nominal", "retuned", "with_effect", "noise_floor")
    rows = [
        (f"{name} / {row['unit']}", *(format_number(row[key], digits=3) for key in rungs))
        for name, row in gap["by_channel"].items()
    ]
    rows.append(("all / noise", *(format_number(gap[key], digits=3) for key in rungs)))
    lines += ["", f"RMSE {withheld_words(report)}", table(("", *(r.replace("_", " ") for r in rungs)), rows)]
    if "runtime_s" in gap:
        times = ", ".join(f"{name.replace('_', ' ')} {seconds:.0f} s" for name, seconds in gap["runtime_s"].items())
        lines += ["", f"battery runtime: {times}"]
    lines += ["", *(f"note: {text}" for text in notes_of(report))]
    lines.append(f"next trial: {report['next_trial']}")
    text = "\n".join([*lines, *(["", *_plan_lines(report)] if "plan" in report else [])])
    return in_words_of(report, text)


def _cause_rows(report: dict[str, Any]) -> list[tuple[str, ...]]:
    from sawbench.reporting.cause_words import in_words_of, interval_words, name_of
    from sawbench.reporting.quantities import format_share

    rows = []
    for cause in report["causes"]:
        names = in_words_of(report, " + ".join(map(name_of, cause["effects"])))
        closed, interval = f"{round(100 * cause['gap_closed'])} %", interval_words(cause["gap_closed_ci95"])
        rows.append((names, format_share(cause["probability"]), closed, interval))
    others = sorted(report["probabilities"].items(), key=lambda item: -item[1])
    return [*rows, *((name.replace("_", " "), format_share(p), "", "") for name, p in others)]


def _closing_lines(report: dict[str, Any]) -> list[str]:
    """Lay out the ladder of causes, from the model as configured to the noise."""
    from sawbench.reporting.cause_words import in_words_of
    from sawbench.reporting.closing import closing_rows, closing_sentences

    closing = report["until_closed"]
    keys = ("model", "probability", "magnitude", "rms", "closed", "interval")
    head = ("causes one by one, residual / noise", "probability", "magnitude", "rms", "closed so far", "95 %")
    return [
        table(head, [[in_words_of(report, row[key]) for key in keys] for row in closing_rows(closing)]),
        *closing_sentences(closing),
    ]


def _plan_lines(report: dict[str, Any]) -> list[str]:
    """Lay out the proposed trials, in their order."""
    from sawbench.reporting.trial_plan import PLAN_COLUMNS, plan_rows, plan_sentences

    rows = [[row[key] for key, _ in PLAN_COLUMNS] for row in plan_rows(report["plan"])]
    shown = [table([words for _, words in PLAN_COLUMNS], rows)] if rows else []
    return [*shown, *plan_sentences(report["plan"], report["next_trial"])]
