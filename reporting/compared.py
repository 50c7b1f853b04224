"""What the comparison page compares: trials with their fits, grouped into series."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from sawbench.bench.units import BATTERY_CURRENT, FORCE, MOTOR_CURRENT
from sawbench.reporting.compared_trial import ComparedTrial
from sawbench.reporting.grouping import Setting, material_names, name_remarks, series_label
from sawbench.reporting.quantities import format_quantity
from sawbench.reporting.rejections import likely_cause
from sawbench.reporting.repetitions import Difference, Estimate, GroupMean, compare_groups, group_mean
from sawbench.reporting.wear import WornTrial, wear_of

_LOSS_REMEDY: Final = (
    "`sawbench info` shows where and why; repair the connection, record the trial again, and move this file to"
    " another folder"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class LeftOut:
    """A recording or one of its values that is not part of the comparison, why, and how to correct it."""

    name: str
    reason: str
    cause: str = ""
    remedy: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Quantity:
    """A column of the comparison."""

    key: str
    label: str
    unit: str

    def written(self, mean: GroupMean) -> str:
        """Return a group's mean with its standard uncertainty and unit."""
        return format_quantity(mean.mean, mean.std, self.unit)


QUANTITIES: Final[tuple[Quantity, ...]] = (
    Quantity(key="stroke_rate_hz", label="Stroke rate", unit="Hz"),
    Quantity(key="peak_force_n", label="Peak force", unit="N"),
    Quantity(key="k_fc_n_s_per_m", label="k_Fc", unit="N·s/m"),
    Quantity(key="rms_motor_current_a", label="RMS motor current", unit="A"),
    Quantity(key="mean_battery_current_a", label="Mean battery current", unit="A"),
    Quantity(key="runtime_s", label="Battery runtime", unit="s"),
)
TESTED: Final = ("peak_force_n", "k_fc_n_s_per_m", "runtime_s")


