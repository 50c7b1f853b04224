"""A recording is evaluated once for its bytes, its configuration and this software; a bad one is a row."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from sawbench.archive import trials
from sawbench.archive.batch import Workers
from sawbench.archive.detail import as_json, from_json
from sawbench.archive.trials import Archive, kept_trials
from sawbench.archive.watching import Watch
from sawbench.bench.config import load_config
from sawbench.inputs import find_files
from sawbench.reporting.compared import ComparedTrial

pytestmark = pytest.mark.unit

ROOT = Path(__file__).parents[3]
OAK, IDLE = ROOT / "recordings" / "oak-01.mcap", ROOT / "recordings" / "none-01.mcap"


@pytest.fixture
def folder(tmp_path):
    """One recording that is sound and one that is none."""
    (tmp_path / "in").mkdir()
    shutil.copy(IDLE, tmp_path / "in" / "idle.mcap")
    (tmp_path / "in" / "bad.mcap").write_bytes(b"no MCAP")
    return tmp_path / "in"


def evaluate(folder, root, *, config=None, retries=False):
    """Bring the archive up to date; return the names of what was evaluated."""
    archive = Archive(root, config, retries=retries)
    return sorted(Path(one.item.file.place).name for one in archive.evaluate(archive.missing(find_files([folder]))))


def test_what_lies_beside_recordings_is_no_recording(folder):
    for name in ("batch.jsonl", "idle.mcap.amendments.jsonl"):
        (folder / name).write_text("{}\n")
    assert [file.place.name for file in find_files(sorted(folder.iterdir()))] == ["bad.mcap", "idle.mcap"]
    assert [file.place.name for file in find_files([folder / "batch.jsonl"])] == ["batch.jsonl"]


def test_a_second_run_does_nothing_and_the_bad_file_is_named(folder, tmp_path):
    root = tmp_path / "archive"
    assert evaluate(folder, root) == ["bad.mcap", "idle.mcap"]
    assert evaluate(folder, root) == []
    bad, idle = kept_trials(Archive(root).table)
    assert bad.error is not None
    assert "is not an MCAP file" in bad.error.what
    assert bad.error.exit_code == 2
    assert idle.value is not None
    assert idle.value.processed.status == "no_cutting"
    assert evaluate(folder, root, retries=True) == ["bad.mcap"]


def test_another_configuration_or_software_evaluates_again(folder, tmp_path, monkeypatch):
    root = tmp_path / "archive"
    evaluate(folder, root)
    named = load_config(ROOT / "bench_config.toml")
    assert evaluate(folder, root, config=named) == ["bad.mcap", "idle.mcap"]
    assert evaluate(folder, root, config=named) == []
    monkeypatch.setattr(trials, "analysis_identity", lambda: "0.2.0+other")
    assert evaluate(folder, root, config=named) == ["bad.mcap", "idle.mcap"]


def test_bytes_count_and_not_times_or_names(folder, tmp_path):
    root = tmp_path / "archive"
    evaluate(folder, root)
    os.utime(folder / "idle.mcap", (1, 1))
    shutil.copy(folder / "idle.mcap", folder / "copy.mcap")
    (folder / "bad.mcap").write_bytes(b"bad MCAP")  # of another length
    assert evaluate(folder, root) == ["bad.mcap"]
    assert [Path(one.item).name for one in kept_trials(Archive(root).table) if one.value] == ["copy.mcap", "idle.mcap"]
    assert evaluate(folder, root) == []


def test_what_is_known_is_kept_when_the_run_is_broken_off(folder, tmp_path):
    archive = Archive(tmp_path / "archive")
    running = archive.evaluate(archive.missing(find_files([folder])))
    next(running)
    running.close()
    assert evaluate(folder, tmp_path / "archive") == ["idle.mcap"]


def test_an_evaluated_trial_comes_back_from_its_row_as_it_was(tmp_path):
    trial = trials.evaluate_file(OAK, None)
    again = from_json(ComparedTrial, as_json(trial))
    assert as_json(again) == as_json(trial)
    assert again.processed.trial == trial.processed.trial
    assert again.processed.cutting_force is not None
    assert (again.processed.cutting_force.mean == trial.processed.cutting_force.mean).all()
    assert again.fit.k_fc_n_s_per_m == trial.fit.k_fc_n_s_per_m


def test_a_watch_leaves_alone_what_still_grows(folder, tmp_path):
    pages = []
    archive = Archive(tmp_path / "archive")
    watch = Watch(folder=folder, archive=archive, workers=Workers(), on_change=lambda: pages.append(1))
    (folder / "running.mcap.part").write_bytes(b"a recording that runs")
    assert watch.look() == []
    (folder / "bad.mcap").write_bytes(b"more of what is not an MCAP")
    assert [(file.place.name, error) for file, error in watch.look()] == [("idle.mcap", "")]
    ((file, error),) = watch.look()
    assert file.place.name == "bad.mcap"
    assert "is not an MCAP file" in error
    assert watch.look() == []
    assert len(pages) == 2
