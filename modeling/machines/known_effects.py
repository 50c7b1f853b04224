"""The `[effects]` table of a configuration, read against the effects that its machine can show."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from sawbench.bench.errors import ConfigError
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import NAME, LearnedTerm
from sawbench.modeling.machines.learned_entry import learned_entry, read_learned
from sawbench.modeling.machines.table import machine_of

if TYPE_CHECKING:
    from sawbench.bench.config import BenchConfig
    from sawbench.modeling.effects.effect import Effect
    from sawbench.modeling.machines.machine import Machine

# A value this many times outside of what occurs is in another unit.
_FARTHEST: Final = 10.0
# A size that is typical in proportion to the load also occurs on machines that carry this much more or less.
_OTHER_LOADS: Final = 10.0
# A number inside a nonlinear form, as an exponent, makes another machine of it sooner.
_FARTHEST_IN_FORM: Final = 2.0
_SAME: Final = 1e-6
Entry = Mapping[str, Any]


def known_effects(config: BenchConfig, *, path: str, model: Any = None) -> tuple[KnownEffect, ...]:
    """Read the effects that a configuration states as known.

    Parameters
    ----------
    config : BenchConfig
    path : str
        Of its file, for the error.
    model : object, optional
        Baseline of the machine; a linear axis states forms relative to it.

    Returns
    -------
    tuple of KnownEffect
        Empty where there is no `[effects]` table.

    Raises
    ------
    ConfigError
        If the machine has no such effect, a key or a form is not one of the effect's, or a number is not possible.

    Examples
    --------
    >>> from sawbench.modeling.machines.parameter_sets import parameter_set
    >>> config = parameter_set("paper_jigsaw").config
    >>> config = config.model_copy(update={"effects": {"guide_friction": {"force_n": 5.1, "std": 0.4}}})
    >>> [(known.name, known.value, known.std) for known in known_effects(config, path="bench_config.toml")]
    [('guide_friction.force_n', 5.1, 0.4)]
    """
    if not config.effects:
        return ()
    machine = machine_of(config, path=path)
    offered = {effect.name: effect for effect in (*machine.effects(model), *machine.sensor_properties)}
    found = []
    for name, entry in config.effects.items():
        where = f"{path}: [effects] {name}"
        if name == NAME:
            found.append(_learned(entry, machine, where))
            continue
        if name not in offered:
            raise _unknown(name, list(offered), where, machine.title)
        found.append(_known(offered[name], entry, where))
    return tuple(found)


def entry_of(known: KnownEffect) -> dict[str, Any]:
    """Write a known effect as its entry of an `[effects]` table, which `known_effects` reads back."""
    if isinstance(known.effect.signature, LearnedTerm):
        return learned_entry(known)
    entry: dict[str, Any] = {known.effect.strength.name: known.value, "std": known.std}
    if len(_forms(known.effect)) > 1:
        names = (name for name, form in known.effect.form_names.items() if form == known.form)
        entry["form"] = next(names, dict(known.form))
    if len(known.direction) > 1:
        entry["direction"] = list(known.direction)
    return entry | dict(known.scales)


def _learned(entry: Entry, machine: Machine, where: str) -> KnownEffect:
    if machine.frame != "crank":
        raise ConfigError(
            f"a {machine.title} does not support a learned term: its quantities are those of a saw", where=where
        )
    return read_learned(entry, where)


def _unknown(name: str, offered: list[str], where: str, title: str) -> ConfigError:
    if name in EFFECT_BY_NAME:
        lacking = ", ".join(part.replace("_", " ") for part in EFFECT_BY_NAME[name].parts)
        return ConfigError(f"a {title} as configured has no such effect: it needs {lacking}", where=where)
    close = difflib.get_close_matches(name, offered, n=1, cutoff=0.5)
    remedy = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(offered)}"
    return ConfigError("is not an effect of the catalogue", where=where, remedy=remedy)


def _known(effect: Effect, entry: Entry, where: str) -> KnownEffect:
    strength = effect.strength
    allowed = (strength.name, "std", "form", "direction", *effect.scales)
    for key in entry:
        if key not in allowed:
            raise ConfigError(f"unknown key {key!r}", where=where, remedy=f"allowed here: {', '.join(allowed)}")
    if strength.name not in entry:
        raise ConfigError(f"missing key {strength.name!r}, the effect's magnitude in {strength.unit}", where=where)
    known = KnownEffect(
        effect=effect,
        value=_number(entry, strength.name, where),
        std=_number(entry, "std", where) if "std" in entry else 0.0,
        form=_form(effect, entry.get("form"), where),
        scales={key: _number(entry, key, where) for key in effect.scales if key in entry},
    )
    if known.std < 0.0:
        raise ConfigError(f"std must not be negative, got {known.std!r}", where=where)
    for key, scale in known.scales.items():
        if scale <= 0.0:
            raise ConfigError(f"{key} must be above 0, got {scale!r}", where=where)
    _check_value(known, where)
    return replace(known, direction=_direction(known, entry.get("direction"), where))


def _number(entry: Entry, key: str, where: str) -> float:
    value = entry[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{key} must be a finite number, got {value!r}", where=where)
    return float(value)


def _forms(effect: Effect) -> list[dict[str, float]]:
    """Return the forms, each once and without the number that is the strength."""
    found: list[dict[str, float]] = []
    for shape in effect.shapes:
        form = {key: value for key, value in shape.items() if key not in effect.carries}
        if form not in found:
            found.append(form)
    return found


def _form(effect: Effect, stated: Any, where: str) -> dict[str, float]:
    forms = _forms(effect)
    if stated is None:
        return forms[0]
    if isinstance(stated, str):
        if stated not in effect.form_names:
            remedy = _forms_in_words(effect, forms)
            raise ConfigError(f"has no form {stated!r}", where=where, remedy=remedy)
        return dict(effect.form_names[stated])
    if not isinstance(stated, Mapping):
        raise ConfigError(f"form must be a name or a table of numbers, got {stated!r}", where=where)
    numbers = {key: _number(stated, key, where) for key in stated}
    alike = [form for form in forms if form.keys() == numbers.keys()]
    if not alike:
        raise ConfigError(
            f"no form has the numbers {', '.join(numbers) or 'none'}", where=where, remedy=f"forms are {_listed(forms)}"
        )
    listed = next((form for form in alike if all(_is_same(form[k], v) for k, v in numbers.items())), None)
    if listed is not None:
        return listed
    for key, value in numbers.items():
        places = sorted({form[key] for form in alike})
        is_switch = all(place == round(place) for place in places)
        if effect.memories or (is_switch and value not in places) or not places[0] <= value <= places[-1]:
            raise ConfigError(f"no form has {key} = {value!r}", where=where, remedy=f"forms are {_listed(alike)}")
    return numbers


def _forms_in_words(effect: Effect, forms: list[dict[str, float]]) -> str:
    """Say which forms can be stated, by name and as tables of numbers."""
    names, tables = ", ".join(effect.form_names), [form for form in forms if form]
    said = ([f"named forms: {names}"] if names else []) + ([f"tables of numbers: {_listed(tables)}"] if tables else [])
    return "; ".join(said) or "it has one form only: leave out form"


def _is_same(one: float, other: float) -> bool:
    return abs(one - other) <= _SAME * max(abs(one), abs(other), _SAME)


def _listed(forms: list[dict[str, float]]) -> str:
    texts = ["{ " + ", ".join(f"{key} = {value:.4g}" for key, value in form.items()) + " }" for form in forms]
    return ", ".join(texts[:6]) + (f" and {len(texts) - 6} more" if len(texts) > 6 else "")


def _check_value(known: KnownEffect, where: str) -> None:
    effect, strength = known.effect, known.effect.strength
    sizes, farthest = ((1.0, 1.0), _FARTHEST_IN_FORM) if effect.carries else ((strength.low, strength.high), _FARTHEST)
    ends = [effect.reported_strength(strength.typical * size, shape) for shape in effect.shapes for size in sizes]
    most = farthest * (1.0 if strength.follows is None else _OTHER_LOADS) * max(abs(end) for end in ends)
    least = -most if min(ends) < 0.0 else 0.0
    if not least <= known.value <= most:
        raise ConfigError(
            f"{strength.name} = {known.value!r} {strength.unit} is far outside the usual range, {min(ends):.3g} to"
            f" {max(ends):.3g}",
            where=where,
            remedy=f"check the unit, which is {strength.unit}",
        )
    try:
        known.shape  # noqa: B018
    except ValueError as error:
        raise ConfigError(f"{strength.name} = {known.value!r}: {error}", where=where) from error


def _direction(known: KnownEffect, stated: Any, where: str) -> tuple[float, ...]:
    count = known.effect.n_signatures(known.shape)
    if stated is None:
        if count == 1:
            return (1.0,)
        raise ConfigError(
            f"missing key 'direction': {count} numbers, how the signatures of this form share the magnitude",
            where=where,
            remedy="for a sine of phase psi they are [cos(psi), sin(psi)]; improved_model.toml has them",
        )
    values = list(stated) if isinstance(stated, list) else [stated]
    numbers = tuple(_number({"direction": value}, "direction", where) for value in values)
    if len(numbers) != count or not any(numbers):
        raise ConfigError(f"direction must hold {count} numbers that are not all 0, got {stated!r}", where=where)
    return numbers
