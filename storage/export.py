"""Recordings as CSV, Parquet and MF4: every sample of every channel, for other programs."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, Recording, Signal
from sawbench.bench.units import TIME_COLUMN
from sawbench.storage.output import write_whole

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
    channel, unit, device : str
    values : ndarray, shape (n,), in `unit`
        NaN in the rows that stand for a gap, and only there.
    """

    channel: str
    unit: str
    device: str
    values: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeBase:
    """The channels that share their sample times, as one table.

    Attributes
    ----------
    time_s : ndarray, shape (n,), s
        Strictly increasing. A gap is one row, halfway between the samples around it; a gap behind the last
        sample ends at its row.
    columns : mapping of str to Column
        By the name of the column.
    """

    time_s: Floats
    columns: Mapping[str, Column]


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportReport:
    """What was written of one recording.

    Attributes
    ----------
    paths : tuple of Path
        The tables, then the metadata.
    n_samples : int
        Over all channels.
    """

    paths: tuple[Path, ...]
    n_samples: int


def export_recording(
    recording: Recording,
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

    Parameters
    ----------
    recording : Recording
        Read from a file: the tables take its name.
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
    bases = time_bases(recording, with_raw=with_raw)
    paths = _table_paths(recording, Path(out_dir), file_format, bases)
    about_path = metadata_path(recording.path, out_dir, file_format)
    for path in (*paths, about_path):
        if path.exists() and not overwrite:
            raise InputError("already exists", where=path, remedy="give another folder, or overwrite with --force")
    about = _metadata(recording, paths, bases, sha256)
    for path, shown in paths.items():
        write_whole(
            path, FORMATS[file_format](shown, about, recording.trial.started_at), overwrite=True, makes_folder=True
        )
    write_whole(about_path, about, overwrite=True, makes_folder=True)
    n_samples = sum(len(signal.values) for signal in recording.signals.values())
    return ExportReport(paths=(*paths, about_path), n_samples=n_samples)


def metadata_path(recording_path: str | Path, out_dir: str | Path, file_format: str) -> Path:
    """File in which the metadata of an exported recording stands: written last, so that its tables are whole."""
    return Path(out_dir) / f"{_stem(recording_path)}.{file_format}.json"


def time_bases(recording: Recording, *, with_raw: bool = False) -> tuple[TimeBase, ...]:
    """Group the channels by their sample times.

    Parameters
    ----------
    recording : Recording
    with_raw : bool
        As `export_recording`.

    Returns
    -------
    tuple of TimeBase
        Channels are together only where all times and gaps are equal: equal rates are not enough, as every
        instrument has its own clock.

    Raises
    ------
    InputError
        If there is no sample, or a raw column has the name of a channel.
    """
    groups: dict[Any, list[Signal]] = {}
    for signal in recording.signals.values():
        if len(signal.time_s):
            gaps = tuple((gap.start_s, gap.end_s) for gap in signal.gaps)
            groups.setdefault((signal.time_s.tobytes(), gaps), []).append(signal)
    if not groups:
        raise InputError("contains no samples to export", where=recording.path)
    return tuple(_time_base(signals, recording, with_raw) for signals in groups.values())


def _time_base(signals: Sequence[Signal], recording: Recording, with_raw: bool) -> TimeBase:
    time_s, gaps = signals[0].time_s, signals[0].gaps
    behind = [gap.end_s for gap in gaps if gap.start_s >= time_s[-1]]
    between = [0.5 * (gap.start_s + gap.end_s) for gap in gaps if gap.start_s < time_s[-1]]
    gap_s = np.unique([*between, *behind])
    at = np.searchsorted(time_s, gap_s)
    columns: dict[str, Column] = {}
    for signal in signals:
        kinds = {signal.channel: (signal.values, signal.unit)}
        if with_raw and signal.raw is not None:
            kinds[f"{signal.channel}_raw"] = (signal.raw, "")
        for name, (values, unit) in kinds.items():
            if name in columns or (name != signal.channel and name in recording.signals):
                raise InputError(f"has two columns {name}", where=recording.path, remedy="export without --raw")
            gapped = np.insert(values, at, np.nan)
            columns[name] = Column(channel=signal.channel, unit=unit, device=signal.device, values=gapped)
    return TimeBase(time_s=np.insert(time_s, at, gap_s), columns=columns)


def _stem(recording_path: str | Path) -> str:
    return Path(recording_path).name.removesuffix(".part").removesuffix(".mcap")


def _table_paths(
    recording: Recording, out_dir: Path, file_format: str, bases: Sequence[TimeBase]
) -> dict[Path, Sequence[TimeBase]]:
    """Return which time bases go into which file."""
    stem = _stem(recording.path)
    if file_format == "mf4" or len(bases) == 1:
        return {out_dir / f"{stem}.{file_format}": bases}
    paths: dict[Path, Sequence[TimeBase]] = {}
    for base in bases:
        channels = list(dict.fromkeys(column.channel for column in base.columns.values()))
        name = re.sub(r"[^\w.+-]", "_", "+".join(channels))
        name = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}+{len(channels)}"
        path = out_dir / f"{stem}.{name}.{file_format}"
        # Names that differ in a sign no file name has, or in capitals, must not share a file.
        taken = {str(other).casefold() for other in paths}
        if str(path).casefold() in taken:
            path = out_dir / f"{stem}.{name}-{len(paths) + 1}.{file_format}"
        paths[path] = (base,)
    return paths


