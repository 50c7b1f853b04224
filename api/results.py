"""What the public functions return; each shows itself in a notebook."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawbench.analysis import OpenedTrial

if TYPE_CHECKING:
    import pandas
    from sawbench.analysis import AnalysedTrial
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.recording import Floats
    from sawbench.modeling.effect_transient import EffectRun
    from sawbench.modeling.results import CuttingFit, ParameterEstimates, RuntimePrediction
    from sawbench.modeling.trajectory import Trajectory
    from sawbench.reporting.compared import ComparedTrial, Comparison, LeftOut


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialFit:
    """k_Fc of a trial.

    Attributes
    ----------
    trial : AnalysedTrial
    cutting : CuttingFit
    estimates : ParameterEstimates or None
        Plant and k_Fc together with their covariance; None for methods that fit k_Fc alone.
    """

    trial: AnalysedTrial
    cutting: CuttingFit
    estimates: ParameterEstimates | None

    def model_cycle(self) -> dict[str, Floats]:
        """One settled stroke of the fitted model: `angle_rad`, `force_n`, `motor_current_a`, shape (n,) each."""
        from sawbench.model_cycles import fitted_cycle

        return fitted_cycle(self.trial, self.cutting)

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import fit_block

        model = self.model_cycle() if self.cutting.status == "ok" else None
        return fit_block(self.trial.processed, self.cutting, model)


@dataclass(frozen=True, kw_only=True, slots=True)
class PredictedRuntime:
    """Battery runtime of a tool that goes on cutting as in a trial.

    Attributes
    ----------
    fit : TrialFit
    prediction : RuntimePrediction
    """

    fit: TrialFit
    prediction: RuntimePrediction

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import runtime_block

        return runtime_block(self.fit.trial.processed.trial.trial_id, self.prediction)


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatedTrial:
    """A run of the electromechanical model.

    Attributes
    ----------
    run : Trajectory or EffectRun
        The latter where the model holds known effects.
    loaded : LoadedConfig
    k_fc_n_s_per_m : float
    duty : float or None
        None where the converter holds the motor voltage.
    """

    run: Trajectory | EffectRun
    loaded: LoadedConfig
    k_fc_n_s_per_m: float
    duty: float | None

    def channels(self) -> dict[str, Floats]:
        """Return what the bench would measure: channel name -> values, shape (n,), in the unit of the name."""
        from sawbench.model_setup import bench_channels

        return bench_channels(self.run, self.loaded.config)

    def recording(self, *, trial_id: str = "simulated", material: str = "simulated") -> OpenedTrial:
        """Return the run as a recording without noise, for `process` and what follows.

        Parameters
        ----------
        trial_id, material : str
        """
        from sawbench.bench.recording import Recording, Signal, Trial
        from sawbench.bench.units import CHANNEL_BY_NAME

        trial = Trial(
            trial_id=trial_id,
            material=material if self.k_fc_n_s_per_m > 0 else "none",
            duty=self.duty,
            source="simulated by the model",
        )
        signals = {
            name: Signal(channel=name, unit=CHANNEL_BY_NAME[name].unit, time_s=self.run.time_s, values=values)
            for name, values in self.channels().items()
        }
        recording = Recording(trial=trial, signals=signals, config_toml=self.loaded.text)
        return OpenedTrial(recording=recording, loaded=self.loaded)

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import recording_block

        return recording_block(self.recording().recording, text=f"{self.run.status}. {self.run.message}")


@dataclass(frozen=True, kw_only=True, slots=True)
class MaterialComparison:
    """Recordings grouped into one series for each material and setting.

    Attributes
    ----------
    rows : tuple of ComparedTrial
    left_out : tuple of LeftOut
        Recordings that could not be processed, with the reason.
    """

    rows: tuple[ComparedTrial, ...]
    left_out: tuple[LeftOut, ...]

    def comparison(self) -> Comparison:
        """Group the trials and compare the groups."""
        from sawbench.reporting.compared import compare

        return compare(self.rows, self.left_out)

    def table(self) -> pandas.DataFrame:
        """Return one row per trial, with every number and its standard uncertainty; columns end in their unit."""
        from sawbench.reporting.comparison_data import comparison_table

        return comparison_table(self.rows)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the comparison as an HTML page.

        Raises
        ------
        InputError
            If the file exists and `overwrite` is not set, or cannot be written.
        """
        from sawbench.reporting.comparison_page import write_comparison_page

        write_comparison_page(path, self.rows, left_out=self.left_out, overwrite=overwrite)
        return Path(path)

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import comparison_block

        return comparison_block(self.comparison())


@dataclass(frozen=True, kw_only=True, slots=True)
class GapReport:
    """The sim-to-real gap of a campaign.

    Attributes
    ----------
    report : mapping
        Content of gap_report.json.
    """

    report: Mapping[str, Any]

    @property
    def verdict(self) -> str:
        """One of "effect", "effects", "parameters", "no_gap", "unknown"."""
        return self.report["verdict"]

    @property
    def causes(self) -> list[Mapping[str, Any]]:
        """Most probable first: `effects`, `probability`, `parameters`, `gap_closed`."""
        return self.report["causes"]

    def save(self, folder: str | Path, *, overwrite: bool = False) -> tuple[Path, Path]:
        """Write gap_report.json and gap_report.html, and improved_model.toml unless the cause is unknown.

        Where trials were planned, plan.csv holds them, a table that `sawbench series` reads. An improved model or a
        plan of an earlier diagnosis that this one has not is removed, if `overwrite` is set.

        Parameters
        ----------
        folder : str or Path
            Made if missing.
        overwrite : bool

        Returns
        -------
        json_path, html_path : Path

        Raises
        ------
        InputError
            If a file exists and `overwrite` is not set, or cannot be written.
        """
        from sawbench.reporting.gap_page import write_gap_page
        from sawbench.storage.output import write_whole

        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in (
            ("improved_model.toml", self.report.get("improved_model")),
            ("plan.csv", self._plan_table()),
        ):
            if text:
                write_whole(folder / name, text, overwrite=overwrite)
            elif overwrite:
                (folder / name).unlink(missing_ok=True)
        json_path = write_whole(folder / "gap_report.json", self.as_json(), overwrite=overwrite)
        return json_path, write_gap_page(folder / "gap_report.html", self.report, overwrite=overwrite)

    def _plan_table(self) -> str:
        """Planned trials as a table; empty where there are none."""
        trials = self.report.get("plan", {}).get("trials", [])
        if not trials:
            return ""
        from sawbench.acquisition.series.plan import PlannedTrial
        from sawbench.acquisition.series.plan_design import plan_table

        known = [{key: row[key] for key in PlannedTrial.model_fields if key in row} for row in trials]
        return plan_table([PlannedTrial.model_validate(row) for row in known])

    def as_json(self) -> str:
        """Return gap_report.json; lists of numbers stand on one line."""
        text = json.dumps(self.report, indent=2, allow_nan=False) + "\n"
        return re.sub(r"\[[\s\d.,eE+-]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text)

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import gap_block

        return gap_block(self.report)
