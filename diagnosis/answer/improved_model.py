"""The configuration with what was found: parameters as the campaign re-tunes them, and the effects of the cause.

One least-squares solution states all of it, each parameter held by its stated uncertainty, so that parameters,
sensors and effects fit together: a torque constant that was found beside a force sensor that reads 0.5 % high predicts
the current beside that sensor only. An uncertainty of a parameter stays what the configuration grants it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from sawbench.bench.config import MOST_REL_STD, BatteryConfig, LoadedConfig, SensorConfig
from sawbench.bench.plain_digits import rounded
from sawbench.bench.recording import Floats
from sawbench.bench.toml_writing import toml_text
from sawbench.diagnosis.answer.learned_term import LearnedAnswer
from sawbench.diagnosis.inference.battery_curve import SeenCurve
from sawbench.diagnosis.inference.dispersion import noise_factor_beside, stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.size import number_of_form
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import NAME
from sawbench.modeling.machines.known_effects import entry_of
from sawbench.modeling.machines.learned_entry import learned_entry

# What the fit calls gain and offset of a channel. The zero of the force wanders and is found in every trial.
_SENSORS: Final[Mapping[str, tuple[str, str | None]]] = MappingProxyType(
    {
        "force_n": ("force_gain", None),
        "motor_current_a": ("motor_current_gain", "motor_current_offset_a"),
        "battery_current_a": ("battery_current_gain", "battery_current_offset_a"),
        "battery_voltage_v": ("battery_voltage_gain", "battery_voltage_offset_v"),
    }
)


_CHANNEL_OF: Final[Mapping[str, str]] = MappingProxyType(
    {"peak_force_n": "force_n", "top_current_a": "motor_current_a"}
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Solution:
    """Nuisances in units of their prior standard deviation, how far they may move, and the cause's columns."""

    names: tuple[str, ...]
    values: Floats
    stds: Floats
    width: Floats
    reach: Floats
    amplitudes: Floats

    def shift(self, name: str | None) -> float:
        """How far a nuisance moves, in its own unit; 0 where the campaign has none of that name."""
        if name not in self.names:
            return 0.0
        k = self.names.index(name)
        return float(np.clip(self.values[k] * self.width[k], -self.reach[k], self.reach[k]))


def improved_model(
    problem: LinearProblem,
    posterior: Posterior,
    members: Sequence[Explanation],
    causes: Sequence[Mapping[str, Any]],
    loaded: LoadedConfig,
    learned: LearnedAnswer | None = None,
) -> str | None:
    """Write the configuration that holds what was found.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
    members : sequence of Explanation
        Of the likeliest cause, with the magnitudes that the report states.
    causes : sequence of mapping
        Of the report; the first one is what is written where effects are claimed.
    loaded : LoadedConfig
        As the campaign was diagnosed with.
    learned : LearnedAnswer, optional
        The term that was learned in place of a cause.

    Returns
    -------
    str or None
        TOML; None where the cause is unknown and no term was learned: re-tuning alone would hide the gap.
    """
    if posterior.verdict == "unknown" and learned is None:
        return None
    if learned is None:
        found = retuned_with(problem, members, freed=posterior.freed if posterior.verdict == "parameters" else ())
    else:
        found = _solve(problem, learned.learned.columns, ())
    tables = tomllib.loads(loaded.text.removeprefix("\ufeff"))
    n_trials = len({part.setting.label for part in problem.parts})
    comments: dict[tuple[str, ...], tuple[str, ...]] = {
        (): (
            f"Written by `sawbench diagnose` from {n_trials} trials. Parameters are re-tuned within their stated",
            f"uncertainty; they were diagnosed with {Path(loaded.path).name}, sha256 {loaded.sha256[:12]}.",
        )
    }
    tables = _retuned(tables, problem, found)
    # A learned term is a function of readings as they are.
    sensors = {} if learned is not None else sensors_of(loaded, found)
    if sensors:
        tables["sensors"] = sensors
        comments["sensors",] = (
            "what the sensors read, as this campaign tells: gain times the true value, plus offset",
        )
    effects: dict[str, Any] = {}
    for known in problem.campaign.plant.known:
        again = _sharpened(known, found)
        effects[known.effect.name] = entry_of(again if learned is not None else with_true_scales(again, found))
        is_of_sensor = known.effect in problem.campaign.plant.machine.sensor_properties
        said = "property of the sensor" if is_of_sensor else "known effect"
        comments["effects", known.effect.name] = (f"{said}; magnitude estimated from this campaign",)
    for known in [] if learned is not None else _found_effects(problem, posterior, members, found):
        effects[known.effect.name] = entry_of(with_true_scales(known, found))
        cause = causes[0]
        closes = _closes(cause["gap_closed"], cause["gap_closed_ci95"])
        comments["effects", known.effect.name] = (
            f"named with {cause['probability']:.0%}; {closes} of the gap that remains after re-tuning",
        )
    if learned is not None:
        effects[NAME] = learned_entry(learned.known)
        closes = _closes(*learned.ladder.closed)
        comments["effects", NAME] = (
            f"a learned term, {learned.words()}",
            f"{closes} of the gap after re-tuning at withheld operating points; it must not be used outside the range"
            " of its nodes",
        )
    return toml_text({**tables, "effects": effects} if effects else tables, comments)


