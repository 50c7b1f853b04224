"""Instruments: one file each, listed in `DRIVERS`, built from the `[devices.*]` tables."""

from __future__ import annotations

import difflib
import importlib
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from bench.errors import ConfigError

if TYPE_CHECKING:
    from acquisition.devices.device import Device
    from bench.config import BenchConfig

# driver -> module and class. Imported only when a configuration names it.
DRIVERS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "gsv8": ("acquisition.devices.gsv8", "Gsv8"),
        "dbc_can": ("acquisition.devices.dbc_can", "DbcCan"),
        "msc7xxx": ("acquisition.devices.msc7xxx", "Msc7xxx"),
    }
)


def device_class(driver: str) -> Any:
    """Import the class of `driver`, a key of `DRIVERS`."""
    module, name = DRIVERS[driver]
    return getattr(importlib.import_module(module), name)


def validate_table(name: str, table: Mapping[str, Any], *, endpoint: str | None = None) -> tuple[str, Any]:
    """Check one `[devices.NAME]` table.

    Parameters
    ----------
    name : str
    table : mapping
        As read from the configuration.
    endpoint : str, optional
        Replaces `port`.

    Returns
    -------
    driver : str
    settings : pydantic model
        Of that driver.

    Raises
    ------
    ConfigError
        If the driver is unknown or a key is missing, unknown or out of range.
    """
    from pydantic import ValidationError

    from bench.config import describe_validation

    where = f"[devices.{name}]"
    driver = table.get("driver")
    if not isinstance(driver, str) or driver not in DRIVERS:
        close = difflib.get_close_matches(str(driver), DRIVERS, n=1, cutoff=0.4)
        hint = f"did you mean {close[0]!r}?" if close else f"drivers are {', '.join(DRIVERS)}"
        what = "has no key driver" if driver is None else f"unknown driver {driver!r}"
        raise ConfigError(what, where=where, remedy=hint)
    given = dict(table) if endpoint is None else {**table, "port": endpoint}
    model = device_class(driver).Settings
    try:
        return driver, model.model_validate(given)
    except ValidationError as error:
        raise ConfigError(describe_validation(error, model), where=where) from error


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

    Returns
    -------
    list of Device

    Raises
    ------
    ConfigError
        If there is no device, a table is wrong, a name is unknown, or two devices give the same channel.

    Examples
    --------
    >>> from bench.config import parse_config
    >>> text = "[devices.cell]\ndriver = 'gsv8'\nport = 'COM3'\n[devices.cell.channels.force_n]\ninput=1"
    >>> build_devices(parse_config(text).config)[0].streams[0].rate_hz
    6000.0
    """
    if not config.devices:
        raise ConfigError(
            "the configuration has no [devices.*] table",
            remedy="copy the [devices.*] tables of the bench_config.toml that ships with sawbench",
        )
    endpoints = endpoints or {}
    for name in (*endpoints, *only):
        if name not in config.devices:
            raise ConfigError(f"no device {name!r}; devices are {', '.join(config.devices)}")
    devices: list[Device] = []
    giver: dict[str, str] = {}
    for name, table in config.devices.items():
        if only and name not in only:
            continue
        driver, settings = validate_table(name, table, endpoint=endpoints.get(name))
        module = importlib.import_module(DRIVERS[driver][0])
        device = module.make(name, settings, clock)
        for channel in (c.name for stream in device.streams for c in stream.channels):
            if channel in giver:
                raise ConfigError(
                    f"{channel} comes from two devices: {giver[channel]} and {name}",
                    where=f"[devices.{name}]",
                    remedy="remove one, or give its channel another name",
                )
            giver[channel] = name
        devices.append(device)
    return devices
