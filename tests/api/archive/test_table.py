"""The table of an archive: what is added is read, by us and by the programs that people use."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pandas as pd
import pytest
from sawbench.archive.table import ResultTable
from sawbench.bench.errors import InputError
from sawbench.storage.places import StoreFile

pytestmark = pytest.mark.contract

NOW = datetime(2026, 3, 5, 12, tzinfo=UTC)


def row(source, *, k_fc=200.0, minute=0, **changes):
    at = NOW + timedelta(minutes=minute)
    return {
        "source": source, "material": "oak", "started_at": NOW, "evaluated_at": at, "k_fc_n_s_per_m": k_fc,
        "exit_code": 0, **changes,
    }  # fmt: skip


@pytest.fixture(params=["disk", "store"])
def table(request, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    yield ResultTable(tmp_path / "archive" if request.param == "disk" else StoreFile("memory://archive-test"))
    fsspec.filesystem("memory").store.clear()


def test_the_latest_row_of_a_recording_counts_before_and_after_tidying(table):
    table.add([row("b"), row("a", k_fc=1.0)])
    table.add([row("a", k_fc=2.0, minute=1), row("c", material=None, started_at=None)])
    for _ in range(2):
        found = table.read(("source", "material", "month", "k_fc_n_s_per_m"))
        assert found["source"].tolist() == ["a", "b", "c"]
        assert found["k_fc_n_s_per_m"].tolist() == [2.0, 200.0, 200.0]
        assert found["material"].fillna("-").tolist() == ["oak", "oak", "-"]
        assert found["month"].fillna("-").tolist() == ["2026-03", "2026-03", "-"]
        table.tidy()
    assert len(table._files()) == 2


def test_a_recording_that_changes_its_material_leaves_the_old_folder(table):
    table.add([row("a"), row("b")])
    table.add([row("a", material="pine/spruce", minute=1)])
    table.tidy()
    assert table.read(("material",))[["source", "material"]].to_numpy().tolist() == [["a", "pine/spruce"], ["b", "oak"]]
    assert len(table._files()) == 2


def test_what_is_no_archive_is_said(tmp_path):
    with pytest.raises(InputError, match="is not an archive"):
        ResultTable(tmp_path).read()


def test_pandas_duckdb_and_polars_read_it(tmp_path):
    table = ResultTable(tmp_path)
    table.add(
        [row("a", k_fc=1.0), row("b", k_fc=3.0), row("c", material=None, started_at=None, k_fc=None, exit_code=2)]
    )
    table.tidy()
    found = pd.read_parquet(tmp_path / "trials")
    assert found.groupby("material", observed=True)["k_fc_n_s_per_m"].mean()["oak"] == 2.0
    duckdb = pytest.importorskip("duckdb", reason="duckdb is not installed")
    files = f"{tmp_path}/trials/**/*.parquet"
    query = f"select avg(k_fc_n_s_per_m), count(*) from read_parquet('{files}', hive_partitioning=true)"
    assert duckdb.sql(f"{query} where material = 'oak' and month = '2026-03'").fetchall() == [(2.0, 2)]
    polars = pytest.importorskip("polars", reason="polars is not installed")
    found = polars.read_parquet(files, hive_partitioning=True)
    assert found.filter(polars.col("material") == "oak")["k_fc_n_s_per_m"].mean() == 2.0
