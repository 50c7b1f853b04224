"""A recording with its configuration, and with what was found in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.bench.recording import Recording
    from sawbench.modeling.measured_cycles import MeasuredCycles


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenedTrial:
    """A recording and the configuration it is read with.

    Attributes
    ----------
    recording : Recording
    loaded : LoadedConfig
    sha256 : str
        Of the file; empty where there is none.
    """

    recording: Recording
    loaded: LoadedConfig
    sha256: str = ""

    def _repr_html_(self) -> str:
        from sawbench.modeling.machines.words import words_of
        from sawbench.reporting.notebook import recording_block

        return recording_block(self.recording, words=words_of(self.loaded.config.frame))


@dataclass(frozen=True, kw_only=True, slots=True)
class AnalysedTrial:
    """A recording with what was found in it; a long one in outline, with the strokes that the fit takes beside it."""

    recording: Recording
    loaded: LoadedConfig
    processed: ProcessedTrial
    strokes: MeasuredCycles | None = None

    @property
    def fitted_strokes(self) -> MeasuredCycles:
        """Strokes that k_Fc is fitted to, and that the fitted model is drawn for.

        Raises
        ------
        InputError
            If the trial has no running strokes or no crank angle with a known zero.
        """
        from sawbench.processing.measured_cycles import measured_cycles

        return measured_cycles(self.processed) if self.strokes is None else self.strokes

    @property
    def where(self) -> str:
        """File, or name of the trial where there is none."""
        return self.recording.path or self.recording.trial.trial_id

    def _repr_html_(self) -> str:
        from sawbench.reporting.notebook import processed_block

        return processed_block(self.processed)
