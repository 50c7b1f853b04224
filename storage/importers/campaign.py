"""`campaign.toml`: which table is which trial."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
)
from sawbench.bench.config import LoadedConfig, load_config
from sawbench.bench.errors import ConfigError
from sawbench.bench.recording import Trial
from sawbench.bench.toml_text import parse_toml, read_toml_text
from sawbench.bench.validation_text import describe_validation
from sawbench.storage.importers.table_map import TableMap, load_map, parse_map

_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def _as_text(value: Any) -> Any:
    """Accept a number as an identity: `blade = 1` means blade "1"."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Identity = Annotated[str, BeforeValidator(_as_text)]


class FurtherTable(BaseModel):
    """Another table of a trial, of an instrument that writes a file of its own."""

    model_config = _STRICT
    file: str = Field(min_length=1)
    map: str | None = None
    time_shift_s: float = 0.0


class TrialEntry(BaseModel):
    """One `[[trial]]`: the table and what was done; everything but the file may be left out."""

    model_config = _STRICT
    file: str = Field(min_length=1)
    duty: float | None = None
    workpiece: str | None = None
    thickness_mm: float | None = Field(default=None, ge=0)
    feed_mm_s: float | None = Field(default=None, ge=0)
    blade: Identity | None = None
    battery: Identity | None = None
    started_at: AwareDatetime | None = Field(default=None, strict=False)
    operator: str | None = None
    notes: str = ""
    repetition: int | None = Field(default=None, ge=1)
    map: str | None = None
    further: tuple[FurtherTable, ...] = Field(default=(), strict=False)

    @field_validator("duty")
    @classmethod
    def _duty_is_a_fraction(cls, duty: float | None) -> float | None:
        if duty is not None and not 0.0 <= duty <= 1.0:
            raise ValueError("must be a fraction from 0 to 1, not percent")
        return duty

    @property
    def trial_id(self) -> str:
        """Stem of the file name; also names the recording."""
        return Path(self.file.removesuffix(".gz")).stem

    def trial(self) -> Trial:
        """Return the entry as the settings of a trial."""
        return Trial(
            trial_id=self.trial_id,
            material=self.workpiece,
            duty=self.duty,
            thickness_mm=self.thickness_mm,
            feed_mm_s=self.feed_mm_s,
            blade=self.blade,
            battery=self.battery,
            operator=self.operator,
            started_at=self.started_at,
            notes=self.notes,
            repetition=self.repetition,
            source=f"import of {Path(self.file).name}",
        )


class Campaign(BaseModel):
    """The whole of `campaign.toml`; `[columns]` and `[table]` are those of a map, for all of its tables."""

    model_config = _STRICT
    config: str | None = None
    map: str | None = None
    columns: dict[str, Any] = Field(default_factory=dict)
    table: dict[str, Any] = Field(default_factory=dict)
    trial: tuple[TrialEntry, ...] = Field(min_length=1, strict=False)


def load_campaign(path: Path) -> tuple[Campaign, LoadedConfig | None]:
    """Read `campaign.toml` and the configuration it names.

    Returns
    -------
    campaign : Campaign
        Every file it names exists, and no two share a stem.
    config : LoadedConfig or None

    Raises
    ------
    ConfigError
        If a file is missing, is not TOML, or holds a key or value that is not allowed.
    """
    campaign = _validate(path, parse_toml(read_toml_text(path), where=path))
    _check_files(path, campaign)
    config = None if campaign.config is None else load_config(path.parent / campaign.config)
    return campaign, config


def map_of(path: Path, campaign: Campaign, entry: TrialEntry) -> TableMap | None:
    """Return the map of a trial's table: its own, that of the campaign, or none.

    Raises
    ------
    ConfigError
        If the map is missing or not valid, or the campaign names a file and states columns besides.
    """
    stated = {key: found for key in ("columns", "table") if (found := getattr(campaign, key))}
    if campaign.map is not None and stated:
        raise ConfigError(
            f"has both map = {campaign.map!r} and [{next(iter(stated))}]",
            where=path,
            remedy="keep one: the file, or the tables in the campaign file",
        )
    named = entry.map or campaign.map
    if named is not None:
        return load_map(path.parent / named)
    return parse_map(stated, where=path) if stated else None


def _validate(path: Path, tables: dict[str, Any]) -> Campaign:
    """Check every trial on its own first, so that a problem is named by the trial's number and its keys."""
    entries = tables.get("trial")
    problems = []
    for number, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
        try:
            TrialEntry.model_validate(entry)
        except ValidationError as error:
            problems.append(f"trial {number}: {describe_validation(error, TrialEntry)}")
    if problems:
        raise ConfigError("\n  ".join(problems), where=path)
    try:
        return Campaign.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(describe_validation(error, Campaign), where=path) from error


def _check_files(path: Path, campaign: Campaign) -> None:
    tables = [table for entry in campaign.trial for table in (entry, *entry.further)]
    missing = [table.file for table in tables if not (path.parent / table.file).is_file()]
    if missing:
        raise ConfigError(
            f"refers to {len(missing)} files that do not exist: {', '.join(missing[:5])}",
            where=path,
            remedy=f"files are looked for in {path.parent.resolve()}",
        )
    folder = path.parent.resolve()
    for table in tables:
        named, target = path.parent / table.file, (path.parent / table.file).resolve()
        is_named_inside = Path(os.path.normpath(folder / table.file)).is_relative_to(folder)
        if is_named_inside and not target.is_relative_to(folder):
            raise ConfigError(
                f"is a link to a file outside the folder of the campaign: {target}",
                where=named,
                remedy="copy the file to the folder, or give its real path in the campaign",
            )
    stems = [entry.trial_id for entry in campaign.trial]
    repeated = sorted({stem for stem in stems if stems.count(stem) > 1})
    if repeated:
        raise ConfigError(
            f"has the trial {repeated[0]} more than once",
            where=path,
            remedy="give every table its own file name",
        )
