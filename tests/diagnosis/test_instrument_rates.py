"""A slow instrument has one rate in all trials, also in those whose digits hide it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis.campaign import reduce_campaign
from sawbench.storage.importers.campaign import load_campaign
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

BATTERY, SLOW_HZ, DIGIT_A = "battery_current_a", 100.0, 0.05


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slow")
    make_campaign(321, folder / "tables", effects={}, length=0.3, rate_hz=2500.0)
    paths = import_path(folder / "tables" / "campaign.toml", folder / "mcap").paths
    return [read_recording(path) for path in paths][:12], load_campaign(folder / "tables" / "campaign.toml")[1]


def interpolated(recording, slow_hz=SLOW_HZ):
    """The battery current as a table has it that draws lines between the messages of a bus, with few digits."""
    signal = recording.signals[BATTERY]
    time_s = signal.time_s
    at_s = np.arange(time_s[0] + 0.3 / slow_hz, time_s[-1], 1.0 / slow_hz)
    lines = np.interp(time_s, at_s, np.interp(at_s, time_s, signal.values))
    written = np.round(np.round(lines / DIGIT_A) * DIGIT_A, 2)
    return replace(recording, signals={**recording.signals, BATTERY: replace(signal, values=written)})


def rates_hz(recordings, loaded):
    return [one.rate_hz for one in reduce_campaign(recordings, loaded).health if one.channel == BATTERY]


def test_the_rate_that_cuts_show_is_that_of_the_idle_runs(campaign):
    recordings, loaded = campaign
    found = rates_hz([interpolated(one) for one in recordings], loaded)
    assert sum(one.trial.is_idle for one in recordings) >= 3
    assert found == pytest.approx([SLOW_HZ] * len(recordings), rel=0.01)


def test_another_rate_of_some_trials_says_nothing_of_the_others(campaign):
    """Rates that differ are no rate of the instrument: what shows none by itself keeps its rows."""
    recordings, loaded = campaign
    cuts = [one for one in recordings if not one.trial.is_idle]
    slow = [interpolated(one, 100.0 if k % 2 else 160.0) for k, one in enumerate(cuts)]
    idle = [one for one in recordings if one.trial.is_idle]
    found = sorted(rates_hz([*slow, *idle], loaded))
    assert found[len(slow) :] == pytest.approx([2500.0] * len(idle), rel=0.01)


def held_by_a_busy_bus(recording):
    """The battery current as a table holds it until the next message, each early or late by 10 % of the period."""
    rng = np.random.default_rng(9)
    signal = recording.signals[BATTERY]
    time_s = signal.time_s
    sampled_s = np.arange(time_s[0] - 0.7 / SLOW_HZ, time_s[-1], 1.0 / SLOW_HZ)
    arrived_s = np.maximum.accumulate(sampled_s + 0.1 / SLOW_HZ * rng.standard_normal(len(sampled_s)))
    sent = np.interp(sampled_s, time_s, signal.values)
    rows = sent[np.clip(np.searchsorted(arrived_s, time_s, side="right") - 1, 0, None)]
    return replace(recording, signals={**recording.signals, BATTERY: replace(signal, values=np.round(rows, 2))})


def test_messages_of_a_busy_bus_are_known_by_the_rate_that_all_trials_share(campaign):
    recordings, loaded = campaign
    found = rates_hz([held_by_a_busy_bus(one) for one in recordings], loaded)
    assert found == pytest.approx([SLOW_HZ] * len(recordings), rel=0.01)


@pytest.mark.parametrize("step_a", [0.2, 0.5, 1.0])
def test_coarse_steps_are_no_messages(campaign, step_a):
    """They stay for many rows too, for as long as the machine lets them: at another stroke rate another time."""
    recordings, loaded = campaign

    def coarse(recording):
        signal = recording.signals[BATTERY]
        steps = np.round(signal.values / step_a) * step_a
        return replace(recording, signals={**recording.signals, BATTERY: replace(signal, values=steps)})

    found = rates_hz([coarse(one) for one in recordings], loaded)
    assert found == pytest.approx([2500.0] * len(found), rel=0.01)
