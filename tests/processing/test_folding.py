"""Folding, return stroke, averages, peak force, quality: against closed forms."""

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig, parse_config
from sawbench.bench.recording import Gap, Signal
from sawbench.processing.averages import cycle_averages
from sawbench.processing.folding import Cycles, find_cycles, fold_channels, fold_signals
from sawbench.processing.noise import white_noise_std
from sawbench.processing.peak_force import estimate_peak_force
from sawbench.processing.quality import clean_channel, plausibility_problems
from sawbench.processing.return_stroke import zero_return_stroke
from sawbench.processing.spikes import find_spikes

from benchmarks.synthetic_trials import stroke_coefficients

pytestmark = pytest.mark.unit

CONFIG = parse_config(
    "[plant]\nresistance_ohm = 0.176\ninductance_h = 0.00321\nback_emf_constant_v_s_per_rad = 0.007383\n"
    "torque_constant_n_m_per_a = 0.005632\nrotor_inertia_kg_m2 = 2.4e-5\nyoke_inertia_kg_m2 = 2.38e-5\n"
    "reciprocating_mass_kg = 0.239\ncrank_radius_m = 0.01\nmotor_damping_n_m_s_per_rad = 3.4274e-6\n"
    "gear_ratio = 9.333\n[battery]\nnominal_voltage_v = 18.0\ncapacity_ah = 1.5\nbeta = 0.99\n"
).config


def turning(t, rate_hz=14.3, ripple=0.05):
    """A crank that is slower while it cuts."""
    return 2 * np.pi * rate_hz * t + ripple * np.sin(2 * np.pi * rate_hz * t)


def shape(angle):
    return 200 * np.maximum(-np.sin(angle), 0) ** 1.5 + 5 * np.cos(3 * angle)


@pytest.mark.parametrize("rate_hz", [700.0, 1000.0, 6000.0, 10000.0])
@pytest.mark.parametrize("threads", [1, 2])
def test_mean_and_std_of_cycles(rate_hz, threads):
    t_angle = np.arange(0, 8, 1 / 6000)
    t = np.arange(0.003, 7.9, 1 / rate_hz)
    cycle = np.floor(turning(t) / (2 * np.pi)).astype(int)
    gain = 1 + 0.1 * np.random.default_rng(1).standard_normal(200)[cycle]
    values = np.stack([gain * shape(turning(t)), np.cos(turning(t))])
    turns = np.arange(1, 111)
    mean, std = fold_channels(t_angle, turning(t_angle), t, values, turns, n_bins=128, n_threads=threads)
    at = (np.arange(128) + 0.5) * 2 * np.pi / 128
    of_turns = np.array([gain[cycle == turn][0] for turn in turns])
    inner = np.abs(np.sin(at)) > 0.1  # the kink at the dead centres is smeared over a sample
    assert mean[1] == pytest.approx(np.cos(at), abs=2e-4 if rate_hz > 700 else 1e-3)
    tolerance = 0.6 if rate_hz <= 1000 else 0.1
    assert mean[0][inner] == pytest.approx((of_turns.mean() * shape(at))[inner], abs=tolerance)
    assert std[0][inner] == pytest.approx((of_turns.std(ddof=1) * np.abs(shape(at)))[inner], abs=tolerance)


@pytest.mark.parametrize("n_bins", [16, 24, 40, 64, 128, 256])
def test_few_bins_are_at_their_angles(n_bins):
    t = np.arange(0, 2, 1 / 6000)
    mean, _ = fold_channels(t, turning(t), t, np.cos(turning(t))[None], np.arange(1, 26), n_bins=n_bins)
    assert mean[0] == pytest.approx(np.cos((np.arange(n_bins) + 0.5) * 2 * np.pi / n_bins), abs=2e-4)


def test_one_cycle_has_no_spread():
    t = np.arange(0, 1, 1e-3)
    mean, std = fold_channels(t, turning(t), t, np.ones((1, 1000)), np.array([3]), n_bins=32)
    assert mean == pytest.approx(np.ones((1, 32)), abs=1e-12)
    assert np.all(std == 0)


def test_cycles_in_gaps_are_left_out_channel_by_channel():
    t = np.arange(0, 2, 1e-3)
    slow = np.arange(0, 2, 4e-3)
    cycles = find_cycles(t, 2 * np.pi * 10 * t, [(0.0, 2.0)])
    assert len(cycles.index) == 19  # the last turn ends beyond the last sample
    few = Cycles(index=cycles.index[:5], start_s=cycles.start_s[:5], end_s=cycles.end_s[:5])
    signals = {"a": ("N", t, np.sin(t)), "b": ("A", slow, np.ones(500))}
    folded = fold_signals(t, 2 * np.pi * 10 * t, signals, {"a": cycles, "b": few}, n_bins=64)
    assert folded["a"].n_cycles == 19
    assert folded["b"].count.tolist() == [5] * 64