@dataclass(frozen=True, kw_only=True, slots=True)
class Series:
    """One material with one setting, and its repetitions.

    Attributes
    ----------
    label : str
        The material, with the settings that tell it from other series of the same material.
    material : str
    setting : Setting
    trials : tuple of ComparedTrial
    means : dict of str to GroupMean
        By key of `QUANTITIES`; a quantity that no trial has is absent.
    """

    label: str
    material: str
    setting: Setting
    trials: tuple[ComparedTrial, ...]
    means: dict[str, GroupMean]


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """The series that share a setting, compared with each other.

    Attributes
    ----------
    setting : Setting
    series : tuple of Series
    differences : dict of str to tuple of Difference
        By key of `TESTED`, between the labels of the series; every pair of the block.
    """

    setting: Setting
    series: tuple[Series, ...]
    differences: dict[str, tuple[Difference, ...]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """One block a setting, what was compared, and what was not.

    Attributes
    ----------
    blocks : tuple of Block
    idle : tuple of ComparedTrial
    left_out : tuple of LeftOut
    remarks : tuple of str
        On the names of materials, and on settings that were corrected.
    wear : tuple of WornTrial
    """

    blocks: tuple[Block, ...]
    idle: tuple[ComparedTrial, ...]
    left_out: tuple[LeftOut, ...]
    remarks: tuple[str, ...] = ()
    wear: tuple[WornTrial, ...] = ()

    @property
    def series(self) -> tuple[Series, ...]:
        """All series, in the order of their labels."""
        return tuple(sorted((one for block in self.blocks for one in block.series), key=lambda one: one.label))

    @property
    def is_simulated(self) -> bool:
        """Whether any trial that is shown comes from the simulated bench."""
        shown = [trial for series in self.series for trial in series.trials] + list(self.idle)
        return any("simulated" in trial.processed.trial.source for trial in shown)


# Quantities read off one channel, with the gain of its sensor: not shown where that channel is doubted.
_CHANNEL_OF: Final = {
    "peak_force_n": FORCE.name,
    "rms_motor_current_a": MOTOR_CURRENT.name,
    "mean_battery_current_a": BATTERY_CURRENT.name,
}


def estimates_of(trial: ComparedTrial) -> dict[str, Estimate]:
    """Return the quantities that a trial has, by key of `QUANTITIES`.

    A fit or a runtime whose status is not "ok" gives nothing, nor does a channel that is clipped, swapped,
    reversed or in another unit.
    """
    processed, found = trial.processed, {}
    if processed.period is not None:
        period = processed.period
        rate_std_hz = period.period_std_s / period.period_s**2
        found["stroke_rate_hz"] = Estimate(value=period.rate_hz, statistical_std=rate_std_hz)
    if processed.peak_force_n is not None:
        found["peak_force_n"] = Estimate(
            value=processed.peak_force_n, statistical_std=processed.peak_force_std_n or 0.0
        )
    if trial.fit is not None and trial.fit.status == "ok":
        fit = trial.fit
        common = math.sqrt(max(0.0, fit.std_n_s_per_m**2 - fit.statistical_std_n_s_per_m**2))
        found["k_fc_n_s_per_m"] = Estimate(
            value=fit.k_fc_n_s_per_m, statistical_std=fit.statistical_std_n_s_per_m, common_std=common
        )
    if MOTOR_CURRENT.name in processed.rms_values:
        found["rms_motor_current_a"] = Estimate(value=processed.rms_values[MOTOR_CURRENT.name])
    if BATTERY_CURRENT.name in processed.mean_values:
        found["mean_battery_current_a"] = Estimate(value=processed.mean_values[BATTERY_CURRENT.name])
    if trial.runtime is not None and trial.runtime.status == "ok":
        found["runtime_s"] = Estimate(value=trial.runtime.runtime_s, common_std=trial.runtime.std_s)
    for key, channel in _CHANNEL_OF.items():
        if key in found:
            gain_std = trial.gain_rel_std.get(channel, 0.0) * abs(found[key].value)
            found[key] = replace(found[key], common_std=gain_std)
    return {
        key: estimate
        for key, estimate in found.items()
        if math.isfinite(estimate.value) and not (key in _CHANNEL_OF and processed.doubts(_CHANNEL_OF[key]))
    }


def compare(rows: Sequence[ComparedTrial], left_out: Sequence[LeftOut] = ()) -> Comparison:
    """Group trials into series and compare the series.

    Parameters
    ----------
    rows : sequence of ComparedTrial
        Any order; the result does not depend on it.
    left_out : sequence of LeftOut
        Recordings that did not get this far.

    Returns
    -------
    Comparison
        Every row is in it: in a series, among the idle trials, or left out with its reason.
    """
    ordered = sorted(rows, key=lambda row: (row.processed.trial.repetition or 0, row.name))
    missing = list(left_out)
    kept: list[ComparedTrial] = []
    for row in ordered:
        if row.left_out_because:
            remedy = _LOSS_REMEDY if row.processed.losses else ""
            missing.append(LeftOut(name=row.name, reason=row.left_out_because, remedy=remedy))
        elif not row.is_idle:
            kept.append(row)
            missing += _values_left_out(row)
    names = material_names(row.processed.trial.material or "" for row in kept)
    idle = tuple(row for row in ordered if row.is_idle)
    return Comparison(
        blocks=_blocks(kept, names),
        idle=idle,
        left_out=tuple(missing),
        remarks=(*name_remarks(names), *_amended(rows)),
        wear=wear_of(ordered, names),
    )


def _amended(rows: Sequence[ComparedTrial]) -> tuple[str, ...]:
    """Say which trials are compared with settings that were corrected after the recording."""
    named = sorted((row.name, words) for row in rows for words in row.processed.trial.amendments)
    return tuple(f"{name} corrected: {words}" for name, words in named)


def _blocks(trials: Sequence[ComparedTrial], names: dict[str, str]) -> tuple[Block, ...]:
    """One block a setting; a label names only the settings that differ within the material."""
    groups: dict[Setting, dict[str, list[ComparedTrial]]] = {}
    for row in trials:
        trial = row.processed.trial
        groups.setdefault(Setting.of(trial), {}).setdefault(names[trial.material or ""], []).append(row)
    settings = {name: [one for one, group in groups.items() if name in group] for name in names.values()}
    blocks = []
    for setting in sorted(groups, key=lambda one: one.order):
        series = tuple(
            _series(series_label(name, setting, settings[name]), name, setting, groups[setting][name])
            for name in sorted(groups[setting])
        )
        blocks.append(Block(setting=setting, series=series, differences=_differences(series)))
    return tuple(blocks)


def _differences(series: Sequence[Series]) -> dict[str, tuple[Difference, ...]]:
    found = {}
    for key in TESTED:
        means = {one.label: one.means[key] for one in series if key in one.means}
        if len(means) > 1:
            found[key] = compare_groups(
                {label: mean.values for label, mean in means.items()},
                common_rel_std=max(means.values(), key=lambda mean: abs(mean.mean)).common_rel_std,
            )
    return found


def _values_left_out(row: ComparedTrial) -> list[LeftOut]:
    """Say which of a trial's results are missing or not reliable."""
    found = []
    if row.fit is None:
        found.append(LeftOut(name=row.name, reason=f"no k_Fc: {row.note or 'it was not fitted'}"))
    elif row.fit.status != "ok":
        cause, remedy = likely_cause(row.processed, row.fit)
        reason = f"k_Fc not used: {FIT_STATUS_WORDS[row.fit.status]}"
        found.append(LeftOut(name=row.name, reason=reason, cause=cause, remedy=remedy))
    doubts = row.processed.doubts(*(name for names in _CHANNEL_OF.values() for name in names))
    found += [LeftOut(name=row.name, reason=f"values of this channel not used: {text}") for text in doubts]
    if row.runtime is not None and row.runtime.status != "ok":
        found.append(LeftOut(name=row.name, reason=f"runtime not used: {RUNTIME_STATUS_WORDS[row.runtime.status]}"))
    elif row.runtime is None and row.fit is not None and row.fit.status == "ok":
        found.append(LeftOut(name=row.name, reason=f"no runtime: {row.note or 'it was not computed'}"))
    return found


FIT_STATUS_WORDS: Final = {
    "ok": "fitted",
    "at_bound": "the fit ended at the edge of the allowed range",
    "not_identifiable": "the signals do not determine it",
    "not_converged": "the fit did not converge",
    "stalled": "the model stalls with these parameters",
    "contradicted": "a channel or the configuration contradicts the model",
}
RUNTIME_STATUS_WORDS: Final = {
    "ok": "computed",
    "stalled": "the model stalls before the battery is empty",
    "cannot_start": "the motor cannot start against this force",
    "never_reached": "the cut-off is never reached",
}


def _series(label: str, material: str, setting: Setting, trials: Sequence[ComparedTrial]) -> Series:
    estimates = [estimates_of(row) for row in trials]
    means = {}
    for quantity in QUANTITIES:
        known = [found[quantity.key] for found in estimates if quantity.key in found]
        if known:
            means[quantity.key] = group_mean(known)
    return Series(label=label, material=material, setting=setting, trials=tuple(trials), means=means)


def comparison_json(rows: Sequence[ComparedTrial], left_out: Sequence[LeftOut] = ()) -> dict[str, Any]:
    """Return the comparison as plain values for `json.dumps`: series, differences, idle and left out."""
    from dataclasses import asdict

    found = compare(rows, left_out)
    return {
        "schema_version": 1,
        "series": [
            {
                "label": one.label,
                "trials": [trial.name for trial in one.trials],
                "means": {key: asdict(mean) for key, mean in one.means.items()},
            }
            for one in found.series
        ],
        "differences": {
            key: [asdict(d) for block in found.blocks for d in block.differences.get(key, ())]
            for key in TESTED
            if any(key in block.differences for block in found.blocks)
        },
        "blocks": [
            {"setting": asdict(block.setting), "series": [one.label for one in block.series]} for block in found.blocks
        ],
        "remarks": list(found.remarks),
        "wear": [{**asdict(one), "is_worn": one.is_worn} for one in found.wear],
        "idle": [trial.name for trial in found.idle],
        "left_out": [asdict(item) for item in found.left_out],
        "is_simulated": found.is_simulated,
    }
