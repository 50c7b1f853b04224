"""What the terminal shows while a trial is recorded: phase, time, light, and the note that is being typed."""

from __future__ import annotations

import io
import os
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from rich.console import Console
from sawbench.acquisition.recording_report import ChannelStatus, RecordingStatus
from sawbench.bench.recording import Trial
from sawbench.commands import record
from sawbench.commands.live_counters import LiveCounters
from sawbench.commands.typed_lines import TypedLines
from sawbench.visualization import live_process

pytestmark = pytest.mark.unit

FORCE = ChannelStatus(
    device="cell", channel="force_n", unit="N", n_samples=1000, rate_hz=500.0, n_gaps=0, n_missing=0, latest=12.5
)
STATUS = RecordingStatus(elapsed_s=2.0, channels=(FORCE,))


def drawn(counters: LiveCounters) -> str:
    console = Console(file=io.StringIO(), width=120)
    console.print(counters._drawn())
    return console.file.getvalue()


@pytest.mark.parametrize(
    ("changes", "light", "why"),
    [
        ({}, "ok", ""),
        ({"warnings": ("force_n: noise",)}, "look", "force_n: noise"),
        ({"channels": (replace(FORCE, n_gaps=1, n_missing=5),)}, "look", "force_n: 5 samples are missing"),
        (
            {"channels": (replace(FORCE, n_gaps=1, n_missing=50),)},
            "stop",
            "force_n: 50 of 1050 samples are missing",
        ),
        ({"warnings": ("force_n: saturated",), "is_spoilt": True}, "stop", "force_n: saturated"),
        ({"lost_devices": ("cell",)}, "stop", "the link to cell is lost"),
    ],
)
def test_the_light_says_whether_the_trial_will_be_trusted_and_why(changes, light, why, capsys):
    status = replace(STATUS, elapsed_s=5.1, **changes)
    assert status.light == light
    counters = LiveCounters()
    counters(status)
    assert why in drawn(counters)
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"({why})" if why else "missing")


def test_the_display_goes_through_its_phases():
    counters = LiveCounters(trial_id="oak-01", seconds=10.0)
    assert "opening the instruments oak-01 ..." in drawn(counters)
    counters(STATUS)
    assert "recording oak-01  2.0 of 10 s   OK " in drawn(counters)
    counters(replace(STATUS, lost_devices=("cell",)))
    assert " STOP " in drawn(counters)
    counters(replace(STATUS, phase="finishing"))
    assert "finishing oak-01 ..." in drawn(counters)


def test_off_a_terminal_the_end_is_said_too(capsys):
    counters = LiveCounters()
    for elapsed_s in (2.0, 5.1):
        counters(replace(STATUS, elapsed_s=elapsed_s))
    counters(replace(STATUS, elapsed_s=6.0, phase="finishing"))
    assert capsys.readouterr().err.splitlines() == ["   5.1 s  OK  1000 samples  0 missing", "finishing ..."]


def test_a_note_shows_in_the_display_and_is_not_echoed_beside_it():
    pytest.importorskip("termios", reason="the terminal of this system cannot be told not to echo")
    outer, inner = os.openpty()
    try:
        typed = TypedLines(inner)
        counters = LiveCounters(typed=typed)
        lines, came = [], threading.Event()

        def read():
            for line in typed:
                lines.append(line)
                came.set()

        with typed.silent():
            threading.Thread(target=read, daemon=True).start()
            os.write(outer, b"cla")
            until_s = time.monotonic() + 30.0
            while typed.pending != "cla" and time.monotonic() < until_s:
                time.sleep(0.01)
            assert "cla_" in drawn(counters)
            os.write(outer, b"np\x7f\x7fmp\n")
            assert came.wait(30.0)
        assert lines == ["clamp"]
        assert typed.pending == ""
        os.set_blocking(outer, False)
        with pytest.raises(BlockingIOError):
            os.read(outer, 100)
    finally:
        os.close(outer)


@pytest.mark.parametrize(
    ("dead_reason", "n_dropped", "said"),
    [("", 0, ""), ("", 7, "left out 7 blocks"), ("the viewer was closed", 7, "ended early: the viewer was closed")],
)
def test_what_the_live_view_left_out_is_said_at_the_end(monkeypatch, capsys, dead_reason, n_dropped, said):
    def view(*_args, **_options):
        return SimpleNamespace(
            close=lambda: None, is_dead=bool(dead_reason), dead_reason=dead_reason, n_dropped=n_dropped
        )

    monkeypatch.setattr(live_process, "LiveViewProcess", view)
    with record.live_view(Trial(trial_id="oak-01"), live=True, rrd_path=None, force=False):
        pass
    errors = capsys.readouterr().err
    assert said in errors
    assert bool(errors) == bool(said)
    # Said also where no recording came about.
    assert "complete" not in errors
