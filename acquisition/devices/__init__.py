"""Instruments: one file and one row of `INSTRUMENTS` each, built from the `[devices.*]` tables.

A package of a laboratory adds an instrument without touching this one: it announces, in its `pyproject.toml`,

    [project.entry-points."sawbench.instruments"]
    my_cell = "my_package.my_cell:INSTRUMENT"

where `INSTRUMENT` is a `devices.instrument.Instrument`.
"""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from sawbench.bench.errors import ConfigError
from sawbench.bench.units import CHANNEL_BY_NAME

if TYPE_CHECKING:
    from sawbench.acquisition.devices.device import Device
    from sawbench.acquisition.devices.instrument import Instrument
    from sawbench.bench.config import BenchConfig
    from sawbench.bench.units import Channel

# driver -> where its `Instrument` is. Imported only when a configuration names it.
INSTRUMENTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "gsv8": "sawbench.acquisition.devices.gsv8:INSTRUMENT",
        "gsv3": "sawbench.acquisition.devices.gsv3:INSTRUMENT",
        "dbc_can": "sawbench.acquisition.devices.dbc_can:INSTRUMENT",
        "msc7xxx": "sawbench.acquisition.devices.msc7xxx:INSTRUMENT",
        "loadstar": "sawbench.acquisition.devices.loadstar:INSTRUMENT",
        "mantracourt": "sawbench.acquisition.devices.mantracourt:INSTRUMENT",
        "mantracourt_can": "sawbench.acquisition.devices.mantracourt_can:INSTRUMENT",
        "cia404": "sawbench.acquisition.devices.cia404:INSTRUMENT",
        "hx711": "sawbench.acquisition.devices.hx711:INSTRUMENT",
        "micro_epsilon_ethernet": "sawbench.acquisition.devices.micro_epsilon_ethernet:INSTRUMENT",
        "edge_times": "sawbench.acquisition.devices.edge_times:INSTRUMENT",
        "ni_daqmx": "sawbench.acquisition.devices.ni_daqmx:INSTRUMENT",
        "labjack": "sawbench.acquisition.devices.labjack:INSTRUMENT",
        "text_lines": "sawbench.acquisition.devices.text_lines:INSTRUMENT",
        "binary_frames": "sawbench.acquisition.devices.binary_frames:INSTRUMENT",
    }
)
ENTRY_POINT_GROUP: Final = "sawbench.instruments"


def load_instrument(driver: str) -> Instrument:
    """Import the instrument of `driver`: a row of `INSTRUMENTS`, else an entry point of another package.

    Raises
    ------
    ConfigError
        If there is none, two packages announce it, or what is announced cannot be imported or is no instrument.
    """
    from sawbench.acquisition.devices.instrument import Instrument

    if driver in INSTRUMENTS:
        found = EntryPoint(name=driver, value=INSTRUMENTS[driver], group=ENTRY_POINT_GROUP)
    else:
        announced = entry_points(group=ENTRY_POINT_GROUP)
        matching = list(announced.select(name=driver))
        if len(matching) != 1:
            raise _no_single(driver, matching, [*INSTRUMENTS, *sorted(announced.names - INSTRUMENTS.keys())])
        found = matching[0]
    try:
        instrument = found.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"driver {driver!r} ({found.value}) cannot be imported: {error}",
            remedy="install its package again, or ask its author",
        ) from error
    if not isinstance(instrument, Instrument):
        raise ConfigError(f"driver {driver!r}: {found.value} is not an Instrument but a {type(instrument).__name__}")
    return instrument


def _no_single(driver: str, matching: list[EntryPoint], known: list[str]) -> ConfigError:
    if matching:
        return ConfigError(
            f"driver {driver!r} is registered twice: {', '.join(point.value for point in matching)}",
            remedy="uninstall one of the two packages",
        )
    close = difflib.get_close_matches(driver, known, n=1, cutoff=0.4)
    hint = f"did you mean {close[0]!r}?" if close else f"drivers are {', '.join(known)}"
    return ConfigError(f"unknown driver {driver!r}", remedy=hint)


