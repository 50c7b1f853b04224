"""`process`, `fit`, `compare`, `catalogue` and `watch` over an archive."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import fsspec
import pytest
from sawbench.commands.main import main

pytestmark = pytest.mark.pipeline

SAMPLES = Path(__file__).parents[2] / "recordings"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Two recordings of oak, one of nylon and one that is none, evaluated by two processes."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "in").mkdir()
    for name in ("oak-01", "oak-02", "nylon-01"):
        shutil.copy(SAMPLES / f"{name}.mcap", folder / "in")
    (folder / "in" / "bad.mcap").write_bytes(b"no MCAP")
    assert main(["process", str(folder / "in"), "--archive", str(folder / "archive"), "--jobs", "2"]) == 2
    return folder


def test_the_page_of_an_archive_is_that_of_its_recordings(lab, tmp_path, capsys):
    assert main(["compare", str(lab / "in"), "--out", str(tmp_path / "direct.html")]) == 1
    assert main(["compare", str(lab / "archive"), "--out", str(tmp_path / "kept.html")]) == 1
    assert "bad.mcap: is not a recording" in capsys.readouterr().out
    for suffix in (".html", ".csv", ".h5"):
        direct, kept = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("direct", "kept"))
        assert direct == kept, suffix


def test_a_second_run_does_nothing(lab, capsys):
    assert main(["process", str(lab / "in"), "--archive", str(lab / "archive"), "--json"]) == 2
    shown = capsys.readouterr()
    assert "4 recordings: 0 evaluated now, 4 were in" in shown.err
    assert [row["trial_id"] for row in json.loads(shown.out)] == ["nylon-01", "oak-01", "oak-02"]


def test_fit_takes_its_results_from_the_archive(lab, capsys):
    files = [str(lab / "in" / f"{name}.mcap") for name in ("oak-01", "oak-02")]
    assert main(["fit", *files, "--json"]) == 0
    direct = json.loads(capsys.readouterr().out)
    assert main(["fit", *files, "--archive", str(lab / "archive"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == direct


def test_the_catalogue_lists_and_filters(lab, capsys):
    archive = str(lab / "archive")
    assert main(["catalogue", archive]) == 0
    shown = capsys.readouterr().out
    assert "4 of 4 recordings" in shown
    assert "bad.mcap: is not a recording" in shown
    assert main(["catalogue", archive, "--material", "oak", "--since", "2026-11-21", "--json"]) == 0
    assert [row["trial_id"] for row in json.loads(capsys.readouterr().out)] == ["oak-01", "oak-02"]
    assert main(["catalogue", archive, "--until", "2026-11-20", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []
    assert main(["catalogue", archive, "--quality", "failed", "--json"]) == 0
    assert [row["error"][:18] for row in json.loads(capsys.readouterr().out)] == ["is not a recording"]


@pytest.mark.parametrize(
    ("option", "column", "scale"), [("--k-fc", "k_fc_n_s_per_m", 1.0), ("--period", "stroke_period_s", 1e3)]
)
def test_the_catalogue_filters_by_what_was_found(lab, capsys, option, column, scale):
    def shown(*options):
        assert main(["catalogue", str(lab / "archive"), "--json", *options]) == 0
        return [(row["trial_id"], row[column]) for row in json.loads(capsys.readouterr().out)]

    known = [row for row in shown() if row[1] is not None]
    least = min(known, key=lambda row: row[1])
    assert 0 < sum(row[1] > least[1] for row in known) < len(shown())
    assert shown(option, "0", str(1.0001 * scale * least[1])) == [least]
    assert least not in shown(option, str(1.0001 * scale * least[1]), "1e9")
    assert shown(option, "0", "1e-9") == []


def test_what_is_no_archive_is_one_error(tmp_path, capsys):
    assert main(["catalogue", str(tmp_path)]) == 2
    assert "is not an archive" in capsys.readouterr().err


def test_an_object_store_is_read_and_written(tmp_path, capsys):
    store = fsspec.filesystem("memory")
    store.pipe_file("/lab/nylon-01.mcap", (SAMPLES / "nylon-01.mcap").read_bytes())
    store.pipe_file("/lab/bad.mcap", b"no MCAP")
    try:
        assert main(["process", "memory://lab", "--out", "memory://out"]) == 2
        assert "memory://lab/bad.mcap: is not a recording" in capsys.readouterr().err.replace("memory:///", "memory://")
        assert sorted(store.ls("/out", detail=False)) == ["/out/nylon-01.h5", "/out/summary.csv"]
        written = store.modified("/out/nylon-01.h5")
        assert main(["process", "memory://lab/nylon-01.mcap", "--out", "memory://out"]) == 0
        assert store.modified("/out/nylon-01.h5") == written
        store.pipe_file("/out/nylon-01.h5", b"somebody's")
        assert main(["process", "memory://lab/nylon-01.mcap", "--out", "memory://out"]) == 2
        assert "exists already" in capsys.readouterr().err
        assert main(["compare", "memory://lab", "--archive", "memory://arc", "--out", "memory://pages/p.html"]) == 1
        assert b"nylon" in store.cat_file("/pages/p.html")
        assert main(["catalogue", "memory://arc"]) == 0
        assert "2 of 2 recordings" in capsys.readouterr().out
        assert main(["process", "memory://nowhere"]) == 2
        assert "has no .mcap file" in capsys.readouterr().err
    finally:
        store.store.clear()


def test_watch_once_processes_and_writes_the_page(lab, tmp_path):
    call = ["watch", str(lab / "in"), "--archive", str(lab / "archive"), "--once", "--out", str(tmp_path / "page.html")]
    shutil.copy(SAMPLES / "none-01.mcap", lab / "in")
    assert main(call) == 0
    assert "none-01" in (tmp_path / "page.html").read_text()
    (lab / "in" / "none-01.mcap").unlink()
    assert main(call) == 2
    assert main(["watch", str(lab / "in")]) == 2


def test_watch_once_names_what_it_cannot_read(lab, tmp_path, capsys):
    (lab / "in" / "torn.mcap").write_bytes(b"no recording")
    assert main(["watch", str(lab / "in"), "--archive", str(tmp_path / "archive"), "--once"]) == 1
    assert "torn.mcap: " in capsys.readouterr().err


def test_process_goes_on_where_it_stopped(tmp_path, capsys, monkeypatch):
    """What an earlier run has written is taken as it stands, unless bytes, configuration or amendments changed."""
    from sawbench import analysis

    asked = []

    def counted(place, config, load=analysis.load_and_process):
        asked.append(place.name)
        return load(place, config)

    monkeypatch.setattr(analysis, "load_and_process", counted)
    (tmp_path / "in").mkdir()
    for name in ("none-01", "nylon-01"):
        shutil.copy(SAMPLES / f"{name}.mcap", tmp_path / "in")
    call = ["process", str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--json"]
    assert main(call) == 0
    first = json.loads(capsys.readouterr().out)
    summary = (tmp_path / "out" / "summary.csv").read_text()
    (tmp_path / "out" / "none-01.h5").unlink()
    (tmp_path / "out" / "summary.csv").unlink()
    assert main(call) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert (tmp_path / "out" / "summary.csv").read_text() == summary
    assert asked == ["none-01.mcap", "nylon-01.mcap", "none-01.mcap"]
    shutil.copy(SAMPLES / "oak-01.mcap", tmp_path / "in" / "nylon-01.mcap")
    assert main(call) == 2
    assert "nylon-01.h5: exists already" in capsys.readouterr().err
    assert main([*call, "--force"]) == 0
    assert asked[3:] == ["none-01.mcap", "nylon-01.mcap"]


def test_everything_but_a_cluster_works_without_dask(tmp_path):
    """In an interpreter of its own in which dask and distributed cannot be imported."""
    hidden = (
        "import sys\n"
        "sys.modules |= dict.fromkeys(('dask', 'distributed'))\n"
        "from sawbench.commands.main import main\n"
        "raise SystemExit(main(sys.argv[1:]))\n"
    )

    def run(*arguments):
        call = [sys.executable, "-c", hidden, *map(str, arguments)]
        return subprocess.run(call, capture_output=True, text=True, check=False, timeout=300)

    archive = ("--archive", tmp_path / "archive")
    done = run("process", SAMPLES / "none-01.mcap", SAMPLES / "nylon-01.mcap", *archive, "--jobs", "2")
    assert done.returncode == 0, done.stderr
    assert "2 of 2 recordings" in run("catalogue", tmp_path / "archive").stdout
    asked = run("process", SAMPLES / "none-01.mcap", "--scheduler", "tcp://127.0.0.1:1")
    assert asked.returncode == 2
    assert "pip install 'sawbench[cluster]'" in asked.stderr
