"""The plan of a series: which trials, in which order, on which blade and battery; from TOML or from a table."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.toml_text import parse_toml, read_toml_text
from sawbench.bench.validation_text import describe_validation
from sawbench.bench.wear_rule import BLADE_GROWTH_LIMIT
from sawbench.storage.importers.unit_conversion import factor_between, split_unit

_STRICT: Final = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
# Repetitions of every setting that the paper asks for.
PAPER_REPETITIONS: Final = 3
# What is read of a file to see whether it is a plan.
_HEAD_CHARACTERS: Final = 20_000
_TRIALS: Final = re.compile(r"^\s*(\[\[trial\]\]|trial\s*=)", re.MULTILINE)

Setting = tuple[str, float | None, float | None, float | None]
Metadata = Literal["operator", "blade", "battery", "material", "batch"]


def _as_text(value: Any) -> Any:
    """Accept a number as an identity: `blade = 1` means blade "1"."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Identity = Annotated[str, BeforeValidator(_as_text), Field(min_length=1)]


class PlannedTrial(BaseModel):
    """One trial of a plan.

    Attributes
    ----------
    id : str
        Name of the recording.
    block : int
        Trials between which nothing but the workpiece is changed.
    material : str
        "none": the blade runs in air.
    duty, feed_mm_s, thickness_mm : float, optional
    repetition : int, optional
    blade, battery, batch : str, optional
    seconds : float, optional
        Duration; default: that of the plan.
    rest_s : float, optional
        How long the tool rests before.
    """

    model_config = _STRICT
    id: str = Field(pattern=r"^[A-Za-z0-9_][\w.+-]*$", max_length=100)
    block: int = Field(default=1, ge=0)
    material: str = Field(min_length=1)
    duty: float | None = Field(default=None, gt=0, le=1)
    feed_mm_s: float | None = Field(default=None, ge=0)
    thickness_mm: float | None = Field(default=None, gt=0)
    repetition: int | None = Field(default=None, ge=1)
    blade: Identity | None = None
    battery: Identity | None = None
    batch: Identity | None = None
    seconds: float | None = Field(default=None, gt=0)
    rest_s: float | None = Field(default=None, ge=0)

    @property
    def setting(self) -> Setting:
        """What its repetitions have in common: material, duty, feed, thickness."""
        return self.material, self.duty, self.feed_mm_s, self.thickness_mm

    @property
    def is_idle(self) -> bool:
        """Whether the blade runs in air."""
        return self.material == "none"


