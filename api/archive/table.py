"""The results of an archive: a Parquet table, partitioned by material and month, one row per recording.

pandas, DuckDB and Polars read the folder `trials` as it stands. Rows are only added while a batch runs; when it ends,
rows that were replaced are taken out and the small files of a partition are joined.
"""

from __future__ import annotations

import io
import uuid
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote, unquote

from sawbench.bench.errors import InputError
from sawbench.bench.units import CHANNELS
from sawbench.storage.output import write_whole
from sawbench.storage.places import Place, list_files, read_bytes, remove

if TYPE_CHECKING:
    import pandas
    import pyarrow

FOLDER: Final = "trials"
_TEXTS: Final = (
    "source", "source_sha256", "stamp", "config_key", "software", "trial_id", "blade", "battery", "operator", "batch",
    "status", "quality", "confidence", "fit_status", "runtime_status", "warnings", "error", "remedy", "detail",
)  # fmt: skip
_WHOLE: Final = ("size_bytes", "exit_code", "repetition", "n_cycles", "n_missing")
_TRUTHS: Final = ("is_amended",)
_TIMES: Final = ("started_at", "evaluated_at")
_NUMBERS: Final = (
    "duty", "thickness_mm", "feed_mm_s", "stroke_period_s", "stroke_period_std_s", "stroke_rate_hz", "peak_force_n",
    "peak_force_std_n", "k_fc_n_s_per_m", "k_fc_std_n_s_per_m", "runtime_s", "runtime_std_s",
    *(f"{kind}_{channel.name}" for kind in ("mean", "rms") for channel in CHANNELS),
)  # fmt: skip
# Named in the folders, as Hive does, and not in the files.
PARTITIONS: Final = ("material", "month")
COLUMNS: Final = (*PARTITIONS, *_TEXTS, *_WHOLE, *_TRUTHS, *_TIMES, *_NUMBERS)
# A recording, and which of its rows is the latest.
_KEY: Final = ("source", "evaluated_at")
# Not what Hive writes for it, which pandas cannot read.
_NOBODY_SAID: Final = "unknown"

Row = Mapping[str, Any]


def schema() -> pyarrow.Schema:
    """Return names and types of the columns in the files."""
    import pyarrow as pa

    return pa.schema(
        [(name, pa.string()) for name in _TEXTS]
        + [(name, pa.int64()) for name in _WHOLE]
        + [(name, pa.bool_()) for name in _TRUTHS]
        + [(name, pa.timestamp("us", tz="UTC")) for name in _TIMES]
        + [(name, pa.float64()) for name in _NUMBERS]
    )


