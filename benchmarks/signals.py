"""Period and fold of 10 min x 4 channels x 10 kHz, in passes over the memory, against numpy and scipy."""

from __future__ import annotations

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.units import CHANNELS
from sawbench.processing.demodulation import demodulate
from sawbench.processing.folding import fold_channels
from sawbench.processing.process import process_recording

from benchmarks.measuring import Clock, Goal, Plot, Section, Table, Timing, time_words

RATE_HZ, STROKE_HZ, N_BINS = 10_000.0, 18.0, 256
UNITS = {channel.name: channel.unit for channel in CHANNELS}
NAMES = ("displacement_mm", "force_n", "motor_current_a", "battery_voltage_v")


def make_trial(seconds: float, rate_hz: float = RATE_HZ):
    """Time, crank angle and four channels with stroke-locked content, noise and a slow drift of the speed."""
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    angle = 2 * np.pi * STROKE_HZ * (t - 0.01 * t**2 / max(t[-1], 1.0)) + 0.03 * np.sin(0.7 * t)
    channels = np.empty((4, len(t)))
    channels[0] = 10 * (1 - np.cos(angle)) + 0.01 * rng.standard_normal(len(t))
    channels[1] = 200 * np.maximum(-np.sin(angle), 0) + rng.standard_normal(len(t))
    channels[2] = 10 + 2 * np.sin(angle + 0.3) + 0.1 * rng.standard_normal(len(t))
    channels[3] = 18 - 0.1 * channels[2] + 0.01 * rng.standard_normal(len(t))
    return t, angle, channels


def recording_of(seconds: float, rate_hz: float, n_channels: int) -> Recording:
    """A trial as a recording; beyond four channels the force comes again under other names."""
    t, _, channels = make_trial(seconds, rate_hz)
    signals = {}
    for k in range(n_channels):
        name = NAMES[k] if k < len(NAMES) else f"extra_{k}_n"
        values = channels[k] if k < len(NAMES) else channels[1]
        signals[name] = Signal(channel=name, unit=UNITS.get(name, "N"), time_s=t, values=values)
    return Recording(trial=Trial(trial_id="benchmark"), signals=signals)


def numpy_fold(t, starts, channels):
    """What most people write: np.interp per cycle, then mean and std."""
    grid = (np.arange(N_BINS) + 0.5) / N_BINS
    found = []
    for values in channels:
        folded = np.empty((len(starts) - 1, N_BINS))
        for k in range(len(starts) - 1):
            first, last = np.searchsorted(t, [starts[k], starts[k + 1]])
            part = slice(max(first - 1, 0), last + 1)
            folded[k] = np.interp(starts[k] + grid * (starts[k + 1] - starts[k]), t[part], values[part])
        found.append((folded.mean(axis=0), folded.std(axis=0, ddof=1)))
    return found


def boundaries(values):
    """Times and crank angle from the phase of the first harmonic: the period, and where every stroke begins."""
    line = demodulate(0.0, 1 / RATE_HZ, values, STROKE_HZ)
    return line.time_s, line.phase_rad + np.pi


