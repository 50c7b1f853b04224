"""Decides by the file's kind how it is imported."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from sawbench.bench.errors import InputError, WritingError
from sawbench.bench.recording import Alignment, Event, Recording, Signal, Trial
from sawbench.bench.units import TIME_COLUMN
from sawbench.storage.digest import sha256_of
from sawbench.storage.importers.clock_times import FirstTime
from sawbench.storage.importers.column_choice import choose_columns
from sawbench.storage.importers.raw_table import RawTable
from sawbench.storage.importers.table import FramesNeedDbc, signals_of
from sawbench.storage.importers.table_map import TableMap
from sawbench.storage.reader import write_recording
from sawbench.storage.writer import software_version

TEXT_SUFFIXES: Final = (".csv", ".tsv", ".txt", ".dat", ".lvm")
HDF5_SUFFIXES: Final = (".h5", ".hdf5", ".hdf")
MAT_SUFFIXES: Final = (".mat",)
JSON_SUFFIXES: Final = (".json",)
MF4_SUFFIXES: Final = (".mf4", ".mdf")
LOG_SUFFIXES: Final = (".log", ".asc", ".blf")


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportReport:
    """What an import wrote.

    Attributes
    ----------
    paths : tuple of Path
        One recording a trial, in the order of the campaign.
    warnings : tuple of str
        Each begins with the name of its table; also in the recording as events.
    n_samples : int
        Over all channels of all trials.
    notes : tuple of str
        How tables were read and what was left out; each begins with the name of its table.
    taken : mapping of str to mapping of str to str
        Recording -> channel -> the column it was taken from, with unit and factor, in words.
    """

    paths: tuple[Path, ...]
    warnings: tuple[str, ...]
    n_samples: int
    notes: tuple[str, ...] = ()
    taken: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class TableContent:
    """What was read from one table.

    Attributes
    ----------
    signals : mapping of str to Signal
    warnings : tuple of str
    taken : mapping of str to str
        Channel -> the column it was taken from, in words.
    notes : tuple of str
        How the file was read, where that was not plain.
    first : FirstTime or None
        When the first row was, where the file states it: the times count from there.
    """

    signals: Mapping[str, Signal]
    warnings: tuple[str, ...]
    taken: Mapping[str, str]
    notes: tuple[str, ...]
    first: FirstTime | None

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time of its signals, s."""
        times = [signal.time_s for signal in self.signals.values()]
        return min(float(time_s[0]) for time_s in times), max(float(time_s[-1]) for time_s in times)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Source:
    """A table of a trial, and what is added to its times."""

    path: Path
    table_map: TableMap | None
    time_shift_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class _Job:
    sources: tuple[_Source, ...]
    trial: Trial
    config_toml: str
    provenance: Mapping[str, str]


def import_path(
    path: str | Path,
    out_dir: str | Path,
    *,
    overwrite: bool = False,
    on_trial: Callable[[int, int, str], None] | None = None,
    table_map: TableMap | None = None,
    trial: Trial | None = None,
    config_toml: str = "",
) -> ImportReport:
    """Turn a campaign or a single table into recordings.

    Parameters
    ----------
    path : str or Path
        `campaign.toml`, or a text, HDF5, MATLAB, JSON or MF4 file.
    out_dir : str or Path
        Folder for `<table's stem>.mcap`; made if missing.
    overwrite : bool
    on_trial : callable, optional
        Called with trials done, trials in all and the name of the next one, for a progress bar.
    table_map : TableMap, optional
        Which column is which channel; of a campaign, for the trials that state none themselves.
    trial : Trial, optional
        Settings of a single table; a campaign states its own.
    config_toml : str
        Bench configuration that is kept with a single table.

    Raises
    ------
    InputError
        If the campaign, a map or a table is wrong; then no recording is written, of no trial. All wrong tables are
        named.
    RecordingError
        If a recording exists and `overwrite` is False; no trial is imported then.
    FramesNeedDbc
        If the file holds CAN frames.
    """
    path, out_dir = Path(path), Path(out_dir)
    if path.suffix.lower() == ".toml":
        jobs = _jobs_of_campaign(path, table_map)
    else:
        jobs = [_job_of_table(path, table_map, trial, config_toml)]
    _refuse_existing([out_dir / f"{job.trial.trial_id}.mcap" for job in jobs], overwrite=overwrite)
    is_new = not out_dir.exists()
    out_dir.mkdir(parents=True, exist_ok=True)
    try:
        # A campaign that lacks trials would be taken for a whole one: all are moved to their place, or none.
        with TemporaryDirectory(prefix=".import-", dir=out_dir) as folder:
            report = _write_all(jobs, Path(folder), on_trial)
            return replace(report, paths=tuple(written.replace(out_dir / written.name) for written in report.paths))
    finally:
        if is_new and not any(out_dir.iterdir()):
            out_dir.rmdir()


