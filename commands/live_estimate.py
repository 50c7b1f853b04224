"""k_Fc and the remaining runtime while `sawbench record` runs: strokes into the recursive estimator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from sawbench.bench.recording import Event, SampleBlock

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.recording import Trial
    from sawbench.modeling.recursive import LiveEstimate

# Without any displacement for this long there will be no live k_Fc, s.
_PATIENCE_S: Final = 2.0


class LiveCuttingEstimate:
    """An observer of a recording that keeps k_Fc and the remaining runtime up to date.

    It runs behind the recorder's bounded queue; whatever goes wrong in it ends the display, is kept in
    `problem`, and never reaches the recording. The load cell is zeroed on the rest before the saw starts;
    strokes during which it spins up are left out. The battery is taken as full at the start.

    Parameters
    ----------
    loaded : LoadedConfig
    trial : Trial
        For the duty and whether idle run.
    show : callable, optional
        Called with (time_s, LiveEstimate) once a stroke.

    Attributes
    ----------
    latest : LiveEstimate or None
    n_changes : int
        Changes of material noticed.
    problem : str
        Why there is no estimate, or none any more; empty while all is well.
    """

    def __init__(
        self,
        loaded: LoadedConfig,
        trial: Trial,
        *,
        show: Callable[[float, LiveEstimate], object] | None = None,
    ) -> None:
        from sawbench.processing.live_strokes import LiveStrokeSplitter

        self.latest: LiveEstimate | None = None
        self.n_changes = 0
        self.problem = ""
        self._show = show
        self._sensors = loaded.config.sensors
        self._splitter = LiveStrokeSplitter()
        self._begun_s: float | None = None
        self._estimator: Any = None
        if trial.is_idle:
            self.problem = "idle run"
        elif loaded.config.plant is None:
            self.problem = "the configuration has no [plant]"
        else:
            self._build(loaded, trial)

    def _build(self, loaded: LoadedConfig, trial: Trial) -> None:
        """Make the tables before the recording starts: the first time compiles for a few seconds."""
        from sawbench.modeling.effect_tables import TrialEffects
        from sawbench.modeling.joint_fit import SensorPriors
        from sawbench.modeling.machines.known_effects import known_effects
        from sawbench.modeling.recursive import RecursiveCuttingEstimator

        config = loaded.config
        try:
            effects = TrialEffects(
                known=known_effects(config, path=loaded.path),
                feed_m_s=math.nan if trial.feed_mm_s is None else 1e-3 * trial.feed_mm_s,
                thickness_m=math.nan if trial.thickness_mm is None else 1e-3 * trial.thickness_mm,
            )
            self._estimator = RecursiveCuttingEstimator(
                plant=loaded.plant(),
                battery=config.battery,
                converter=config.converter,
                duty=config.converter.default_duty if trial.duty is None else trial.duty,
                cutting_half=config.cutting.cutting_half,
                sensors=SensorPriors(
                    force_gain_rel_std=config.analysis.force_gain_rel_std,
                    current_gain_rel_std=config.analysis.current_gain_rel_std,
                ),
                effects=effects,
            )
        except Exception as error:
            self.problem = str(error)

    def __call__(self, item: SampleBlock | Event) -> None:
        """Take a block of samples; never raises."""
        if self.problem or not isinstance(item, SampleBlock):
            return
        try:
            self._take(item)
        except Exception as error:  # the display ends, the recording does not
            self.problem = f"{type(error).__name__}: {error}"

    def _take(self, block: SampleBlock) -> None:
        from sawbench.modeling.recursive import StrokeSummary

        splitter = self._splitter
        if block.channel in self._sensors:
            block = replace(block, values=self._sensors[block.channel].true(block.values))
        strokes = splitter.update(block)
        if self._begun_s is None and len(block.time_s):
            self._begun_s = float(block.time_s[0])
        if not splitter.has_displacement:
            if splitter.newest_s - (self._begun_s or 0.0) > _PATIENCE_S:
                self.problem = "no displacement_mm is received, so the strokes are unknown"
            return
        offset_n = splitter.rest_force_n or 0.0
        for stroke in strokes:
            force_n = None if stroke.mean_force_n is None else stroke.mean_force_n - offset_n
            if not stroke.is_settled or (force_n is None and stroke.mean_current_a is None):
                continue
            found: LiveEstimate = self._estimator.update(
                StrokeSummary(
                    period_s=stroke.period_s,
                    mean_force_n=force_n,
                    mean_current_a=stroke.mean_current_a,
                    battery_voltage_v=stroke.battery_voltage_v,
                    battery_current_a=stroke.battery_current_a,
                )
            )
            self.latest = found
            self.n_changes += found.has_changed
            if self._show is not None:
                self._show(stroke.end_s, found)

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of the latest estimate."""
        return () if self.latest is None else self.latest.notes

    def describe(self) -> str:
        """One line for the terminal; empty before the first stroke and where there is no estimate."""
        from sawbench.reporting.quantities import format_quantity

        latest = self.latest
        if latest is None:
            return ""
        line = f"k_Fc {format_quantity(latest.k_fc_n_s_per_m, latest.std_n_s_per_m, 'N·s/m')}"
        if latest.remaining_s is not None:
            left = format_quantity(latest.remaining_s, latest.remaining_std_s, "s")
            line += f", {left} of battery runtime left if the battery was full at the start"
        line += f" ({latest.n_strokes} strokes"
        return line + (f", {self.n_changes} changes of material)" if self.n_changes else ")")
