"""`campaign.toml`: which table is which trial."""

from __future__ import annotations

import tomllib
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

from bench.config import LoadedConfig, describe_validation, load_config
from bench.errors import ConfigError
from bench.recording import Trial

_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _as_text(value: Any) -> Any:
    """Accept a number as an identity: `blade = 1` means blade "1"."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Identity = Annotated[str, BeforeValidator(_as_text)]


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
    started_at: AwareDatetime | None = None
    operator: str | None = None
    notes: str = ""
    repetition: int | None = Field(default=None, ge=1)

    @field_validator("duty")
    @classmethod
    def _duty_is_a_fraction(cls, duty: float | None) -> float | None:
        if duty is not None and not 0.0 <= duty <= 1.0:
            raise ValueError("must be a fraction from 0 to 1, not percent")
        return duty

    @property
    def trial_id(self) -> str:
        """Stem of the file name; also names the recording."""
        return Path(self.file).stem

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
    """The whole of `campaign.toml`."""

    model_config = _STRICT
    config: str | None = None
    trial: tuple[TrialEntry, ...] = Field(min_length=1)


def load_campaign(path: Path) -> tuple[Campaign, LoadedConfig | None]:
    """Read `campaign.toml` and the configuration it names.

    Parameters
    ----------
    path : Path

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
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError("no such file", where=path, remedy="check the path") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"is not valid TOML: {error}", where=path) from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", where=path) from error
    campaign = _validate(path, tables)
    _check_files(path, campaign)
    config = None if campaign.config is None else load_config(path.parent / campaign.config)
    return campaign, config


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
    missing = [entry.file for entry in campaign.trial if not (path.parent / entry.file).is_file()]
    if missing:
        raise ConfigError(
            f"names {len(missing)} files that do not exist: {', '.join(missing[:5])}",
            where=path,
            remedy=f"files are looked for in {path.parent.resolve()}",
        )
    stems = [entry.trial_id for entry in campaign.trial]
    repeated = sorted({stem for stem in stems if stems.count(stem) > 1})
    if repeated:
        raise ConfigError(
            f"names the trial {repeated[0]} more than once",
            where=path,
            remedy="give every table a file name of its own",
        )
