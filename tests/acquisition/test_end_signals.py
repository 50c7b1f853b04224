"""Signals that end a program are noted while samples are written, and keep their meaning."""

from __future__ import annotations

import signal
import threading

import pytest
from sawbench.acquisition import end_signals
from sawbench.acquisition.end_signals import EndSignals

pytestmark = pytest.mark.unit


@pytest.fixture(autouse=True)
def _python_handles_ctrl_c():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt():
    signal.raise_signal(signal.SIGINT)


def test_a_signal_is_noted_once():
    with EndSignals() as signals:
        assert signals.take() is None
        interrupt()
        interrupt()
        assert signals.take() == "stopped by the operator (Ctrl-C)"
        assert signals.take() is None
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_nobody_took_is_raised_at_the_end():
    reached = []
    with pytest.raises(KeyboardInterrupt, match="Ctrl-C"), EndSignals():
        interrupt()
        reached.append("end")
    assert reached == ["end"]


def test_an_error_is_not_hidden_by_it():
    with pytest.raises(OSError, match="disk full"), EndSignals():
        interrupt()
        raise OSError("disk full")


def test_one_that_comes_again_where_writing_hangs_is_raised_at_once(monkeypatch):
    now = iter([10.0, 10.9, 11.0])
    monkeypatch.setattr(end_signals.time, "monotonic", lambda: next(now))
    reached = []
    with pytest.raises(KeyboardInterrupt), EndSignals():
        for _ in range(3):
            interrupt()
            reached.append("after")
    assert reached == ["after", "after"]


def test_the_words_and_the_wishes_of_a_handler_hold():
    def once(number, _):
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt("the terminal was closed")

    signal.signal(signal.SIGINT, once)
    with EndSignals() as signals:
        interrupt()
        assert signals.take() == "the terminal was closed"
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_what_python_does_not_handle_stays():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with EndSignals() as signals:
        interrupt()
        assert signals.take() is None
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_another_thread_changes_nothing():
    handlers = []

    def work():
        with EndSignals():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
