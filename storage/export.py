"""Recordings as CSV, Parquet and MF4: every sample of every channel, for other programs."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from hashlib import sha256 as new_hash
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, Recording, loss_in_words
from sawbench.bench.units import TIME_COLUMN
from sawbench.storage.describe import ChannelOutline, outline_of
from sawbench.storage.output import whole_file, write_whole
from sawbench.storage.pieces import is_long, read_pieces
from sawbench.storage.reader import read_recording

if TYPE_CHECKING:
    import pyarrow as pa

_FORMAT: Final = "sawbench export"
_FORMAT_VERSION: Final = 1
_LONGEST_NAME: Final = 80
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    name, channel, unit, device : str
    is_raw : bool
        What the instrument sent, before calibration.
    """

    name: str
    channel: str
    unit: str
    device: str
    is_raw: bool


Table = tuple[Column, ...]
"""Columns of channels that share their sample times."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportReport:
    """What was written of one recording.

    Attributes
    ----------
    paths : tuple of Path
        The tables, then the metadata.
    n_samples : int
        Over all channels.
    losses : tuple of str
        What of the recording is missing, where that matters.
    """

    paths: tuple[Path, ...]
    n_samples: int
    losses: tuple[str, ...]


def export_recording(
    source: Recording | Path,
    out_dir: str | Path,
    *,
    file_format: str,
    with_raw: bool = False,
    sha256: str = "",
    overwrite: bool = False,
) -> ExportReport:
    """Write a recording at full rate, with its metadata beside it.

    Nothing is resampled: each time base is a table of its own. CSV and Parquet are one file a time base, MF4 is one
    file with a channel group for each. Parquet and MF4 hold the values bit for bit, CSV as the shortest decimal
    number that is read back as the same value (at most 17 significant digits).

    Channels share a table only where all times and gaps are equal: equal rates are not enough, as every instrument has
    its own clock. A gap is one row, halfway between the samples around it;
    one behind the last sample ends at its row.

    Parameters
    ----------
    source : Recording or Path
        Read from a file, whose name the tables take; or the file, which is read piece by piece where it is long.
    out_dir : str or Path
        Made if missing.
    file_format : str
        A key of `FORMATS`: "csv", "parquet" or "mf4".
    with_raw : bool
        Also what the instruments sent before calibration, as `<channel>_raw`, where it was recorded.
    sha256 : str
        Of the recording's file, for the metadata.
    overwrite : bool
        Replace files that exist; otherwise none is written if one exists.

    Raises
    ------
    InputError
        If the recording has no samples, two columns have one name, or a file exists or cannot be written.
    """
    pieces = _pieces_of(source, with_raw=with_raw)
    recording, channels, shared = _surveyed(pieces())
    tables = tuple(_columns([channels[name] for name in names], channels, recording, with_raw) for names in shared)
    paths = _table_paths(recording, Path(out_dir), file_format, tables)
    about_path = metadata_path(recording.path, out_dir, file_format)
    for path in (*paths, about_path):
        if path.exists() and not overwrite:
            raise InputError("already exists", where=path, remedy="give another folder, or overwrite with --force")
    about = _metadata(recording, channels, paths, sha256)
    with ExitStack() as stack:
        files = [
            stack.enter_context(
                FORMATS[file_format](
                    stack.enter_context(whole_file(path, overwrite=True, makes_folder=True)),
                    shown, about, recording.trial.started_at,
                )
            )
            for path, shown in paths.items()
        ]  # fmt: skip
        for piece in pieces():
            for file, shown in zip(files, paths.values(), strict=True):
                for number, table in enumerate(shown):
                    if table[0].channel in piece.signals:
                        file.add(number, *_rows(table, piece))
    write_whole(about_path, about, overwrite=True, makes_folder=True)
    outlines = channels.values()
    lost = (loss_in_words(one.first.channel, one.n_samples, one.n_missing) for one in outlines)
    return ExportReport(
        paths=(*paths, about_path),
        n_samples=sum(one.n_samples for one in outlines),
        losses=(*filter(None, lost), *recording.interruptions),
    )


def metadata_path(recording_path: str | Path, out_dir: str | Path, file_format: str) -> Path:
    """File in which the metadata of an exported recording stands: written last, so that its tables are whole."""
    return Path(out_dir) / f"{_stem(recording_path)}.{file_format}.json"


def _pieces_of(source: Recording | Path, *, with_raw: bool) -> Callable[[], Iterable[Recording]]:
    """Return what gives the recording from its start, in one piece or in several."""
    if isinstance(source, Recording):
        return lambda: (source,)
    if is_long(source):
        return lambda: read_pieces(source, with_raw=with_raw)
    whole = read_recording(source)
    return lambda: (whole,)


def _surveyed(pieces: Iterable[Recording]) -> tuple[Recording, dict[str, ChannelOutline], list[list[str]]]:
    """Return the recording without samples, its channels, and the names of those that share their times and gaps."""
    digests: dict[str, Any] = {}

    def seen() -> Iterator[Recording]:
        for piece in pieces:
            for name, signal in piece.signals.items():
                digests.setdefault(name, new_hash()).update(signal.time_s)
            yield piece

    recording, channels = outline_of(seen())
    groups: dict[Any, list[str]] = {}
    for name, channel in channels.items():
        gaps = tuple((gap.start_s, gap.end_s) for gap in channel.gaps)
        groups.setdefault((digests[name].digest(), gaps), []).append(name)
    if not groups:
        raise InputError("contains no samples to export", where=recording.path)
    return recording, channels, list(groups.values())


def _columns(
    shown: Sequence[ChannelOutline], channels: Mapping[str, ChannelOutline], recording: Recording, with_raw: bool
) -> Table:
    columns: dict[str, Column] = {}
    for outline in shown:
        one = outline.first
        for is_raw in (False, True) if with_raw and outline.has_raw else (False,):
            name = f"{one.channel}_raw" if is_raw else one.channel
            if name in columns or (is_raw and name in channels):
                raise InputError(f"has two columns {name}", where=recording.path, remedy="export without --raw")
            columns[name] = Column(
                name=name, channel=one.channel, unit="" if is_raw else one.unit, device=one.device, is_raw=is_raw
            )
    return tuple(columns.values())


def _rows(table: Table, piece: Recording) -> tuple[Floats, list[Floats]]:
    """Times and cells of a piece; NaN in the row of a gap, and only there."""
    first = piece.signals[table[0].channel]
    time_s, gaps = first.time_s, first.gaps
    behind = [gap.end_s for gap in gaps if gap.start_s >= time_s[-1]]
    between = [0.5 * (gap.start_s + gap.end_s) for gap in gaps if gap.start_s < time_s[-1]]
    gap_s = np.unique([*between, *behind])
    at = np.searchsorted(time_s, gap_s)
    signals = [piece.signals[column.channel] for column in table]
    own = [signal.raw if column.is_raw else signal.values for column, signal in zip(table, signals, strict=True)]
    return np.insert(time_s, at, gap_s), [np.insert(values, at, np.nan) for values in own if values is not None]


def _stem(recording_path: str | Path) -> str:
    return Path(recording_path).name.removesuffix(".part").removesuffix(".mcap")


def _table_paths(
    recording: Recording, out_dir: Path, file_format: str, tables: Sequence[Table]
) -> dict[Path, Sequence[Table]]:
    """Return which tables go into which file."""
    stem = _stem(recording.path)
    if file_format == "mf4" or len(tables) == 1:
        return {out_dir / f"{stem}.{file_format}": tables}
    paths: dict[Path, Sequence[Table]] = {}
    for table in tables:
        channels = list(dict.fromkeys(column.channel for column in table))
        name = re.sub(r"[^\w.+-]", "_", "+".join(channels))
        name = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}+{len(channels)}"
        path = out_dir / f"{stem}.{name}.{file_format}"
        # Names that differ in a sign no file name has, or in capitals, must not share a file.
        taken = {str(other).casefold() for other in paths}
        if str(path).casefold() in taken:
            path = out_dir / f"{stem}.{name}-{len(paths) + 1}.{file_format}"
        paths[path] = (table,)
    return paths


def _metadata(
    recording: Recording,
    outlines: Mapping[str, ChannelOutline],
    paths: Mapping[Path, Sequence[Table]],
    sha256_hex: str,
) -> str:
    """Everything of the recording but its samples, as JSON."""
    columns = [(path.name, column) for path, shown in paths.items() for table in shown for column in table]
    file_of = {column.channel: name for name, column in columns}
    raw = {column.channel for _, column in columns if column.is_raw}
    channels = {
        name: {
            "file": file_of[name],
            "raw_column": f"{name}_raw" if name in raw else None,
            "unit": one.first.unit,
            "device": one.first.device,
            "n_samples": one.n_samples,
            "rate_hz": one.rate_hz,
            "n_missing": one.n_missing,
            "gaps": [asdict(gap) for gap in one.gaps],
            "alignment": None if one.first.alignment is None else asdict(one.first.alignment),
        }
        for name, one in outlines.items()
    }
    about = {
        "format": _FORMAT,
        "format_version": _FORMAT_VERSION,
        "recording": Path(recording.path).name,
        "recording_sha256": sha256_hex or None,
        "is_complete": recording.is_complete,
        "files": [path.name for path in paths],
        "trial": asdict(recording.trial),
        "channels": channels,
        "events": [asdict(event) for event in recording.events],
        "provenance": dict(recording.provenance),
        "config_toml": recording.config_toml,
    }
    return json.dumps(about, indent=2, allow_nan=False, default=datetime.isoformat) + "\n"


class _Arrow:
    """What CSV and Parquet share: one table, given out as it comes."""

    def __init__(self, table: Table, about: str) -> None:
        import pyarrow as pa

        fields = [pa.field(TIME_COLUMN, pa.float64(), metadata={"unit": "s"})]
        fields += [pa.field(c.name, pa.float64(), metadata={"unit": c.unit, "device": c.device}) for c in table]
        self.schema = pa.schema(fields, metadata={"sawbench": about})

    def of(self, time_s: Floats, cells: Sequence[Floats]) -> pa.Table:
        """Rows; their NaN are empty cells."""
        import pyarrow as pa

        arrays = [pa.array(time_s), *(pa.array(values, from_pandas=True) for values in cells)]
        return pa.Table.from_arrays(arrays, schema=self.schema)


class CsvFile:
    """A header of names and a row per sample; the cells of a gap are empty."""

    def __init__(self, stream: BinaryIO, shown: Sequence[Table], about: str, started_at: datetime | None) -> None:
        del started_at
        (table,) = shown
        self._stream, self._arrow = stream, _Arrow(table, about)
        header = io.StringIO(newline="")
        csv.writer(header, lineterminator="\n").writerow([TIME_COLUMN, *(column.name for column in table)])
        stream.write(header.getvalue().encode())

    def __enter__(self) -> CsvFile:
        return self

    def add(self, number: int, time_s: Floats, cells: Sequence[Floats]) -> None:
        """Append rows to the table of this number."""
        import pyarrow.csv

        del number
        options = pyarrow.csv.WriteOptions(include_header=False)
        pyarrow.csv.write_csv(self._arrow.of(time_s, cells), self._stream, options)

    def __exit__(self, *_: object) -> None:
        pass


class ParquetFile:
    """A table whose cells are null in a gap; units at the fields, all metadata under the key `sawbench`."""

    def __init__(self, stream: BinaryIO, shown: Sequence[Table], about: str, started_at: datetime | None) -> None:
        from pyarrow.parquet import ParquetWriter

        del started_at
        (table,) = shown
        self._arrow = _Arrow(table, about)
        self._writer = ParquetWriter(stream, self._arrow.schema, compression="zstd")

    def __enter__(self) -> ParquetFile:
        return self

    def add(self, number: int, time_s: Floats, cells: Sequence[Floats]) -> None:
        """Append rows to the table of this number."""
        del number
        self._writer.write_table(self._arrow.of(time_s, cells))

    def __exit__(self, *_: object) -> None:
        self._writer.close()


class Mf4File:
    """A channel group a table; NaN in a gap; all metadata as the attachment `sawbench.json`."""

    def __init__(self, stream: BinaryIO, shown: Sequence[Table], about: str, started_at: datetime | None) -> None:
        from asammdf import MDF

        self._stream, self._tables, self._about = stream, shown, about
        self._group_of: dict[int, int] = {}
        self._file = MDF(version="4.10")
        # Left alone, the header would hold the time of the export; MF4 knows no time before 1970.
        self._file.header.start_time = max(started_at or _EPOCH, _EPOCH)

    def __enter__(self) -> Mf4File:
        return self

    def add(self, number: int, time_s: Floats, cells: Sequence[Floats]) -> None:
        """Append rows to the table of this number."""
        from asammdf import Signal as MdfSignal

        if number in self._group_of:
            self._file.extend(self._group_of[number], [(values, None) for values in (time_s, *cells)])
            return
        signals = [
            MdfSignal(values, time_s, name=column.name, unit=column.unit, comment=column.device)
            for column, values in zip(self._tables[number], cells, strict=True)
        ]
        self._group_of[number] = self._file.append(signals, common_timebase=True)

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._file.attach(self._about.encode(), file_name="sawbench.json", mime="application/json")
            self._file.save(self._stream, compression=2)  # pyright: ignore[reportArgumentType] - any binary file will do
        self._file.close()


FORMATS: Final[Mapping[str, type[CsvFile | ParquetFile | Mf4File]]] = MappingProxyType(
    {"csv": CsvFile, "parquet": ParquetFile, "mf4": Mf4File}
)
