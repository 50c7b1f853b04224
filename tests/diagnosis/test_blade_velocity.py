"""The cut goes with the blade's own velocity, which jumps where a plunger meets its crank pin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.recording import Signal, Trial
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.diagnosis.inference.features import HARMONICS, N_BLOCKS, layout_of
from sawbench.diagnosis.inference.linear_problem import block_matrix
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.reduction import N_HARMONICS, running_state
from sawbench.diagnosis.smooth_state import smooth_state
from sawbench.modeling.effects.yoke_backlash import swing
from sawbench.modeling.state import TWO_PI
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.settled import find_steady_part
from sawbench.processing.stroke_ripple import restore_ripple

from tests.rigs.drawn_states import BASELINE, setting_of
from tests.rigs.drawn_states import running as drawn_strokes
from tests.rigs.processed import processed_trial

pytestmark = pytest.mark.unit

RATE_HZ, STROKES_HZ, K_N_S_PER_M = 5000.0, 14.0, 300.0


def running(gap_m, seed=1, seconds=6.0, noise_m=8e-6, start_s=2.0, spike_m=0.0):
    """Settled strokes of a crank that turns evenly; the plunger stays behind by the gap, and catches up in a jump."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    turned = TWO_PI * STROKES_HZ * time_s
    # Carried by one flank of the gap, then by the other: crossed within a few hundredths of a radian at two angles.
    flank = np.tanh(np.sin(turned - 1.2) / 0.08)
    stroke_m = BASELINE.radius_m * (1.0 - np.cos(turned)) + 0.5 * gap_m * flank
    velocity = np.gradient(stroke_m, time_s)
    force_n = K_N_S_PER_M * np.maximum(-velocity, 0.0)
    values = {
        "displacement_mm": 1e3 * (stroke_m + noise_m * rng.standard_normal(len(time_s))),
        "force_n": force_n + 0.7 * rng.standard_normal(len(time_s)),
    }
    values["displacement_mm"][len(time_s) // 2 :: 5000] += 1e3 * spike_m
    channels = {name: CHANNEL_BY_NAME[name] for name in values}
    signals = {
        name: Signal(channel=channel, unit=channel.unit, time_s=time_s, values=values[name])
        for name, channel in channels.items()
    }
    measured_m = 1e-3 * values["displacement_mm"]
    tracked = track_crank_angle(time_s, measured_m, mechanism=BASELINE.mechanism)
    angle = restore_ripple(tracked, find_steady_part(tracked), time_s, measured_m)
    trial = Trial(trial_id="t", duty=0.5, material="oak", feed_mm_s=3.0)
    state = running_state(processed_trial(trial, signals, angle, start_s, seconds - 0.1), setting_of(is_idle=False))
    assert state is not None
    return state


def force_beside_law(state, velocity):
    """What the best linear law leaves of the mean force, over its peak."""
    force_n = state.force_n.mean(axis=0)
    speed = np.maximum(-velocity, 0.0)
    return np.abs(force_n - (speed @ force_n) / (speed @ speed) * speed).max() / force_n.max()


def test_the_force_of_a_plunger_that_jumps_goes_with_its_measured_velocity():
    state = running(gap_m=3e-4)
    crank_only = replace(state, blade_excess_m_s=None)
    measured, of_crank = (BASELINE.blade_velocity(s).mean(axis=0) for s in (state, crank_only))
    assert force_beside_law(state, measured) < 0.01
    assert force_beside_law(state, of_crank) > 0.025


def test_signatures_keep_the_measured_velocity():
    state = running(gap_m=3e-4)
    kept, lost = (
        smooth_state(s, block_matrix(len(s.speed_rad_s)), mechanism=BASELINE.mechanism)
        for s in (state, replace(state, blade_excess_m_s=None))
    )
    assert force_beside_law(state, BASELINE.blade_velocity(kept)[0]) < 0.01
    assert force_beside_law(state, BASELINE.blade_velocity(lost)[0]) > 0.1


def test_without_play_the_velocity_is_the_cranks():
    state = running(gap_m=0.0)
    smooth = smooth_state(state, block_matrix(len(state.speed_rad_s)), mechanism=BASELINE.mechanism)
    peak = np.abs(BASELINE.blade_velocity(smooth)).max()
    assert peak == pytest.approx(TWO_PI * STROKES_HZ * BASELINE.radius_m, rel=0.01)
    assert np.abs(smooth.blade_excess_m_s).max() < 2e-3 * peak


def test_play_is_no_gap_of_the_cutting_law():
    state = drawn_strokes()
    assert set(swing(BASELINE, state, 1e-3 * np.cos(2 * state.angle_rad))) == {"electrical", "mechanical"}


def test_a_spike_of_the_displacement_is_no_velocity():
    plain, spiked = running(gap_m=3e-4), running(gap_m=3e-4, spike_m=3e-3)
    away = np.abs(spiked.blade_excess_m_s - plain.blade_excess_m_s).max()
    assert away < 0.3 * np.abs(plain.blade_excess_m_s).max()


def test_few_units_keep_the_cranks_velocity():
    state = running(gap_m=3e-4)
    few = replace(
        state, **{name: getattr(state, name)[:3] for name in ("angle_rad", "speed_rad_s", "force_n", "force_rate_n_s",
                  "acceleration_rad_s2", "motor_voltage_v", "time_s", "cut_distance_m", "charge_used_as", "n_strokes",
                  "blade_excess_m_s")}
    )  # fmt: skip
    assert smooth_state(few, block_matrix(3), mechanism=BASELINE.mechanism).blade_excess_m_s is None


def second_harmonic(waves):
    return 2.0 * np.abs(np.fft.rfft(waves.mean(axis=0))[2]) / waves.shape[1]


@pytest.mark.parametrize(("ripple", "kept"), [(0.0, (0.0, 0.3)), (0.02, (0.9, 1.0))])
def test_a_wave_of_the_angle_that_may_be_noise_is_in_no_signature(ripple, kept):
    """All units of a trial share its error: a delay of that noise was a late clock, and its inertia a light rotor."""
    state = running(gap_m=0.0, noise_m=3e-5)
    state = replace(state, speed_rad_s=state.speed_rad_s * (1.0 + ripple * np.cos(2.0 * state.angle_rad)))
    smooth = smooth_state(state, block_matrix(len(state.speed_rad_s)), mechanism=BASELINE.mechanism)
    share = second_harmonic(smooth.speed_rad_s) / second_harmonic(state.speed_rad_s)
    assert kept[0] <= share <= kept[1]


def with_excess(excess_m_s):
    """Strokes at one speed whose blade goes by so much beyond the crank."""
    state = running(gap_m=0.0, seconds=4.0)
    speed = np.full_like(state.speed_rad_s, TWO_PI * STROKES_HZ)
    excess = excess_m_s(state.angle_rad)
    return replace(state, speed_rad_s=speed, k_guess_n_s_per_m=K_N_S_PER_M, blade_excess_m_s=excess)


def smoothed(state):
    return smooth_state(state, block_matrix(len(state.speed_rad_s)), mechanism=BASELINE.mechanism)


def test_a_harmonic_that_chance_shows_is_no_more_certain_than_chance():
    """As seen: one trial of 38 with a wave of 15 times the stroke rate, and 25 nats for a compliant blade."""
    state, shown = with_excess(np.zeros_like), 0
    for seed in range(60):
        noise = 0.01 * np.random.default_rng(seed).standard_normal(state.speed_rad_s.shape)
        smooth = smoothed(replace(state, blade_excess_m_s=noise))
        amplitude = 2.0 / noise.shape[1] * np.abs(np.fft.rfft(smooth.blade_excess_m_s[0]))[1 : N_HARMONICS + 1]
        is_there = amplitude > 1e-9
        assert np.array_equal(smooth.excess_std_m_s > 0.0, is_there)
        assert np.all(amplitude[is_there] < 6.0 * smooth.excess_std_m_s[is_there])
        shown += is_there.any()
    assert 1 <= shown <= 12


def test_an_uncertain_velocity_of_the_blade_makes_its_force_uncertain():
    rng = np.random.default_rng(1)

    def wave(angle):
        return 0.05 * np.cos(9.0 * angle)

    plant = Jigsaw(baseline=BASELINE)
    exact, noisy = with_excess(wave), with_excess(lambda a: wave(a) + 0.01 * rng.standard_normal(a.shape))
    layout = layout_of(exact, plant.residuals(exact), HARMONICS)
    without, of_exact, of_noisy = (
        np.diag(plant.model_error(layout, state))[layout.slices["cutting"]]
        for state in (replace(exact, blade_excess_m_s=None), exact, noisy)
    )
    assert np.allclose(of_exact, without, rtol=1e-6)
    added = np.sqrt(of_noisy - without)
    # Of a mean of white noise over all units and angles; where half of the turn cuts, the ninth keeps half of itself.
    std_m_s = 0.01 * np.sqrt(2.0 / noisy.speed_rad_s.size)
    assert added[9] == pytest.approx(0.5 * K_N_S_PER_M * std_m_s * np.sqrt(N_BLOCKS), rel=0.3)
    assert added[4] < 0.3 * added[9]
