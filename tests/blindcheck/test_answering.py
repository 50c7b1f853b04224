"""Answers are given without the key, kept through interruptions, and found out when changed."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from sawbench.bench.errors import InputError
from sawbench.blindcheck.answering import INDEX, answer, read_answers
from sawbench.blindcheck.sealing import sha256_of

pytestmark = pytest.mark.pipeline

NAMES = [f"case-{k:04d}" for k in range(1, 5)]


def test_every_case_is_answered_with_its_hash_and_the_software(sealed, program, runs):
    steps: list[tuple[int, int]] = []
    found = answer(sealed[0], program(), workers=2, on_progress=lambda done, wanted, name: steps.append((done, wanted)))
    assert (found.n_cases, found.n_new, found.n_failed, runs()) == (4, 4, 0, 4)
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]
    index, answers = read_answers(sealed[0])
    assert sorted(answers) == NAMES
    assert index["software"]["source_sha256"] == "a" * 64
    assert index["commitments_sha256"] == sha256_of(sealed[0] / "commitments.json")
    assert found.index_sha256 == sha256_of(sealed[0] / "answers" / INDEX)
    for name, one in answers.items():
        assert index["answers"][name] == sha256_of(sealed[0] / "answers" / f"{name}.json")
        assert one["status"] == "answered"
        assert one["report"]["verdict"] == "effect"
        assert one["time_s"] > 0.0


def test_the_process_sees_a_copy_of_its_campaign_and_nothing_of_the_key(sealed, program, tmp_path, monkeypatch):
    out, key = sealed
    monkeypatch.setenv("SAWBENCH_KEY", str(key))
    monkeypatch.setenv("OLDPWD", str(Path(key).parent))
    answer(out, program(), workers=1)
    for line in (tmp_path / "log").read_text().splitlines():
        seen = json.loads(line)
        assert str(out) not in seen["cwd"]
        assert not any("key" in Path(path).name or "commitments" in path for path in seen["seen"])
        assert {Path(path).name for path in seen["seen"] if path.endswith(".csv")} == {
            f"trial-{k:02d}.csv" for k in range(1, 19)
        }
        assert str(Path(key).parent) not in json.dumps(seen["environment"])
        assert str(out) not in json.dumps(seen["environment"])
        assert seen["environment"]["OPENBLAS_NUM_THREADS"] == "1"
        assert not Path(seen["cwd"]).exists(), "copies are thrown away"


@pytest.mark.parametrize("place", ["key.json", "case-0001/notes.txt", "old/labels"])
def test_a_key_inside_the_set_is_refused(place, sealed, program, runs):
    out, key = sealed
    (out / place).parent.mkdir(exist_ok=True)
    shutil.copy(key, out / place)
    with pytest.raises(InputError, match="is a key"):
        answer(out, program())
    assert runs() == 0


def test_a_run_that_was_broken_off_goes_on(sealed, program, runs):
    def stop(done, wanted, name):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(sealed[0], program(), workers=1, on_progress=stop)
    begun = runs()
    kept = json.loads((sealed[0] / "answers" / INDEX).read_text())["answers"]
    assert len(kept) == 1
    with pytest.raises(InputError, match="3 of 4 cases are not answered"):
        read_answers(sealed[0])
    found = answer(sealed[0], program(), workers=1)
    assert found.n_new == 3
    assert runs() == begun + 3
    assert json.loads((sealed[0] / "answers" / INDEX).read_text())["answers"].items() >= kept.items()
    assert answer(sealed[0], program()).n_new == 0
    assert runs() == begun + 3


def test_other_machines_answer_the_same_and_only_what_is_missing(sealed, program, tmp_path):
    """What is sent to them survives the way there; an answer that arrived is kept when the run is broken off."""
    here = answer(sealed[0], program(), answers_dir=tmp_path / "here")
    sent = replace(program(), fingerprint=partial(str, "a" * 64))

    def elsewhere(work, cases):
        work, cases = pickle.loads(pickle.dumps((work, cases)))
        for number, case in enumerate(cases):
            yield number, work(case)

    def stop(done, wanted, name):
        raise KeyboardInterrupt

    there = tmp_path / "there"
    with pytest.raises(KeyboardInterrupt):
        answer(sealed[0], sent, answers_dir=there, elsewhere=elsewhere, on_progress=stop)
    assert answer(sealed[0], sent, answers_dir=there, elsewhere=elsewhere).n_new == here.n_cases - 1
    reports = [
        {name: one["report"] for name, one in read_answers(sealed[0], folder)[1].items()}
        for folder in (here.answers_dir, there)
    ]
    assert reports[0] == reports[1]


@pytest.mark.skipif(os.name != "posix", reason="kills with a signal")
def test_a_run_that_was_killed_goes_on(sealed, program, runs, tmp_path):
    """The first case is answered, the second never ends: a kill leaves one valid answer."""
    script = tmp_path / "run.py"
    code = (
        "import json, os, pathlib, sys, time\n"
        "log = pathlib.Path(sys.argv[1])\n"
        "if log.exists(): (log.parent / 'child').write_text(str(os.getpid())); time.sleep(60)\n"
        "log.write_text('x\\n')\n"
        "pathlib.Path('../gap_report.json').write_text(json.dumps({'verdict': 'no_gap'}))\n"
    )
    script.write_text(
        "import pathlib, sys\nfrom sawbench.blindcheck.answering import Program, answer\n"
        f"steps = ((sys.executable, '-I', '-c', {code!r}, {str(tmp_path / 'log')!r}),)\n"
        "software = {'source_sha256': 'a' * 64}\n"
        "program = Program(steps=steps, report='../gap_report.json', software=software, fingerprint=lambda: 'a' * 64)\n"
        f"answer(pathlib.Path({str(sealed[0])!r}), program, workers=1)\n"
    )
    root = Path(__file__).parents[2]
    process = subprocess.Popen([sys.executable, str(script)], env=os.environ | {"PYTHONPATH": str(root)})
    child = tmp_path / "child"
    try:
        while not (child.exists() and child.read_text()):
            assert process.poll() is None
            time.sleep(0.02)
    finally:
        process.kill()
        process.wait()
    os.kill(int(child.read_text()), signal.SIGKILL)
    kept = json.loads((sealed[0] / "answers" / INDEX).read_text())["answers"]
    assert list(kept) == ["case-0001"]
    (tmp_path / "log").unlink()
    assert answer(sealed[0], program(), workers=1).n_new == 3
    assert json.loads((sealed[0] / "answers" / INDEX).read_text())["answers"]["case-0001"] == kept["case-0001"]


def test_a_program_that_fails_hangs_or_says_nonsense_has_answered_so(sealed, program):
    fails = "import sys; sys.stderr.write('no such battery'); sys.exit(2)"
    hangs = "import time; time.sleep(60)"
    mute = "pass"
    nonsense = "import pathlib; pathlib.Path('../gap_report.json').write_text('{')"
    for code, status, word in (
        (fails, "failed", "no such battery"),
        (hangs, "timed_out", ""),
        (mute, "failed", "no readable report"),
        (nonsense, "failed", "no readable report"),
    ):
        found = answer(sealed[0], program(code, source=status + word), workers=4, timeout_s=2.0, force=True)
        assert found.n_failed == 4
        for one in read_answers(sealed[0])[1].values():
            assert one["status"] == status
            assert one["report"] is None
            assert word in one["message"]


def test_a_first_step_that_fails_ends_the_case(sealed, program, runs):
    answer(sealed[0], program(before=("import sys; sys.exit(3)",)))
    assert runs() == 0
    assert {one["exit_code"] for one in read_answers(sealed[0])[1].values()} == {3}


def test_other_software_needs_another_folder_or_force(sealed, program, runs, tmp_path):
    answer(sealed[0], program())
    other = program(source="b" * 64)
    with pytest.raises(InputError, match="--answers"):
        answer(sealed[0], other)
    assert answer(sealed[0], other, answers_dir=tmp_path / "other").n_new == 4
    assert read_answers(sealed[0])[0]["software"]["source_sha256"] == "a" * 64
    assert answer(sealed[0], other, force=True).n_new == 4
    assert read_answers(sealed[0])[0]["software"]["source_sha256"] == "b" * 64
    assert runs() == 12


def test_software_that_changes_during_the_run_is_found(sealed, program):
    changed = dataclasses.replace(program(), fingerprint=lambda: "c" * 64)
    with pytest.raises(InputError, match="changed while"):
        answer(sealed[0], changed)


@pytest.mark.parametrize("what", ["content", "removed", "swapped", "index", "stray"])
def test_a_changed_answer_is_found(what, sealed, program):
    answer(sealed[0], program())
    folder = sealed[0] / "answers"
    if what == "content":
        path = folder / "case-0002.json"
        path.write_text(path.read_text().replace("0.6", "0.7"))
    elif what == "removed":
        (folder / "case-0002.json").unlink()
    elif what == "swapped":
        (folder / "case-0002.json").write_bytes((folder / "case-0001.json").read_bytes())
    else:
        index = json.loads((folder / INDEX).read_text())
        if what == "index":
            index["answers"]["case-0003"] = "0" * 64
        else:
            index["answers"]["case-0009"] = "0" * 64
        (folder / INDEX).write_text(json.dumps(index))
    with pytest.raises(InputError, match="not the answers that were given"):
        read_answers(sealed[0])


def test_answers_to_another_set_are_found(sealed, program):
    answer(sealed[0], program())
    path = sealed[0] / "commitments.json"
    path.write_text(path.read_text() + " ")
    with pytest.raises(InputError, match="belongs to another"):
        read_answers(sealed[0])


def test_a_changed_campaign_is_not_answered(sealed, program):
    path = sealed[0] / "case-0003" / "trial-02.csv"
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(InputError, match="changed after sealing"):
        answer(sealed[0], program())


def test_no_answers_and_no_set_are_said_so(sealed, program, tmp_path):
    with pytest.raises(InputError, match="no answers"):
        read_answers(sealed[0])
    with pytest.raises(InputError, match="no such file"):
        answer(tmp_path / "nothing", program())
