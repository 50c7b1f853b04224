"""`sawbench runtime`: the battery runtime with its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.bench.errors import UntrustedResult
from sawbench.commands.failures import Failures
from sawbench.commands.options import config_option, json_option
from sawbench.commands.terminal import emit, progress
from sawbench.inputs import config_for, find_recordings
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.modeling.battery_range import BatteryUse
    from sawbench.modeling.results import RuntimePrediction


@click.command(
    name="runtime",
    epilog="Example: sawbench runtime recordings/oak-01.mcap; sawbench runtime --k-fc 240 --duty 0.5",
)
@click.argument("paths", metavar="[FILE...]", nargs=-1, type=click.Path(path_type=Path))
@config_option
@click.option("--k-fc", "k_fc", type=click.FloatRange(0), help="Use this k_Fc instead of recordings, N*s/m.")
@click.option("--k-fc-std", type=click.FloatRange(0), default=0.0, help="Standard uncertainty of --k-fc, N*s/m.")
@click.option("--duty", type=click.FloatRange(0, 1, min_open=True), help="With --k-fc; default: the configuration's.")
@click.option(
    "--temperature", "temperature_c", type=float,
    help="Ambient temperature, degC; checked against the range of a fitted battery (`sawbench battery fit`).",
)  # fmt: skip
@click.option(
    "--cycle", type=click.FloatRange(0), help="Number of charge cycles of the battery; also checked against that range."
)
@json_option
def command(
    paths: tuple[Path, ...],
    config_path: Path | None,
    k_fc: float | None,
    k_fc_std: float,
    duty: float | None,
    temperature_c: float | None,
    cycle: float | None,
    as_json: bool,
) -> int:
    """Predict how long the battery lasts if the tool goes on cutting as in each trial."""
    from sawbench.analysis import predict
    from sawbench.modeling.battery_range import BatteryUse

    if bool(paths) == (k_fc is not None):
        raise click.UsageError("give either recordings or --k-fc")
    if paths and (duty is not None or k_fc_std):
        raise click.UsageError(
            "--duty and --k-fc-std go with --k-fc; a recording has its own, and `sawbench amend` corrects its duty"
        )
    use = BatteryUse(temperature_c=temperature_c, cycle=cycle)
    results: list[tuple[str, RuntimePrediction]] = []
    if k_fc is not None:
        loaded = config_for(None, config_path)
        results.append((f"k_Fc {k_fc:g}", predict(loaded, k_fc=k_fc, k_fc_std=k_fc_std, duty=duty, use=use)))
    files = find_recordings(paths)
    failures = Failures(len(files))
    for path in progress(files, "predicting"):
        with failures.collected():
            found = _of_recording(path, config_path, use, is_alone=len(files) == 1)
            results += [] if found is None else [found]
    emit(
        [{"trial": name, **plain(result)} for name, result in results],
        "\n".join(describe(name, result) for name, result in results),
        as_json=as_json,
    )
    return failures.exit_code(is_trusted=all(result.status == "ok" for _, result in results))


def _of_recording(
    path: Path, config_path: Path | None, use: BatteryUse, *, is_alone: bool
) -> tuple[str, RuntimePrediction] | None:
    """Trial and runtime; None, with a line that says so, for one of several whose blade runs in air."""
    from sawbench.analysis import fit_trial, load_and_process, runtime_of

    trial = load_and_process(path, config_path)
    if not is_alone and trial.recording.trial.is_idle:
        click.echo(f"{path}: idle run, so there is no cutting runtime", err=True)
        return None
    fit, estimates = fit_trial(trial)
    if fit.status != "ok":
        raise UntrustedResult(
            "no runtime, because k_Fc is not reliable: " + "; ".join((fit.status.replace("_", " "), *fit.notes)),
            where=path,
            remedy=f"see `sawbench fit {path}`",
        )
    return trial.recording.trial.trial_id, runtime_of(trial, fit, estimates, use)


def describe(name: str, result: RuntimePrediction) -> str:
    """The prediction in words."""
    from sawbench.reporting.quantities import correlation_words, format_quantity

    if result.status != "ok":
        return f"{name}: no runtime ({result.status.replace('_', ' ')})"
    lines = [
        f"{name}: {format_quantity(result.runtime_s, result.std_s, 's')} until the"
        f" {'cut-off state of charge' if result.ended_by == 'soc' else 'cut-off voltage'}"
    ]
    lines.append(
        f"  means of the model over the discharge: battery current {result.mean_battery_current_a:.3f} A,"
        f" motor current {result.mean_motor_current_a:.3f} A"
    )
    if result.appendix_a_runtime_s is not None:
        lines.append(f"  from the measured mean current (Appendix A): {result.appendix_a_runtime_s:.0f} s")
    largest = sorted(result.contributions_s.items(), key=lambda item: -item[1])[:4]
    if largest:
        lines.append("  uncertainty from " + ", ".join(f"{key} {value:.1f} s" for key, value in largest))
        correlation = correlation_words(result.std_s, result.contributions_s.values())
        lines += [f"  {correlation}"] if correlation else []
    lines += [f"  {result.battery_basis}"] if result.battery_basis else []
    return "\n".join([*lines, *(f"  note: {text}" for text in result.notes)])