def _write_all(
    jobs: Sequence[_Job], folder: Path, on_trial: Callable[[int, int, str], None] | None
) -> ImportReport:  # fmt: skip
    paths, warnings, notes, taken, n_samples = [], [], [], {}, 0
    refused: list[InputError] = []
    for number, job in enumerate(jobs):
        if on_trial is not None:
            on_trial(number, len(jobs), job.trial.trial_id)
        try:
            contents = _contents(job)
            words = _taken(job.sources, contents)
            recording = _recording(job, contents, words)
        except InputError as error:
            refused.append(error)
            continue
        if refused:
            continue
        target = folder / f"{job.trial.trial_id}.mcap"
        try:
            write_recording(recording, target)
        except WritingError as error:
            # All of an import is given up: nothing is left that could be recovered.
            raise WritingError.of(error.__cause__ or error, where=target.name) from error
        paths.append(target)
        taken[target.name] = words
        for source, content in zip(job.sources, contents, strict=True):
            warnings += [f"{source.path.name}: {text}" for text in content.warnings]
            said = (*content.notes, *_unknown_start(recording.trial, content.first))
            notes += [f"{source.path.name}: {text}" for text in said]
        n_samples += sum(len(signal.values) for signal in recording.signals.values())
    if len(refused) > 1:
        raise InputError("\n  ".join([f"{len(refused)} of {len(jobs)} trials cannot be imported:", *map(str, refused)]))
    if refused:
        raise refused[0]
    return ImportReport(
        paths=tuple(paths), warnings=tuple(warnings), notes=tuple(notes), n_samples=n_samples, taken=taken
    )


def _contents(job: _Job) -> list[TableContent]:
    """Read all tables of a trial, on the times of the first one."""
    is_saw, expected = _machine(job.config_toml)
    contents = [
        read_table(source.path, source.table_map, is_idle=job.trial.is_idle, is_saw=is_saw, expected=expected)
        for source in job.sources
    ]
    first = contents[0]
    return [_of_one_clock(source, content, first) for source, content in zip(job.sources, contents, strict=True)]


def stem_of(path: Path) -> str:
    """Return the name of a file without its suffixes of format and packing.

    Examples
    --------
    >>> stem_of(Path("run.1.TXT.gz")), stem_of(Path("trial-01.csv"))
    ('run.1', 'trial-01')
    """
    return Path(path.stem).stem if path.suffix.lower() == ".gz" else path.stem


def _job_of_table(path: Path, table_map: TableMap | None, trial: Trial | None, config_toml: str) -> _Job:
    settings = trial or Trial(trial_id=stem_of(path), source=f"import of {path.name}")
    source = _Source(path=path, table_map=table_map)
    return _Job(sources=(source,), trial=settings, config_toml=config_toml, provenance={})


def _jobs_of_campaign(path: Path, table_map: TableMap | None) -> list[_Job]:
    from sawbench.storage.importers.campaign import load_campaign, map_of
    from sawbench.storage.importers.table_map import load_map

    campaign, config = load_campaign(path)
    about = {"campaign": path.name, "campaign_sha256": sha256_of(path)}
    return [
        _Job(
            sources=(
                _Source(path=path.parent / entry.file, table_map=map_of(path, campaign, entry) or table_map),
                *(
                    _Source(
                        path=path.parent / table.file,
                        table_map=None if table.map is None else load_map(path.parent / table.map),
                        time_shift_s=table.time_shift_s,
                    )
                    for table in entry.further
                ),
            ),
            trial=entry.trial(),
            config_toml=config.text if config else "",
            provenance={**about, "trial_number": str(number)},
        )
        for number, entry in enumerate(campaign.trial, start=1)
    ]


