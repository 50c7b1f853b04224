"""Speed and accuracy of the signal processing, as ratios within one run.

Prints, beside one pass over the memory and numpy in the same process: folding (1 and 2 threads), cycle
boundaries, the crank-angle smoother, the whole of `process_recording`; and the errors that
`docs/processing.md` quotes.

Run: python -m benchmarks.processing [--minutes 10] [--quick]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.demodulation import demodulate
from sawbench.processing.folding import fold_channels
from sawbench.processing.process import process_recording
from sawbench.processing.spectrum import find_lines, power_spectrum

from benchmarks.synthetic_trials import GEAR_RATIO, NOMINAL, simulate

RATE_HZ = 10_000.0
STROKE_HZ = 18.0
N_BINS = 256


def shortest_s(run, repeats=9):
    """Shortest duration of `run`, s, after one call that compiles: other users of the machine only add."""
    run()
    spent = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        spent.append(time.perf_counter() - start)
    return min(spent)


def make_trial(n, rng):
    """Four channels with stroke-locked content, noise and a slow drift of the speed."""
    t = np.arange(n) / RATE_HZ
    angle = 2 * np.pi * (STROKE_HZ * t - 0.02 * STROKE_HZ * t**2 / max(t[-1], 1.0) / 2) + 0.03 * np.sin(0.7 * t)
    channels = np.empty((4, n))
    channels[0] = 10 * (1 - np.cos(angle)) + 0.01 * rng.standard_normal(n)
    channels[1] = 200 * np.maximum(-np.sin(angle), 0) + rng.standard_normal(n)
    channels[2] = 10 + 2 * np.sin(angle + 0.3) + 0.1 * rng.standard_normal(n)
    channels[3] = 18 - 0.1 * channels[2] + 0.01 * rng.standard_normal(n)
    return t, angle, channels


def numpy_fold(t, starts, channels):
    """What most people write: np.interp per cycle, then mean and std."""
    result = []
    grid = (np.arange(N_BINS) + 0.5) / N_BINS
    for values in channels:
        folded = np.empty((len(starts) - 1, N_BINS))
        for k in range(len(starts) - 1):
            at = starts[k] + grid * (starts[k + 1] - starts[k])
            first, last = np.searchsorted(t, [starts[k], starts[k + 1]])
            part = slice(max(first - 1, 0), last + 1)
            folded[k] = np.interp(at, t[part], values[part])
        result.append((folded.mean(axis=0), folded.std(axis=0, ddof=1)))
    return result


def boundaries(values, n):
    """Crank angle at every sample from the phase of the first harmonic."""
    line = demodulate(0.0, 1 / RATE_HZ, values, STROKE_HZ)
    return line.time_s, line.phase_rad + np.pi


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the trial")
    parser.add_argument("--quick", action="store_true", help="20 s instead, for a look")
    options = parser.parse_args()
    n = int((20.0 if options.quick else 60.0 * options.minutes) * RATE_HZ)
    rng = np.random.default_rng(1)
    t, angle, channels = make_trial(n, rng)
    turns = np.arange(1, int(angle[-1] / (2 * np.pi)) - 1)
    starts = np.interp(2 * np.pi * np.r_[turns, turns[-1] + 1], angle, t)
    pass_s = shortest_s(channels.sum)
    print(
        f"{n} samples x 4 channels ({channels.nbytes / 1e6:.0f} MB), {len(turns)} strokes; "
        f"one pass {1e3 * pass_s:.1f} ms"
    )
    peer_s = shortest_s(lambda: numpy_fold(t, starts, channels), 1)
    print(f"fold, np.interp per cycle               {peer_s / pass_s:7.2f} passes")
    for threads in (1, 2):
        own_s = shortest_s(lambda k=threads: fold_channels(t, angle, t, channels, turns, n_bins=N_BINS, n_threads=k))
        print(
            f"fold + mean + std, {threads} thread(s)           {own_s / pass_s:7.2f} passes, "
            f"numpy/own {peer_s / own_s:.1f}"
        )
    bound_s = shortest_s(lambda: boundaries(channels[0], n))
    coarse_t, coarse = boundaries(channels[0], n)
    shift = coarse - np.interp(coarse_t, t, angle)
    shift = shift - 2 * np.pi * np.round(np.median(shift) / (2 * np.pi))
    inner = slice(64, -64)
    print(
        f"boundaries by demodulation              {bound_s / pass_s:7.2f} passes, {1e3 * np.std(shift[inner]):.1f} mrad"
    )

    def with_boundaries():
        at, phase = boundaries(channels[0], n)
        fold_channels(at, phase, t, channels, turns[4:-4], n_bins=N_BINS, n_threads=1)

    print(f"boundaries + fold, 1 thread             {shortest_s(with_boundaries) / pass_s:7.2f} passes")
    smooth_s = shortest_s(lambda: track_crank_angle(t, 1e-3 * channels[0]), 1)
    track = track_crank_angle(t, 1e-3 * channels[0])
    error = track.angle_rad - np.interp(track.time_s, t, angle)
    print(f"crank-angle smoother                    {smooth_s / pass_s:7.2f} passes, {1e3 * np.std(error):.2f} mrad")
    names = (
        ("displacement_mm", "mm"),
        ("force_n", "N"),
        ("motor_current_a", "A"),
        ("battery_voltage_v", "V"),
    )
    signals = {
        name: Signal(channel=name, unit=unit, time_s=t, values=row)
        for (name, unit), row in zip(names, channels, strict=True)
    }
    recording = Recording(trial=Trial(trial_id="benchmark"), signals=signals)
    whole_s = shortest_s(lambda: process_recording(recording, BenchConfig()), 1)
    period = process_recording(recording, BenchConfig()).period
    print(f"process_recording, everything           {whole_s / pass_s:7.2f} passes ({whole_s:.2f} s)")
    true_period = (starts[-1] - starts[0]) / len(turns)
    print(f"period of the drifting trial            {1e6 * (period.period_s / true_period - 1):7.1f} ppm")
    print_period_errors(rng)
    print_angle_errors(rng)


def print_period_errors(rng):
    """Errors of the first guess and of the refined period at a constant rate."""
    for seconds in (1.0, 10.0):
        guess, refined, claimed = [], [], []
        for _ in range(40):
            rate = rng.uniform(12.0, 20.0)
            t = np.arange(0, seconds, 1 / 6000.0)
            y = 0.01 * (1 - np.cos(2 * np.pi * rate * t + rng.uniform(0, 6.28))) + 1e-5 * rng.standard_normal(len(t))
            line = find_lines(power_spectrum(y, 6000.0), 1.0, 100.0)[0]
            guess.append(line.frequency_hz / rate - 1)
            signal = Signal(channel="displacement_mm", unit="mm", time_s=t, values=1e3 * y)
            found = process_recording(
                Recording(trial=Trial(trial_id="p"), signals={"displacement_mm": signal}), BenchConfig()
            ).period
            refined.append(found.period_s * rate - 1)
            claimed.append(found.period_std_s * rate)
        rms = [1e6 * np.sqrt(np.mean(np.square(x))) for x in (guess, refined, claimed)]
        print(
            f"period error, {seconds:4.0f} s at 6 kHz, 10 um:     spectrum {rms[0]:.1f} ppm, "
            f"refined {rms[1]:.2f} ppm, stated {rms[2]:.2f} ppm"
        )


def print_angle_errors(rng):
    """Errors of angle and speed on an integrated jigsaw that cuts, from rest; strokes that differ by 5 %."""
    plant = {name: value for name, (value, _) in NOMINAL.items()}
    t, _, motor_speed, angle, *_ = simulate(plant, 240.29 * (1 + 0.05 * rng.standard_normal(60)), 0.4375, 2.0, 6000.0)
    speed = motor_speed / GEAR_RATIO
    for noise_um in (2, 10, 50):
        track = track_crank_angle(t, 0.01 * (1 - np.cos(angle)) + 1e-6 * noise_um * rng.standard_normal(len(t)))
        true_angle = np.interp(track.time_s, t, angle)
        error = track.angle_rad - true_angle
        steady = track.time_s > 0.4
        dead = steady & (np.abs(np.sin(true_angle)) < 0.1)
        ripple = np.std(np.interp(track.time_s, t, speed)[steady])
        of_speed = np.std(track.speed_rad_s[steady] - np.interp(track.time_s, t, speed)[steady])
        rms = [1e3 * np.sqrt(np.mean(error[part] ** 2)) for part in (steady, dead, ~steady)]
        print(
            f"jigsaw, {noise_um:3d} um noise: {rms[0]:.2f} mrad steady, {rms[1]:.2f} near dead centres, "
            f"{rms[2]:.2f} in the start; speed {of_speed:.3f} of a ripple of {ripple:.2f} rad/s; "
            f"error over stated {np.sqrt(np.mean((error / track.angle_std_rad)[steady] ** 2)):.2f}"
        )


if __name__ == "__main__":
    main()