def validate_table(
    name: str,
    table: Mapping[str, Any],
    *,
    channels: Mapping[str, Channel] = CHANNEL_BY_NAME,
    endpoint: str | None = None,
) -> tuple[Instrument, Any]:
    """Check one `[devices.NAME]` table.

    Parameters
    ----------
    name : str
    table : mapping
        As read from the configuration.
    channels : mapping of str to Channel
        That the table may name.
    endpoint : str, optional
        Replaces `port`; what is there is another instrument, so `serial_number` falls away.

    Returns
    -------
    instrument : Instrument
    settings : pydantic model
        Of that instrument.

    Raises
    ------
    ConfigError
        If the driver is unknown or a key is missing, unknown or out of range.
    """
    from pydantic import ValidationError
    from sawbench.bench.validation_text import describe_validation

    where = f"[devices.{name}]"
    driver = table.get("driver")
    if not isinstance(driver, str):
        raise ConfigError("has no key driver", where=where, remedy=f"drivers are {', '.join(INSTRUMENTS)}")
    try:
        instrument = load_instrument(driver)
    except ConfigError as error:
        raise ConfigError(error.what, where=where, remedy=error.remedy) from error
    given = dict(table)
    if endpoint is not None:
        given["port"] = endpoint
        given.pop("serial_number", None)
    try:
        return instrument, instrument.settings.model_validate(given, context={"channels": channels})
    except ValidationError as error:
        raise ConfigError(describe_validation(error, instrument.settings), where=where) from error


def build_devices(
    config: BenchConfig,
    endpoints: Mapping[str, str] | None = None,
    *,
    only: tuple[str, ...] = (),
    clock: Callable[[], float] = time.monotonic,
) -> list[Device]:
    r"""Build every instrument of the configuration; nothing is opened.

    Parameters
    ----------
    config : BenchConfig
    endpoints : mapping of str to str, optional
        Device name -> port that replaces the configured one (the simulated bench announces such a mapping).
    only : tuple of str
        Names of the devices to build; all where empty.
    clock : callable
        Monotonic seconds, shared by all instruments.

    Raises
    ------
    ConfigError
        If there is no device, a table is wrong, a name is unknown, or two devices share a channel or a serial port.

    Examples
    --------
    >>> from sawbench.bench.config import parse_config
    >>> text = "[devices.cell]\ndriver = 'gsv8'\nport = 'COM3'\n[devices.cell.channels.force_n]\ninput=1"
    >>> build_devices(parse_config(text).config)[0].streams[0].rate_hz
    6000.0
    """
    if not config.devices:
        raise ConfigError(
            "the configuration has no [devices.*] table",
            remedy="copy the [devices.*] tables of the bench_config.toml of the package",
        )
    endpoints = endpoints or {}
    for name in (*endpoints, *only):
        if name not in config.devices:
            raise ConfigError(f"no device {name!r}; devices are {', '.join(config.devices)}")
    devices: list[Device] = []
    giver: dict[str, str] = {}
    at_port: dict[str, str] = {}
    for name, table in config.devices.items():
        if only and name not in only:
            continue
        instrument, settings = validate_table(name, table, channels=config.known_channels, endpoint=endpoints.get(name))
        _refuse_shared_port(name, settings, at_port)
        device = instrument.make(name, settings, clock)
        for channel in (c.name for stream in device.streams for c in stream.channels):
            if channel in giver:
                raise ConfigError(
                    f"{channel} is provided by two devices: {giver[channel]} and {name}",
                    where=f"[devices.{name}]",
                    remedy="remove one, or give its channel another name",
                )
            giver[channel] = name
        devices.append(device)
    return devices


def _refuse_shared_port(name: str, settings: Any, at_port: dict[str, str]) -> None:
    """Refuse the port of another table, and note whose it is; a server or a CAN interface serves several.

    Opening it twice would only say that another program uses it.
    """
    is_serial = hasattr(settings, "baud_rate") and getattr(settings, "interface", "slcan") == "slcan"
    if not is_serial or "://" in settings.port:
        return
    other = at_port.setdefault(settings.port, name)
    if other != name:
        raise ConfigError(
            f"port {settings.port} is that of [devices.{other}] too: only one instrument can be at a serial port",
            where=f"[devices.{name}]",
            remedy="correct `port` in one of the two tables; `sawbench init` in an empty folder shows what is where",
        )