def test_removed_force_is_reported():
    t = np.arange(0, 2, 1e-3)
    force = fold_signals(
        t,
        turning(t),
        {"force_n": ("N", t, shape(turning(t)))},
        {"force_n": find_cycles(t, turning(t), [(0.0, 2.0)])},
        n_bins=256,
    )["force_n"]
    cutting, removed = zero_return_stroke(force, "pi_to_2pi")
    assert np.all(cutting.mean[cutting.angle_rad < np.pi] == 0)
    assert np.all(cutting.mean[cutting.angle_rad > np.pi] == force.mean[force.angle_rad > np.pi])
    assert removed.half == "zero_to_pi"
    assert removed.rms_n == pytest.approx(5 / np.sqrt(2), rel=0.02)
    assert abs(removed.peak_n) == pytest.approx(5, rel=0.05)
    assert not removed.looks_swapped
    assert zero_return_stroke(force, "zero_to_pi")[1].looks_swapped


def test_averages_over_whole_cycles_ignore_the_rest():
    t = np.sort(np.random.default_rng(2).uniform(0, 3, 20_000))
    values = 10 + 3 * np.sin(2 * np.pi * 5 * t) + 100 * (t > 2)
    cycles = find_cycles(t, 2 * np.pi * 5 * t, [(0.1, 1.95)])
    mean, rms = cycle_averages(t, values, cycles)
    assert mean == pytest.approx(10, abs=0.01)
    assert rms == pytest.approx(np.sqrt(100 + 4.5), abs=0.01)


def test_peak_force_is_not_biased_by_noise_and_its_uncertainty_covers():
    t = np.arange(0, 3, 1 / 6000)
    angle = 2 * np.pi * 15 * t
    turns = np.arange(1, 44)
    inside = z = 0
    naive = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        gain = 1 + 0.05 * rng.standard_normal(60)[np.floor(angle / (2 * np.pi)).astype(int)]
        force = 250 * gain * np.maximum(-np.sin(angle), 0) + 8 * rng.standard_normal(len(t))
        folded = fold_signals(
            t, angle, {"force_n": ("N", t, force)}, {"force_n": find_cycles(t, angle, [(0, 3)])}, n_bins=256
        )["force_n"]
        peak = estimate_peak_force(zero_return_stroke(folded, "pi_to_2pi")[0], t, angle, t, force, turns)
        error = peak.mean_n - 250
        inside += abs(error) < 1.96 * peak.mean_std_n
        z += error / peak.mean_std_n
        naive.append(force[: 6000 * 2].reshape(-1, 400).max(axis=1).mean() - 250)
    assert np.mean(naive) > 10  # the largest sample: high by more than a noise standard deviation
    assert abs(z / 60) < 0.5
    assert inside >= 52  # 57 expected of 60


def test_uncertainty_of_the_peak_covers_where_strokes_are_few_or_correlated():
    """Strokes whose force is that of the one before in part, or of which there are five."""
    rng = np.random.default_rng(8)
    for n_strokes, rho in ((5, 0.0), (20, 0.3)):
        t = np.arange(0, n_strokes / 10, 1e-3)
        angle = 2 * np.pi * 10 * t
        turns = np.arange(n_strokes)
        cycles = {"force_n": Cycles(index=turns, start_s=turns / 10, end_s=(turns + 1) / 10)}
        held = 0
        for _ in range(400):
            peaks = stroke_coefficients(rng, n_strokes, 200, 0.05, rho)
            force = peaks[np.floor(angle / (2 * np.pi) + 1e-9).astype(int)] * np.maximum(-np.sin(angle), 0)
            folded = fold_signals(t, angle, {"force_n": ("N", t, force)}, cycles, n_bins=128)["force_n"]
            peak = estimate_peak_force(folded, t, angle, t, force, turns)
            held += abs(peak.mean_n - 200) < 1.96 * peak.mean_std_n
        assert 0.91 < held / 400 < 0.99


def signal(values, rate_hz=1000.0, channel="force_n", unit="N", **options):
    return Signal(channel=channel, unit=unit, time_s=np.arange(len(values)) / rate_hz, values=values, **options)


