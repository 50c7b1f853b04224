"""`sawbench simulate`: the electromechanical model alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.commands.options import bench_config_option, force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit
from sawbench.inputs import config_for

if TYPE_CHECKING:
    from sawbench.bench.config import BenchConfig

# Shorter runs are interpreted in less time than it takes to load or even to compile the kernels; a cutting
# coefficient fifty times that of wood makes steps so small that they are not.
_COMPILED_FROM_S, _COMPILED_FROM_SAMPLES, _COMPILED_FROM_K_FC = 20.0, 1e5, 1e4


@click.command(name="simulate", epilog="Example: sawbench simulate --k-fc 240.29 --seconds 1 --out current.csv")
@bench_config_option
@click.option("--k-fc", "k_fc", type=click.FloatRange(0), default=240.29, show_default=True, help="N*s/m; 0: air.")
@click.option("--duty", type=click.FloatRange(0, 1, min_open=True), help="Default: the configuration's.")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), default=1.0, show_default=True)
@click.option("--rate", "rate_hz", type=click.FloatRange(0, min_open=True), default=1000.0, show_default=True)
@click.option("--soc", type=click.FloatRange(0, 1, min_open=True), default=1.0, show_default=True)
@click.option("--angle", "angle_rad", type=float, default=0.0, show_default=True, help="Crank angle at the start, rad.")
@click.option("--out", "out_path", type=click.Path(path_type=Path, dir_okay=False), help="CSV with every sample.")
@force_option
@json_option
# click hands over every option by its name: as many parameters as options.
def command(
    config_path: Path | None,
    k_fc: float,
    duty: float | None,
    seconds: float,
    rate_hz: float,
    soc: float,
    angle_rad: float,
    out_path: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Run the model from rest and say what it does; the columns of the CSV are those of a trial table."""
    from sawbench.model_setup import simulated_run
    from sawbench.modeling.transient import InitialState
    from sawbench.storage.output import write_whole

    if out_path is not None:
        refuse_unwritable(out_path, force=force)
    loaded = config_for(None, config_path)
    run = simulated_run(
        loaded,
        k_fc_n_s_per_m=k_fc,
        duty=duty,
        duration_s=seconds,
        rate_hz=rate_hz,
        initial=InitialState(crank_angle_rad=angle_rad, soc=soc),
        compiles=seconds > _COMPILED_FROM_S or seconds * rate_hz > _COMPILED_FROM_SAMPLES or k_fc > _COMPILED_FROM_K_FC,
    )
    if out_path is not None:
        write_whole(out_path, _csv(run, loaded.config), overwrite=force)
    found = _summary(run)
    lines = [
        f"status          {run.status}: {run.message}" if run.message else f"status          {run.status}",
        f"peak current    {found['peak_current_a']:.3f} A",
        f"mean current    {found['mean_current_a']:.3f} A over the last half",
        f"stroke rate     {found['stroke_rate_hz']:.3f} Hz over the last half",
        f"peak force      {found['peak_force_n']:.1f} N",
    ]
    if run.energy is not None:
        lines.append(
            f"energy          {run.energy.electrical_in_j:.2f} J in, {run.energy.cutting_j:.2f} J cutting,"
            f" closes to {run.energy.closure_error:.1e}"
        )
    lines += [] if out_path is None else [f"samples         {out_path}"]
    emit(
        {**found, "status": run.status, "message": run.message, "energy": run.energy},
        "\n".join(lines),
        as_json=as_json,
    )
    return 0 if run.status == "ok" else 1


def _summary(run: Any) -> dict[str, float]:
    import numpy as np

    half = len(run.time_s) // 2
    turns = (run.crank_angle_rad[-1] - run.crank_angle_rad[half]) / (2.0 * np.pi)
    return {
        "peak_current_a": float(run.motor_current_a.max()),
        "mean_current_a": float(run.motor_current_a[half:].mean()),
        "stroke_rate_hz": float(turns / max(run.time_s[-1] - run.time_s[half], 1e-12)),
        "peak_force_n": float(run.force_n.max()),
    }


def _csv(run: Any, config: BenchConfig) -> str:
    import pandas as pd
    from sawbench.model_setup import bench_channels

    return pd.DataFrame({"time_s": run.time_s, **bench_channels(run, config)}).to_csv(index=False, float_format="%.9g")
