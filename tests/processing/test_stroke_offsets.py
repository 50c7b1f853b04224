"""The offset between instruments from the strokes: the current of a motor integrated here, with a known shift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.processed import StrokeOffset
from sawbench.bench.recording import Alignment, Recording, Signal, Trial
from sawbench.processing.process import process_recording
from sawbench.processing.stroke_offsets import changed_between

pytestmark = pytest.mark.unit

RATE_HZ, SECONDS, STROKE_HZ = 5000.0, 4.0, 14.0
RESISTANCE, INDUCTANCE, BACK_EMF, GEAR = 0.18, 3.2e-3, 7.4e-3, 9.5
STATED = Alignment(std_s=1e-4, latency_s=1e-3)


def plant(**changed):
    table = {
        "resistance_ohm": {"nominal": RESISTANCE, "rel_std": 0.05},
        "inductance_h": {"nominal": INDUCTANCE, "rel_std": 0.1},
        "back_emf_constant_v_s_per_rad": {"nominal": BACK_EMF, "rel_std": 0.02},
        "torque_constant_n_m_per_a": {"nominal": 0.0056, "rel_std": 0.03},
        "rotor_inertia_kg_m2": {"nominal": 2.4e-05, "rel_std": 0.05},
        "yoke_inertia_kg_m2": {"nominal": 2.4e-05, "rel_std": 0.05},
        "reciprocating_mass_kg": {"nominal": 0.24, "rel_std": 0.02},
        "crank_radius_m": {"nominal": 0.01, "rel_std": 0.003},
        "motor_damping_n_m_s_per_rad": {"nominal": 3e-06, "rel_std": 0.3},
        "gear_ratio": GEAR,
    }
    return BenchConfig.model_validate({"plant": table | changed})


def speed_rad_s(t):
    """A stroke with its first two harmonics, 6 and 2 % of the speed."""
    w = 2 * np.pi * STROKE_HZ
    return w * (1 + 0.06 * np.sin(w * t + 0.4) + 0.02 * np.cos(2 * w * t - 1.0))


def motion(n_fine=20):
    """Crank angle and current on a fine grid, the circuit stepped by the trapezium rule from its periodic state."""
    t = np.arange(-1.0, SECONDS + 1.0, 1 / (RATE_HZ * n_fine))
    step_s = t[1] - t[0]
    speed = speed_rad_s(t)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step_s)))
    volts = 13.0 - BACK_EMF * GEAR * speed
    grow, decay = step_s / (2 * INDUCTANCE), RESISTANCE * step_s / (2 * INDUCTANCE)
    current = np.empty_like(t)
    current[0] = volts.mean() / RESISTANCE
    drive = grow * (volts[1:] + volts[:-1])
    for k, driven in enumerate(drive):
        current[k + 1] = ((1 - decay) * current[k] + driven) / (1 + decay)
    return t, angle, current


FINE = motion()


def recording(shift_s=0.0, drift=0.0, *, device="power", alignment=STATED, scatter=1.0, force_device="power"):
    """`drift`: how much slower the clock of the current runs, so that its stamps fall behind."""
    rng = np.random.default_rng(5)
    fine_s, angle, current = FINE
    t = np.arange(0.0, SECONDS, 1 / RATE_HZ)
    crank = np.interp(t, fine_s, angle)
    values = {
        "displacement_mm": 10 * (1 - np.cos(crank)) + 0.003 * scatter * rng.standard_normal(len(t)),
        "force_n": 150 * np.maximum(-np.sin(crank), 0.0) + 0.3 * scatter * rng.standard_normal(len(t)),
        "motor_current_a": np.interp(t, fine_s, current) + 0.03 * scatter * rng.standard_normal(len(t)),
    }
    times = {"displacement_mm": t, "force_n": t, "motor_current_a": t + shift_s + drift * t}
    devices = {"displacement_mm": "cell", "force_n": force_device, "motor_current_a": device}
    units = {"displacement_mm": "mm", "force_n": "N", "motor_current_a": "A"}
    signals = {
        name: Signal(channel=name, unit=units[name], time_s=times[name], values=values[name], device=devices[name],
                     alignment=alignment)
        for name in values
    }  # fmt: skip
    return Recording(trial=Trial(trial_id="t", material="oak", duty=0.7), signals=signals)


def offsets(config=None, **options):
    found = process_recording(recording(**options), config or plant())
    return {offset.channel: offset for offset in found.offsets}, found.warnings


@pytest.mark.parametrize("shift_ms", [-6.0, -0.4, 0.0, 1.0, 4.0])
def test_a_shift_of_the_current_is_found(shift_ms):
    found, _ = offsets(shift_s=shift_ms / 1e3)
    current = found["motor_current_a"]
    # The circuit and its constants are exact here: only noise is left.
    assert current.offset_s == pytest.approx(shift_ms / 1e3, abs=1.5e-4)
    # 5 and 10 % of R and L at 1.56 = wL / R are 0.05 rad, 0.58 ms, less what the second harmonic tells.
    assert 1e-4 < current.offset_std_s < 6e-4
    assert current.repeat_std_s < 0.5 * current.offset_std_s


def test_constants_that_are_off_within_what_is_stated_keep_the_offset_within_its_uncertainty():
    for change in (0.9, 1.1):
        config = plant(inductance_h={"nominal": change * INDUCTANCE, "rel_std": 0.1})
        current = offsets(config)[0]["motor_current_a"]
        assert abs(current.offset_s) < 2.5 * current.offset_std_s


def test_an_offset_beyond_the_stated_alignment_is_a_warning():
    quiet, said = offsets(shift_s=0.0015)
    assert not quiet["motor_current_a"].problem and not any("against the strokes" in text for text in said)
    late, said = offsets(shift_s=0.006)
    assert "ms too late against the strokes" in late["motor_current_a"].problem
    assert late["motor_current_a"].problem in said
    unstated, said = offsets(shift_s=0.006, alignment=None)
    assert unstated["motor_current_a"].offset_s == pytest.approx(0.006, abs=2e-4)
    assert not unstated["motor_current_a"].problem


def test_a_clock_that_drifts_within_the_trial_is_found_and_said():
    found, said = offsets(drift=1e-3)
    current = found["motor_current_a"]
    # From the first to the last whole stroke, which lie a little inside of the 4 s.
    assert current.change_s == pytest.approx(3.8e-3, abs=4e-4)
    assert current.change_std_s < 3e-4
    assert any("from the first to the last" in text for text in said)
    assert abs(found["force_n"].change_s) < 1e-4 and not found["force_n"].problem


def test_what_the_trial_cannot_tell_is_said():
    found, _ = offsets(BenchConfig())
    assert found["motor_current_a"].offset_s is None and "[plant]" in found["motor_current_a"].reason
    assert found["force_n"].offset_s is None and "only a change" in found["force_n"].reason


def test_one_instrument_has_one_clock():
    found, _ = offsets(device="cell", force_device="cell")
    assert not found


def test_a_trial_apart_from_the_others_is_named():
    def one(offset_s):
        made = StrokeOffset(channel="motor_current_a", device="p", against="c", offset_s=offset_s, offset_std_s=5e-4)
        return [replace(made, repeat_std_s=5e-5)]

    said = changed_between([("a", one(3e-4)), ("b", one(2e-4)), ("c", one(2.9e-3)), ("d", one(2.5e-4))])
    assert len(said) == 1 and said[0].startswith("c: motor_current_a comes +2.6 ± 0.1 ms later")
    assert not changed_between([("a", one(3e-4)), ("b", one(1.2e-3))])
