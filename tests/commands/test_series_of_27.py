"""A whole series on the simulated bench: killed twice, gone on with, one bad trial found; compared and diagnosed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.pipeline,
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="this system has no SIGKILL"),
]

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
N_TRIALS = 27
# A computer that is too busy for the simulated bench ends a sitting; the next one goes on.
MOST_SITTINGS = 8
# The first time that trial 11 is recorded, somebody has clamped something else.
RUN = """
import pathlib, sys
import sawbench.commands.recording_session as session
from sawbench.commands.main import run

right, marker = session.simulated_bench, pathlib.Path(sys.argv.pop())

def clumsy(config_path, *, material, seed, **others):
    if material != "none" and seed // 100 % 100 == 10 and not marker.exists():
        marker.touch()
        material = "pine" if material != "pine" else "oak"
    return right(config_path, material=material, seed=seed, **others)

session.simulated_bench = clumsy
run()
"""


def sawbench(*arguments, timeout=3600):
    call = [sys.executable, "-m", "sawbench.commands.main", *map(str, arguments)]
    return subprocess.run(call, capture_output=True, text=True, check=False, timeout=timeout)


def trials_of(folder, kind):
    """Trials of the journal's entries of one kind, in their order."""
    journal = folder / "series_journal.jsonl"
    lines = journal.read_text().splitlines() if journal.exists() else []
    return [entry["trial"] for entry in map(json.loads, lines) if entry["kind"] == kind]


def run_until(path, marker, kill_after=None):
    """Run the series; SIGKILL it in the middle of the recording that is the `kill_after`-th to begin."""
    call = [sys.executable, "-c", RUN, "series", "run", str(path), "--simulated", "--yes", str(marker)]
    with subprocess.Popen(call, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        while kill_after is not None and process.poll() is None:
            begun = trials_of(path.with_suffix(""), "started")
            part = path.with_suffix("") / f"{begun[-1]}.mcap.part" if begun else None
            if part is not None and len(begun) >= kill_after and part.exists() and part.stat().st_size > 20_000:
                process.kill()
                break
            time.sleep(0.02)
        _, err = process.communicate(timeout=3600)
    return process.returncode, err.decode()


def test_27_trials_killed_twice_with_one_bad_trial(tmp_path):
    path, marker = tmp_path / "wood.toml", tmp_path / "clumsy"
    # A copy: the calibration book is beside it.
    config = shutil.copy(CONFIG, tmp_path)
    call = ["series", "plan", "--out", path, "--config", config, "--seed", 11, "--seconds", 3, "--operator", "Kim"]
    call += [part for wood in ("oak", "nylon", "black_locust") for part in ("--material", wood)]
    call += [part for duty in (0.4, 0.4375, 0.5) for part in ("--duty", duty)]
    assert sawbench(*call, "--feed", 4, "--thickness", 20).returncode == 0
    text = path.read_text().replace("tare_seconds = 5.0", "tare_seconds = 1.0")
    path.write_text(text.replace("check_seconds = 2.0", "check_seconds = 0.5"))

    for kill_after, wanted in ((5, -9), (16, -9), (None, 0)):
        for _ in range(MOST_SITTINGS):
            code, said = run_until(path, marker, kill_after=kill_after)
            if code == wanted:
                break
        assert code == wanted, said

    found = json.loads(sawbench("series", "status", path, "--json").stdout)
    assert found["n_kept"] == N_TRIALS and found["next"] is None
    rejected = {trial["id"]: trial["rejected"] for trial in found["trials"] if trial["rejected"]}
    because = [reason for reasons in rejected.values() for reason in reasons]
    assert because.count("the recording was interrupted") == 2
    bad = [reason for name, reasons in rejected.items() if name.startswith("11-") for reason in reasons]
    assert any("k_Fc" in reason and "from the mean of its repetition" in reason for reason in bad)
    assert not any(trial["measures"]["faults"] for trial in found["trials"])
    # What is kept is never recorded again.
    assert sorted(trials_of(path.with_suffix(""), "kept")) == [trial["id"] for trial in found["trials"]]

    folder = path.with_suffix("")
    compared = sawbench("compare", folder, "--out", tmp_path / "report.html", "--json")
    assert compared.returncode == 0, compared.stderr
    report = json.loads(compared.stdout)
    assert [len(series["trials"]) for series in report["series"]] == [3] * 9 and not report["left_out"]
    diagnosed = sawbench("diagnose", folder, "--out", tmp_path / "gap")
    assert diagnosed.returncode == 0, diagnosed.stderr
    gap = json.loads((tmp_path / "gap" / "gap_report.json").read_text())
    assert len(gap["provenance"]["recordings"]) == N_TRIALS
