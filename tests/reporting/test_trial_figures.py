"""Pictures of a trial's signals: what an instrument writes beyond its range does not flatten the rest."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.recording import Gap, Recording, Signal, Trial
from sawbench.modeling.machines.words import SAW
from sawbench.reporting.trial_figures import _signal_panels, _window, signals_picture

pytestmark = pytest.mark.unit


def recorded(**overloads):
    """A force of 100 N with values put in at some samples, and a gap."""
    time_s = np.arange(2000) * 1e-3
    force_n = 100.0 * np.sin(2 * np.pi * 10.0 * time_s)
    for at, value in overloads.items():
        force_n[int(at[1:])] = value
    gap = Gap(start_s=0.8504, end_s=0.8506, n_missing=1, reason="lost")
    signal = Signal(channel="force_n", unit="N", time_s=time_s, values=force_n, gaps=(gap,))
    return Recording(trial=Trial(trial_id="t"), signals={"force_n": signal})


def force_axis(recording):
    shown = {"force_n": _window(recording.signals["force_n"], 0.0, 2.0)}
    return _signal_panels(recording, (), SAW, shown, 0.0, 2.0).axes[0]


def test_overloads_are_marked_and_leave_the_scale_to_the_rest():
    recording = recorded(_200=1e6, _700=-1e6)
    axis = force_axis(recording)
    low, high = axis.get_ylim()
    assert -150 < low < -100 < 100 < high < 150
    _, above, below = axis.lines
    assert above.get_xdata() == pytest.approx([0.2])
    assert below.get_xdata() == pytest.approx([0.7])
    assert "overloads of cutting force" in signals_picture(recording, seconds=2.0).caption


def test_a_force_within_what_it_can_have_is_drawn_in_full():
    recording = recorded(_200=900.0)
    axis = force_axis(recording)
    assert axis.get_ylim()[1] > 900.0
    assert len(axis.lines) == 1
    assert "overload" not in signals_picture(recording, seconds=2.0).caption