class SeriesPlan(BaseModel):
    """The whole of a plan; every key but `trial` may be left out.

    Attributes
    ----------
    config, recordings : str, optional
        Bench configuration and folder of the recordings, relative to the plan.
    seed : int, optional
        Of the order.
    operator : str, optional
    required : tuple of str
        Metadata without which no trial is recorded.
    seconds : float, optional
        Duration of a trial; default: the configuration's.
    tare : {"trial", "block", "never"}
        Before what the load cell is zeroed.
    tare_seconds, check_seconds : float
        How long to look; 0: no check before a trial.
    blade_growth_limit : float
        Relative growth of the specific force at which the blade is changed.
    repeatability : float
        Relative standard deviation expected between repetitions, until the series itself provides it.
    trial : tuple of PlannedTrial
        In the order in which they are recorded.
    """

    model_config = _STRICT
    config: str | None = None
    recordings: str | None = None
    seed: int | None = None
    operator: Identity | None = None
    required: tuple[Metadata, ...] = Field(default=("material",), strict=False)
    seconds: float | None = Field(default=None, gt=0)
    tare: Literal["trial", "block", "never"] = "block"
    tare_seconds: float = Field(default=5.0, ge=0.5, le=600)
    check_seconds: float = Field(default=2.0, ge=0, le=600)
    blade_growth_limit: float = Field(default=BLADE_GROWTH_LIMIT, gt=0)
    repeatability: float = Field(default=0.05, gt=0, lt=1)
    trial: tuple[PlannedTrial, ...] = Field(min_length=1, strict=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadedPlan:
    """A plan and where it stands.

    Attributes
    ----------
    plan : SeriesPlan
    path : Path
    sha256 : str
        Of the text.
    """

    plan: SeriesPlan
    path: Path
    sha256: str

    @property
    def folder(self) -> Path:
        """Where its recordings are: beside the plan, under its name, unless it states another folder."""
        return self.path.parent / (self.plan.recordings or self.path.stem)

    @property
    def config_path(self) -> Path | None:
        """The bench configuration that it states."""
        return None if self.plan.config is None else self.path.parent / self.plan.config

    def trial(self, trial_id: str) -> PlannedTrial:
        """Return one of its trials.

        Raises
        ------
        InputError
            If it has no such trial.
        """
        found = next((trial for trial in self.plan.trial if trial.id == trial_id), None)
        if found is None:
            names = ", ".join(trial.id for trial in self.plan.trial[:5])
            raise InputError(f"has no trial {trial_id!r}; its trials are {names}, ...", where=self.path)
        return found


def trial_name(number: int, material: str) -> str:
    """Name a trial by its place and material; what cannot stand in the name of a file becomes a dash.

    Examples
    --------
    >>> trial_name(3, "birch plywood, 9 mm")
    '03-birch-plywood-9-mm'
    >>> trial_name(4, "none")
    '04-idle'
    """
    word = "idle" if material == "none" else re.sub(r"[^\w.+-]+", "-", material).strip("-")
    return f"{number:02d}-{word[:80] or 'trial'}"


def is_plan(path: Path) -> bool:
    """Whether a file is a plan, or meant as one: one with a mistake has to be listed, so that the mistake is said.

    Parameters
    ----------
    path : Path
        TOML or a table (`.csv`).

    Notes
    -----
    TOML: it has trials, and they name no file, as those of a campaign do. A table: it has a column for the material or
    for idle runs, and at least half of its columns are those of a plan; tables of results state the settings too, but
    as the smaller part.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            head = file.read(_HEAD_CHARACTERS)
        if path.suffix.lower() != ".csv":
            return _TRIALS.search(head) is not None and "\nfile" not in head
        names, _, _ = _columns(_rows("\n".join(head.split("\n")[:2]), path))
    except (OSError, ConfigError):
        return False
    known = [name for name in names if name in _COLUMNS or name == "idle"]
    return not {"material", "workpiece", "idle"}.isdisjoint(known) and 2 * len(known) >= len(names)


def load_plan(path: Path) -> LoadedPlan:
    """Read a plan: TOML, or a table (`.csv`) with a row for each trial.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds a key or value that is not allowed; names trial and key.
    """
    text = read_toml_text(path, remedy="write one with `sawbench series plan --out PLAN.toml`")
    tables = _table_of(text, path) if path.suffix.lower() == ".csv" else parse_toml(text, where=path)
    trials = tables.get("trial")
    for number, trial in enumerate(trials if isinstance(trials, list) else (), start=1):
        try:
            PlannedTrial.model_validate(trial)
        except ValidationError as error:
            raise ConfigError(f"trial {number}: {describe_validation(error, PlannedTrial)}", where=path) from error
    try:
        plan = SeriesPlan.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(describe_validation(error, SeriesPlan), where=path) from error
    n_of_id = Counter(trial.id.lower() for trial in plan.trial)
    repeated = next((trial.id for trial in plan.trial if n_of_id[trial.id.lower()] > 1), None)
    if repeated is not None:
        raise ConfigError(f"has the trial {repeated} more than once", where=path, remedy="give every trial its own id")
    return LoadedPlan(plan=plan, path=path, sha256=hashlib.sha256(text.encode()).hexdigest())


def missing_metadata(plan: SeriesPlan, operator: str | None) -> str:
    """Say which required metadata nobody has stated; empty where all are there.

    Parameters
    ----------
    plan : SeriesPlan
    operator : str, optional
        Who records, where the plan does not say it.
    """
    lacking = []
    for name in plan.required:
        if name == "operator":
            lacking += [] if operator or plan.operator else ["operator"]
            continue
        trials = [t.id for t in plan.trial if not getattr(t, name) and not (name == "batch" and t.is_idle)]
        if trials:
            lacking.append(f"{name} of {', '.join(trials[:3])}" + (f" and {len(trials) - 3} more" * (len(trials) > 3)))
    return "; ".join(lacking)


def departures(plan: SeriesPlan) -> list[str]:
    """Say where a plan departs from the paper's rule: a new blade for every setting, three repetitions, +20 %."""
    said = []
    cut = [trial for trial in plan.trial if not trial.is_idle]
    settings = Counter(trial.setting for trial in cut)
    few = [setting for setting, n in settings.items() if n < PAPER_REPETITIONS]
    if few:
        said.append(f"{len(few)} of {len(settings)} settings have fewer than {PAPER_REPETITIONS} repetitions")
    n_settings = Counter(blade for blade, _ in {(trial.blade, trial.setting) for trial in cut})
    shared = [blade for blade, n in n_settings.items() if n > 1]
    if shared:
        said.append(f"{len(shared)} blades cut more than one setting: wear and setting are then partly confounded")
    if plan.blade_growth_limit != BLADE_GROWTH_LIMIT:
        said.append(
            f"blades are changed at +{plan.blade_growth_limit:.0%} specific force, not at +{BLADE_GROWTH_LIMIT:.0%}"
        )
    return said


# Column -> key of a trial; what is compared is lower case, without a unit.
_COLUMNS: Final[Mapping[str, str]] = {
    "id": "id", "trial": "id", "block": "block", "material": "material", "workpiece": "material", "duty": "duty",
    "feed": "feed_mm_s", "feed_mm_s": "feed_mm_s", "thickness": "thickness_mm", "thickness_mm": "thickness_mm",
    "length": "seconds", "length_s": "seconds", "seconds": "seconds", "rest": "rest_s", "rest_s": "rest_s",
    "repetition": "repetition", "blade": "blade", "battery": "battery", "batch": "batch",
}  # fmt: skip
# Numbers that may be stated in another unit.
_UNITS: Final[Mapping[str, str]] = {
    "duty": "1", "feed_mm_s": "mm/s", "thickness_mm": "mm", "seconds": "s", "rest_s": "s",
}  # fmt: skip
_SHARES: Final[Mapping[str, float]] = {"1": 1.0, "-": 1.0, "%": 0.01}
_TEXTS: Final = frozenset({"id", "material", "blade", "battery", "batch"})
_WHOLE: Final = frozenset({"block", "repetition"})
_YES: Final = frozenset({"1", "true", "yes", "y", "x"})
_NO: Final = frozenset({"", "0", "false", "no", "n"})


def _table_of(text: str, path: Path) -> dict[str, Any]:
    """Return the keys of a plan for a table with a row for each trial."""
    rows = _rows(text, path)
    names, units, n_before = _columns(rows)
    unknown = [name for name in names if name not in {*_COLUMNS, "idle"}]
    if unknown or not names:
        raise ConfigError(
            f"has a column {unknown[0]!r}" if unknown else "is empty",
            where=path,
            remedy=f"columns of a plan are {', '.join(dict.fromkeys([*_COLUMNS, 'idle']))}",
        )
    keys = [_COLUMNS.get(name, name) for name in names]
    if repeated := next((name for name, key in zip(names, keys, strict=True) if keys.count(key) > 1), None):
        raise ConfigError(f"has more than one column for {repeated!r}", where=path, remedy="leave out one of them")
    factors = {name: _factor(name, unit, path) for name, unit in zip(names, units, strict=True)}
    trials: list[dict[str, Any]] = []
    n_of_setting: Counter[Setting] = Counter()
    for line, cells in enumerate(rows[n_before + 1 :], start=n_before + 2):
        if any(cell.strip() for cell in cells):
            cells_by_name = dict(zip(names, (cell.strip() for cell in cells), strict=False))
            trial = _row(cells_by_name, factors, f"{path}: line {line}")
            setting = (trial["material"], trial.get("duty"), trial.get("feed_mm_s"), trial.get("thickness_mm"))
            n_of_setting[setting] += 1
            trial.setdefault("repetition", n_of_setting[setting])
            trial.setdefault("id", trial_name(len(trials) + 1, trial["material"]))
            trials.append(trial)
    return {"trial": trials}


def _rows(text: str, path: Path) -> list[list[str]]:
    header, _, rest = text.partition("\n")
    if header.lower().startswith("sep="):
        # Excel's line before the header; empty, so that the lines keep their numbers.
        text, header = f"\n{rest}", rest.partition("\n")[0]
    separator = max(",;\t", key=header.count)
    try:
        return list(csv.reader(io.StringIO(text, newline=""), delimiter=separator))
    except csv.Error as error:
        raise ConfigError(f"cannot be read as a table: {error}", where=path) from error


def _columns(rows: Sequence[Sequence[str]]) -> tuple[list[str], list[str], int]:
    """Return names and units ("" where none is stated) of the columns of a table, and how many rows are before them."""
    n_before = 1 if rows and not rows[0] else 0
    header = rows[n_before] if rows[n_before:] else []
    split = [split_unit(name) for name in header]
    return [name.strip().lower() for name, _ in split], [unit for _, unit in split], n_before


def _factor(name: str, unit: str, path: Path) -> float:
    """What the numbers of a column are multiplied by; what stands in brackets behind a text is no unit."""
    stored = _UNITS.get(_COLUMNS.get(name, ""), "")
    if not unit or not stored:
        return 1.0
    factor = _SHARES.get(unit) if stored == "1" else factor_between(unit, stored)
    if factor is None:
        known = "1 or %" if stored == "1" else f"{stored}, or a unit of the same kind, as `sawbench import` knows them"
        raise ConfigError(f"column {name!r} is in {unit!r}", where=path, remedy=f"state it in {known}")
    return factor


def _row(cells: Mapping[str, str], factors: Mapping[str, float], where: str) -> dict[str, Any]:
    idle = cells.get("idle", "").lower()
    if idle not in _YES | _NO:
        raise ConfigError(f"idle is {idle!r}, expected yes or no", where=where)
    trial: dict[str, Any] = {}
    for name, cell in cells.items():
        if name != "idle" and cell:
            trial[_COLUMNS[name]] = _cell(_COLUMNS[name], cell, factors[name], where)
    if idle in _YES:
        trial["material"] = "none"
    if "material" not in trial:
        raise ConfigError("has no material", where=where, remedy="enter the material, or set idle to yes")
    # In air there is neither workpiece nor feed.
    if trial["material"] == "none":
        trial = {key: value for key, value in trial.items() if key not in {"feed_mm_s", "thickness_mm"}}
    trial.setdefault("blade", "B1")
    trial.setdefault("battery", "P1")
    return trial


def _rounded(number: float) -> float:
    """A number as a person writes it: repetitions have equal settings, whatever unit those were typed in."""
    return float(f"{number:.12g}")


def _cell(key: str, cell: str, factor: float, where: str) -> str | float | int:
    if key in _TEXTS:
        return cell
    try:
        return int(cell) if key in _WHOLE else _rounded(factor * float(cell.replace(",", ".")))
    except ValueError:
        raise ConfigError(f"{key} is {cell!r}, expected a {'whole ' * (key in _WHOLE)}number", where=where) from None
