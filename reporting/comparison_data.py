"""The numbers of a comparison, beside its page: a table for CSV, and HDF5 with the folded cycles."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from sawbench.bench.folded import pooled
from sawbench.reporting.compared import QUANTITIES, ComparedTrial, Comparison, estimates_of
from sawbench.reporting.html import software_version
from sawbench.reporting.wear import cut_length_m
from sawbench.storage.output import write_whole
from sawbench.storage.places import Place

if TYPE_CHECKING:
    import pandas


def comparison_table(rows: Sequence[ComparedTrial]) -> pandas.DataFrame:
    """Return one row per trial, with every number of the page, for CSV.

    Returns
    -------
    pandas.DataFrame
        Columns end in their unit; `_std` columns hold standard uncertainties. `use` is "compared", "idle" or
        the reason why the trial was left out.
    """
    import pandas as pd

    records = []
    for row in rows:
        trial, estimates = row.processed.trial, estimates_of(row)
        record: dict[str, Any] = {
            "trial": row.name,
            "material": trial.material,
            "repetition": trial.repetition,
            "thickness_mm": trial.thickness_mm,
            "feed_mm_s": trial.feed_mm_s,
            "duty": trial.duty,
            "blade": trial.blade,
            "battery": trial.battery,
            "status": row.processed.status,
            "use": row.left_out_because or ("idle" if row.is_idle else "compared"),
        }
        for quantity in QUANTITIES:
            estimate = estimates.get(quantity.key)
            record[quantity.key] = None if estimate is None else estimate.value
            std = None if estimate is None else math.hypot(estimate.statistical_std, estimate.common_std)
            record[f"{quantity.key}_std"] = std or None
        record |= {
            "source": trial.source,
            "source_sha256": row.processed.source_sha256,
            "started_at": None if trial.started_at is None else trial.started_at.isoformat(),
            "operator": trial.operator,
            "file": Path(row.processed.source_path).name or None,
            "cut_length_m": cut_length_m(row),
        }
        records.append(record)
    return pd.DataFrame.from_records(records)


def write_comparison_hdf5(
    path: str | Place, rows: Sequence[ComparedTrial], found: Comparison, *, overwrite: bool = False
) -> Place:
    """Write the table and the folded cutting force of every series to HDF5; the same input gives the same bytes.

    Datasets are named as the columns of the table, and end in their unit.

    Parameters
    ----------
    path : str or Path
    rows : sequence of ComparedTrial
    found : Comparison
        Of these rows.
    overwrite : bool

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    import h5py
    from pandas import isna
    from pandas.api.types import is_numeric_dtype

    content = io.BytesIO()
    with h5py.File(content, "w") as store:
        store.attrs["format"] = "sawbench comparison"
        store.attrs["format_version"] = 1
        store.attrs["software"] = software_version()
        table = store.create_group("trials")
        for name, column in comparison_table(sorted(rows, key=lambda row: row.name)).items():
            if not is_numeric_dtype(column):
                texts = ["" if isna(value) else str(value) for value in column]
                table.create_dataset(str(name), data=texts, dtype=h5py.string_dtype())
            else:
                table.create_dataset(str(name), data=column.to_numpy(dtype=np.float64, na_value=np.nan))
        for one in found.series:
            cycles = [t.processed.cutting_force for t in one.trials if t.processed.cutting_force is not None]
            if cycles:
                group = store.require_group("cutting_force").create_group(one.label.replace("/", " per "))
                cycle = pooled(cycles)
                for name, values in (("angle_rad", cycle.angle_rad), ("mean_n", cycle.mean), ("std_n", cycle.std)):
                    group.create_dataset(name, data=values)
    return write_whole(path, content.getvalue(), overwrite=overwrite)
