"""Errors of the signal processing, as docs/processing.md quotes them: `python -m benchmarks.processing`.

How fast it is measures `python -m benchmarks --only signals`.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.process import process_recording
from sawbench.processing.spectrum import find_lines, power_spectrum

from benchmarks.signals import RATE_HZ, make_trial, recording_of
from benchmarks.synthetic_trials import GEAR_RATIO, NOMINAL, simulate


def print_drifting_trial(seconds=600.0):
    """Errors of angle and period on a long trial whose speed drifts by 2 %."""
    t, angle, channels = make_trial(seconds)
    track = track_crank_angle(t, 1e-3 * channels[0])
    error = track.angle_rad - np.interp(track.time_s, t, angle)
    period = process_recording(recording_of(seconds, RATE_HZ, 4), BenchConfig()).period
    turns = int(angle[-1] / (2 * np.pi)) - 2
    first, last = np.interp([2 * np.pi, 2 * np.pi * (1 + turns)], angle, t)
    ppm = 1e6 * (period.period_s * turns / (last - first) - 1)
    print(f"{seconds:g} s of a drifting speed: angle {1e3 * np.std(error):.2f} mrad, period {ppm:.1f} ppm")


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
    print_drifting_trial()
    print_period_errors(np.random.default_rng(1))
    print_angle_errors(np.random.default_rng(2))
