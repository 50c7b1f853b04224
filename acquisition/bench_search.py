"""Which instruments are plugged into this machine: its ports, and what answers at each of them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Final

from sawbench.acquisition.device_probe import DeviceProbe, probe_devices
from sawbench.acquisition.devices import INSTRUMENTS, load_instrument, validate_table
from sawbench.acquisition.line_recognition import recognise_lines
from sawbench.acquisition.transports.serial_port import SerialPort
from sawbench.bench.errors import DeviceError
from serial.tools import list_ports

SERIAL: Final = "serial"
# Interfaces of python-can that find their own channels; slcan adapters are serial ports.
_CAN_INTERFACES: Final = ("socketcan", "pcan", "kvaser", "vector", "ixxat")
_CAN_DRIVER: Final = "dbc_can"
_LISTEN_S: Final = 0.5
# Ten lines a second are the slowest that are recognised.
_HEAR_S: Final = 1.2
_BAUD_RATES: Final = (115_200, 9600, 57_600)


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
    table : mapping of str to Any
        Its `[devices.NAME]` table as far as what it sent tells, with `driver`; empty: that of `example_table`.
    """

    driver: str
    place: FoundPort
    serial_number: str | None
    about: str
    table: Mapping[str, Any] = field(default_factory=dict)

    def proposed(self) -> dict[str, Any]:
        """Table for a configuration, without port."""
        return dict(self.table) or example_table(self.driver)


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
    A CAN bus answers by frames of any kind; its bit rate is taken to be that of the driver's default. A serial port
    that understands no request is listened to: see `recognise_lines`.
    """
    found: dict[FoundPort, FoundInstrument] = {}
    # Any frame makes a bus, so those that answer to a question come before.
    for driver in sorted(INSTRUMENTS, key=lambda name: name == _CAN_DRIVER):
        instrument = load_instrument(driver)
        if not instrument.is_searched or (instrument.package is not None and find_spec(instrument.package) is None):
            continue
        is_can = "interface" in instrument.settings.model_fields
        waiting = [p for p in ports if p not in found and (p.interface == SERIAL or is_can)]
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
    for place in ports:
        if place.interface == SERIAL and place not in found:
            if watch is not None:
                watch(f"lines of numbers at {place.port}")
            heard = _heard(place, clock)
            found |= {} if heard is None else {place: heard}
    return tuple(found[place] for place in ports if place in found)


def _heard(place: FoundPort, clock: Callable[[], float]) -> FoundInstrument | None:
    """What prints lines at a port by itself."""
    for baud_rate in _BAUD_RATES:
        link = SerialPort(place.port, device=place.port, baud_rate=baud_rate)
        try:
            link.open()
            # What had been waiting says nothing about a rate.
            link.read()
            begun_s, received = clock(), b""
            while (heard_s := clock() - begun_s) < _HEAR_S:
                received += link.read()
        except DeviceError:
            return None
        finally:
            link.close()
        lines = recognise_lines(received, heard_s)
        if lines is None:
            continue
        example = example_table(lines.driver)
        ((channel, wired),) = example["channels"].items()
        table = {
            "driver": lines.driver,
            "baud_rate": baud_rate,
            **lines.settings,
            "channels": {channel: {**wired, "input": lines.column}},
        }
        number = link.facts.get("serial_number")
        return FoundInstrument(driver=lines.driver, place=place, serial_number=number, about=lines.about, table=table)
    return None


def example_table(driver: str) -> dict[str, Any]:
    """Return a table of a driver as its `Instrument` has it, without port, reading the first input."""
    instrument = load_instrument(driver)
    example = dict(instrument.example if instrument.searched_as is None else instrument.searched_as)
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