@pytest.mark.parametrize("are_sampled_so", [True, False])
def test_jitter_times_slope_is_no_noise(are_sampled_so):
    """A stroke of 25 mm at 46 Hz and 1 kHz; the samples were taken at the times that jitter, or only say so."""
    rng = np.random.default_rng(5)
    even = np.arange(4000) * 1e-3
    jittered = even + 1.5e-4 * rng.uniform(-1.0, 1.0, 4000)
    sampled = jittered if are_sampled_so else even
    values = 12.5 * (1.0 - np.cos(2 * np.pi * 46.0 * sampled)) + 0.016 * rng.standard_normal(4000)
    assert white_noise_std(values, jittered) == pytest.approx(0.016, rel=0.1)


def test_noise_spikes_clipping_and_missing_samples_are_counted():
    rng = np.random.default_rng(4)
    clean = 100 * np.sin(np.arange(20_000) * 0.02) + 0.5 * rng.standard_normal(20_000)
    assert white_noise_std(clean) == pytest.approx(0.5, rel=0.05)
    spiky = clean.copy()
    at = np.arange(500, 20_000, 1000)
    spiky[at] += 300
    assert np.flatnonzero(find_spikes(spiky)).tolist() == at.tolist()
    quality = clean_channel(signal(np.clip(clean, -1e9, 80))).quality
    assert quality.n_clipped == pytest.approx(np.sum(clean > 80), rel=0.05)
    assert any("clipped" in problem for problem in quality.problems)
    time = np.delete(np.arange(20_000) / 1e3, np.r_[100:150, 700])
    lost = Signal(channel="force_n", unit="N", time_s=time, values=np.delete(clean, np.r_[100:150, 700]))
    result = clean_channel(lost)
    assert result.quality.n_missing == 51
    assert result.holes == ((pytest.approx(0.099), pytest.approx(0.150)),)
    assert clean_channel(signal(clean)).quality.problems == ()


def test_real_edges_and_quantisation_are_no_defects():
    square = np.where(np.sin(np.arange(5000) * 0.05) > 0, 50.0, 0.0) + np.random.default_rng(5).standard_normal(5000)
    assert not find_spikes(square).any()
    coarse = np.round(10 * np.sin(np.arange(20_000) * 0.01) / 0.05) * 0.05
    assert clean_channel(signal(coarse)).quality.n_clipped == 0
    assert clean_channel(signal(coarse)).noise_std >= 0.05 / np.sqrt(12) * 0.99


def test_annotated_gaps_break_cycles():
    gap = Gap(start_s=1.0, end_s=1.3, n_missing=300)
    assert clean_channel(signal(np.sin(np.arange(3000) * 0.1), gaps=(gap,))).holes == ((1.0, 1.3),)


@pytest.mark.parametrize(
    ("channel", "values", "words"),
    [
        ("displacement_mm", 0.01 * (1 - np.cos(np.arange(2000) * 0.1)), "probably in m"),
        ("displacement_mm", 40 * (1 - np.cos(np.arange(2000) * 0.1)), "radius"),
        ("force_n", 0.2 * np.maximum(np.sin(np.arange(2000) * 0.1), 0), "kN"),
        ("force_n", -200 * np.maximum(np.sin(np.arange(2000) * 0.1), 0) ** 4, "sign"),
        ("battery_voltage_v", 18_000 + np.sin(np.arange(2000) * 0.1), "plausible"),
        ("battery_voltage_v", 5 + np.sin(np.arange(2000) * 0.1), "other unit"),
        ("motor_current_a", -10 + np.sin(np.arange(2000) * 0.1), "sign"),
    ],
)
def test_wrong_units_and_signs_are_named(channel, values, words):
    found = plausibility_problems(
        {
            channel: clean_channel(signal(values, channel=channel)),
            "battery_current_a": clean_channel(signal(4 + np.sin(np.arange(2000) * 0.1), channel="battery_current_a")),
        },
        CONFIG,
        None,
    )
    assert words in " ".join(found[channel])


def test_swapped_currents_are_named_and_good_channels_are_not():
    wave = np.sin(np.arange(2000) * 0.1)
    good = {
        "motor_current_a": clean_channel(signal(10 + wave, channel="motor_current_a")),
        "battery_current_a": clean_channel(signal(4.4 + wave, channel="battery_current_a")),
        "force_n": clean_channel(signal(200 * np.maximum(wave, 0))),
        "displacement_mm": clean_channel(signal(10 + 10 * wave, channel="displacement_mm")),
    }
    assert plausibility_problems(good, CONFIG, 0.4375) == {}
    swapped = {
        "motor_current_a": good["battery_current_a"],
        "battery_current_a": good["motor_current_a"],
    }
    assert "swapped" in plausibility_problems(swapped, CONFIG, 0.4375)["battery_current_a"][0]
    assert plausibility_problems(swapped, BenchConfig(), None) == {}
