"""The calibration book: every tare and calibration of a bench, in the order they were made, none ever removed.

A TOML file beside the configuration. What is in force for a channel is its table in the configuration, then the
latest calibration of the book, then the latest tare after that. The simulated bench has a book of its own, so that
nothing found on it can reach a recording of the real one.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices import build_devices
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.toml_text import parse_toml, read_toml_text
from sawbench.bench.units import Channel
from sawbench.bench.validation_text import describe_validation
from sawbench.storage.output import folder_held, write_whole

if TYPE_CHECKING:
    from sawbench.acquisition.devices.device import Device

_STRICT: Final = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
_HEADER: Final = (
    "# Tares and calibrations of the bench, written by `sawbench tare` and `sawbench calibrate`; the latest of each\n"
    "# channel is used. Entries are never removed: the file is the history.\n\n"
)


class BookEntry(BaseModel):
    """One tare or calibration.

    Attributes
    ----------
    kind : {"tare", "calibration"}
    device, channel : str
    made_at : datetime
        Timezone-aware.
    result : Calibration
        What was in force from then on, whole.
    configured : Calibration
        What the configuration said then: where it says something else now, the entry no longer fits.
    zero_std_raw : float
        Standard uncertainty of `result.zero_raw`, raw unit.
    seconds : float, optional
        Averaged over this long (each point); None for points from a table.
    instrument : mapping of str to str
        Port, model, firmware, serial number: what the instrument says of itself.
    software, operator, note : str
    details : mapping
        Numbers of the kind: scatter and drift of a tare; points, covariance, residuals of a calibration.
    """

    model_config = _STRICT
    kind: Literal["tare", "calibration"]
    device: str
    channel: str
    made_at: AwareDatetime
    result: Calibration
    configured: Calibration
    zero_std_raw: float = Field(ge=0)
    seconds: float | None = Field(default=None, gt=0)
    instrument: dict[str, str] = Field(default_factory=dict)
    software: str = ""
    operator: str = ""
    note: str = ""
    details: dict[str, Any] = Field(default_factory=dict)

    @property
    def title(self) -> str:
        """Kind, time and operator, for one line."""
        whose = f" by {self.operator}" if self.operator else ""
        return f"{self.kind} of {self.made_at.isoformat(timespec='seconds')}{whose}"


class CalibrationBook(BaseModel):
    """All entries, oldest first.

    Attributes
    ----------
    schema_version : int
    entries : tuple of BookEntry
    """

    model_config = _STRICT
    schema_version: Literal[1] = 1
    entries: tuple[BookEntry, ...] = ()

    def of_channel(self, device: str, channel: str) -> tuple[BookEntry, ...]:
        """Entries of one channel, oldest first."""
        return tuple(e for e in self.entries if (e.device, e.channel) == (device, channel))

    def in_force(self, device: str, channel: str) -> tuple[BookEntry, ...]:
        """Return the latest calibration, if any, and the latest tare after it, if any."""
        entries = self.of_channel(device, channel)
        calibrations = [k for k, e in enumerate(entries) if e.kind == "calibration"]
        first = calibrations[-1] if calibrations else 0
        chosen = [entries[first]] if calibrations else []
        tares = [e for e in entries[first:] if e.kind == "tare"]
        return (*chosen, *tares[-1:])


def book_path(config_path: Path, *, simulated: bool, shipped: Path) -> Path:
    """Place of the book: beside the configuration, or in the working folder for the one of the package.

    Parameters
    ----------
    config_path : Path
    simulated : bool
    shipped : Path
        The configuration of the package.

    Examples
    --------
    >>> book_path(Path("rig/bench_config.toml"), simulated=False, shipped=Path("x")).as_posix()
    'rig/bench_config.calibration.toml'
    """
    is_shipped = config_path.resolve() == shipped.resolve()
    folder = Path() if is_shipped else config_path.parent
    stem = "bench_config" if is_shipped else config_path.stem
    return folder / f"{stem}.calibration{'-simulated' if simulated else ''}.toml"


def read_book(path: Path) -> CalibrationBook:
    """Read a book; an empty one where there is no file.

    Raises
    ------
    InputError
        If the file cannot be read or holds something else.
    """
    if not path.exists():
        return CalibrationBook()
    try:
        return CalibrationBook.model_validate(parse_toml(read_toml_text(path), where=path))
    except ValidationError as error:
        what = describe_validation(error, CalibrationBook)
    except ConfigError as error:
        what = error.what
    raise InputError(
        f"is not a calibration book: {what}",
        where=path,
        remedy="repair it, or move it to another folder to work without it",
    )


def add_entry(path: Path, entry: BookEntry) -> None:
    """Append `entry`; the file is replaced as a whole, so that a crash leaves the old one, and two at once both stay.

    Raises
    ------
    InputError
        If the book that is there cannot be read, or the new one cannot be written.
    """
    import tomli_w

    with folder_held(path):
        grown = CalibrationBook(entries=(*read_book(path).entries, entry))
        text = _HEADER + tomli_w.dumps(_without_none(grown.model_dump(mode="python")))
        write_whole(path, text, overwrite=True)


def build_calibrated(
    config: BenchConfig,
    book: CalibrationBook,
    endpoints: Mapping[str, str] | None = None,
    *,
    clock: Callable[[], float] = time.monotonic,
) -> tuple[list[Device], dict[tuple[str, str], Calibration]]:
    """Build every instrument with what the book has in force; nothing is opened.

    Parameters
    ----------
    config : BenchConfig
    book : CalibrationBook
    endpoints : mapping of str to str, optional
    clock : callable
        See `build_devices`.

    Returns
    -------
    devices : list of Device
    configured : dict of (device, channel) to Calibration
        What the configuration alone says.

    Raises
    ------
    ConfigError
        See `build_devices` and `calibrated`.
    """
    plain = build_devices(config, endpoints, clock=clock)
    configured = {(d.name, c.name): c.calibration for d in plain for s in d.streams for c in s.channels}
    if not book.entries:
        return plain, configured
    return build_devices(calibrated(config, book, configured), endpoints, clock=clock), configured


def calibrated(
    config: BenchConfig, book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration]
) -> BenchConfig:
    """Return the configuration with what the book has in force.

    Parameters
    ----------
    config : BenchConfig
    book : CalibrationBook
    configured : mapping of (device, channel) to Calibration
        What the instruments use without the book, see `build_calibrated`.

    Raises
    ------
    ConfigError
        If the configuration of a channel was changed since an entry that is in force was made, or the entry is of a
        device that is no longer configured while another one gives the channel.
    """
    _refuse_other_device(book, configured)
    tables = {name: dict(table) for name, table in config.devices.items()}
    for (device, channel), present in configured.items():
        entries = book.in_force(device, channel)
        if not entries:
            continue
        _refuse_stale(entries, present)
        values = in_words(entries)
        _put(tables[device], channel, values)
    return config.model_copy(update={"devices": tables})


_NO_CALIBRATION: Final = (
    "has no calibration: the raw value of the instrument, such as mV/V, would be taken in the unit of the channel"
)


def uncalibrated(
    book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration], channels: Mapping[str, Channel]
) -> list[tuple[str, str, ConfigError]]:
    """Return device, channel and what is wrong for every channel that nobody gave a calibration.

    Parameters
    ----------
    book : CalibrationBook
    configured : mapping of (device, channel) to Calibration
    channels : mapping of str to Channel
        Those of the bench.
    """
    return [
        (device, channel, ConfigError(what, where=f"[devices.{device}] {channel}", remedy=_how_to_calibrate(channel)))
        for (device, channel), present in configured.items()
        if (what := _lack(present, channels[channel].unit))
        and all(entry.kind != "calibration" for entry in book.in_force(device, channel))
    ]


def _lack(present: Calibration, unit: str) -> str:
    """Say why raw values would pass for values in `unit`; empty where somebody stated how they are turned into them."""
    if present == Calibration():
        return _NO_CALIBRATION
    is_formula_stated = bool({"scale", "polynomial"} & present.model_fields_set)
    if is_formula_stated or present.raw_unit in {"", unit}:
        return ""
    raw_unit = present.raw_unit
    return f"its calibration has raw_unit {raw_unit!r} but no scale: {raw_unit} would be taken for {unit}"


def _how_to_calibrate(channel: str) -> str:
    return (
        f"`sawbench calibrate --channel {channel}`, or state calibration = {{ scale = ..., raw_unit = ..., "
        "source = ... }; if the instrument already sends this unit, `source` alone is enough"
    )


def refuse_uncalibrated(
    book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration], channels: Mapping[str, Channel]
) -> None:
    """Refuse channels that nobody gave a calibration; see `uncalibrated`.

    Raises
    ------
    ConfigError
        Names device and channel of the first.
    """
    for _, _, error in uncalibrated(book, configured, channels):
        raise error


def calibrations_of(book: CalibrationBook, channel: str) -> CalibrationBook:
    """Return the book with the calibrations of one channel alone: what a new tare builds on."""
    return CalibrationBook(entries=tuple(e for e in book.entries if e.kind == "calibration" and e.channel == channel))


def in_words(entries: Sequence[BookEntry]) -> Calibration:
    """Return the calibration that the entries in force amount to; its source names them."""
    source = "; ".join([*(e.title for e in entries), f"before: {entries[0].configured.source or 'not stated'}"])
    return entries[-1].result.model_copy(update={"source": source})


def provenance(book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration]) -> dict[str, str]:
    """Entries in force, whole, as JSON, for the recording: `calibration book CHANNEL`."""
    return {
        f"calibration book {channel}": json.dumps([e.model_dump(mode="json") for e in entries])
        for device, channel in configured
        if (entries := book.in_force(device, channel))
    }


def zeroed(calibration: Calibration, raw_at_rest: float) -> Calibration:
    """Return the calibration whose value is 0 at `raw_at_rest`.

    Parameters
    ----------
    calibration : Calibration
    raw_at_rest : float
        Mean raw reading of the unloaded sensor, raw unit.

    Raises
    ------
    InputError
        If the polynomial has no zero.

    Examples
    --------
    >>> zeroed(Calibration(scale=250.0, offset=5.0), 0.1).zero_raw
    0.12000000000000001
    """
    if calibration.polynomial is None:
        at_zero = -calibration.offset / calibration.scale
    else:
        roots = np.polynomial.polynomial.polyroots(calibration.polynomial)
        real = roots[np.abs(roots.imag) < 1e-9].real
        if not len(real):
            raise InputError("the polynomial of the calibration has no zero, so the channel cannot be tared")
        # The zero on the branch that is in use: the one nearest to the reading.
        present = raw_at_rest - calibration.zero_raw
        at_zero = float(real[np.argmin(np.abs(real - present))])
    return calibration.model_copy(update={"zero_raw": raw_at_rest - at_zero})


def _refuse_other_device(book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration]) -> None:
    present = {channel: device for device, channel in configured}
    for former, channel in dict.fromkeys((e.device, e.channel) for e in book.entries):
        device = present.get(channel)
        if device is None or (former, channel) in configured:
            continue
        lost, own = book.in_force(former, channel), book.in_force(device, channel)
        if own and (own[0].kind == "calibration" or lost[0].kind == "tare"):
            continue
        again = "tare" if lost[0].kind == "tare" else "calibrate"
        raise ConfigError(
            f"the {lost[0].title} is of device {former!r}, which is not configured; {channel} is given by {device!r}",
            where=f"calibration book, {channel}",
            remedy=f"if it is the same instrument, name it {former!r} in the configuration, or {device!r} in the "
            f"entries of the book; otherwise `sawbench {again} --channel {channel}`",
        )


def _refuse_stale(entries: Sequence[BookEntry], present: Calibration) -> None:
    for entry in entries:
        if entry.configured.is_same_formula(present):
            continue
        raise ConfigError(
            f"the calibration in the configuration was changed since the {entry.title}, which is valid for "
            f"{entry.configured.statement(entry.channel, 'value')}",
            where=f"{entry.device} {entry.channel}",
            remedy="restore the previous calibration, or make a new one: "
            + ("`sawbench tare`" if entry.kind == "tare" else "`sawbench calibrate --force`"),
        )


def _put(table: dict[str, Any], channel: str, calibration: Calibration) -> None:
    values = calibration.model_dump(exclude_none=True)
    if channel in (channels := table.get("channels", {})):
        table["channels"] = {**channels, channel: {**channels[channel], "calibration": values}}
    else:
        table["calibration"] = {**table.get("calibration", {}), channel: values}


def _without_none(value: Any) -> Any:
    """TOML has no null."""
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_without_none(item) for item in value]
    return value


def said_in_force(book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration], now: datetime) -> list[str]:
    """One line for each entry that is applied: channel, what it is, how old."""
    return [f"{e.channel}: {e.title}, {age(e, now)}" for e in entries_in_force(book, configured)]


def entries_in_force(book: CalibrationBook, configured: Mapping[tuple[str, str], Calibration]) -> list[BookEntry]:
    """Return what is applied to the channels of the configured instruments."""
    return [entry for place in configured for entry in book.in_force(*place)]


def of_other_instruments(
    entries: Sequence[BookEntry], facts: Mapping[str, Mapping[str, str]]
) -> list[tuple[BookEntry, str]]:
    """Return the entries that were made with another instrument than the one that is there, and words for each.

    Parameters
    ----------
    entries : sequence of BookEntry
        Those that are applied.
    facts : mapping of str to mapping
        What the instruments say of themselves, by device; one without a serial number is not compared.
    """
    found = []
    for entry in entries:
        before, now = (said.get("serial_number") for said in (entry.instrument, facts.get(entry.device, {})))
        if before and now and before != now:
            words = f"the {entry.title} was made with serial number {before}, the instrument now has {now}"
            found.append((entry, words))
    return found


def not_in_book(
    book: CalibrationBook,
    configured: Mapping[tuple[str, str], Calibration],
    channels: Mapping[str, Channel],
    path: Path,
) -> list[tuple[str, str, str]]:
    """Return device, channel and words for every channel whose raw values the configuration alone turns into its unit.

    Parameters
    ----------
    book : CalibrationBook
    configured : mapping of (device, channel) to Calibration
    channels : mapping of str to Channel
        Those of the bench.
    path : Path
        Of the book.
    """
    where = f"{path} has no entry of it" if path.exists() else f"no calibration book was found at {path}"
    return [
        (device, channel, f"the calibration of the configuration is used: {where}")
        for (device, channel), present in configured.items()
        if present.raw_unit not in {"", channels[channel].unit} and not book.in_force(device, channel)
    ]


def age(entry: BookEntry, now: datetime) -> str:
    """How old an entry is, in words.

    Examples
    --------
    >>> from datetime import UTC
    >>> c = Calibration()
    >>> made = datetime(2026, 3, 1, tzinfo=UTC)
    >>> e = BookEntry(kind="tare", device="d", channel="c", made_at=made, result=c, configured=c,
    ...               zero_std_raw=0.0, seconds=1.0)
    >>> age(e, datetime(2026, 3, 3, 12, tzinfo=UTC))
    '2.5 days old'
    """
    hours = (now - entry.made_at).total_seconds() / 3600.0
    return f"{hours:.1f} h old" if hours < 48 else f"{hours / 24.0:.1f} days old"