def measure(clock: Clock) -> Section:
    """Passes of each step, then what `process_recording` costs over length, channels and rate."""
    import scipy.fft

    t, angle, channels = make_trial(60.0 if clock.quick else 600.0)
    turns = np.arange(1, int(angle[-1] / (2 * np.pi)) - 1)
    starts = np.interp(2 * np.pi * np.r_[turns, turns[-1] + 1], angle, t)
    length = scipy.fft.next_fast_len(len(t), real=True)

    def fold(threads: int):
        return lambda: fold_channels(t, angle, t, channels, turns, n_bins=N_BINS, n_threads=threads)

    def whole(threads: int):
        def work():
            at, phase = boundaries(channels[0])
            fold_channels(at, phase, t, channels, turns[4:-4], n_bins=N_BINS, n_threads=threads)

        return work

    one, slow = "sawbench: period + fold", "numpy: fold, np.interp a cycle"
    found = clock.together(
        {
            "one pass over the memory": channels.sum,
            "sawbench: period, phase of every stroke": lambda: boundaries(channels[0]),
            "sawbench: fold, mean, std": fold(1),
            one: whole(1),
            "scipy: spectrum of one channel": lambda: scipy.fft.rfft(channels[0], length),
            "numpy: spectrum of one channel": lambda: np.fft.rfft(channels[0], length),
        },
        seconds=2.0, least=5,
    )  # fmt: skip
    if not clock.busy:
        found |= clock.together({f"{one}, 2 threads": whole(2)}, least=5)
    found |= clock.together({slow: lambda: numpy_fold(t, starts, channels)}, seconds=0.0, least=1)
    unit_s = found["one pass over the memory"].median_s
    passes = {name: timing.median_s / unit_s for name, timing in found.items()}
    at, phase = boundaries(channels[0])
    off = (phase - np.interp(at, t, angle))[64:-64]
    rows, lines, hour_s = growth_of_processing(clock)
    return Section(
        title="Period and fold",
        words=[
            f"{len(t) / RATE_HZ / 60:g} min of 4 channels at 10 kHz ({channels.nbytes / 1e6:.0f} MB), {len(turns)} "
            f"strokes whose rate drifts. One pass is the sum of all values: {time_words(unit_s)}. The spectrum of "
            "numpy or scipy gives a mean rate only; the phase here gives the period and the start of every stroke, "
            f"{1e3 * np.std(off):.1f} mrad off.",
        ],
        tables=[
            Table(
                head=("step", "passes over the memory", "time"),
                rows=[(name, f"{passes[name]:.2f}", str(timing)) for name, timing in found.items()],
            ),
            Table(
                title="Cost of processing",
                head=("trial", "`process_recording`", "a million samples"),
                rows=rows,
            ),
        ],
        goals=[
            Goal(what="period + fold, passes, 1 thread", value=passes[one], bound=5.0),
            Goal(what="fold + mean + std ahead of numpy", value=passes[slow] / passes["sawbench: fold, mean, std"],
                 bound=10.0, at_least=True),
            Goal(what="fold + mean + std, passes, 1 thread", value=passes["sawbench: fold, mean, std"], bound=3.0),
        ],
        plots=[
            Plot(name="fold", title="Period and fold: passes over the memory", x_label="passes", bars=passes),
            Plot(name="processing", title="process_recording over the amount of data",
                 x_label="million samples", y_label="time / s", lines=lines),
        ],
        numbers={"process_s_an_hour_of_4_channels": hour_s},
    )  # fmt: skip


def growth_of_processing(clock: Clock):
    """Rows and curves of the cost over length, channels and rate, and the seconds for an hour of four channels."""
    base = {"seconds": 60.0, "rate_hz": RATE_HZ, "n_channels": 4}
    cases = {
        "seconds": (6.0, 20.0, 60.0, *(() if clock.quick else (200.0,))),
        "n_channels": (1, 2, 4, 8),
        "rate_hz": (1000.0, 3000.0, 10_000.0, *(() if clock.quick else (30_000.0,))),
    }
    known: dict[tuple, tuple[int, Timing]] = {}
    rows, lines = [], {}
    for name, values in cases.items():
        line = []
        for value in values:
            chosen = base | {name: value}
            key = tuple(chosen.values())
            if key not in known:
                recording = recording_of(**chosen)
                timing = clock(lambda: process_recording(recording, BenchConfig()), seconds=0.3, least=2)  # noqa: B023
                n = sum(len(signal.values) for signal in recording.signals.values())
                known[key] = n, timing
                words = f"{chosen['seconds']:g} s, {chosen['n_channels']} channels, {chosen['rate_hz'] / 1e3:g} kHz"
                rows.append((words, str(timing), time_words(1e6 * timing.median_s / n)))
            n, timing = known[key]
            line.append((n / 1e6, timing.median_s))
        label = {"seconds": "longer", "n_channels": "more channels", "rate_hz": "faster sampling"}[name]
        lines[label] = tuple(map(list, zip(*line, strict=True)))
    return rows, lines, 60.0 * known[tuple(base.values())][1].median_s
