"""`sawbench runtime`: the battery runtime with its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from commands.options import config_for, config_option, find_recordings, json_option
from commands.terminal import emit, plain, progress

if TYPE_CHECKING:
    from modeling.results import RuntimePrediction


@click.command(name="runtime", epilog="Example: sawbench runtime recordings/oak-01.mcap")
@click.argument("paths", metavar="[FILE...]", nargs=-1, type=click.Path(path_type=Path))
@config_option
@click.option("--k-fc", "k_fc", type=click.FloatRange(0), help="Instead of recordings: this k_Fc, N*s/m.")
@click.option("--k-fc-std", type=click.FloatRange(0), default=0.0, help="Its standard uncertainty, N*s/m.")
@click.option("--duty", type=click.FloatRange(0, 1, min_open=True), help="With --k-fc; default: the configuration's.")
@json_option
def command(
    paths: tuple[Path, ...],
    config_path: Path | None,
    k_fc: float | None,
    k_fc_std: float,
    duty: float | None,
    as_json: bool,
) -> int:
    """Predict how long the battery lasts if the tool goes on cutting as in each trial."""
    from commands.analysis import fit_trial, load_and_process, predict, runtime_of

    if bool(paths) == (k_fc is not None):
        raise click.UsageError("name recordings, or give --k-fc, one of the two")
    results: list[tuple[str, RuntimePrediction]] = []
    if k_fc is not None:
        loaded = config_for(None, config_path)
        results.append((f"k_Fc {k_fc:g}", predict(loaded, k_fc=k_fc, k_fc_std=k_fc_std, duty=duty)))
    files = find_recordings(paths)
    for path in progress(files, "predicting"):
        trial = load_and_process(path, config_path)
        if len(files) > 1 and trial.recording.trial.is_idle:
            click.echo(f"{path}: the blade runs in air, so there is no cutting runtime", err=True)
            continue
        results.append((trial.recording.trial.trial_id, runtime_of(trial, *fit_trial(trial))))
    emit(
        [{"trial": name, **plain(result)} for name, result in results],
        "\n".join(describe(name, result) for name, result in results),
        as_json=as_json,
    )
    return 0 if all(result.status == "ok" for _, result in results) else 1


def describe(name: str, result: RuntimePrediction) -> str:
    """The prediction in words."""
    from reporting.quantities import format_quantity

    if result.status != "ok":
        return f"{name}: no runtime ({result.status.replace('_', ' ')})"
    lines = [
        f"{name}: {format_quantity(result.runtime_s, result.std_s, 's')} until the"
        f" {'cut-off state of charge' if result.ended_by == 'soc' else 'cut-off voltage'}"
    ]
    lines.append(
        f"  mean battery current {result.mean_battery_current_a:.3f} A, motor {result.mean_motor_current_a:.3f} A"
    )
    if result.appendix_a_runtime_s is not None:
        lines.append(f"  by the measured mean current (Appendix A): {result.appendix_a_runtime_s:.0f} s")
    largest = sorted(result.contributions_s.items(), key=lambda item: -item[1])[:4]
    if largest:
        lines.append("  uncertainty from " + ", ".join(f"{key} {value:.1f} s" for key, value in largest))
    return "\n".join(lines)
