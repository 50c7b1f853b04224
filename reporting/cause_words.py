"""Causes in the words of the workshop, as every effect of the catalogue states them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from sawbench.bench.plain_digits import fitting_unit
from sawbench.diagnosis.inference.settings import Z95
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.machines.words import SAW, MachineWords, words_of
from sawbench.reporting.quantities import format_quantity

# Magnitudes whose unit is a rate: name -> words, unit, factor.
_RATES: Final = {
    "torque_at_1000_rad_s_n_m": ("torque at 1000 rad/s", "N*m", 1.0),
    "drift_n_per_1000_s": ("drift", "N per 1000 s", 1.0),
    "growth_per_10_m": ("growth", "% per 10 m of blade travel", 100.0),
}
# What stands before the word for a period of the motion, where that is meant.
_OF_CYCLES: Final = ("simulated", "mean", "single", "harmonic of the", "One", "with the")
_SUFFIX: Final = {
    "N": "_n", "N*m": "_n_m", "K/W": "_k_per_w", "Ohm": "_ohm", "s": "_s", "m": "_m", "N/m": "_n_per_m",
    "N*s/m": "_n_s_per_m", "Hz": "_hz", "V": "_v",
}  # fmt: skip


def name_of(effect: str) -> str:
    """Write an identifier as words.

    Examples
    --------
    >>> name_of("guide_friction")
    'guide friction'
    """
    return effect.replace("_", " ")


def what_happens(effect: str) -> str:
    """Say in plain words what an effect is; its name where the catalogue does not hold it."""
    known = EFFECT_BY_NAME.get(effect)
    return name_of(effect) if known is None or known.words is None else known.words.happens


def what_to_do(effect: str) -> str:
    """Say what to do about it, and what to measure first; empty where the catalogue does not hold it."""
    known = EFFECT_BY_NAME.get(effect)
    if known is None or known.words is None:
        return ""
    return f"{known.words.mend}. To make sure, measure {known.words.measure}"


def is_undetermined(ends: Sequence[float]) -> bool:
    """Whether too little was withheld for a 95 % interval: its ends are then -1 and 1."""
    return tuple(ends) == (-1.0, 1.0)


def interval_words(ends: Sequence[float]) -> str:
    """95 % interval of a closed share in per cent.

    Parameters
    ----------
    ends : sequence of float
        -1 and 1 where too little was withheld for an interval.

    Examples
    --------
    >>> interval_words([0.81, 0.97]), interval_words([-1.0, 1.0])
    ('81 to 97 %', 'not determined')
    """
    low, high = (round(100 * end) for end in ends)
    return "not determined" if is_undetermined(ends) else f"{low} to {high} %"


def withheld_words(report: Mapping[str, Any]) -> str:
    """What the errors of a gap report, or of its learned term, were measured at; older reports do not say it."""
    held_out = report.get("held_out", report.get("detail", {}).get("held_out", "operating points"))
    return "at the trial of the fit" if held_out == "nothing" else f"at withheld {held_out}"


def improved_command(report: Mapping[str, Any], path: str) -> str:
    """Command line that takes the improved model of a gap report: a saw has a runtime, another machine has none.

    Examples
    --------
    >>> improved_command({"detail": {"frame": "linear_axis"}}, "improved_model.toml")
    'sawbench diagnose RECORDINGS --config improved_model.toml --out gap-2'
    """
    if report.get("detail", {}).get("frame") is None:
        return f"sawbench runtime RECORDING --config {path}"
    return f"sawbench diagnose RECORDINGS --config {path} --out gap-2"


def in_words_of(report: Mapping[str, Any], text: str) -> str:
    """Write a text of a gap report in the words of the machine that it is about.

    Parameters
    ----------
    report : mapping
        Its `detail` names the machine's frame, unless that is a saw's.
    text : str
        With the words of a saw.

    Examples
    --------
    >>> in_words_of({"detail": {"frame": "linear_axis"}}, "Gap: yoke backlash at crank angles 0 to 20°")
    'Gap: backlash at phases of the cycle 0 to 20°'
    """
    frame = report.get("detail", {}).get("frame")
    if frame is None:
        return text
    pairs = _of_motion(words_of(frame))
    for effect in EFFECT_BY_NAME.values():
        here = effect.words_on.get(frame)
        if here is None or effect.words is None:
            continue
        for was, now in ((effect.words.happens, here.happens), (effect.words.measure, here.measure)):
            pairs += [(was, now), (_sentence(was), _sentence(now))]
        pairs += [(_sentence(effect.words.mend), _sentence(here.mend))]
        pairs += [(name_of(effect.name), here.name)] if here.name else []
    for was, now in pairs:
        text = text.replace(was, now)
    return text


def _of_motion(words: MachineWords) -> list[tuple[str, str]]:
    """What a saw's report says of its cycle, and what it is here; a stroke by itself is the travel of an axis."""
    pairs = [(SAW.angles, words.angles), (SAW.angle, words.angle), (_sentence(SAW.angle), _sentence(words.angle))]
    pairs += [(f"{which} {SAW.cycle}", f"{which} {words.cycle}") for which in _OF_CYCLES]
    return [*pairs, (SAW.rate, words.rate)]


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


