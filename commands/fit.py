"""`sawbench fit`: the cutting coefficient k_Fc with its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.commands.failures import Failures
from sawbench.commands.options import config_option, json_option, recordings_argument
from sawbench.commands.terminal import emit, progress, table
from sawbench.inputs import find_recordings
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.modeling.results import CuttingFit

METHODS = ("current_and_force", "current", "force", "annealing")


@click.command(name="fit", epilog="Example: sawbench fit recordings/oak-01.mcap --method current")
@recordings_argument
@config_option
@click.option(
    "--method", type=click.Choice(METHODS),
    help="Default: every channel there is. 'annealing' is the paper's search, kept for comparison.",
)  # fmt: skip
@json_option
def command(paths: tuple[Path, ...], config_path: Path | None, method: Any, as_json: bool) -> int:
    """Fit the linear cutting coefficient of each trial."""
    from sawbench.analysis import fit_trial, load_and_process

    files = find_recordings(paths)
    fits: list[tuple[str, CuttingFit]] = []
    failures = Failures(len(files))
    for path in progress(files, "fitting"):
        with failures.collected():
            trial = load_and_process(path, config_path)
            if len(files) > 1 and trial.recording.trial.is_idle:
                click.echo(f"{path}: the blade runs in air, so there is no k_Fc", err=True)
                continue
            fits.append((trial.recording.trial.trial_id, fit_trial(trial, method)[0]))
    emit([{"trial": name, **plain(fit)} for name, fit in fits], describe(fits), as_json=as_json)
    return failures.exit_code(is_trusted=all(fit.status == "ok" for _, fit in fits))


def describe(fits: list[tuple[str, CuttingFit]]) -> str:
    """One row a trial, then the remarks."""
    from sawbench.reporting.quantities import format_quantity

    rows = [
        [
            name,
            format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m"),
            f"{fit.statistical_std_n_s_per_m:.2g}",
            fit.method,
            "-" if fit.rmse_a is None else f"{fit.rmse_a:.3f} A",
            "-" if fit.rmse_n is None else f"{fit.rmse_n:.2f} N",
            fit.status,
        ]
        for name, fit in fits
    ]
    remarks = [f"{name}: {text}" for name, fit in fits for text in (fit.identifiability, *fit.notes) if text]
    return "\n".join(
        [table(["trial", "k_Fc", "statistical part", "method", "RMSE current", "RMSE force", "status"], rows), *remarks]
    )