def _closes(share: float, ends: Sequence[float]) -> str:
    low, high = ends
    is_open = (low, high) == (-1, 1)
    interval = "no interval: too near to the noise, or too few trials" if is_open else f"{low:.0%} to {high:.0%}"
    return f"closes {share:.0%} ({interval})"


def retuned_with(problem: LinearProblem, members: Sequence[Explanation], *, freed: Collection[str] = ()) -> Solution:
    """Fit the parameters, and the sizes of the effects of a cause, to all trials.

    Parameters
    ----------
    problem : LinearProblem
    members : sequence of Explanation
        Empty where there is no cause.
    freed : collection of str
        Numbers of the plant that may move beyond what is stated of them.
    """
    columns = [m.column.of_any_size for m in members]
    return _solve(problem, np.hstack(columns) if columns else None, freed)


def _solve(problem: LinearProblem, columns: Floats | None, freed: Collection[str]) -> Solution:
    """Fit by the noise that this very fit leaves: by that of an ideal form, a strong cause overrides every prior."""
    scale = problem.scale_of(freed)
    given = np.zeros((len(problem.data), 0)) if columns is None else columns
    noise = noise_factor_beside(problem, given, scale=scale)
    extra = stacked_with_noise(problem, [given], noise)
    values, stds = Marginal(with_noise(problem, noise), scale=scale, extra=extra).estimate()
    n = len(problem.names)
    width = scale * problem.prior_std
    farthest = np.where(scale > 1.0, SETTINGS.ladder.farthest, SETTINGS.ladder.farthest_stated)
    return Solution(
        names=problem.names, values=values[:n], stds=stds[:n], width=width, reach=farthest * width,
        amplitudes=values[n:],
    )  # fmt: skip


def _retuned(tables: Mapping[str, Any], problem: LinearProblem, found: Solution) -> dict[str, Any]:
    """Tables with the parameters that moved, and the battery's curve; their absolute standard uncertainty stays."""
    out = {name: dict(table) if isinstance(table, Mapping) else table for name, table in tables.items()}
    for nuisance in problem.campaign.plant.nuisances():
        if not nuisance.is_plant or nuisance.name not in found.names:
            continue
        shift = found.shift(nuisance.name)
        if abs(shift) < SETTINGS.report.least_move * nuisance.std:
            continue
        table = _table_of(nuisance.name, out)
        value = float(f"{nuisance.nominal + shift:.6g}")
        stated = out[table].get(nuisance.name)
        if nuisance.name in BatteryConfig.model_fields:
            out[table][nuisance.name] = max(value, 0.0)
            continue
        rel_std = stated.get("rel_std", 0.0) if isinstance(stated, Mapping) else 0.0
        std = rel_std * abs(nuisance.nominal)
        # What is re-tuned to nothing, or beyond, becomes as small as a configuration can state it.
        value = max(value, float(f"{std / MOST_REL_STD:.6g}"))
        if value > 0.0:
            out[table][nuisance.name] = {"nominal": value, "rel_std": float(f"{std / value:.4g}")}
    shapes = [n for n in problem.campaign.plant.nuisances() if n.is_curve]
    if any(abs(found.shift(n.name)) >= SETTINGS.report.least_move * n.std for n in shapes):
        seen = SeenCurve.of([part.state for part in problem.parts])
        deviations_v = {n.name: found.shift(n.name) for n in shapes}
        out["battery"] = seen.table(problem.campaign.baseline.battery, out["battery"], deviations_v)
    return out


def sensors_of(loaded: LoadedConfig, found: Solution) -> dict[str, Any]:
    """Table `[sensors]`: what the configuration states of each channel, and what the campaign adds to that.

    Parameters
    ----------
    loaded : LoadedConfig
    found : Solution
    """
    known, table = loaded.config.sensors, {}
    for channel in _SENSORS:
        more = _read_by(found, channel)
        reads = known.get(channel, SensorConfig()).after(more.gain, more.offset)
        if reads != SensorConfig():
            table[channel] = {"gain": float(f"{reads.gain:.6g}"), "offset": float(f"{reads.offset:.4g}")}
    return {name: one.model_dump() for name, one in known.items()} | table


