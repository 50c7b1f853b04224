"""Intact campaigns recorded through the simulated instruments: none may be accused.

    python -m benchmarks.through_wires OUT [--seeds 801 802 ...] [--length 0.25]

Draws campaigns of the blind check without an effect, plays every trial to the emulated instruments of the default
configuration (`benchmarks.scripted_bench`: bytes, drivers, clocks and MCAP as on the bench, in scripted
time), and diagnoses the recordings. Prints the verdict of each; ends with 1 if an effect is declared.
"""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np
import tomli_w
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import record
from sawbench.acquisition.recording_report import RecordingStart
from sawbench.bench.config import LoadedConfig, load_config
from sawbench.bench.recording import Trial
from sawbench.blindcheck.campaign import measured_trials
from sawbench.blindcheck.drawing import draw_campaign
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.inputs import config_for, default_config_path
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter
from threadpoolctl import threadpool_limits

from benchmarks.playback import Playback
from benchmarks.scripted_bench import ScriptedBench

_STARTED: Final = datetime(2026, 3, 2, 9, tzinfo=UTC)
# Three times as fast as the fastest instrument; quartzes are off by some 10 ppm.
_RATE_HZ, _QUARTZ_PPM = 20_000.0, 30.0
# Clocks settle for some 0.4 s; the tool starts after that, and the recording ends before the readings do.
_TRIGGER_S, _BEFORE_S = 1.0, 0.4


def record_through_wires(path: Path, trial: Trial, played: Playback, loaded: LoadedConfig, seed: int) -> None:
    """Play a trial to the emulated instruments and record what they send."""
    rng = np.random.default_rng([seed, 31])
    errors = {name: float(rng.normal(0.0, _QUARTZ_PPM)) for name in loaded.config.devices}
    bench = ScriptedBench(
        played, loaded.config, clock_error_ppm=errors, trigger_after_s=_TRIGGER_S, seed=int(rng.integers(2**31))
    )

    def open_writer(start: RecordingStart) -> RecordingWriter:
        return RecordingWriter(
            path=path, trial=trial, config_toml="", provenance=start.provenance, started_at=trial.started_at
        )

    with bench:
        devices = build_devices(loaded.config, bench.endpoints, clock=bench.clock)
        record(devices, open_writer, seconds=played.seconds + _BEFORE_S, clock=bench.clock, between_rounds=bench.step)


def record_campaign(seed: int, folder: Path, length: float) -> list[Path]:
    """Record every trial of an intact campaign; returns the files, `bench_config.toml` beside them."""
    draw = draw_campaign(seed, rate_hz=_RATE_HZ, length=length)
    loaded = config_for(None, default_config_path())
    folder.mkdir(parents=True)
    (folder / "bench_config.toml").write_text(tomli_w.dumps(draw.bench.config()), encoding="utf-8")
    paths = []
    for number, (plan, session_s, readings) in enumerate(measured_trials(draw), start=1):
        trial = Trial(
            trial_id=f"trial-{number:02d}", material=plan.workpiece, duty=plan.duty, thickness_mm=plan.thickness_mm,
            feed_mm_s=plan.feed_mm_s, blade="B1", battery=plan.battery, source="simulated bench",
            started_at=_STARTED + timedelta(seconds=round(session_s)),
        )  # fmt: skip
        paths.append(folder / f"{trial.trial_id}.mcap")
        record_through_wires(paths[-1], trial, Playback(readings), loaded, 1000 * seed + number)
    return paths


def main() -> int:
    """Record, diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(801, 811)))
    parser.add_argument("--length", type=float, default=0.25, help="factor on the duration of every trial")
    chosen = parser.parse_args()
    n_accused = 0
    for seed in chosen.seeds:
        folder = chosen.out / f"campaign-{seed}"
        recordings = [read_recording(path) for path in record_campaign(seed, folder, chosen.length)]
        with threadpool_limits(limits=1, user_api="blas"):
            report = diagnose(recordings, load_config(folder / "bench_config.toml"), provenance={})
        n_accused += report["verdict"] in ("effect", "effects")
        print(f"{seed}: {report['verdict']}, no gap {report['probabilities']['no_gap']:.1%}", flush=True)
    print(f"{n_accused} of {len(chosen.seeds)} intact campaigns accused")
    return 1 if n_accused else 0


if __name__ == "__main__":
    sys.exit(main())