def equations_of(effects: Iterable[str]) -> set[str]:
    """Return the equations of the report in which effects act; none for what the catalogue does not hold."""
    return {EFFECT_BY_NAME[effect].place for effect in effects if effect in EFFECT_BY_NAME}


def magnitude_words(name: str, parameter: Mapping[str, Any]) -> str:
    r"""Write a magnitude of the report with its standard uncertainty and unit.

    Examples
    --------
    >>> magnitude_words("edge_force.force_n", {"value": 8.31, "std": 0.42, "unit": "N"})
    'edge force: force 8.31\xa0±\xa00.42\xa0N'
    >>> magnitude_words("gap_m", {"value": 0.0057, "std": 0.0004, "unit": "m"})
    'gap 5.70\xa0±\xa00.40\xa0mm'
    """
    words, unit, factor = _words_of_magnitude(name, parameter)
    value, std = factor * parameter["value"], None if parameter["std"] is None else factor * parameter["std"]
    unit, factor = fitting_unit(value, unit)
    value, std = factor * value, None if std is None else factor * std
    return f"{words} {format_quantity(value, std, '' if unit == '1' else unit.replace('*', '·'), digits=3)}"


def _words_of_magnitude(name: str, parameter: Mapping[str, Any]) -> tuple[str, str, float]:
    """What a magnitude is called, after the effect where that is told, its unit, and the factor to it."""
    effect, _, name = name.rpartition(".")
    words, unit, factor = _RATES.get(name) or (
        name_of(name.removesuffix(_SUFFIX.get(parameter["unit"], ""))), parameter["unit"], 1.0
    )  # fmt: skip
    return f"{name_of(effect)}: {words}" if effect else words, unit, factor


def strength_words(cause: Mapping[str, Any], limits: Mapping[str, Any], *, is_named: bool) -> list[str]:
    """Write the magnitudes of a cause; of one that is not named, those alone whose 95 % interval excludes no effect.

    Parameters
    ----------
    cause : mapping
        Of the report.
    limits : mapping
        `detail.detection_limits` of the report: what the parameter of an effect is without it.
    is_named : bool
        Whether the verdict names the cause: its magnitude is there.
    """
    of_cause = [limits[effect] for effect in cause["effects"] if effect in limits]
    absent = {limit["name"]: limit["without_effect"] or 0.0 for limit in of_cause}
    said = []
    for name, one in cause["parameters"].items():
        without = absent.get(name.rpartition(".")[2], 0.0)
        is_open = one["std"] is not None and abs(one["value"] - without) < Z95 * one["std"]
        if is_open and not is_named:
            said.append(f"{_words_of_magnitude(name, one)[0]} not determined")
        else:
            said.append(magnitude_words(name, one))
    return said


def limit_words(limit: Mapping[str, Any]) -> str:
    r"""Write the smallest magnitude of an effect that a campaign shows.

    Examples
    --------
    >>> limit_words({"name": "force_n", "unit": "N", "change": 2.0, "without_effect": 0.0})
    'force 2.00\xa0N'
    >>> limit_words({"name": "stiffness_n_per_m", "unit": "N/m", "change": 5e5, "without_effect": None})
    'stiffness 500000\xa0N/m or less'
    >>> limit_words({"name": "exponent", "unit": "1", "change": 0.2, "without_effect": 1.0})
    'exponent 0.200 away from 1'
    """
    words = magnitude_words(limit["name"], {**limit, "value": limit["change"], "std": None})
    without = limit["without_effect"]
    if without is None:
        return f"{words} or less"
    return f"{words} away from {without:g}" if without else words
