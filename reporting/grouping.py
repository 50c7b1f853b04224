"""Which trials may be compared: those at one setting; and which names mean one material."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType
from typing import Final

from sawbench.bench.recording import Trial

# Names of materials that are so similar are asked about (`difflib`'s ratio).
_SIMILAR: Final = 0.8


# How many a setting is shown with.
_DIGITS: Final = MappingProxyType({"duty": ".4g", "feed_mm_s": "g", "thickness_mm": "g"})


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """How a trial was run; None where nobody said."""

    duty: float | None
    feed_mm_s: float | None
    thickness_mm: float | None

    @classmethod
    def of(cls, trial: Trial) -> Setting:
        """Return the setting of a trial, to the digits that are shown: trials that read alike are at one setting."""
        stated = {name: getattr(trial, name) for name in _DIGITS}
        return cls(**{n: None if value is None else float(f"{value:{_DIGITS[n]}}") for n, value in stated.items()})

    @property
    def label(self) -> str:
        """All three in words."""
        return ", ".join(
            f"{name} not stated" if value is None else form.format(value)
            for name, value, form in (
                ("duty", self.duty, "duty {:g}"),
                ("feed", self.feed_mm_s, "feed {:g} mm/s"),
                ("thickness", self.thickness_mm, "{:g} mm thick"),
            )
        )

    @property
    def order(self) -> tuple[float, ...]:
        """Sort by duty, feed and thickness; what nobody said comes last."""
        values = (self.duty, self.feed_mm_s, self.thickness_mm)
        return tuple(float("inf") if value is None else value for value in values)


def series_label(material: str, setting: Setting, settings: Sequence[Setting]) -> str:
    """Name a series: its material, and what of its setting differs among those of the material.

    Parameters
    ----------
    material : str
    setting : Setting
    settings : sequence of Setting
        All settings at which the material was cut.

    Examples
    --------
    >>> thin, thick = (Setting(duty=0.4, feed_mm_s=4.0, thickness_mm=mm) for mm in (20.0, 27.0))
    >>> series_label("oak", thin, [thin, thick])
    'oak, 20 mm'
    """
    parts = [material]
    for name, form in (("thickness_mm", "{:g} mm"), ("feed_mm_s", "{:g} mm/s"), ("duty", "duty {:g}")):
        if len({getattr(one, name) for one in settings}) > 1:
            value = getattr(setting, name)
            parts.append(f"{name.partition('_')[0]} not stated" if value is None else form.format(value))
    return ", ".join(parts)


def material_key(name: str) -> str:
    """Return what two spellings of one material have in common.

    Examples
    --------
    >>> material_key(" Black_Locust") == material_key("black locust")
    True
    """
    return re.sub(r"[\s_-]+", " ", name).strip().casefold()


def material_names(materials: Iterable[str]) -> dict[str, str]:
    """Give every spelling of a material one name: the most frequent spelling, of equals the first in the alphabet.

    Parameters
    ----------
    materials : iterable of str
        Of all trials, as they were entered.

    Returns
    -------
    dict
        Spelling to name.

    Examples
    --------
    >>> material_names(["Oak", "oak", "oak", "nylon"])
    {'Oak': 'oak', 'nylon': 'nylon', 'oak': 'oak'}
    """
    counts = Counter(materials)
    best: dict[str, str] = {}
    for name in sorted(counts, key=lambda spelling: (-counts[spelling], spelling)):
        best.setdefault(material_key(name), name)
    return {name: best[material_key(name)] for name in sorted(counts)}


def name_remarks(names: dict[str, str]) -> list[str]:
    """Say which spellings were taken for one material, and ask about names that are nearly the same.

    Parameters
    ----------
    names : dict
        As `material_names` returns it.

    Examples
    --------
    >>> name_remarks({"Oak": "oak", "oak": "oak"})
    ['Treated as one material: Oak, oak.']
    """
    said = []
    shown = sorted(set(names.values()))
    for name in shown:
        spellings = [spelling for spelling, of in names.items() if of == name]
        if len(spellings) > 1:
            said.append(f"Treated as one material: {', '.join(spellings)}.")
    said += [
        f"Are {first} and {second} the same material? They are compared as two; if they are the same, correct the name."
        for first, second in _similar(shown)
    ]
    return said


def _similar(names: Sequence[str]) -> list[tuple[str, str]]:
    return [
        (first, second)
        for first, second in combinations(names, 2)
        if difflib.SequenceMatcher(None, material_key(first), material_key(second)).ratio() >= _SIMILAR
    ]
