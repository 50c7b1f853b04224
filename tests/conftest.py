"""One thread a worker, a small sealed set, and programs that stand in for the diagnosis."""

from __future__ import annotations

import shutil
import sys

import pytest
import scipy.linalg  # noqa: F401 - loads the linear algebra whose threads are limited
from sawbench.blindcheck import sealing
from sawbench.blindcheck.answering import Program
from sawbench.blindcheck.bench import Nature
from threadpoolctl import threadpool_limits

N_CASES = 4
# Answers from nothing but the campaign's files, and notes where it ran and what it could see.
_ANSWER = """
import hashlib, json, os, pathlib, sys
log = pathlib.Path(sys.argv[1])
seen = sorted(str(p) for p in pathlib.Path.cwd().parent.rglob("*"))
with log.open("a") as file:
    file.write(json.dumps({"cwd": os.getcwd(), "environment": dict(os.environ), "seen": seen}) + "\\n")
size = pathlib.Path("trial-01.csv").stat().st_size
first = "edge_force" if size % 2 else "blade_wear"
pathlib.Path("../gap_report.json").write_text(json.dumps({
    "verdict": "effect",
    "causes": [{"effects": [first], "indistinguishable_from": [], "probability": 0.6, "gap_closed": 0.9,
                "gap_closed_ci95": [0.8, 1.0]}],
    "probabilities": {"no_gap": 0.2, "parameters": 0.1, "unknown": 0.1}}))
"""


def pytest_collection_modifyitems(items):
    """What takes longest comes first, so that two workers end together: whole pipelines before single modules."""
    levels = ("pipeline", "contract", "unit")
    items.sort(key=lambda item: next((k for k, level in enumerate(levels) if item.get_closest_marker(level)), 0))


@pytest.fixture(scope="session", autouse=True)
def _one_thread():
    """Small matrix products on one thread, as `sawbench diagnose` has them: workers share the cores already."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def sealed_once(tmp_path_factory):
    out = tmp_path_factory.mktemp("sealed") / "set"
    return out, sealing.make(21, N_CASES, out, nature=Nature(length=0.02), workers=1)


@pytest.fixture
def sealed(sealed_once, tmp_path):
    """A copy of the set that a test may spoil, and its key in a folder of its own."""
    shutil.copytree(sealed_once[0], tmp_path / "set")
    (tmp_path / "safe").mkdir()
    return tmp_path / "set", shutil.copy(sealed_once[1], tmp_path / "safe" / "key.json")


@pytest.fixture
def program(tmp_path):
    """A program for `answer`; its log has one line a case that it was run on."""

    def make(code: str = _ANSWER, *, source: str = "a" * 64, before: tuple[str, ...] = ()) -> Program:
        step = (sys.executable, "-I", "-c", code, str(tmp_path / "log"))
        steps = ((sys.executable, "-I", "-c", *before), step) if before else (step,)
        software = {"version": "0", "commit": None, "is_dirty": None, "source_sha256": source}
        return Program(steps=steps, report="../gap_report.json", software=software, fingerprint=lambda: source)

    return make


@pytest.fixture
def runs(tmp_path):
    """How many times the program was started."""
    return lambda: len((tmp_path / "log").read_text().splitlines()) if (tmp_path / "log").exists() else 0
