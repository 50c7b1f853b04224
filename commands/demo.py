"""`sawbench demo`: the whole main job on the simulated bench."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.bench.errors import UntrustedResult
from sawbench.bench.recording import Trial
from sawbench.commands.options import bench_config_option, force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit, has_display
from sawbench.inputs import config_for, default_config_path
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.analysis import AnalysedTrial, Evaluation
    from sawbench.modeling.results import CuttingFit, RuntimePrediction

_TRIAL = "oak-demo"


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoFiles:
    """What the demo leaves behind."""

    recording: Path
    processed: Path
    report: Path
    view: Path
    truth: Path

    @classmethod
    def in_folder(cls, folder: Path) -> DemoFiles:
        """Names of the files."""
        return cls(
            recording=folder / f"{_TRIAL}.mcap",
            processed=folder / f"{_TRIAL}.h5",
            report=folder / f"{_TRIAL}.html",
            view=folder / f"{_TRIAL}.rrd",
            truth=folder / "simulated_truth.json",
        )


@click.command(name="demo", epilog="Example: sawbench demo --out demo --seconds 8 --no-view")
@click.option(
    "--out",
    "out_dir",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("demo"),
    show_default=True,
)
@click.option("--seconds", type=click.FloatRange(2.0), default=8.0, show_default=True, help="Duration of the trial, s.")
@click.option("--no-view", is_flag=True, help="Do not open the Rerun viewer.")
@click.option("--seed", default=1, show_default=True, help="Seed of the simulated wood and sensor noise.")
@bench_config_option
@force_option
@json_option
def command(
    out_dir: Path,
    seconds: float,
    no_view: bool,
    seed: int,
    config_path: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Simulated instruments on real ports -> record -> process -> k_Fc -> runtime -> report, in under a minute."""
    from sawbench.analysis import Evaluation, fit_trial, load_and_process, runtime_of

    files = DemoFiles.in_folder(out_dir)
    for name in DemoFiles.__slots__:
        path = getattr(files, name)
        refuse_unwritable(path, force=force, makes_folder=True)
        if name != "recording":
            path.unlink(missing_ok=True)
    out_dir.mkdir(parents=True, exist_ok=True)
    _say("1/4  starting the simulated instruments and recording", as_json)
    _record(files, seconds=seconds, seed=seed, config_path=config_path, show=has_display() and not no_view, force=force)
    _say("2/4  processing: stroke period, folded cycle, return stroke", as_json)
    trial = load_and_process(files.recording, config_path)
    _say("3/4  modelling: k_Fc and runtime", as_json)
    fit, estimates = fit_trial(trial)
    runtime = runtime_of(trial, fit, estimates)
    _say("4/4  writing HDF5, report and Rerun recording", as_json)
    _write(files, trial, Evaluation(fit=fit, estimates=estimates, runtime=runtime))
    emit(_as_json(files, trial, fit, runtime), _as_text(files, trial, fit, runtime), as_json=as_json)
    return 0 if fit.status == "ok" and runtime.status == "ok" else 1


def _say(text: str, as_json: bool) -> None:
    click.echo(text, err=as_json)


def _record(files: DemoFiles, *, seconds: float, seed: int, config_path: Path | None, show: bool, force: bool) -> None:
    from sawbench.commands.live_counters import LiveCounters
    from sawbench.commands.record import live_view
    from sawbench.commands.recording_session import SessionOptions, record_trial, simulated_bench

    path = config_path or default_config_path()
    loaded = config_for(None, path)
    duty = loaded.config.converter.default_duty
    trial = Trial(
        trial_id=_TRIAL,
        material="oak",
        duty=duty,
        thickness_mm=20.0,
        feed_mm_s=4.0,
        blade="B1",
        battery="P1",
        operator="demo",
        notes="created by the simulated bench",
        repetition=1,
        source="simulated bench",
    )
    with (
        simulated_bench(path, material="oak", duty=duty, seed=seed, truth_path=files.truth) as endpoints,
        live_view(trial, live=show, rrd_path=None, force=force) as observers,
        LiveCounters() as counters,
    ):
        summary = record_trial(
            loaded,
            SessionOptions(path=files.recording, trial=trial, seconds=seconds, endpoints=endpoints, overwrite=force),
            observers=observers,
            status=counters,
        )
    if not summary.is_complete or summary.duration_s < 0.9 * seconds:
        raise UntrustedResult(
            f"the recording ended after {summary.duration_s:.1f} of {seconds:g} s: {summary.end_reason}",
            where=files.recording,
            remedy="run the demo again with --force",
        )


def _write(files: DemoFiles, trial: AnalysedTrial, found: Evaluation) -> None:
    from sawbench.model_cycles import LINEAR
    from sawbench.reporting.trial_page import write_trial_page
    from sawbench.storage.results import write_processed
    from sawbench.trial_report import trial_report
    from sawbench.visualization.replay import view_recording

    write_processed(trial.processed, files.processed)
    report = trial_report(trial, found)
    model = report.model.get(LINEAR)
    view_recording(trial.recording, save_path=files.view, spawn=False, processed=trial.processed, model=model)
    write_trial_page(
        files.report,
        report,
        files={"Recording": files.recording, "Processed": files.processed, "Rerun": files.view},
    )


def _as_json(files: DemoFiles, trial: AnalysedTrial, fit: CuttingFit, runtime: RuntimePrediction) -> dict[str, Any]:
    processed = trial.processed
    return {
        "period": plain(processed.period),
        "peak_force_n": processed.peak_force_n,
        "peak_force_std_n": processed.peak_force_std_n,
        "fit": plain(fit.in_outline),
        "runtime": plain(runtime),
        "files": {name: getattr(files, name) for name in DemoFiles.__slots__},
    }


def _as_text(files: DemoFiles, trial: AnalysedTrial, fit: CuttingFit, runtime: RuntimePrediction) -> str:
    from sawbench.reporting.quantities import format_quantity

    processed, period = trial.processed, trial.processed.period
    assert period is not None
    peak = "-"
    if processed.peak_force_n is not None:
        peak = format_quantity(processed.peak_force_n, processed.peak_force_std_n, "N")
    lines = [
        "",
        f"stroke period  {format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, 'ms')}"
        f"   ({period.rate_hz:.2f} Hz, confidence {period.confidence}, {period.n_cycles} strokes)",
        f"peak force     {peak}",
        f"k_Fc           {format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, 'N·s/m')}",
        f"runtime        {format_quantity(runtime.runtime_s, runtime.std_s, 's')}   (full battery to"
        f" {trial.loaded.battery().cutoff_soc:.0%} charge)",
        "(value ± one standard uncertainty)",
        "",
        f"MCAP   {files.recording}",
        f"HDF5   {files.processed}",
        f"HTML   {files.report}",
        f"Rerun  {files.view}      sawbench view {files.recording}",
        f"truth  {files.truth}   true values of the simulated bench; not used by any result above",
    ]
    return "\n".join(lines)
