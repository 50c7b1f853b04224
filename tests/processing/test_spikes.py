"""Single samples far off are of a cable, and left out; at one crank angle they are of the machine, and stay."""

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.process import process_recording, track_strokes
from sawbench.processing.quality import clean_channel

pytestmark = pytest.mark.unit

RATE_HZ, STROKES_HZ, DURATION_S = 2000.0, 13.37, 6.0
TIME_S = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)


def crank(turns):
    return CrankAngle(
        time_s=TIME_S,
        angle_rad=2.0 * np.pi * turns,
        speed_rad_s=2.0 * np.pi * np.gradient(turns, TIME_S),
        angle_std_rad=np.zeros(len(turns)),
        radius_m=0.01,
        source="displacement_mm",
        is_absolute=True,
    )


def at_turns(turns, wanted):
    return np.unique(np.searchsorted(turns, wanted))


def force(*at, size_n=80.0):
    """A stroke's wave, noise, and a sample that is far off at each place."""
    rng = np.random.default_rng(11)
    values = 20.0 * np.sin(2.0 * np.pi * STROKES_HZ * TIME_S) + rng.standard_normal(len(TIME_S))
    for places in at:
        values[places] += size_n
    return Signal(channel="force_n", unit="N", time_s=TIME_S, values=values)


STEADY = STROKES_HZ * TIME_S
OF_CABLE = np.random.default_rng(12).choice(len(TIME_S), 25, replace=False)


@pytest.mark.parametrize("per_stroke", [1, 2])
def test_spikes_at_one_crank_angle_stay_and_those_of_the_cable_do_not(per_stroke):
    places = at_turns(STEADY, np.arange(1, int(STEADY[-1]) * per_stroke) / per_stroke + 0.12)
    signal = force(places, OF_CABLE)
    clean = clean_channel(signal, crank(STEADY))
    # Of those of the cable some stand where the machine strikes.
    assert len(places) - 2 <= clean.quality.n_impacts <= len(places) + 5
    assert clean.quality.n_spikes >= len(OF_CABLE) - 7
    assert np.isin(TIME_S[places], clean.time_s).mean() > 0.97
    assert any("same crank angle" in problem for problem in clean.quality.problems)


def test_without_an_angle_and_at_random_times_every_spike_is_left_out():
    signal = force(OF_CABLE)
    for angle in (None, crank(STEADY)):
        quality = clean_channel(signal, angle).quality
        assert (quality.n_spikes, quality.n_impacts) == (len(OF_CABLE), 0)


def test_the_spikes_of_one_burst_share_their_angle_and_are_no_impacts():
    starts = np.arange(300, len(TIME_S), 1700)
    bursts = np.unique(np.concatenate([starts + 6 * k for k in range(8)]))
    quality = clean_channel(force(bursts), crank(STEADY)).quality
    assert (quality.n_spikes, quality.n_impacts) == (len(bursts), 0)


def test_at_rest_all_spikes_have_one_angle_and_are_of_the_cable():
    turns = np.where(TIME_S < 3.0, 0.0, STROKES_HZ * (TIME_S - 3.0))
    rest = OF_CABLE[TIME_S[OF_CABLE] < 2.9]
    at = np.unique(np.r_[rest, np.arange(40, 5000, 150)])
    signal = Signal(
        channel="force_n",
        unit="N",
        time_s=TIME_S,
        values=np.random.default_rng(3).standard_normal(len(TIME_S)) + 80.0 * np.isin(np.arange(len(TIME_S)), at),
    )
    quality = clean_channel(signal, crank(turns)).quality
    assert (quality.n_spikes, quality.n_impacts) == (len(at), 0)


def test_a_trial_keeps_what_strikes_in_the_machine():
    places = at_turns(STEADY, np.arange(2, 2 * int(STEADY[-1])) / 2 + 0.05)
    displacement = 10.0 * (1.0 - np.cos(2.0 * np.pi * STEADY))
    displacement[OF_CABLE] += 30.0
    recording = Recording(
        trial=Trial(trial_id="t1"),
        signals={
            "displacement_mm": Signal(channel="displacement_mm", unit="mm", time_s=TIME_S, values=displacement),
            "force_n": force(places),
        },
    )
    for found in (process_recording(recording, BenchConfig()), track_strokes(recording, BenchConfig())):
        assert len(found.channels["force_n"].values) == len(TIME_S)
        quality = {row.channel: row for row in found.quality}
        assert quality["force_n"].n_impacts == pytest.approx(len(places), abs=2)
        assert quality["displacement_mm"].n_spikes == len(OF_CABLE)
        assert len(found.channels["displacement_mm"].values) == len(TIME_S) - len(OF_CABLE)


@pytest.mark.parametrize("n_overloads", [1, 3, 40])
@pytest.mark.parametrize("overload_n", [32767.0, -6000.0])
def test_an_overload_of_any_length_is_left_out_and_said(n_overloads, overload_n):
    t = np.arange(12_000) / 6000.0
    values = 200.0 * np.abs(np.sin(40.0 * t)) + np.random.default_rng(3).normal(0.0, 0.3, len(t))
    values[5000 : 5000 + n_overloads] = overload_n
    found = clean_channel(Signal(channel="force_n", unit="N", time_s=t, values=values))
    assert found.quality.n_spikes == n_overloads
    assert found.values.max() < 210.0 and found.values.min() > -10.0
    assert any(f"{n_overloads} spikes were left out" in text for text in found.quality.problems)


def test_a_channel_in_another_unit_keeps_its_samples():
    """A force in millinewton is outside of what is plausible for most of the time, and within its own range."""
    t = np.arange(12_000) / 6000.0
    values = 200_000.0 * np.abs(np.sin(40.0 * t))
    assert clean_channel(Signal(channel="force_n", unit="N", time_s=t, values=values)).quality.n_spikes == 0
