"""The live view in a process of its own: it shows what a view here would, and its end is no matter of the recorder."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.visualization.live_process import LiveViewProcess

from tests.rigs.rrd import joined, read_rrd

pytestmark = pytest.mark.pipeline

TRIAL = Trial(trial_id="oak-01", material="oak")
# Reads nothing, as a process that was stopped.
DEAF = (sys.executable, "-c", "import time; time.sleep(600)")


def block(first_index=0, values=None, n=500):
    index = first_index + np.arange(n)
    return SampleBlock(
        device="cell",
        channel="force_n",
        unit="N",
        first_index=first_index,
        time_s=index / 5000.0,
        values=np.zeros(n) if values is None else values,
    )


def test_what_is_handed_over_is_in_the_file(tmp_path):
    path = tmp_path / "live.rrd"
    view = LiveViewProcess(TRIAL, show="none", save_path=path, has_estimate=True)
    values = np.zeros(500)
    values[123] = 287.0
    view(block())
    view(block(500, values))
    view(Event(kind="note", time_s=0.1, text="fence touched"))
    view.cutting_estimate(0.15, 320.0, 4.0, 900.0, 30.0)
    # However long the other process takes to start.
    view.close(timeout_s=600.0)
    view.close()
    assert (view.is_dead, view.dead_reason, view.n_dropped) == (False, "", 0)
    found = read_rrd(path)
    assert joined(found, "signals/force_n")[1].max() == 287.0
    assert joined(found, "signals/k_fc_n_s_per_m")[1].tolist() == [320.0]


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_a_killed_process_is_a_reason_and_calls_go_on(tmp_path):
    view = LiveViewProcess(show="none", save_path=tmp_path / "live.rrd")
    view._process.kill()
    view._process.wait()
    for k in range(200):
        view(block(500 * k))
    view.close()
    assert view.is_dead
    assert "ended" in view.dead_reason


def test_a_process_that_hangs_drops_what_it_should_show_and_is_ended():
    view = LiveViewProcess(show="none", command=DEAF)
    for k in range(6000):
        view(block(500 * k))
    # A million samples wait at most, whatever blocks they come in.
    assert view.n_dropped > 4000
    view.close(timeout_s=0.1)
    assert "does not accept" in view.dead_reason
    assert view._process.returncode is not None


def test_a_file_that_cannot_be_written_is_said_before_anything_starts(tmp_path):
    path = tmp_path / "live.rrd"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        LiveViewProcess(show="none", save_path=path)
    with pytest.raises(InputError, match="folder does not exist"):
        LiveViewProcess(show="none", save_path=tmp_path / "nowhere" / "live.rrd")
    assert path.read_text() == "precious"


def test_the_recorder_does_not_import_rerun():
    code = "import sys, sawbench.visualization.live_process; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