class ResultTable:
    """The table of an archive.

    Parameters
    ----------
    root : Path or StoreFile
        Folder of the archive; made when the first rows are added. One batch at a time writes to it.
    """

    def __init__(self, root: Place) -> None:
        self.root = root

    def exists(self) -> bool:
        """Whether there is a table."""
        return bool(self._files())

    def read(self, columns: Sequence[str] = COLUMNS) -> pandas.DataFrame:
        """Return the latest row of every recording, in the order of their places.

        Parameters
        ----------
        columns : sequence of str
            Of `COLUMNS`.

        Returns
        -------
        pandas.DataFrame
            `source` is always among its columns; what is not known is None or NaN.

        Raises
        ------
        InputError
            If there is no table, or a file of it is damaged.
        """
        return self._table(columns).to_pandas(integer_object_nulls=True)

    def _table(self, columns: Sequence[str]) -> pyarrow.Table:
        files = self._files()
        if not files:
            raise InputError(
                "is not an archive: it has no folder `trials` with results",
                where=self.root,
                remedy="create one with `sawbench process RECORDINGS --archive DIR`",
            )
        return _latest(_joined([self._read(file, columns) for file in files]))

    def rows(self) -> list[dict[str, Any]]:
        """Return the latest row of every recording as mappings; see `read`."""
        return self._table(COLUMNS).to_pylist()

    def add(self, rows: Iterable[Row]) -> None:
        """Add rows: one file a partition, whole or not at all.

        Raises
        ------
        InputError
            If the archive cannot be written to.
        """
        import pyarrow as pa

        groups: dict[str, list[Row]] = {}
        for row in rows:
            groups.setdefault(_folder(row), []).append(row)
        for folder, group in groups.items():
            self._write(folder, pa.table({n: [row.get(n) for row in group] for n in schema().names}, schema=schema()))

    def tidy(self) -> None:
        """Take out the rows that were replaced, and join the files of each partition that has several."""
        import pyarrow as pa
        import pyarrow.compute as pc

        of_folder: dict[str, list[Place]] = {}
        for file in self._files():
            of_folder.setdefault(self._folder_of(file), []).append(file)
        if not of_folder:
            return
        keys = {folder: _joined([self._read(file, _KEY) for file in files]) for folder, files in of_folder.items()}
        kept = _rows(_latest(_joined(list(keys.values()))))
        for folder, files in of_folder.items():
            if len(files) == 1 and _rows(keys[folder]) <= kept:
                continue
            whole = _joined([self._read(file, schema().names) for file in files])
            stays = pa.array([row in kept for row in zip(*(whole[name].to_pylist() for name in _KEY), strict=True)])
            whole = _latest(whole.filter(pc.fill_null(stays, False)))
            if len(whole):
                self._write(folder, whole.select(schema().names))
            for file in files:
                remove(file)

    def _files(self) -> list[Place]:
        return [file.place for file in list_files(self.root / FOLDER, "**/*.parquet")]

    def _folder_of(self, file: Place) -> str:
        return "/".join(str(file).replace("\\", "/").split("/")[-3:-1])

    def _read(self, file: Place, columns: Sequence[str]) -> pyarrow.Table:
        import pyarrow as pa
        import pyarrow.parquet as pq

        names = [name for name in dict.fromkeys((*_KEY, *columns)) if name not in PARTITIONS]
        try:
            table = pq.ParquetFile(pa.BufferReader(read_bytes(file))).read(columns=names)
        except (OSError, pa.ArrowException) as error:
            raise InputError(
                f"is damaged: {error}",
                where=file,
                remedy="delete it and run the batch again: only the missing part is computed",
            ) from error
        for part in self._folder_of(file).split("/"):
            name, _, text = part.partition("=")
            if name in columns:
                value = None if text == _NOBODY_SAID else unquote(text)
                table = table.append_column(name, pa.array([value] * len(table), pa.string()))
        return table

    def _write(self, folder: str, table: pyarrow.Table) -> None:
        import pyarrow.parquet as pq

        content = io.BytesIO()
        pq.write_table(table, content, compression="zstd")
        place = self.root / FOLDER
        for part in folder.split("/"):
            place = place / part
        write_whole(place / f"part-{uuid.uuid4().hex}.parquet", content.getvalue(), makes_folder=True)


def _folder(row: Row) -> str:
    started: datetime | None = row.get("started_at")
    material = row.get("material")
    named = quote(material, safe=" ") if material else _NOBODY_SAID
    return f"material={named}/month={f'{started.astimezone(UTC):%Y-%m}' if started else _NOBODY_SAID}"


def _joined(parts: Sequence[pyarrow.Table]) -> pyarrow.Table:
    import pyarrow as pa

    return pa.concat_tables(parts)


def _rows(table: pyarrow.Table) -> set[tuple[Any, ...]]:
    return set(zip(*(table[name].to_pylist() for name in _KEY), strict=True))


def _latest(table: pyarrow.Table) -> pyarrow.Table:
    """The row of each recording that was added last, in the order of their places."""
    last: dict[str, tuple[Any, int]] = {}
    for number, (source, at) in enumerate(zip(*(table[name].to_pylist() for name in _KEY), strict=True)):
        if source not in last or at >= last[source][0]:
            last[source] = (at, number)
    return table.take([last[source][1] for source in sorted(last)])
