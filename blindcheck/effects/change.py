"""What an effect does to the plant and to the sensors."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

Forms = Literal["own", "plain"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """What an effect may know about the campaign it is put into.

    Attributes
    ----------
    seed : int
        Of the campaign.
    peak_force_n : float
        Peak cutting force at the middle duty without any effect.
    usual_limit_a : float
        Motor current at which an electronic limiter of typical size acts.
    forms : {"own", "plain"}
        "own": the functional forms of this package; "plain": textbook forms, for the check that leaves the
        forms of nature out.
    """

    seed: int
    peak_force_n: float
    usual_limit_a: float = 21.0
    forms: Forms = "own"

    def rng(self, effect_id: str) -> np.random.Generator:
        """Draw phases and shapes of one effect, the same whatever else is hidden in the campaign."""
        return np.random.default_rng([self.seed, zlib.crc32(effect_id.encode())])


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """Fields that an effect sets; amplitudes of the same name add up when effects are combined.

    Attributes
    ----------
    plant : mapping of str to float
        Amplitudes, names of `dynamics.FIELDS`.
    shape : mapping of str to float
        Fields of the plant that replace the default.
    sensors : mapping of str to object
        Fields of `SensorSettings` that replace the default.
    """

    plant: Mapping[str, float] = field(default_factory=dict)
    shape: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("plant", "shape", "sensors"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))


Effect = Callable[[float, Setting], Change]


def combine(changes: list[Change]) -> Change:
    """Return one change that does what all of them do.

    Examples
    --------
    >>> a, b = Change(plant={"guide_n": 1.0}), Change(plant={"guide_n": 2.0})
    >>> combine([a, b]).plant["guide_n"]
    3.0
    """
    plant: dict[str, float] = {}
    shape: dict[str, float] = {}
    sensors: dict[str, Any] = {}
    for change in changes:
        for name, value in change.plant.items():
            plant[name] = plant.get(name, 0.0) + value
        shape |= change.shape
        sensors |= change.sensors
    return Change(plant=plant, shape=shape, sensors=sensors)
