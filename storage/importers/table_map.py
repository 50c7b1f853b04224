"""`map.toml`: which column of a foreign table is which channel, in what unit and with what sign."""

from __future__ import annotations

from datetime import tzinfo
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator
from sawbench.bench.errors import ConfigError
from sawbench.bench.toml_text import parse_toml, read_toml_text
from sawbench.bench.units import TIME_COLUMN
from sawbench.bench.validation_text import describe_validation
from sawbench.storage.importers.clock_times import zone_named

_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def _is_column(value: Any) -> Any:
    is_name = isinstance(value, str) and value != ""
    is_place = isinstance(value, int) and not isinstance(value, bool) and value >= 1
    if not is_name and not is_place:
        raise ValueError("must be the name of a column, or its position counted from 1")
    return value


class ColumnRule(BaseModel):
    """How one channel is taken from a column: value = sign * (scale * cell + offset), in `unit`.

    Attributes
    ----------
    column : str or int
        Name of the column, or its place counted from 1.
    unit : str, optional
        Unit of the scaled values; default: what the file states, else the unit of the channel.
    sign : int
        -1 where the column counts the other way round.
    scale : float
        Units per count, volt, ...; 1 where the column is in `unit` already.
    offset : float
        In `unit`, added after the scale.
    """

    model_config = _STRICT
    column: Annotated[str | int, BeforeValidator(_is_column)]
    unit: Annotated[str, Field(min_length=1)] | None = None
    sign: Literal[1, -1] = 1
    scale: float = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _scale_is_no_zero(self) -> ColumnRule:
        if self.scale == 0:
            raise ValueError("scale must not be 0")
        return self


def _as_rule(value: Any) -> Any:
    """Accept `force_n = "Fz"` for `force_n = { column = "Fz" }`."""
    return value if isinstance(value, dict | ColumnRule) else {"column": value}


class ReadingRules(BaseModel):
    """`[table]`: what cannot be seen in the file itself; everything may be left out.

    Attributes
    ----------
    encoding, separator, decimal : str, optional
        Of a text table; found in the file otherwise.
    thousands : str, optional
        Sign between thousands; without it such numbers are refused.
    header_line : int, optional
        Line of the column names, counted from 1; 0: the table has none.
    rate_hz : float, optional
        Of a table without a time column.
    repeated_times : str
        "refuse", or "drop": of rows with the same time the first is taken.
    time_zone : str, optional
        Of times with a date that state none: an offset, "+01:00", or a name, "Europe/Berlin".
    alignment_std_s : float, optional
        Standard uncertainty of the times of its columns against each other: small where one instrument sampled them
        all; without it they are known to a row.
    """

    model_config = _STRICT
    encoding: str | None = None
    separator: Literal[",", ";", "\t", "|", " "] | None = None
    decimal: Literal[".", ","] | None = None
    thousands: Literal[".", ",", " ", "'", "\u00a0", "\u202f"] | None = None
    header_line: Annotated[int, Field(ge=0)] | None = None
    rate_hz: Annotated[float, Field(gt=0)] | None = None
    repeated_times: Literal["refuse", "drop"] = "refuse"
    time_zone: str | None = None
    alignment_std_s: Annotated[float, Field(ge=0)] | None = None

    @property
    def zone(self) -> tzinfo | None:
        """The time zone that is stated."""
        return None if self.time_zone is None else zone_named(self.time_zone)

    @field_validator("time_zone")
    @classmethod
    def _zone_is_known(cls, time_zone: str | None) -> str | None:
        if time_zone is not None:
            zone_named(time_zone)
        return time_zone

    @model_validator(mode="after")
    def _signs_differ(self) -> ReadingRules:
        if self.decimal is not None and self.decimal == self.thousands:
            raise ValueError("decimal and thousands are the same character")
        return self


ChannelName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]


class TableMap(BaseModel):
    """The whole of `map.toml`."""

    model_config = _STRICT
    columns: dict[ChannelName, Annotated[ColumnRule, BeforeValidator(_as_rule)]] = Field(default_factory=dict)
    table: ReadingRules = ReadingRules()

    @model_validator(mode="after")
    def _one_time(self) -> TableMap:
        if self.table.rate_hz is not None and TIME_COLUMN in self.columns:
            raise ValueError(f"has both a column for {TIME_COLUMN} and table.rate_hz: keep one")
        return self

    def as_toml(self) -> str:
        """Return the map as TOML, without what was left to the defaults."""
        return tomli_w.dumps(self.model_dump(exclude_defaults=True, exclude_none=True))


def load_map(path: str | Path) -> TableMap:
    """Read and validate `map.toml`.

    Raises
    ------
    ConfigError
        If the file is missing, is not TOML, or holds a key or value that is not allowed.
    """
    path = Path(path)
    return parse_map(parse_toml(read_toml_text(path, remedy="give the file with --map"), where=path), where=path)


def parse_map(tables: dict[str, Any], *, where: Path) -> TableMap:
    """Validate the tables of a map; see `load_map`."""
    try:
        return TableMap.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(
            describe_validation(error, TableMap),
            where=where,
            remedy='for example: [columns] force_n = { column = "Fz", unit = "kN", sign = -1 }',
        ) from error
