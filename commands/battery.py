"""`sawbench battery fit`: measured discharges to a `[battery]` table with its uncertainty and range."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.bench.errors import InputError
from sawbench.commands.options import force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit, stepper, table

if TYPE_CHECKING:
    from sawbench.batteries import FittedBattery
    from sawbench.modeling.battery_fit import BatteryModel

VARIANTS = ("eq16", "eq16_free", "eq16_free_r", "eq16_end", "eq16_end_r", "ocv_r")


@click.group(
    name="battery",
    epilog="Example: sawbench battery fit rate-*.csv --config bench_config.toml --out fitted_bench.toml",
)
def command() -> None:
    """Batteries: fit their model to measured discharges."""


@command.command(
    name="fit", epilog="Example: sawbench battery fit cells.mat --map runs.toml --series 5 --out battery.toml"
)
@click.argument("paths", metavar="TABLE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--map", "map_path", type=click.Path(path_type=Path, dir_okay=False),
    help="TOML that assigns the columns (docs/battery.md); default: column names of common battery testers.",
)  # fmt: skip
@click.option(
    "--out", "out_path", required=True, type=click.Path(path_type=Path, dir_okay=False),
    help="TOML with the [battery] table; a page with the curves is written to the same folder.",
)  # fmt: skip
@click.option(
    "--config", "config_path", type=click.Path(path_type=Path, dir_okay=False),
    help="Bench configuration: --out is then a copy of it with the new [battery]; cutoff_soc is kept.",
)  # fmt: skip
@click.option("--series", type=click.IntRange(1), default=1, help="Measured cells in series in the battery.")
@click.option("--parallel", type=click.IntRange(1), default=1, help="Measured cells in parallel in the battery.")
@click.option("--temperature", "temperature_c", type=float, help="Ambient temperature, degC, if no column contains it.")
@click.option(
    "--cutoff-voltage", "cutoff_voltage_v", type=click.FloatRange(0, min_open=True),
    help="Cut-off voltage of the battery, V; default: the highest voltage that all discharges reach.",
)  # fmt: skip
@click.option(
    "--cutoff-soc", type=click.FloatRange(0, 1, min_open=True, max_open=True),
    help="Cut-off state of charge of the tool; default: that of --config, else only the voltage ends a run.",
)  # fmt: skip
@click.option(
    "--variant",
    type=click.Choice(VARIANTS),
    help="Use this model; default: the model with the smallest error of withheld runtimes.",
)
@click.option(
    "--most-miss", type=click.FloatRange(0, 1, min_open=True), default=0.05, show_default=True,
    help="Reject a model whose relative runtime error for a fitted discharge exceeds this.",
)  # fmt: skip
@force_option
@json_option
# click hands over every option by its name: as many parameters as options.
def fit(
    paths: tuple[Path, ...],
    map_path: Path | None,
    out_path: Path,
    config_path: Path | None,
    series: int,
    parallel: int,
    temperature_c: float | None,
    cutoff_voltage_v: float | None,
    cutoff_soc: float | None,
    variant: BatteryModel | None,
    most_miss: float,
    force: bool,
    as_json: bool,
) -> None:
    """Fit the battery to discharges from full charge, two or more; the model is chosen by withheld runtimes.

    TABLE: what a battery tester exports (CSV and other text, .mat, HDF5, JSON), with time, current and voltage; charges
    and rests between discharges may stand in it.
    """
    from sawbench.batteries import Pack, fit_battery_tables
    from sawbench.bench.config import load_config
    from sawbench.reporting.battery_page import write_battery_page
    from sawbench.storage.importers import load_map
    from sawbench.storage.output import write_whole

    page_path = out_path.with_suffix(".html")
    if page_path == out_path:
        raise InputError(
            "--out is a page", where=out_path, remedy="give a .toml file; the page is written to the same folder"
        )
    for path in (out_path, page_path):
        refuse_unwritable(path, force=force)
    base = None if config_path is None else load_config(config_path)
    if cutoff_soc is None and base is not None and base.config.battery is not None:
        cutoff_soc = base.config.battery.cutoff_soc
    with stepper("fitting") as step:
        found = fit_battery_tables(
            paths,
            table_map=None if map_path is None else load_map(map_path),
            pack=Pack(series=series, parallel=parallel),
            temperature_c=temperature_c,
            cutoff_voltage_v=cutoff_voltage_v,
            cutoff_soc=cutoff_soc,
            models=None if variant is None else (variant,),
            largest_own_miss=most_miss,
            on_model=step,
        )
    write_whole(out_path, found.as_toml(base), overwrite=force)
    write_battery_page(page_path, found.choice, found.table, notes=found.notes, overwrite=force)
    emit(result_of(found, out_path, page_path), describe(found, out_path, page_path), as_json=as_json)


def result_of(found: FittedBattery, *written: Path) -> dict[str, object]:
    """What `--json` prints: the table, and every model on every discharge."""
    models = [
        {
            "model": trial.model,
            "runtime_rel_std": trial.rel_std if trial.withheld else None,
            "refusal": trial.refusal or None,
            "withheld": [
                {
                    "discharge": miss.label,
                    "measured_s": miss.measured_s,
                    "predicted_s": miss.predicted_s,
                    "runtime_error": miss.runtime_error,
                    "voltage_error": miss.voltage_error,
                }
                for miss in trial.withheld
            ],
        }
        for trial in found.choice.trials
    ]
    return {"battery": found.table, "models": models, "notes": found.notes, "written": [str(path) for path in written]}


def describe(found: FittedBattery, *written: Path) -> str:
    """Discharges, models, what was chosen and why, and the files."""
    from sawbench.reporting.battery_page import DISCHARGE_HEAD, MODEL_HEAD, battery_text

    text = battery_text(found.choice)
    return "\n".join(
        [
            *found.notes,
            "",
            table(DISCHARGE_HEAD, text.discharges),
            "",
            table(MODEL_HEAD, text.models),
            *text.refusals,
            "",
            text.summary,
            *(str(path) for path in written),
        ]
    )
