"""Stated confidence of the stroke period against how often it is right: `python -m benchmarks.period_confidence`.

Seeded signals of many kinds, written down here as closed forms (nothing of the estimator or of the model), the shipped
recordings without their displacement, and the measurements of other machines in the shared data where they are at hand
(SAWBENCH_SHARED). A rate is right within 1 %. Exit code 1 where a high or moderate confidence is wrong.
"""

from __future__ import annotations

import argparse
import gzip
import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from sawbench.bench.config import AnalysisConfig, BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.units import CHANNELS
from sawbench.inputs import config_for
from sawbench.processing.process import process_recording
from sawbench.storage.reader import read_recording

ROOT = Path(__file__).parents[1]
UNITS = {channel.name: channel.unit for channel in CHANNELS}
SLOW = BenchConfig(analysis=AnalysisConfig(min_stroke_rate_hz=0.05, max_stroke_rate_hz=20.0))
RIGHT = 0.01
CONFIDENCES = ("high", "moderate", "low", "none")
ALONE = Trial(trial_id="case")
Case = tuple[str, float, dict[str, tuple[np.ndarray, np.ndarray]], BenchConfig, Trial]


def phase_of(rng, rate_hz, t):
    """Crank angle over time: a constant rate, a slow wander of some percent, and a ripple within the stroke."""
    wander = rng.uniform(0.0, 0.02) * np.sin(2 * np.pi * rng.uniform(0.05, 0.2) * t + rng.uniform(0, 6.28))
    steady = 2 * np.pi * rate_hz * t + rng.uniform(0, 6.28) + wander
    return steady + rng.uniform(0.0, 0.1) * np.sin(steady + rng.uniform(0, 6.28))


def trapezoid(angle, share):
    """Back and forth with a dwell of `share` of the period at both ends, in -1 to 1."""
    return np.clip(np.arcsin(np.sin(angle)) / (0.5 * np.pi) / (1.0 - 2.0 * share), -1.0, 1.0)


def displacements(rng, a, t, rate_hz):
    """Displacements in mm by kind, of one stroke a turn each."""
    rod = rng.uniform(0.2, 0.4)
    grows = np.minimum(t * rate_hz / rng.uniform(2.0, 5.0), 1.0)
    alternates = 1.0 + rng.uniform(0.02, 0.15) * np.sign(np.sin(0.5 * a))
    return {
        "crank": 10 * (1 - np.cos(a)),
        "slider crank": 10 * (1 - np.cos(a) + (1 - np.sqrt(1 - (rod * np.sin(a)) ** 2)) / rod),
        "trapezoidal moves": 10 * trapezoid(a, rng.uniform(0.05, 0.3)),
        "amplitude that grows at first": 12 * grows * np.sin(a),
        "every second stroke shorter": 10 * alternates * (1 - np.cos(a)),
        "play at the dead centres": 10 * np.clip(np.sin(a), -rng.uniform(0.85, 0.99), 0.97),
        "clipped": np.clip(10 * (1 - np.cos(a)), 2.0, 20 - rng.uniform(1.0, 3.0)),
        "saw-tooth moves": 10 * np.interp(a % (2 * np.pi), [0, rng.uniform(1.0, 5.0), 2 * np.pi], [0, 1, 0]),
    }


def forces(rng, a):
    """Forces in N by kind."""
    cut = np.maximum(-np.sin(a), 0.0)
    teeth = int(rng.integers(3, 13))
    return {
        "cut once a stroke": 100 * cut * (1 + 0.05 * np.sin(a / 7.3)),
        "cut that differs every second stroke": 100 * cut * (1 + rng.uniform(0.1, 0.9) * np.sign(np.sin(0.5 * a))),
        "cut both ways": 100 * np.abs(np.sin(a)) + rng.uniform(0, 3) * np.sin(a),
        "cut both ways, exactly alike": 100 * np.abs(np.sin(a)),
        "only even orders": 30 + 10 * np.cos(2 * a) + 4 * np.cos(4 * a + 1.0) + 2 * np.cos(6 * a),
        "tooth pulses": 20 * np.maximum(np.cos(teeth * a), 0.0) ** 4,
        "friction of both ways": 40 * np.tanh(8 * np.sin(a)),
        "a belt beside the cut": 60 * cut + 80 * np.sin(0.27 * a),
    }


def currents(rng, a):
    """Motor currents in A by kind."""
    return {
        "ripple once a stroke": 10 + 2 * np.sin(a) + 0.7 * np.cos(2 * a),
        "ripple of even orders": 10 + 2 * np.cos(2 * a) + 0.5 * np.cos(4 * a),
        "every second stroke": 10 + 2 * np.maximum(-np.sin(a), 0) * (1 + 0.8 * np.sign(np.sin(0.5 * a))),
        "a belt": 10 + 2 * np.sin(0.27 * a) + 0.5 * np.sin(a),
    }