def _table_of(name: str, tables: Mapping[str, Any]) -> str:
    if "linear_axis" in tables:
        return "linear_axis"
    return "battery" if name in BatteryConfig.model_fields else "plant"


def _sharpened(known: KnownEffect, found: Solution) -> KnownEffect:
    """Return an effect that was known before with the magnitude and the uncertainty that the campaign leaves it."""
    if known.name not in found.names or known.std <= 0.0:
        return known
    k = found.names.index(known.name)
    value = known.value + float(found.values[k]) * known.std
    is_possible = value > 0.0 or known.value < 0.0
    return replace(known, value=rounded(value), std=rounded(float(found.stds[k]) * known.std)) if is_possible else known


def found_effects(problem: LinearProblem, posterior: Posterior, members: Sequence[Explanation]) -> list[KnownEffect]:
    """Effects of the likeliest cause as a model can hold them.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
    members : sequence of Explanation
        With the magnitudes that the report states.
    """
    return _found_effects(problem, posterior, members, retuned_with(problem, members))


def _found_effects(
    problem: LinearProblem, posterior: Posterior, members: Sequence[Explanation], found: Solution
) -> list[KnownEffect]:
    known, start = [], 0
    for member in members:
        effect, count = member.effect, member.column.columns.shape[1]
        sizes = found.amplitudes[start : start + count] * effect.strength.high
        start += count
        stated, std = member.strength, stated_std(problem, member)
        value = effect.reported_strength(effect.amplitude(sizes) * effect.strength.typical, member.column.shape)
        is_by_strokes = effect.name in posterior.strokes and posterior.strokes[effect.name].alone > 0.0
        is_whole_form = number_of_form(member.column) is not None
        if is_by_strokes or is_whole_form or (count == 1 and sizes[0] <= 0.0):
            value = stated
        carried = [key for key in effect.carries if key in member.column.shape]
        known.append(
            KnownEffect(
                effect=effect,
                value=rounded(value),
                std=rounded(float(np.hypot(std, value - stated))),
                form={key: number for key, number in member.column.shape.items() if key not in carried},
                direction=(1.0,) if count == 1 else tuple(rounded(s) for s in sizes / np.abs(sizes).max()),
                scales={name: rounded(_scale(problem, name)) for name in effect.scales},
            )
        )
    return known


def magnitudes(problem: LinearProblem, members: Sequence[Explanation]) -> dict[str, dict[str, Any]]:
    """State the magnitudes of a cause as the report does.

    Parameters
    ----------
    problem : LinearProblem
    members : sequence of Explanation
        With the magnitudes that the report states.

    Returns
    -------
    dict of str to dict
        By the name of the effect's parameter, that of the effect before it (`edge_force.force_n`) where two have one of
        the same name: `value`, `std`, `unit`.
    """
    plain = [m.effect.strength.name for m in members]
    return {
        name if plain.count(name) == 1 else f"{m.effect.name}.{name}": {
            "value": m.strength, "std": stated_std(problem, m), "unit": m.effect.strength.unit,
        }
        for name, m in zip(plain, members, strict=True)
    }  # fmt: skip


def stated_std(problem: LinearProblem, member: Explanation) -> float:
    """Return the standard uncertainty of a magnitude, that of the scale which all forces share included."""
    return float(np.hypot(member.strength_std, problem.campaign.plant.scale_rel_std * member.strength))


def with_true_scales(known: KnownEffect, found: Solution) -> KnownEffect:
    """Return an effect whose form is stated relative to true values, beside a table of what the sensors read.

    Parameters
    ----------
    known : KnownEffect
        Relative to values as this campaign takes them.
    found : Solution
    """

    def true(name: str, value: float) -> float:
        if name not in _CHANNEL_OF:
            return value
        return rounded(float(_read_by(found, _CHANNEL_OF[name]).true(np.array(value))))

    return replace(known, scales={name: true(name, value) for name, value in known.scales.items()})


def _scale(problem: LinearProblem, name: str) -> float:
    """What the forms of this campaign are stated relative to."""
    model = problem.campaign.plant.model
    return float(getattr(model, name) if hasattr(model, name) else getattr(problem.parts[0].state, name))


def _read_by(found: Solution, channel: str) -> SensorConfig:
    gain, offset = _SENSORS[channel]
    return SensorConfig().after(1.0 + found.shift(gain), found.shift(offset))