def _refuse_existing(paths: list[Path], *, overwrite: bool) -> None:
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise InputError(
            f"{len(existing)} of {len(paths)} recordings already exist and are not overwritten",
            where=existing[0],
            remedy="give another folder with --out, or replace them with --force",
        )


def _recording(job: _Job, contents: Sequence[TableContent], taken: Mapping[str, str]) -> Recording:
    provenance = {"imported_by": software_version(), **job.provenance}
    for number, (source, content) in enumerate(zip(job.sources, contents, strict=True), start=1):
        which = "" if number == 1 else f" {number}"
        provenance |= {f"source_file{which}": source.path.name, f"source_sha256{which}": sha256_of(source.path)}
        if source.table_map is not None:
            provenance[f"map{which}"] = source.table_map.as_toml()
            provenance |= _alignments(source.table_map, content)
        if content.notes:
            provenance[f"table{which}"] = "; ".join(content.notes)
    provenance |= {f"column of {channel}": words for channel, words in taken.items()}
    signals = _of_all(job.sources, contents)
    start_s = min((float(signal.time_s[0]) for signal in signals.values()), default=0.0)
    return Recording(
        trial=_started(job.trial, contents[0].first),
        signals=signals,
        events=tuple(
            Event(kind="warning", time_s=start_s, text=text) for content in contents for text in content.warnings
        ),
        config_toml=job.config_toml,
        provenance=provenance,
    )


def _started(trial: Trial, first: FirstTime | None) -> Trial:
    """A trial with its start, where the first of its tables knows it and nobody stated another one."""
    if trial.started_at is not None or first is None or first.at is None:
        return trial
    return replace(trial, started_at=first.at)


def _unknown_start(trial: Trial, first: FirstTime | None) -> list[str]:
    """Say that times have a date which does not tell when they were."""
    if trial.started_at is not None or first is None or not first.has_date:
        return []
    text = "the times have a date of which the time zone or the order of day and month is not known: when the trial "
    return [f"{text}started is not recorded; state it in a map (--map): [table] time_zone, or started_at of the trial"]


def _alignments(table_map: TableMap, content: TableContent) -> dict[str, str]:
    if table_map.table.alignment_std_s is None:
        return {}
    stated = Alignment(std_s=table_map.table.alignment_std_s, latency_s=0.0)
    return {key: text for channel in content.signals for key, text in stated.entry(channel).items()}


def _taken(sources: Sequence[_Source], contents: Sequence[TableContent]) -> dict[str, str]:
    """Channel -> the column it was taken from; every table has a time of its own."""
    first, *further = (content.taken for content in contents)
    named = [
        {f"{name} of {source.path.name}" if name == TIME_COLUMN else name: words for name, words in taken.items()}
        for source, taken in zip(sources[1:], further, strict=True)
    ]
    return {channel: words for taken in (first, *named) for channel, words in taken.items()}


def _of_one_clock(source: _Source, content: TableContent, first: TableContent) -> TableContent:
    """A table on the times of the first one: times that a clock shows say how far the two are apart."""
    shift_s = source.time_shift_s
    if first.first is not None and content.first is not None:
        shift_s += content.first.after(first.first)
    placed = replace(content, signals={name: signal.later(shift_s) for name, signal in content.signals.items()})
    (start_s, end_s), (first_start_s, first_end_s) = placed.span_s, first.span_s
    if max(start_s, first_start_s) <= min(end_s, first_end_s):
        return placed
    apart = (
        f"its times, {start_s:.6g} to {end_s:.6g} s, and those of the first table, {first_start_s:.6g} to "
        f"{first_end_s:.6g} s, do not overlap; check whether it is of this trial, or state time_shift_s"
    )
    return replace(placed, warnings=(*placed.warnings, apart))


