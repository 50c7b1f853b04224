"""Work on two cores: the same answers in the same order, whatever becomes of the other process."""

import os
import select
import sys
from types import MappingProxyType

import numpy as np
import pytest
from sawbench.bench.second_core import on_two_cores, second_core

pytestmark = pytest.mark.unit
two_cores = pytest.mark.skipif(
    sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="one core, or no safe fork"
)


def square(number):
    return number**2


def where(_):
    return os.getpid()


def test_without_leave_everything_is_done_here():
    assert set(on_two_cores(where, range(4))) == {os.getpid()}


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_order_and_values_are_those_of_one_core(n):
    with second_core():
        assert on_two_cores(square, range(n)) == [k * k for k in range(n)]


def test_more_than_a_pipe_holds_comes_back():
    with second_core():
        found = on_two_cores(lambda k: np.full(300_000, float(k)), range(4))
    assert [float(part.sum()) for part in found] == [0.0, 3e5, 6e5, 9e5]


@two_cores
def test_the_other_process_does_its_share():
    with second_core():
        assert len(set(on_two_cores(where, range(4)))) == 2


@two_cores
def test_who_is_free_takes_the_next_item():
    here, (done, say_done) = os.getpid(), os.pipe()

    def waits_for_the_others(number):
        if number == 0:
            for _ in range(3):
                assert select.select([done], [], [], 30.0)[0]
                os.read(done, 1)
        else:
            os.write(say_done, b".")
        return os.getpid()

    with second_core():
        pids = on_two_cores(waits_for_the_others, range(4))
    assert [pid == here for pid in pids] == [True, False, False, False]


@two_cores
def test_a_read_only_mapping_comes_back():
    here = os.getpid()
    with second_core():
        found = on_two_cores(lambda _: MappingProxyType({"n": 3, "is_away": os.getpid() != here}), range(2))
    assert [dict(mapping) for mapping in found] == [{"n": 3, "is_away": False}, {"n": 3, "is_away": True}]


def test_an_error_of_the_other_process_is_raised_here():
    def fails(number):
        if number == 1:
            raise ValueError("the second one")
        return number

    with second_core(), pytest.raises(ValueError, match="the second one"):
        on_two_cores(fails, range(4))


def test_an_error_here_leaves_no_process_behind(monkeypatch):
    pids, fork = [], os.fork

    def noted_fork():
        pids.append(fork())
        return pids[-1]

    def fails(number):
        raise ValueError(str(number))

    monkeypatch.setattr(os, "fork", noted_fork)
    with second_core(), pytest.raises(ValueError, match="0"):
        on_two_cores(fails, range(4))
    with pytest.raises(ChildProcessError):
        os.waitpid(pids[0], os.WNOHANG)


def test_what_a_dead_process_had_is_done_here():
    here = os.getpid()

    def dies(number):
        if os.getpid() != here:
            os._exit(9)
        return number

    with second_core():
        assert on_two_cores(dies, range(5)) == [0, 1, 2, 3, 4]


class Unpicklable:
    """As an effect is: it holds a function without a name."""

    def __init__(self):
        self.work = lambda: None


@two_cores
def test_what_both_processes_have_comes_back_as_itself():
    known = [Unpicklable(), Unpicklable()]
    with second_core():
        found = on_two_cores(lambda k: (os.getpid(), {"it": known[k]}), range(2), known=known)
    assert len({pid for pid, _ in found}) == 2
    assert [part["it"] is one for (_, part), one in zip(found, known, strict=True)] == [True, True]


@two_cores
def test_what_cannot_be_sent_is_done_here_and_said():
    with second_core(), pytest.warns(RuntimeWarning, match="done twice, because it could not be sent"):
        found = on_two_cores(lambda k: (k, lambda: None), range(2))
    assert [number for number, _ in found] == [0, 1]
