"""A diagnosis has one thread for its linear algebra, whichever library brings it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.unit

# In a process of its own: what other tests have loaded would be limited too.
PROGRAM = """
from types import SimpleNamespace as Thing
from sawbench.diagnosis.answer import gap_report
from sawbench.gap import diagnose_trials

def threads(*_, **__):
    import scipy.linalg
    from threadpoolctl import threadpool_info
    return {"threads": [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]}

gap_report.diagnose = threads
recording = Thing(path=None, trial=Thing(trial_id="t", source="simulated", amendments=()))
trial = Thing(recording=recording, sha256="0", loaded=Thing(sha256="0"))
print(max(diagnose_trials([trial])["threads"]))
"""


def test_a_diagnosis_has_one_thread_for_its_linear_algebra():
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=free, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 1
