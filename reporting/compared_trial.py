"""A trial as the comparison page takes it: what was found in it, its fit and its runtime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sawbench.bench.processed import ProcessedTrial
from sawbench.modeling.results import CuttingFit, RuntimePrediction


@dataclass(frozen=True, kw_only=True, slots=True)
class ComparedTrial:
    """One trial of a comparison.

    Attributes
    ----------
    processed : ProcessedTrial
    fit : CuttingFit or None
    runtime : RuntimePrediction or None
    note : str
        Why there is no fit or runtime, where there is none.
    gain_rel_std : mapping of str to float
        Relative standard uncertainty of the sensors' gains by channel, as configured: all trials share it.
    """

    processed: ProcessedTrial
    fit: CuttingFit | None = None
    runtime: RuntimePrediction | None = None
    note: str = ""
    gain_rel_std: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Trial identifier."""
        return self.processed.trial.trial_id

    @property
    def is_idle(self) -> bool:
        """Whether the blade ran in air, as declared."""
        return self.processed.trial.is_idle

    @property
    def left_out_because(self) -> str:
        """Why the trial takes no part in the comparison; empty where it does."""
        reasons = {
            "stalled": "the saw stalled",
            "no_stroke": "no stroke was found",
            "no_cutting": f"no cutting was found, but the workpiece is {self.processed.trial.material!r}",
        }
        if self.is_idle:
            return ""
        if self.processed.trial.material is None:
            return "the material is not stated"
        if self.processed.losses:
            return f"too many samples lost: {', '.join(self.processed.losses)}"
        return reasons.get(self.processed.status, "")