def _metadata(
    recording: Recording, paths: Mapping[Path, Sequence[TimeBase]], bases: Sequence[TimeBase], sha256: str
) -> str:
    """Everything of the recording but its samples, as JSON."""
    file_of = {channel: path.name for path, shown in paths.items() for base in shown for channel in base.columns}
    raw = {name for base in bases for name, column in base.columns.items() if name != column.channel}
    channels = {
        signal.channel: {
            "file": file_of.get(signal.channel),
            "raw_column": f"{signal.channel}_raw" if f"{signal.channel}_raw" in raw else None,
            "unit": signal.unit,
            "device": signal.device,
            "n_samples": len(signal.values),
            "rate_hz": signal.rate_hz,
            "n_missing": signal.n_missing,
            "gaps": [asdict(gap) for gap in signal.gaps],
            "alignment": None if signal.alignment is None else asdict(signal.alignment),
        }
        for signal in recording.signals.values()
    }
    about = {
        "format": _FORMAT,
        "format_version": _FORMAT_VERSION,
        "recording": Path(recording.path).name,
        "recording_sha256": sha256 or None,
        "is_complete": recording.is_complete,
        "files": [path.name for path in paths],
        "trial": asdict(recording.trial),
        "channels": channels,
        "events": [asdict(event) for event in recording.events],
        "provenance": dict(recording.provenance),
        "config_toml": recording.config_toml,
    }
    return json.dumps(about, indent=2, allow_nan=False, default=datetime.isoformat) + "\n"


def _arrow_table(base: TimeBase) -> pa.Table:
    import pyarrow as pa

    arrays = [pa.array(base.time_s), *(pa.array(c.values, from_pandas=True) for c in base.columns.values())]
    fields = [pa.field(TIME_COLUMN, pa.float64(), metadata={"unit": "s"})]
    fields += [
        pa.field(name, pa.float64(), metadata={"unit": c.unit, "device": c.device}) for name, c in base.columns.items()
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _csv_content(shown: Sequence[TimeBase], about: str, started_at: datetime | None) -> bytes:
    """Return a header of names and a row per sample; the cells of a gap are empty."""
    import pyarrow.csv

    del about, started_at
    (base,) = shown
    header = io.StringIO(newline="")
    csv.writer(header, lineterminator="\n").writerow([TIME_COLUMN, *base.columns])
    content = io.BytesIO()
    content.write(header.getvalue().encode())
    pyarrow.csv.write_csv(_arrow_table(base), content, pyarrow.csv.WriteOptions(include_header=False))
    return content.getvalue()


def _parquet_content(shown: Sequence[TimeBase], about: str, started_at: datetime | None) -> bytes:
    """Return a table whose cells are null in a gap; units at the fields, all metadata under the key `sawbench`."""
    import pyarrow.parquet

    del started_at
    (base,) = shown
    content = io.BytesIO()
    table = _arrow_table(base).replace_schema_metadata({"sawbench": about})
    pyarrow.parquet.write_table(table, content, compression="zstd")
    return content.getvalue()


def _mf4_content(shown: Sequence[TimeBase], about: str, started_at: datetime | None) -> bytes:
    """Return a channel group a time base; NaN in a gap; all metadata as the attachment `sawbench.json`."""
    from asammdf import MDF
    from asammdf import Signal as MdfSignal

    content = io.BytesIO()
    with MDF(version="4.10") as measurement:
        for base in shown:
            signals = [
                MdfSignal(column.values, base.time_s, name=name, unit=column.unit, comment=column.device)
                for name, column in base.columns.items()
            ]
            measurement.append(signals, common_timebase=True)
        # Left alone, the header would hold the time of the export; MF4 knows no time before 1970.
        measurement.header.start_time = max(started_at or _EPOCH, _EPOCH)
        measurement.attach(about.encode(), file_name="sawbench.json", mime="application/json")
        measurement.save(content, compression=2)
    return content.getvalue()


Content = Callable[[Sequence[TimeBase], str, datetime | None], bytes]
FORMATS: Final[Mapping[str, Content]] = MappingProxyType(
    {"csv": _csv_content, "parquet": _parquet_content, "mf4": _mf4_content}
)
