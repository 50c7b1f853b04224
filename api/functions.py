"""The public functions: from a file to a trial, its fit, its runtime, a comparison and a diagnosis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sawbench.analysis import (
    AnalysedTrial,
    OpenedTrial,
    fit_trial,
    load_and_process,
    open_trial,
    process_opened,
    runtime_of,
)
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.comparison import compare_files
from sawbench.gap import diagnose_trials
from sawbench.inputs import config_for, find_recordings
from sawbench.model_setup import simulated_run
from sawbench.results import GapReport, MaterialComparison, PredictedRuntime, SimulatedTrial, TrialFit

if TYPE_CHECKING:
    from sawbench.modeling.cycle_observation import FitMethod

Source = str | Path | OpenedTrial
"""A recording: its file, or what `read` or `SimulatedTrial.recording` returned."""


def read(
    path: str | Path, *, config: str | Path | None = None, span_s: tuple[float, float] | None = None
) -> OpenedTrial:
    """Read a recording, or a part of it.

    Parameters
    ----------
    path : str or Path
        `.mcap` file; `sawbench import` makes one from a table or a log.
    config : str or Path, optional
        Bench configuration; default: the recording's own, else ./bench_config.toml, else the one that ships.
    span_s : (float, float), optional
        Only the samples from the first time to the second, s on the recording's clock. A recording of more than 60
        million samples, 20 minutes at 6 channels of 8 kHz, is only read in parts; `process` takes one of any length.

    Returns
    -------
    OpenedTrial
        Signals in the units of their names, times in s; the trial's settings; the configuration.

    Raises
    ------
    InputError
        If the file is missing or no recording, is too long to be read at once or has no sample in the span, or the
        configuration is not valid.

    Examples
    --------
    >>> read("oak-01.mcap").recording.signals["force_n"].rate_hz  # doctest: +SKIP
    6000.0
    >>> read("hour.mcap", span_s=(1800.0, 1810.0)).recording.signals["force_n"].duration_s  # doctest: +SKIP
    9.9999
    """
    return open_trial(Path(path), None if config is None else Path(config), span_s)


def process(trial: Source, *, config: str | Path | None = None) -> AnalysedTrial:
    """Find the strokes of a trial, fold every channel onto one turn of the crank, judge the channels.

    Parameters
    ----------
    trial : str, Path or OpenedTrial
    config : str or Path, optional
        As in `read`; not with an `OpenedTrial`, which holds its configuration.

    Returns
    -------
    AnalysedTrial
        `processed` holds stroke period (s), crank angle (rad), folded cycles and quality; what could not be found is
        None there, and `processed.warnings` says why.

    Raises
    ------
    InputError
        As `read`; if `config` is given with an `OpenedTrial`.

    Examples
    --------
    >>> trial = process(simulate(k_fc_n_s_per_m=200.0, duration_s=0.5).recording(material="oak"))
    >>> trial.processed.period.confidence
    'high'
    """
    if isinstance(trial, OpenedTrial):
        if config is not None:
            raise InputError("an opened trial holds its configuration", remedy="give `config` to `read` instead")
        return process_opened(trial)
    return load_and_process(Path(trial), None if config is None else Path(config))


def fit(trial: Source | AnalysedTrial, *, method: FitMethod | None = None) -> TrialFit:
    """Fit the linear cutting coefficient k_Fc of a trial.

    Parameters
    ----------
    trial : str, Path, OpenedTrial or AnalysedTrial
    method : {"current_and_force", "current", "force"}, optional
        Default: every channel there is.

    Returns
    -------
    TrialFit
        `cutting` holds k_Fc with its standard uncertainty (N*s/m) and a status: rely on it where that is "ok".

    Raises
    ------
    InputError
        If the trial is no cutting trial or lacks what the fit needs.

    Examples
    --------
    >>> fit("oak-01.mcap").cutting.k_fc_n_s_per_m  # doctest: +SKIP
    239.8
    """
    analysed = trial if isinstance(trial, AnalysedTrial) else process(trial)
    cutting, estimates = fit_trial(analysed, method)
    return TrialFit(trial=analysed, cutting=cutting, estimates=estimates)


def runtime(
    trial: Source | AnalysedTrial | TrialFit, *, temperature_c: float | None = None, cycle: float | None = None
) -> PredictedRuntime:
    """Predict how long a full battery lasts if the tool goes on cutting as in this trial.

    Parameters
    ----------
    trial : str, Path, OpenedTrial, AnalysedTrial or TrialFit
    temperature_c, cycle : float, optional
        Of the surroundings, and charges and discharges of the battery, to check against the range of a fitted battery.

    Returns
    -------
    PredictedRuntime
        `prediction` holds the runtime and its standard uncertainty, s; its `notes` say where a fitted battery is
        used outside its range.

    Raises
    ------
    UntrustedResult
        If the fit of the trial is not reliable; the message says why.
    InputError
        As `fit`.

    Examples
    --------
    >>> runtime("oak-01.mcap").prediction.runtime_s  # doctest: +SKIP
    927.4
    """
    from sawbench.modeling.battery_range import BatteryUse

    found = trial if isinstance(trial, TrialFit) else fit(trial)
    if found.cutting.status != "ok":
        raise UntrustedResult(
            "no runtime, because k_Fc is not reliable: "
            + "; ".join((found.cutting.status.replace("_", " "), *found.cutting.notes)),
            where=found.trial.where,
        )
    use = BatteryUse(temperature_c=temperature_c, cycle=cycle)
    return PredictedRuntime(fit=found, prediction=runtime_of(found.trial, found.cutting, found.estimates, use))


def simulate(
    *,
    config: str | Path | None = None,
    k_fc_n_s_per_m: float = 240.29,
    duty: float | None = None,
    duration_s: float = 1.0,
    rate_hz: float = 1000.0,
    soc: float = 1.0,
    crank_angle_rad: float = 0.0,
) -> SimulatedTrial:
    """Run the electromechanical model from rest.

    Parameters
    ----------
    config : str or Path, optional
        Default: ./bench_config.toml, else the one that ships.
    k_fc_n_s_per_m : float
        0: the blade runs in air.
    duty : float, optional
        Above 0, at most 1; default: the configuration's.
    duration_s, rate_hz : float
    soc : float
        State of charge at the start, 0..1.
    crank_angle_rad : float
        At the start.

    Returns
    -------
    SimulatedTrial
        `run` holds the states, each of shape (n,); `channels()` what the bench would measure.

    Raises
    ------
    InputError
        If a value is out of range or the configuration is not valid.

    Examples
    --------
    >>> run = simulate(k_fc_n_s_per_m=0.0, duration_s=0.2)
    >>> run.run.status, len(run.channels()["force_n"])
    ('ok', 201)
    """
    from sawbench.modeling.transient import InitialState

    loaded = config_for(None, None if config is None else Path(config))
    run = simulated_run(
        loaded,
        k_fc_n_s_per_m=k_fc_n_s_per_m,
        duty=duty,
        duration_s=duration_s,
        rate_hz=rate_hz,
        initial=InitialState(crank_angle_rad=crank_angle_rad, soc=soc),
    )
    if loaded.config.converter.mode == "held_voltage":
        duty = None
    elif duty is None:
        duty = loaded.config.converter.default_duty
    return SimulatedTrial(run=run, loaded=loaded, k_fc_n_s_per_m=k_fc_n_s_per_m, duty=duty)


def compare(trials: str | Path | Iterable[str | Path], *, config: str | Path | None = None) -> MaterialComparison:
    """Process, fit and compare recordings, one series for each material and setting.

    Parameters
    ----------
    trials : str, Path or iterable of them
        Recordings, or folders of recordings.
    config : str or Path, optional
        As in `read`.

    Returns
    -------
    MaterialComparison
        Trials that cannot be compared are in it too, each with its reason.

    Raises
    ------
    InputError
        If none of the recordings can be compared.

    Examples
    --------
    >>> compare("recordings").table()["material"].unique()  # doctest: +SKIP
    array(['oak', 'nylon'], dtype=object)
    """
    from sawbench.bench.config import load_config

    loaded = None if config is None else load_config(Path(config))
    rows, left_out = compare_files(find_recordings(_paths(trials)), loaded)
    return MaterialComparison(rows=tuple(rows), left_out=tuple(left_out))


def diagnose(
    trials: str | Path | Iterable[Source],
    *,
    config: str | Path | None = None,
    until_closed: bool = False,
    plan: int = 0,
) -> GapReport:
    """Say where the model misses the measurements of a campaign, and which unmodelled effect causes it.

    Parameters
    ----------
    trials : str, Path or iterable of str, Path, OpenedTrial
        Recordings, or folders of recordings, of one machine.
    config : str or Path, optional
        As in `read`; default: that of the first recording.
    until_closed : bool
        Add causes one by one to the model until nothing more closes at withheld operating points; the ladder of causes
        is `report["until_closed"]`.
    plan : int
        How many trials to propose that tell most about what is still possible, 0 to 20: `report["plan"]`, and plan.csv
        where the report is saved.

    Returns
    -------
    GapReport
        `report` is the content of gap_report.json.

    Raises
    ------
    InputError
        If nothing can be diagnosed; the message says why for every trial.

    Examples
    --------
    >>> diagnose("recordings", config="bench_config.toml").verdict  # doctest: +SKIP
    'no_gap'
    """
    sources: Sequence[Source] = [trials] if isinstance(trials, str | Path) else list(trials)
    opened: list[OpenedTrial] = []
    for source in sources:
        if isinstance(source, OpenedTrial):
            opened.append(source)
        else:
            opened += [read(path, config=config) for path in find_recordings([Path(source)])]
    loaded = config_for(opened[0].recording, Path(config)) if opened and config is not None else None
    return GapReport(report=diagnose_trials(opened, loaded, until_closed=until_closed, plan=plan))


def _paths(trials: str | Path | Iterable[str | Path]) -> list[Path]:
    return [Path(trials)] if isinstance(trials, str | Path) else [Path(path) for path in trials]
