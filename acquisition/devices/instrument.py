"""What a row of `devices.INSTRUMENTS`, or an entry point of another package, leads to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from sawbench.acquisition.devices.device import Device
from sawbench.acquisition.simulation.plant_stream import EmulatedInstrument, PlantStream


@dataclass(frozen=True, kw_only=True, slots=True)
class Instrument:
    """A driver with its settings and its emulator.

    Attributes
    ----------
    settings : type of BaseModel
        Of the table `[devices.NAME]`; frozen, strict, with fields `driver` and `port`.
    make : callable
        (name, settings, clock in monotonic s) -> Device; does no input or output.
    example : mapping of str to Any
        A valid table without `driver` and `port`; the contract test records it from the emulator.
    emulate : callable, optional
        (name, settings, plant, clock error in 1e-6) -> EmulatedInstrument; None where there is no emulator, so that
        `sawbench simbench` cannot serve it.
    is_searched : bool
        `sawbench init` tries it at every port: only where the instrument can be told from another one.
    searched_as : mapping of str to Any, optional
        Table that `sawbench init` tries and proposes, where that is not the example.
    package : str, optional
        Python package without which it is not searched.
    """

    settings: type[BaseModel]
    make: Callable[[str, Any, Callable[[], float]], Device]
    example: Mapping[str, Any]
    emulate: Callable[[str, Any, PlantStream, float], EmulatedInstrument] | None = None
    is_searched: bool = True
    searched_as: Mapping[str, Any] | None = None
    package: str | None = None
