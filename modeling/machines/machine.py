"""A machine is a composition of parts: which equations it has, what enters them, and which effects it can show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from sawbench.bench.processed import Frame
from sawbench.modeling.effects.catalogue import EFFECTS, SENSOR_PROPERTIES
from sawbench.modeling.effects.effect import Effect, Part
from sawbench.modeling.load import OAK
from sawbench.modeling.machines.words import MachineWords, words_of
from sawbench.modeling.residuals import Equation


@dataclass(frozen=True, kw_only=True, slots=True)
class Machine:
    """What a machine is made of.

    Attributes
    ----------
    name, title : str
        Identifier, and what a person calls it.
    frame : {"crank", "linear_axis"}
        Whose equations its parts enter: those of a driven crank, or of a force on a mass.
    parts : frozenset of Part
    states : tuple of str
        What moves or is stored.
    inputs : tuple of str
        Channels that enter the equations.
    equations : tuple of Equation
    parameters : tuple of str
        Numbers of the configuration that may be mistuned.
    """

    name: str
    title: str
    frame: Frame
    parts: frozenset[Part]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    equations: tuple[Equation, ...]
    parameters: tuple[str, ...]

    @property
    def words(self) -> MachineWords:
        """What pages call its motion and its channels."""
        return words_of(self.frame)

    def effects(self, model: Any) -> tuple[Effect, ...]:
        """List the effects whose parts the machine has, in the order of the catalogue.

        Parameters
        ----------
        model : object
            Numbers of the machine's baseline; typical sizes on a linear axis are shares of its force and travel, on a
            saw of the load that it carries: without a model, that of `load.OAK`.
        """
        offered = (effect for effect in EFFECTS if self.parts.issuperset(effect.parts))
        if self.frame == "crank":
            load = OAK if model is None else model.load
            return tuple(replace(effect, strength=effect.strength.at(load)) for effect in offered)
        return tuple(e.variants[self.frame](model) if self.frame in e.variants else e for e in offered)

    @property
    def sensor_properties(self) -> tuple[Effect, ...]:
        """What its sensors may have by themselves: part of a model, and never the cause of a gap."""
        return tuple(one for one in SENSOR_PROPERTIES if self.parts.issuperset(one.parts))
