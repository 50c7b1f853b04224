"""Links that are late and lose nothing, and losses that no counter shows: synthetic arrivals with a known truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rigs.arrivals import SMALLEST_ERROR_S, START_S, late, rising, stalled, swelling, timed

pytestmark = pytest.mark.unit

LATE = {
    **{f"{ms} ms late for {s} s": late(ms / 1e3, s) for ms in (5, 20, 100, 300, 2000) for s in (0.1, 0.5, 1.5, 2.0)},
    **{f"stalled for {s} s": stalled(s) for s in (0.05, 0.2, 0.5, 1.0, 2.0)},
    **{f"rising to {s} s": rising(s, 2.0) for s in (0.05, 0.5)},
    **{f"swelling to {s} s": swelling(s, 2.0) for s in (0.05, 0.5)},
    "100 ms late, 1 s of every 3 s": lambda t: 0.1 if t > 2 and t % 3 < 1 else 0.0,
    "30 ms late, half of every second": lambda t: 0.03 if t > 2 and t % 1 < 0.5 and t < 10 else 0.0,
    "late as soon as it may be": late(0.1, 1.5, at_s=0.7),
    "at the start stalled for 1.3 s": stalled(1.34, at_s=-0.13),
    "at the start stalled for 0.7 s": stalled(0.73, at_s=-0.07),
    "at the start rising by 0.3 s": rising(0.256, 0.83, at_s=-0.27),
    "at the start rising by 0.9 s": rising(0.9, 1.46, at_s=-0.23),
    "at the start swelling by 12 ms": swelling(0.012, 0.88, at_s=-0.26),
    "at the start late by 57 ms behind a tenth of a second in time": late(0.057, 1.13, at_s=0.1),
}


@pytest.mark.parametrize("rate_hz", [1000.0, 6000.0, 10_000.0])
@pytest.mark.parametrize("name", LATE)
def test_lateness_up_to_two_seconds_moves_no_time_and_loses_nothing(name, rate_hz):
    found = timed(rate_hz, LATE[name])
    assert not found.losses
    assert not found.doubts
    assert np.abs(found.error_s).max() <= max(1.0 / rate_hz, SMALLEST_ERROR_S)


@pytest.mark.parametrize("off_ppm", [-20_000.0, -2000.0, 2000.0, 20_000.0])
def test_a_rounded_rate_is_followed_from_the_first_sample_on(off_ppm):
    found = timed(6000.0, lambda _: 0.0, ppm=off_ppm)
    assert not found.losses
    assert not found.doubts
    assert np.abs(found.error_s).max() <= 1.0 / 6000.0


@pytest.mark.parametrize("lasts_ms", [5, 10, 60, 1000])
@pytest.mark.parametrize("name", ["100 ms late for 0.5 s", "30 ms late, half of every second", "stalled for 0.05 s"])
@pytest.mark.parametrize("rate_hz", [1000.0, 6000.0])
def test_a_loss_of_five_milliseconds_is_found_and_the_times_after_it_are_right(rate_hz, name, lasts_ms):
    n = round(lasts_ms * rate_hz / 1e3)
    found = timed(rate_hz, LATE[name], lost=[(7.0, n)])
    (loss,) = found.losses
    assert loss.n_missing == pytest.approx(n, abs=1)
    assert loss.start_s - START_S == pytest.approx(7.0, abs=0.6 if "half" in name else 0.01)
    assert np.abs(found.error_s[found.true_s > 7.6]).max() <= 1.0 / rate_hz + SMALLEST_ERROR_S


@pytest.mark.parametrize("read_every_s", [0.0047, 0.0447])
@pytest.mark.parametrize("n", [30, 300, 6000])
def test_a_loss_is_said_within_two_seconds_before_it_is_counted(n, read_every_s):
    found = timed(6000.0, lambda _: 0.0, lost=[(5.0, n)], seconds=5.0 + n / 6000.0 + 3.0, read_every_s=read_every_s)
    behind_s = 5.0 + n / 6000.0
    assert found.n_late == 1
    assert found.first_said_s[0] < min(behind_s + 2.0, found.loss_said_s[0])


def test_a_late_link_that_was_said_is_taken_back_when_it_is_in_time_again():
    found = timed(6000.0, late(0.02, 1.95))
    assert found.n_late == 1
    begun, over = found.undecided
    assert "20 ms late" in begun.text
    assert over.text == f"over: {begun.text}: nothing was lost"
    assert over.start_s - START_S == pytest.approx(4.0, abs=0.03)
    assert over.end_s - START_S == pytest.approx(5.97, abs=0.03)
    assert not found.losses


def test_a_link_late_for_longer_is_called_a_loss_and_taken_back():
    found = timed(6000.0, late(0.1, 3.0))
    (loss,), (doubt,) = found.losses, found.doubts
    assert loss.n_missing == doubt.n_taken_back
    assert loss.n_missing == pytest.approx(600, abs=3)
    # The doubt covers every time that is wrong by more than a sample.
    wrong_s = found.true_s[np.abs(found.error_s) > 1.0 / 6000.0]
    assert doubt.start_s - START_S <= wrong_s.min() + 0.11
    assert doubt.end_s - START_S >= wrong_s.max()
    assert wrong_s.max() < 7.0 + 3.5


def _in_steps(*steps):
    """Late by 100 ms from 4 s to 7 s, called a loss by then, and after that by (from time in s, lateness in s)."""
    return lambda t: (
        0.0 if t < 4 else 0.1 if t < 7 else [late_s for at_s, late_s in ((7.0, 0.1), *steps) if t >= at_s][-1]
    )


@pytest.mark.parametrize("read_every_s", [0.0047, 0.0447])
@pytest.mark.parametrize(
    "lateness",
    [
        _in_steps((7.0, 0.0983), (8.5, 0.0)),
        _in_steps((7.0, 0.0017), (8.5, 0.0)),
        lambda t: 0.1 if 4 <= t < 7 else 0.1 * (13 - t) / 6 if 7 <= t < 13 else 0.0,
    ],
    ids=["a little sooner at first", "a little late at last", "over 6 s"],
)
def test_a_false_loss_is_taken_back_whole_however_the_link_falls_back_into_time(lateness, read_every_s):
    """The clock follows a step of less than 2 ms, so that less is left to be contradicted by the next one."""
    rate_hz = 10_000.0
    found = timed(rate_hz, lateness, seconds=17.0, read_every_s=read_every_s)
    assert sum(loss.n_missing for loss in found.losses) == sum(doubt.n_taken_back for doubt in found.doubts)
    is_wrong = np.abs(found.error_s) > 1.0 / rate_hz + SMALLEST_ERROR_S
    assert is_wrong.any()
    given_s = (found.true_s + found.error_s)[is_wrong] + START_S
    marked = [(doubt.start_s - 0.001 <= given_s) & (given_s <= doubt.end_s) for doubt in found.doubts]
    assert np.any(marked, axis=0).all()


def test_a_link_late_while_its_clock_settles_is_said():
    found = timed(6000.0, late(0.1, 0.5, at_s=0.0))
    (doubt,) = found.doubts
    assert "earlier than possible" in doubt.text
    assert np.abs(found.error_s[found.true_s > doubt.end_s - START_S]).max() <= 1.0 / 6000.0


def test_frames_sent_twice_are_said_and_the_times_after_them_are_right():
    found = timed(6000.0, lambda _: 0.0, twice=[(5.0, 60)])
    (doubt,) = found.doubts
    assert "sent twice" in doubt.text
    assert np.abs(found.error_s[found.true_s > doubt.end_s - START_S]).max() <= 1.0 / 6000.0


def test_what_is_late_when_the_recording_ends_is_said():
    found = timed(6000.0, late(0.05, 2.0, at_s=10.0))
    (doubt,) = found.doubts
    assert not found.losses
    assert "a late link, or 30" in doubt.text


def test_losses_that_follow_each_other_too_fast_to_be_told_apart_are_said_where_times_may_be_wrong():
    found = timed(6000.0, lambda _: 0.0, lost=[(4.0 + 0.4 * k, 900) for k in range(6)], seconds=12.0)
    assert sum(loss.n_missing for loss in found.losses) == pytest.approx(5400, abs=6)
    given_s = (found.true_s + found.error_s)[np.abs(found.error_s) > 0.001] + START_S
    marked = [(doubt.start_s - 0.001 <= given_s) & (given_s <= doubt.end_s) for doubt in found.doubts]
    assert len(given_s)
    assert np.any(marked, axis=0).all()
