"""`sawbench fit`: the cutting coefficient k_Fc with its uncertainty."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.commands.batch import Batch, batch_options, named_config
from sawbench.commands.failures import Failures
from sawbench.commands.options import config_option, json_option, places_argument
from sawbench.commands.terminal import emit, table
from sawbench.inputs import find_files
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.modeling.results import CuttingFit
    from sawbench.storage.places import Place

METHODS = ("current_and_force", "current", "force")


@click.command(name="fit", epilog="Example: sawbench fit recordings/oak-01.mcap --method current")
@places_argument
@config_option
@click.option("--method", type=click.Choice(METHODS), help="Default: all available channels.")
@batch_options()
@json_option
def command(paths: tuple[Place, ...], config_path: Path | None, method: Any, batch: Batch, as_json: bool) -> int:
    """Fit the linear cutting coefficient of each trial."""
    from sawbench.archive.files import fit_file

    if method is not None and batch.archive is not None:
        raise click.UsageError("an archive stores the fit with all available channels: leave out --method")
    files = find_files(paths)
    failures, config = Failures(len(files)), named_config(config_path)
    if batch.archive is None:
        work = partial(fit_file, config=config, method=method, skips_idle=len(files) > 1)
        places = [file.place for file in files]
        found = [(places[k], *fitted) for k, fitted in sorted(batch.each(places, work, failures, "fitting"))]
    else:
        from sawbench.archive.trials import fit_or_reason

        found = []
        for trial in batch.kept(files, config, failures, "fitting"):
            with failures.collected():
                found.append((trial.processed.source_path, trial.processed.trial.trial_id, fit_or_reason(trial)))
    for place, _, fit in found:
        if fit is None:
            click.echo(f"{place}: idle run, so there is no k_Fc", err=True)
    fits = [(name, fit) for _, name, fit in found if fit is not None]
    emit([{"trial": name, **plain(fit.in_outline)} for name, fit in fits], describe(fits), as_json=as_json)
    return failures.exit_code(is_trusted=all(fit.status == "ok" for _, fit in fits))


def describe(fits: list[tuple[str, CuttingFit]]) -> str:
    """One row per trial, then the remarks."""
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
