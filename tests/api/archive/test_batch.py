"""A batch goes on behind bad items and dead workers."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path

import pytest
from sawbench.archive.batch import Workers, run_batch
from sawbench.bench.errors import InputError

pytestmark = pytest.mark.unit


def halved(item: int) -> int:
    if item % 2:
        raise InputError(f"{item} is odd", where="items")
    return item // 2


def broken(item: int) -> int:
    raise KeyError(item)


def deadly(item: int, *, folder: Path, times: int) -> int:
    """Kill the own process the first few times that item 3 is worked on."""
    if item == 3:
        deaths = len(list(folder.iterdir()))
        if deaths < times:
            (folder / str(deaths)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return item * 10


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_bad_item_costs_only_itself(jobs):
    outcomes = sorted(run_batch(halved, [4, 7, 8], Workers(jobs=jobs)), key=lambda one: one.index)
    assert [one.item for one in outcomes] == [4, 7, 8]
    assert [one.value for one in outcomes] == [2, None, 4]
    assert [one.error and one.error.what for one in outcomes] == [None, "7 is odd", None]
    assert outcomes[1].error.exit_code == 2


def test_a_mistake_of_ours_is_an_error_of_its_item_too():
    (outcome,) = run_batch(broken, ["x"])
    assert "internal error" in str(outcome.error)
    assert outcome.error.exit_code == 1


def test_what_a_dead_worker_had_begun_is_done_by_another(tmp_path):
    work = partial(deadly, folder=tmp_path, times=1)
    outcomes = {one.item: one for one in run_batch(work, [1, 2, 3, 4, 5], Workers(jobs=2))}
    assert {item: one.value for item, one in outcomes.items()} == {1: 10, 2: 20, 3: 30, 4: 40, 5: 50}
    assert len(list(tmp_path.iterdir())) == 1


def test_an_item_that_kills_its_worker_twice_is_given_up(tmp_path):
    work = partial(deadly, folder=tmp_path, times=9)
    outcomes = {one.item: one for one in run_batch(work, [1, 3, 5], Workers(jobs=2))}
    assert len(list(tmp_path.iterdir())) == 2
    assert "worker process died" in str(outcomes[3].error)
    assert (outcomes[1].value, outcomes[5].value) == (10, 50)


def test_no_job_at_all_is_refused():
    with pytest.raises(InputError, match="at least 1"):
        Workers(jobs=0)


def test_a_cluster_does_the_same():
    distributed = pytest.importorskip("distributed", reason="dask is not installed (extra `cluster`)")
    settings = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**settings, protocol="tcp") as cluster:
        workers = Workers(scheduler=cluster.scheduler_address)
        outcomes = sorted(run_batch(halved, [4, 7, 8], workers), key=lambda one: one.index)
    assert [one.value for one in outcomes] == [2, None, 4]
    assert outcomes[1].error.what == "7 is odd"


def test_an_address_without_a_scheduler_is_said(monkeypatch):
    pytest.importorskip("distributed", reason="dask is not installed (extra `cluster`)")
    monkeypatch.setattr("sawbench.archive.cluster._TIMEOUT_S", 0.2)
    with pytest.raises(InputError, match="no dask scheduler answers"):
        list(run_batch(halved, [4], Workers(scheduler="tcp://127.0.0.1:9")))