def synthetic(n_seeds: int) -> Iterator[Case]:
    """Every kind of signal, seeded: rates from 2 to 40 Hz, 3 to 60 strokes, 1 to 10 kHz, 0.1 to 5 % of noise."""
    for seed in range(n_seeds):
        rng = np.random.default_rng([61, seed])
        rate_hz, n_strokes = float(rng.uniform(2.0, 40.0)), float(np.exp(rng.uniform(np.log(3.0), np.log(60.0))))
        t = np.arange(0.0, n_strokes / rate_hz, 1.0 / rng.uniform(60.0 * rate_hz, 10_000.0))
        a = phase_of(rng, rate_hz, t)
        true_hz = rate_hz
        noise = 10.0 ** rng.uniform(-3.0, -1.3)
        for channel, kinds in (
            ("displacement_mm", displacements(rng, a, t, rate_hz)),
            ("force_n", forces(rng, a)),
            ("motor_current_a", currents(rng, a)),
        ):
            for kind, clean in kinds.items():
                of = noise * (0.1 if channel == "displacement_mm" else 1.0)
                noisy = clean + of * np.ptp(clean) * rng.standard_normal(len(t))
                yield f"{channel}: {kind}", true_hz, {channel: (t, noisy)}, BenchConfig(), ALONE


def shipped() -> Iterator[Case]:
    """Force or current of the shipped recordings; their displacement, which is left out, tells the rate."""
    for path in sorted((ROOT / "recordings").glob("*.mcap")):
        recording = read_recording(path)
        signals, config = recording.signals, config_for(recording, None).config
        only = {"displacement_mm": signals["displacement_mm"]}
        truth = process_recording(Recording(trial=Trial(trial_id="truth"), signals=only), BenchConfig()).period
        assert truth is not None
        for name in ("force_n", "motor_current_a"):
            if name in signals:
                chosen = {name: (signals[name].time_s, signals[name].values)}
                yield f"{name}: shipped recordings", truth.rate_hz, chosen, BenchConfig(), ALONE
                yield f"{name}: shipped recordings, [plant] and duty", truth.rate_hz, chosen, config, recording.trial


def of_others() -> Iterator[Case]:
    """Measurements of other machines in the shared data: what is there."""
    data = Path(os.environ.get("SAWBENCH_SHARED", ROOT.parent / "shared")) / "data"
    for path in sorted((data / "friction_backlash_damper").glob("*.csv")):
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        rate_hz = float(path.stem.split("_")[1].removesuffix("Hz"))
        force, position = (table[:, 0], table[:, 2]), (table[:, 0], table[:, 1])
        both = {"displacement_mm": position, "force_n": force}
        yield "displacement_mm: friction dampers", rate_hz, both, BenchConfig(), ALONE
        yield "force_n: friction dampers", rate_hz, {"force_n": force}, BenchConfig(), ALONE
    for name, rate_hz in (("L4_00", 0.1), ("L4_24", 0.3), ("L4_44", 0.5)):
        path = data / "davinci_motor" / f"{name}.TXT.gz"
        if not path.exists():
            continue
        with gzip.open(path, "rt") as file:
            rows = [line.replace(",", " ").split() for line in file if line[:1].isdigit() or line[:1] == " "]
        table = np.array([row[:10] for row in rows[:-1]], dtype=float)
        channels = {"displacement_mm": table[:, 1] * 360 / 8192, "force_n": 3.9811e-5 * table[:, 2],
                    "motor_current_a": table[:, 3]}  # fmt: skip
        for channel, values in channels.items():
            yield f"{channel}: surgical robot's drive", rate_hz, {channel: (table[:, 0], values)}, SLOW, ALONE
    yield from spindles(data / "cnc_spindle_current" / "Data_KS-NPC-6FF_0.mat")


def spindles(path: Path) -> Iterator[Case]:
    """Windows of constant speed of two machine tool spindles; the encoder tells the rate."""
    from scipy.io import loadmat

    if not path.exists():
        return
    table = loadmat(path)
    for name in ("Main", "Sub"):
        speed_rpm, current = (table[f"{what}_{name}Spindle"].ravel().astype(float) for what in ("Speed", "Current"))
        first = 0
        while first + 4000 < len(speed_rpm):
            window = speed_rpm[first : first + 4000]
            if window.min() < 500 or np.ptp(window) > 0.01 * window.mean():
                first += 500
                continue
            chosen = {"motor_current_a": (np.arange(4000) * 1e-3, current[first : first + 4000])}
            yield "motor_current_a: machine tool spindles", float(window.mean()) / 60, chosen, BenchConfig(), ALONE
            first += 4000


def judged(case: Case) -> tuple[str, bool]:
    """Stated confidence, "none" without a period, and whether the rate is right."""
    _, true_hz, channels, config, trial = case
    signals = {n: Signal(channel=n, unit=UNITS[n], time_s=t, values=v) for n, (t, v) in channels.items()}
    period = process_recording(Recording(trial=trial, signals=signals), config).period
    return ("none", False) if period is None else (period.confidence, abs(period.rate_hz / true_hz - 1) < RIGHT)


def main() -> int:
    """Print the table: right of all, by kind and by stated confidence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="signals of each kind")
    options = parser.parse_args()
    found: dict[str, dict[str, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for cases in (synthetic(options.seeds), shipped(), of_others()):
        for case in cases:
            confidence, is_right = judged(case)
            found[case[0]][confidence].append(is_right)
            found["**all**"][confidence].append(is_right)
    print("| signal | " + " | ".join(CONFIDENCES) + " |\n|" + "---|" * (1 + len(CONFIDENCES)))
    for kind, by in found.items():
        cells = [f"{sum(by[c])} of {len(by[c])}" if c != "none" else str(len(by[c])) for c in CONFIDENCES]
        print(f"| {kind} | " + " | ".join(cells) + " |")
    return int(any(not all(found["**all**"][confidence]) for confidence in ("high", "moderate")))


if __name__ == "__main__":
    sys.exit(main())
