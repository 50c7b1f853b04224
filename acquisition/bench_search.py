"""Which instruments are plugged into this machine: its ports, and what answers at each of them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sawbench.acquisition.device_probe import DeviceProbe, probe_devices
from sawbench.acquisition.devices import INSTRUMENTS, load_instrument, validate_table
from serial.tools import list_ports

SERIAL: Final = "serial"
# Interfaces of python-can that find their own channels; slcan adapters are serial ports.
_CAN_INTERFACES: Final = ("socketcan", "pcan", "kvaser", "vector", "ixxat")
_CAN_DRIVER: Final = "dbc_can"
_LISTEN_S: Final = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundPort:
    """A port of this machine.

    Attributes
    ----------
    interface : str
        "serial", or an interface of python-can.
    port : str
        As a `[devices.NAME]` table names it.
    about : str
        What the system says of it.
    """

    interface: str
    port: str
    about: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundInstrument:
    """An instrument that answers.

    Attributes
    ----------
    driver : str
    place : FoundPort
    serial_number : str or None
        Of the instrument or its USB adapter; None where neither states one.
    about : str
        Model or bus, and what its first channel reads at present.
    """

    driver: str
    place: FoundPort
    serial_number: str | None
    about: str


def find_ports() -> tuple[FoundPort, ...]:
    """List serial ports with hardware behind them, and channels of CAN interfaces; nothing is opened.

    Returns
    -------
    tuple of FoundPort
        Serial ports first, by name.
    """
    serial_ports = sorted(list_ports.comports(), key=lambda p: p.device)
    # A built-in port without hardware is listed too; the system knows nothing of it.
    found = [
        FoundPort(interface=SERIAL, port=p.device, about=p.description or "")
        for p in serial_ports
        if p.hwid not in {"", "n/a", None}
    ]
    return (*found, *(FoundPort(interface=i, port=channel) for i, channel in _can_channels()))


def _can_channels() -> list[tuple[str, str]]:
    import can

    said = logging.getLogger("can")
    level = said.level
    # It says of every driver library that it is not installed.
    said.setLevel(logging.CRITICAL)
    try:
        found: Sequence[Mapping[str, Any]] = can.detect_available_configs(list(_CAN_INTERFACES))
    finally:
        said.setLevel(level)
    return [(str(row["interface"]), str(row["channel"])) for row in found]


def identify(
    ports: Sequence[FoundPort],
    *,
    clock: Callable[[], float] = time.monotonic,
    watch: Callable[[str], object] | None = None,
) -> tuple[FoundInstrument, ...]:
    """Try every driver on every port, all ports at the same time, and keep the one whose samples come.

    Parameters
    ----------
    ports : sequence of FoundPort
        Each is sent the requests of one driver after the other, until one is understood.
    clock : callable
        Monotonic seconds.
    watch : callable, optional
        Called with the name of a driver before it is tried.

    Returns
    -------
    tuple of FoundInstrument
        In the order of `ports`. A port that is busy, forbidden or silent is left out.

    Notes
    -----
    A CAN bus answers by frames of any kind; its bit rate is taken to be that of the driver's default.
    """
    found: dict[FoundPort, FoundInstrument] = {}
    for driver in INSTRUMENTS:
        instrument = load_instrument(driver)
        if not instrument.is_searched:
            continue
        waiting = [p for p in ports if p not in found and (p.interface == SERIAL or driver == _CAN_DRIVER)]
        if not waiting:
            continue
        if watch is not None:
            watch(driver)
        devices = []
        for place in waiting:
            interface = {} if place.interface == SERIAL else {"interface": place.interface}
            table = {**example_table(driver), "port": place.port, **interface}
            devices.append(instrument.make(place.port, validate_table(place.port, table)[1], clock))
        for place, probe in zip(waiting, probe_devices(devices, seconds=_LISTEN_S, clock=clock), strict=True):
            if _is_understood(probe):
                found[place] = FoundInstrument(
                    driver=driver,
                    place=place,
                    serial_number=probe.facts.get("serial_number"),
                    about=_about(probe),
                )
    return tuple(found[place] for place in ports if place in found)


def example_table(driver: str) -> dict[str, Any]:
    """Return a table of a driver as its `Instrument` has it, without port, reading the first input."""
    example = dict(load_instrument(driver).example)
    if "channels" in example:
        # An amplifier need not send its further inputs.
        example["channels"] = {name: {**table, "input": 1} for name, table in example["channels"].items()}
    return {"driver": driver, **example}


def _is_understood(probe: DeviceProbe) -> bool:
    n_samples = sum(len(stream.raw) for stream in probe.streams)
    n_frames = n_samples + int(probe.facts.get("n_other_frames", "0"))
    return n_frames > probe.n_discarded_bytes


def _about(probe: DeviceProbe) -> str:
    kind = probe.facts.get("model") or probe.facts.get("bus", "")
    read = [
        f"{float(s.raw[:, 0].mean()):.4g} {s.stream.channels[0].calibration.raw_unit}".rstrip()
        for s in probe.streams
        if len(s.raw)
    ]
    return f"{kind}, reads {read[0]}" if read else f"{kind}, other frames"
