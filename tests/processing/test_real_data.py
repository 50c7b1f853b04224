"""Processing on measurements of other machines whose truth is known; skipped where they are absent."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import AnalysisConfig, BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.process import process_recording

pytestmark = pytest.mark.pipeline

SHARED = os.environ.get("SAWBENCH_SHARED")
ROOT = Path(SHARED) / "data" if SHARED else Path(__file__).parents[2].parent / "shared" / "data"
UNITS = {"force_n": "N", "displacement_mm": "mm", "motor_current_a": "A"}
SLOW = BenchConfig(analysis=AnalysisConfig(min_stroke_rate_hz=0.05, max_stroke_rate_hz=20.0))


def need(name):
    path = ROOT / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    return path


def process(time_s, config=None, **channels):
    signals = {
        name: Signal(channel=name, unit=UNITS[name], time_s=time_s, values=values) for name, values in channels.items()
    }
    return process_recording(Recording(trial=Trial(trial_id="real"), signals=signals), config or BenchConfig())


@pytest.mark.parametrize(("name", "rate_hz"), [("d3_1Hz_30lb_1in", 1.0), ("d2_2Hz_36lb_0.5in", 2.0)])
def test_friction_damper(name, rate_hz):
    table = np.loadtxt(need(f"friction_backlash_damper/{name}.csv"), delimiter=",", skiprows=1)
    result = process(table[:, 0], displacement_mm=table[:, 1], force_n=table[:, 2])
    assert result.period.rate_hz == pytest.approx(rate_hz, rel=2e-3)
    assert result.period.channel == "displacement_mm"
    half_stroke_mm = 25.4 if rate_hz == 1.0 else 12.7
    assert 1e3 * result.angle.radius_m == pytest.approx(half_stroke_mm, rel=0.02)
    alone = process(table[:, 0], force_n=table[:, 2])
    assert alone.period is None or alone.period.confidence != "high"


@pytest.mark.parametrize(("name", "rate_hz"), [("L4_00", 0.1), ("L4_24", 0.3), ("L4_44", 0.5)])
def test_reciprocating_motor_drive(name, rate_hz):
    with gzip.open(need(f"davinci_motor/{name}.TXT.gz"), "rt") as file:
        rows = [line.replace(",", " ").split() for line in file if line[:1].isdigit() or line[:1] == " "]
    table = np.array([row[:10] for row in rows[:-1]], dtype=float)
    time, position = table[:, 0], table[:, 1] * 360 / 8192
    torque, current = 3.9811e-5 * table[:, 2], table[:, 3]
    with_position = process(time, SLOW, displacement_mm=position, force_n=torque, motor_current_a=current)
    assert with_position.period.rate_hz == pytest.approx(rate_hz, rel=3e-3)
    of_torque = process(time, SLOW, force_n=torque).period
    of_current = process(time, SLOW, motor_current_a=current).period
    for found, worst in ((of_torque, "high"), (of_current, "moderate")):
        if found is not None:
            assert found.confidence not in ("high", worst)
            assert found.rate_hz == pytest.approx(rate_hz, rel=0.02)


@pytest.mark.parametrize("spindle", ["Main", "Sub"])
def test_spindle_current_never_gives_a_confident_wrong_rate(spindle):
    from scipy.io import loadmat

    table = loadmat(need("cnc_spindle_current/Data_KS-NPC-6FF_0.mat"))
    speed_rpm = table[f"Speed_{spindle}Spindle"].ravel().astype(float)
    current = table[f"Current_{spindle}Spindle"].ravel().astype(float)
    n_windows = 0
    first = 0
    while first + 4000 < len(speed_rpm):
        window = speed_rpm[first : first + 4000]
        if window.min() < 500 or np.ptp(window) > 0.01 * window.mean():
            first += 500
            continue
        n_windows += 1
        period = process(np.arange(4000) * 1e-3, motor_current_a=current[first : first + 4000]).period
        first += 4000
        if period is None:
            continue
        is_right = abs(period.rate_hz / (window.mean() / 60) - 1) < 0.01
        assert is_right or (period.confidence == "low" and period.rivals and "alone" in period.reason)
    assert n_windows >= 4
