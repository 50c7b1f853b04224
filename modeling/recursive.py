"""k_Fc and the remaining runtime, renewed once a stroke while the saw runs.

The time mean of the force over a stroke is the impulse over the period, and the impulse is k_Fc times the
distance cut, whatever the speed does within the stroke:

    mean F = 2 r_c k_Fc / T          so      k_Fc = mean F * T / (2 r_c)

From the current, k_Fc follows from the mean torques, with the small effect of the ripple taken from the
periodic model. A running mean with its autocorrelation gives the uncertainty; a two-sided cumulative sum
notices a change of material and starts the mean again from where the change began.

What known effects add to a stroke at that k_Fc is taken off first, as in a fit (`modeling.effect_fit`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.battery_range import outside_range
from sawbench.modeling.effect_fit import history_note
from sawbench.modeling.effect_tables import EffectTables, TrialEffects, models_of
from sawbench.modeling.joint_fit import SensorPriors
from sawbench.modeling.periodic_cycle import CuttingHalf
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.stroke_tables import StrokeTables, stroke_tables

# Cumulative sum: slack and threshold in standard deviations of a stroke, innovations clipped so that one
# knot in the wood does not look like another material.
SLACK: Final = 0.75
THRESHOLD: Final = 12.0
CLIP: Final = 4.0
# From this sum on a change is suspected: the level and the spread that strokes are judged by stay as they were
# before, or the first strokes of a new material would widen the spread until the change hides in it.
SUSPICION: Final = 3.0
KEPT_STROKES: Final = 64
FEWEST_FOR_SCATTER: Final = 6
# Stroke-to-stroke variation of wood before it has been measured.
ASSUMED_SPREAD: Final = 0.05
# k_Fc of a stroke and what the effects add at that k_Fc are found in turn.
MOST_PASSES: Final = 20
PASS_TOLERANCE: Final = 1e-4


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeSummary:
    """One stroke as the stream gives it; means over time, None where not measured.

    Attributes
    ----------
    period_s : float
    mean_force_n, mean_current_a : float or None
        Zeroed load cell; motor current.
    battery_voltage_v, battery_current_a : float or None
    """

    period_s: float
    mean_force_n: float | None = None
    mean_current_a: float | None = None
    battery_voltage_v: float | None = None
    battery_current_a: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveEstimate:
    """What is known after a stroke.

    Attributes
    ----------
    k_fc_n_s_per_m, std_n_s_per_m : float
        Mean since the last change of material, and its standard uncertainty.
    statistical_std_n_s_per_m : float
    remaining_s, remaining_std_s : float or None
        Runtime left to the cut-off; None without a battery.
    soc : float or None
    n_strokes : int
        Since the last change of material.
    has_changed : bool
        True at the stroke that a change of material was noticed.
    notes : tuple of str
        Where a fitted battery is used outside of its range; what known effects take for granted.
    """

    k_fc_n_s_per_m: float
    std_n_s_per_m: float
    statistical_std_n_s_per_m: float
    remaining_s: float | None
    remaining_std_s: float | None
    soc: float | None
    n_strokes: int
    has_changed: bool
    notes: tuple[str, ...] = ()


class RecursiveCuttingEstimator:
    """Renew k_Fc and the remaining runtime once a stroke.

    Parameters
    ----------
    plant : PlantConfig
    battery : BatteryConfig, optional
        Needed for the remaining runtime; what it states of its fit widens that.
    converter : ConverterConfig, optional
    duty : float, optional
        Commanded duty; needed for the remaining runtime of a fixed duty.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    sensors : SensorPriors, optional
    start_soc : float
        State of charge before the first stroke.
    effects : TrialEffects, optional
        Known effects; they need a battery, and a duty or a held voltage.

    Examples
    --------
    >>> from sawbench.bench.config import PlantConfig
    >>> plant = PlantConfig(
    ...     resistance_ohm=0.176, inductance_h=0.00321, back_emf_constant_v_s_per_rad=0.007383,
    ...     torque_constant_n_m_per_a=0.005632, rotor_inertia_kg_m2=2.4e-5, yoke_inertia_kg_m2=2.38e-5,
    ...     reciprocating_mass_kg=0.239, crank_radius_m=0.01, motor_damping_n_m_s_per_rad=3.4274e-6,
    ...     gear_ratio=56 / 6)
    >>> live = RecursiveCuttingEstimator(plant=plant)
    >>> for _ in range(10):
    ...     estimate = live.update(StrokeSummary(period_s=0.072, mean_force_n=66.75))
    >>> round(estimate.k_fc_n_s_per_m, 1)
    240.3
    """

    def __init__(
        self,
        *,
        plant: PlantConfig,
        battery: BatteryConfig | None = None,
        converter: ConverterConfig | None = None,
        duty: float | None = None,
        cutting_half: CuttingHalf = "pi_to_2pi",
        sensors: SensorPriors | None = None,
        start_soc: float = 1.0,
        effects: TrialEffects | None = None,
    ) -> None:
        if not 0.0 < start_soc <= 1.0:
            raise InputError(f"start_soc is {start_soc!r}, allowed is above 0 and up to 1")
        self._tables: StrokeTables = stroke_tables(
            plant, battery=battery, converter=converter, duty=duty, cutting_half=cutting_half
        )
        self._plant = plant
        self._sensors = sensors or SensorPriors()
        self._soc = start_soc
        self._battery = battery
        self._models: tuple[EffectTables, ...] = ()
        self._effect_notes: tuple[str, ...] = ()
        if effects is not None and effects.known:
            sign = -1 if cutting_half == "pi_to_2pi" else 1
            baseline = Baseline(plant=plant, battery=battery, cutting_sign=sign, known=tuple(effects.known))
            self._models = models_of(self._tables, baseline, effects.point(converter, duty))
            self._tables = self._models[0].tables
            self._effect_notes = history_note(baseline)
        self._recent: deque[float] = deque(maxlen=KEPT_STROKES)
        self._level = _RunningMean()
        self._current_ratio = _RunningMean()
        self._up = self._down = 0.0
        self._since_up = self._since_down = 0
        self._judged_by = (0.0, 1.0)

    def update(self, stroke: StrokeSummary) -> LiveEstimate:
        """Take one stroke.

        Raises
        ------
        InputError
            If the period is not positive, or the stroke holds neither force nor current.
        """
        if not (math.isfinite(stroke.period_s) and stroke.period_s > 0):
            raise InputError(f"period_s is {stroke.period_s!r}, allowed is a number above 0")
        k_fc, systematic, moved = self._stroke_coefficient(stroke)
        has_changed = self._notice_change(k_fc)
        if not has_changed:
            self._level.add(k_fc)
        self._recent.append(k_fc)
        level = self._level.mean
        statistical = self._level.std_of_mean(ASSUMED_SPREAD * abs(level))
        drawn_a, remaining_s, remaining_std_s = self._remaining(stroke, level, statistical, moved)
        notes = (*self._effect_notes, *self._outside(drawn_a))
        if self._models and level > self._models[0].largest_k_fc:
            remaining_s = remaining_std_s = None
            notes = (*notes, "at this k_Fc the model with its [effects] does not reach the cut-off: no runtime")
        return LiveEstimate(
            k_fc_n_s_per_m=level,
            std_n_s_per_m=math.hypot(statistical, systematic * abs(level), *moved),
            statistical_std_n_s_per_m=statistical,
            remaining_s=remaining_s,
            remaining_std_s=remaining_std_s,
            soc=None if self._tables.capacity_a_s is None else self._soc,
            n_strokes=self._level.count,
            has_changed=has_changed,
            notes=notes,
        )

    def _outside(self, drawn_a: float | None) -> Iterator[str]:
        """Say where the mean battery current, or the cut-off, is outside of what the battery was fitted to."""
        if drawn_a is not None and self._battery is not None:
            yield from outside_range(drawn_a, self._battery)

    def _stroke_coefficient(self, stroke: StrokeSummary) -> tuple[float, float, list[float]]:
        """k_Fc of one stroke, the relative uncertainty that all share, and what each uncertain effect moves it by."""
        if not self._models:
            return *self._bare_coefficient(stroke), []
        voltage_v, k_fc = stroke.battery_voltage_v, self._level.mean
        if voltage_v is None or not math.isfinite(voltage_v):
            voltage_v = self._tables.battery_voltage(k_fc, self._soc)
        found = []
        for model in self._models:
            systematic = 0.0
            for _ in range(MOST_PASSES):
                before = k_fc
                k_fc, systematic = self._bare_coefficient(_without_effects(stroke, model, before, voltage_v))
                if abs(k_fc - before) <= PASS_TOLERANCE * abs(k_fc):
                    break
            found.append((k_fc, systematic))
        (k_fc, systematic), *others = found
        return k_fc, systematic, [other - k_fc for other, _ in others]

    def _bare_coefficient(self, stroke: StrokeSummary) -> tuple[float, float]:
        """k_Fc of one stroke of a saw without effects, and the relative uncertainty that all strokes share."""
        sensors, plant = self._sensors, self._plant
        parts = []
        radius_m = plant.crank_radius_m.nominal
        if stroke.mean_force_n is not None and math.isfinite(stroke.mean_force_n):
            k_fc = stroke.mean_force_n * stroke.period_s / (2.0 * radius_m)
            parts.append((k_fc, math.hypot(sensors.force_gain_rel_std, plant.crank_radius_m.rel_std)))
        if stroke.mean_current_a is not None and math.isfinite(stroke.mean_current_a):
            k_fc = self._tables.from_current(stroke.mean_current_a, stroke.period_s)
            share = self._tables.damping_share(k_fc)
            parts.append(
                (
                    k_fc,
                    math.hypot(
                        (1.0 + share) * sensors.current_gain_rel_std,
                        (1.0 + share) * plant.torque_constant_n_m_per_a.rel_std,
                        2.0 * plant.crank_radius_m.rel_std,
                        share * plant.motor_damping_n_m_s_per_rad.rel_std,
                    ),
                )
            )
        if not parts:
            raise InputError("a stroke needs mean_force_n or mean_current_a")
        weights = [1.0 / max(rel_std, 1e-6) ** 2 for _, rel_std in parts]
        k_fc = sum(w * k for w, (k, _) in zip(weights, parts, strict=True)) / sum(weights)
        return k_fc, 1.0 / math.sqrt(sum(weights))

    def _notice_change(self, k_fc: float) -> bool:
        """Two-sided cumulative sum of innovations; on a change the mean restarts from it."""
        level = self._level
        if level.count < FEWEST_FOR_SCATTER:
            return False
        if max(self._up, self._down) < SUSPICION:
            self._judged_by = (level.mean, self._spread())
        mean, spread = self._judged_by
        innovation = max(-CLIP, min(CLIP, (k_fc - mean) / spread))
        self._up = max(0.0, self._up + innovation - SLACK)
        self._down = max(0.0, self._down - innovation - SLACK)
        self._since_up = self._since_up + 1 if self._up > 0 else 0
        self._since_down = self._since_down + 1 if self._down > 0 else 0
        if max(self._up, self._down) <= THRESHOLD:
            return False
        n_new = min(self._since_up if self._up > THRESHOLD else self._since_down, KEPT_STROKES)
        fresh = _since_change([*self._recent, k_fc][-n_new:], mean)
        self._level = _RunningMean()
        for value in fresh:
            self._level.add(value)
        self._current_ratio = _RunningMean()
        self._up = self._down = 0.0
        self._since_up = self._since_down = 0
        return True

    def _spread(self) -> float:
        """Scatter of a stroke; few strokes lean on the scatter assumed for wood, as if it were that of six more."""
        level = self._level
        measured, assumed = level.effective_std, ASSUMED_SPREAD * abs(level.mean)
        n_assumed = FEWEST_FOR_SCATTER
        pooled = (level.count * measured**2 + n_assumed * assumed**2) / (level.count + n_assumed)
        return max(math.sqrt(pooled), 0.01 * abs(level.mean))

    def _remaining(
        self, stroke: StrokeSummary, level: float, statistical: float, moved: list[float]
    ) -> tuple[float | None, float | None, float | None]:
        """Mean battery current (A) at this k_Fc, runtime left (s) and its standard uncertainty (s)."""
        tables = self._tables
        if tables.capacity_a_s is None:
            return None, None, None
        expected_a = tables.battery_current(level, self._soc)
        drawn_a = expected_a
        if stroke.battery_current_a is not None and math.isfinite(stroke.battery_current_a):
            drawn_a = stroke.battery_current_a
            if expected_a > 0:
                self._current_ratio.add(drawn_a / expected_a)
        is_measured = self._current_ratio.count > 0
        ratio = max(self._current_ratio.mean, 1e-3) if is_measured else 1.0
        self._soc = max(self._soc - drawn_a * stroke.period_s / tables.capacity_a_s, 0.0)
        modelled_s = tables.remaining(level, self._soc)
        stds = [self._battery_std(level), *self._effects_moved(level, moved, is_measured=is_measured)]
        if is_measured:
            spread = self._current_ratio.std_of_mean(ASSUMED_SPREAD)
            stds.append(modelled_s * math.hypot(spread / ratio, self._sensors.current_gain_rel_std))
        else:
            step = max(statistical, 1e-3 * abs(level))
            slope = abs(tables.remaining(level + step, self._soc) - modelled_s) / max(step, 1e-9)
            stds += [slope * statistical, modelled_s * self._plant.torque_constant_n_m_per_a.rel_std]
        return expected_a * ratio, modelled_s / ratio, math.hypot(*stds) / ratio

    def _battery_std(self, level: float) -> float:
        """Of the runtime of a full battery: what its fit misses is charge, which does not shrink as it drains."""
        fitted = None if self._battery is None else self._battery.fitted
        return 0.0 if fitted is None else fitted.runtime_rel_std * self._tables.remaining(level, 1.0)

    def _effects_moved(self, level: float, moved: list[float], *, is_measured: bool) -> list[float]:
        """What a standard uncertainty of each effect moves the runtime by; a measured battery current stays."""
        nominal_s = self._tables.remaining(level, self._soc)
        nominal_a = self._tables.battery_current(level, self._soc)
        changes = []
        for model, by in zip(self._models[1:], moved, strict=True):
            other_a = model.tables.battery_current(level + by, self._soc)
            scale = other_a / nominal_a if is_measured and nominal_a > 0.0 else 1.0
            changes.append(model.tables.remaining(level + by, self._soc) * scale - nominal_s)
        return changes


def _without_effects(stroke: StrokeSummary, model: EffectTables, k_fc: float, voltage_v: float) -> StrokeSummary:
    """Return the stroke as the saw would have made it without its known effects."""
    period_s, force_n, current_a = model.share(k_fc, voltage_v)
    return replace(
        stroke,
        # An effect that is far too strong must not turn time round.
        period_s=max(stroke.period_s - period_s, 0.1 * stroke.period_s),
        mean_force_n=None if stroke.mean_force_n is None else stroke.mean_force_n - force_n,
        mean_current_a=None if stroke.mean_current_a is None else stroke.mean_current_a - current_a,
    )


def _since_change(values: list[float], level_before: float) -> list[float]:
    """Strokes after the change: the split that leaves the least squared deviation from the two levels.

    The cumulative sum leaves zero at the change or, by chance, some strokes before it.
    """
    candidates = range(max(len(values) - 2, 1))
    costs = [
        sum((value - level_before) ** 2 for value in values[:n]) + float(np.var(values[n:])) * (len(values) - n)
        for n in candidates
    ]
    return values[int(np.argmin(costs)) :]


class _RunningMean:
    """Mean, scatter and lag-one correlation of a series, kept in a few numbers (Welford)."""

    __slots__ = ("_cross", "_last", "_squares", "count", "mean")

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._squares = 0.0
        self._cross = 0.0
        self._last = 0.0

    def add(self, value: float) -> None:
        """Take one value."""
        before = self.mean
        self.count += 1
        self.mean += (value - before) / self.count
        self._squares += (value - before) * (value - self.mean)
        if self.count > 1:
            self._cross += (value - self.mean) * (self._last - self.mean)
        self._last = value

    @property
    def std(self) -> float:
        """Standard deviation of one value; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0

    @property
    def correlation(self) -> float:
        """Lag-one correlation, its small-sample bias taken off, 0..0.9."""
        if self.count < FEWEST_FOR_SCATTER or self._squares <= 0:
            return 0.0
        raw = self._cross / self._squares
        return min(max(raw + (1.0 + 3.0 * raw) / self.count, 0.0), 0.9)

    @property
    def effective_std(self) -> float:
        """Standard deviation that a sum of many correlated values behaves as if it had."""
        rho = self.correlation
        return self.std * math.sqrt((1.0 + rho) / (1.0 - rho))

    def std_of_mean(self, assumed: float) -> float:
        """Return the standard uncertainty of the mean; few values lean on `assumed` scatter."""
        if self.count == 0:
            return assumed
        if self.count < FEWEST_FOR_SCATTER:
            return max(self.std, assumed) / math.sqrt(self.count)
        # Student's t against Gauss: (n - 1) / (n - 3) in the variance.
        widening = math.sqrt((self.count - 1) / (self.count - 3))
        return self.effective_std / math.sqrt(self.count) * widening
