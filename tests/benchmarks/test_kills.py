"""A few recorders killed at random moments."""

from __future__ import annotations

import os

import pytest

pytestmark = [
    pytest.mark.pipeline,
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="this system has no SIGKILL"),
]


def test_a_killed_recorder_leaves_a_file_that_opens_and_has_no_hole():
    from benchmarks.kills import run

    found = run(5)
    # How much is lost hangs on the machine: a thread that flushes must get its turn. That is for the benchmark.
    assert not [kill for kill in found if kill.wrong and not kill.wrong.startswith("lost ")]