def _of_all(sources: Sequence[_Source], contents: Sequence[TableContent]) -> dict[str, Signal]:
    """Signals of all tables of a trial."""
    signals: dict[str, Signal] = {}
    for source, content in zip(sources, contents, strict=True):
        repeated = sorted(signals.keys() & content.signals.keys())
        if repeated:
            raise InputError(
                f"has {repeated[0]}, which another table of the trial has too",
                where=source.path,
                remedy="give this table a map that names the channels to take, with the other one under its own name",
            )
        signals |= content.signals
    return signals


@lru_cache(maxsize=1)  # a campaign has one
def _machine(config_toml: str) -> tuple[bool, frozenset[str]]:
    """Whether the configuration of a table describes a saw, as without one, and which further channels it names."""
    from sawbench.bench.config import parse_config

    if not config_toml:
        return True, frozenset()
    config = parse_config(config_toml, where="configuration").config
    return config.frame == "crank", config.further_channels


def read_table(
    path: Path,
    table_map: TableMap | None = None,
    *,
    is_idle: bool = False,
    is_saw: bool = True,
    expected: frozenset[str] = frozenset(),
) -> TableContent:
    """Read the signals of a single table.

    Parameters
    ----------
    path : Path
    table_map : TableMap, optional
    is_idle : bool
        The blade ran in air.
    is_saw : bool
        See `signals_of`.
    expected : frozenset of str
        Channels beyond those of the bench that the configuration names.

    Raises
    ------
    InputError
        As `import_path`.
    """
    raw = read_raw_table(path, table_map)
    choice = choose_columns(raw, table_map)
    signals: dict[str, Signal] = {}
    warnings = list(choice.warnings)
    for table in choice.tables:
        found, said = signals_of(table, is_idle=is_idle, is_saw=is_saw, expected=choice.mapped | expected)
        signals |= found
        warnings += said
    if not signals:
        raise InputError(f"has no channel with values; {'; '.join(warnings)}", where=path, remedy="check the table")
    return TableContent(
        signals=signals,
        warnings=tuple(dict.fromkeys(warnings)),
        taken=choice.words,
        notes=(*raw.notes, *choice.notes),
        first=choice.first,
    )


def read_raw_table(path: Path, table_map: TableMap | None) -> RawTable:
    """Read every column of a single table, before anything is taken for a channel.

    Raises
    ------
    InputError
        If the file is missing, damaged or of an unknown kind.
    """
    suffix = Path(path.stem).suffix.lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if suffix in TEXT_SUFFIXES:
        from sawbench.storage.importers.text_table import read_text_table

        return read_text_table(path, table_map.table if table_map else None)
    if suffix in LOG_SUFFIXES:
        raise FramesNeedDbc("is a log of CAN frames", where=path, remedy="give the DBC that describes the frames")
    if path.suffix.lower() == ".gz":
        raise InputError(
            "is compressed, which is supported for text only", where=path, remedy="decompress it with gzip -d"
        )
    if suffix in MF4_SUFFIXES:
        from sawbench.storage.importers.reader_process import read_apart

        return read_apart("mf4", path)
    if suffix in HDF5_SUFFIXES:
        from sawbench.storage.importers.hdf5_table import read_hdf5_table

        return read_hdf5_table(path)
    if suffix in MAT_SUFFIXES:
        from sawbench.storage.importers.reader_process import read_apart

        return read_apart("mat", path)
    if suffix in JSON_SUFFIXES:
        from sawbench.storage.importers.json_table import read_json_table

        return read_json_table(path)
    if suffix == ".mcap":
        raise InputError("is already a recording", where=path, remedy="`sawbench info` shows its content")
    tables = (*TEXT_SUFFIXES, *HDF5_SUFFIXES, *MAT_SUFFIXES, *JSON_SUFFIXES, *MF4_SUFFIXES)
    raise InputError(
        "has an unknown format",
        where=path,
        remedy=f"known are {', '.join(('.toml', *tables, *LOG_SUFFIXES))}; text may be compressed (.csv.gz)",
    )
