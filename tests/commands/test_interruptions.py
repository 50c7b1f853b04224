"""Ctrl-C a second time, and a terminal that is closed: what was recorded is finished, and it is said where it is."""

from __future__ import annotations

import io
import signal
import threading
import types
from datetime import UTC, datetime
from pathlib import Path

import pytest
import sawbench.commands.main
from sawbench.acquisition.recording_report import RecordingStart
from sawbench.bench.config import load_config
from sawbench.bench.recording import Trial
from sawbench.commands.recording_session import SessionOptions, record_trial, simulated_bench
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[2] / "bench_config.toml"


def test_a_second_ctrl_c_says_where_the_recording_is(tmp_path, monkeypatch):
    def interrupted(_devices, open_writer, **_):
        open_writer(RecordingStart(started_at=datetime(2026, 3, 2, 9, tzinfo=UTC), provenance={}))
        raise KeyboardInterrupt

    monkeypatch.setattr("sawbench.acquisition.recorder.record", interrupted)
    options = SessionOptions(path=tmp_path / "t.mcap", trial=Trial(trial_id="t", material="oak"), seconds=1.0)
    with pytest.raises(KeyboardInterrupt, match=r"t\.mcap has what was recorded, marked as not complete"):
        record_trial(load_config(CONFIG), options)
    assert not read_recording(options.path).is_complete


@pytest.mark.parametrize("finishes", [False, True])
def test_ctrl_c_at_the_end_says_whether_the_file_is_finished(tmp_path, monkeypatch, finishes):
    def finished(_devices, open_writer, **_):
        writer = open_writer(RecordingStart(started_at=datetime(2026, 3, 2, 9, tzinfo=UTC), provenance={}))
        if not finishes:
            monkeypatch.setattr("sawbench.storage.output.PartFile.finish", interrupted)
        writer.close()
        interrupted()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("sawbench.acquisition.recorder.record", finished)
    options = SessionOptions(path=tmp_path / "t.mcap", trial=Trial(trial_id="t", material="oak"), seconds=1.0)
    said = (
        r"t\.mcap is finished" if finishes else r"t\.mcap\.part has what was recorded; read it with `sawbench recover`"
    )
    with pytest.raises(KeyboardInterrupt, match=said):
        record_trial(load_config(CONFIG), options)
    assert options.path.exists() is finishes


def test_the_words_of_an_interruption_are_said(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt("x.mcap has what was recorded")

    monkeypatch.setattr("sawbench.storage.describe.describe_recording", interrupted)
    assert sawbench.commands.main.main(["info", "x.mcap"]) == 130
    assert capsys.readouterr().err.strip() == "sawbench: x.mcap has what was recorded"


@pytest.fixture
def hang_up(monkeypatch):
    """Give the signal; afterwards all is as before."""
    number = getattr(signal, "SIGHUP", None)
    if number is None:
        pytest.skip("this system has no SIGHUP")
    before = {which: signal.getsignal(which) for which in (number, signal.SIGTERM)}
    monkeypatch.setattr(sawbench.commands.main, "main", lambda: signal.raise_signal(number) or 0)
    yield number
    for which, handler in before.items():
        signal.signal(which, handler)


def test_a_terminal_that_is_closed_ends_a_command_as_ctrl_c_does_once(hang_up):
    signal.signal(hang_up, signal.SIG_DFL)
    with pytest.raises(KeyboardInterrupt, match="the terminal was closed"):
        sawbench.commands.main.run()
    # The shell passes the same on: the file is being finished meanwhile.
    signal.raise_signal(hang_up)


def test_nohup_holds(hang_up):
    signal.signal(hang_up, signal.SIG_IGN)
    with pytest.raises(SystemExit) as ended:
        sawbench.commands.main.run()
    assert ended.value.code == 0


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit])
def test_an_interruption_while_the_simulated_bench_starts_leaves_nothing_to_wait_for(monkeypatch, interruption):
    class Starting:
        stdin = stdout = stderr = None

        def __init__(self, *_args, **_options):
            self.stdin, self.stderr = io.StringIO(), io.StringIO()
            self.stdout = types.SimpleNamespace(readline=self.interrupt, close=lambda: None)

        def interrupt(self):
            raise interruption

        def wait(self, _timeout=None):
            return 0

        def kill(self):
            pass

    monkeypatch.setattr("sawbench.commands.recording_session.subprocess.Popen", Starting)
    before = set(threading.enumerate())
    with (
        pytest.raises(interruption),
        simulated_bench(Path("bench_config.toml"), material="oak", duty=None, seed=0),
    ):
        pass
    left = [thread for thread in threading.enumerate() if thread not in before and not thread.daemon]
    assert not left
