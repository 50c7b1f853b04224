"""`process_recording` on whole trials: status, phases, what is there and what is not."""

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig, parse_config
from sawbench.bench.recording import Gap, Recording, Signal, Trial
from sawbench.processing.process import process_recording

pytestmark = pytest.mark.unit

UNITS = {
    "force_n": "N",
    "displacement_mm": "mm",
    "motor_current_a": "A",
    "battery_voltage_v": "V",
    "battery_current_a": "A",
}
RATE_HZ = 5000.0


def trial_angle(seconds=3.0, rest_s=0.3, rise_s=0.08, rate_hz=14.0, start_rad=0.7):
    """Crank angle of a rest, an exponential start, and steady running with 3 % ripple."""
    t = np.arange(0, seconds, 1 / RATE_HZ)
    run = np.maximum(t - rest_s, 0)
    turns = rate_hz * (run - rise_s * (1 - np.exp(-run / rise_s)))
    return t, start_rad + 2 * np.pi * turns + 0.03 * np.sin(2 * np.pi * turns)


def make(seed=0, **options):
    t, angle = trial_angle(**options)
    rng = np.random.default_rng(seed)
    slow = slice(None, None, 5)
    cuts = np.maximum(-np.sin(angle), 0)
    running = 1 - np.exp(-np.maximum(t - 0.3, 0) / 0.08)
    current = running * (9 + 2 * cuts)
    return {
        "displacement_mm": (t, 10 * (1 - np.cos(angle)) + 0.01 * rng.standard_normal(len(t))),
        "force_n": (t, 240 * running * cuts + 0.5 * rng.standard_normal(len(t))),
        "motor_current_a": (t[slow], (current + 0.05 * rng.standard_normal(len(t)))[slow]),
        "battery_voltage_v": (t[slow], (18 - 0.01 * current)[slow]),
        "battery_current_a": (t[slow], (0.4375 * current)[slow]),
    }


def process(channels, config=None, **trial):
    signals = {name: Signal(channel=name, unit=UNITS[name], time_s=t, values=v) for name, (t, v) in channels.items()}
    trial = Trial(trial_id="t", duty=0.4375, **trial)
    return process_recording(
        Recording(trial=trial, signals=signals, path="x.mcap"), config or BenchConfig(), source_sha256="ab"
    )


def test_a_whole_trial():
    result = process(make())
    assert result.status == "cutting"
    assert result.period.rate_hz == pytest.approx(14.0, rel=2e-3)
    assert abs(result.period.rate_hz - 14.0) < 4 * result.period.period_std_s * 14.0**2 + 0.02
    assert [phase.kind for phase in result.phases] == ["rest", "spin_up", "running"]
    assert set(result.folded) == set(UNITS)
    assert len(result.folded["force_n"].mean) == 256
    assert result.peak_force_n == pytest.approx(240, rel=2e-3)
    assert 0 < result.peak_force_std_n < 2
    assert result.mean_values["force_n"] == pytest.approx(240 / np.pi, rel=0.03)
    assert result.rms_values["motor_current_a"] > result.mean_values["motor_current_a"]
    assert result.removed.half == "zero_to_pi"
    assert result.removed.share_of_impulse < 0.01
    assert result.angle.is_absolute
    assert (result.source_path, result.source_sha256) == ("x.mcap", "ab")
    assert result.warnings == ("the configuration has no [plant]: the mechanism is taken as a Scotch yoke",)


def test_the_folded_current_keeps_its_place_at_another_rate():
    result = process(make())
    angle = result.folded["motor_current_a"].angle_rad
    expected = 9 + 2 * np.maximum(-np.sin(angle), 0)
    assert result.folded["motor_current_a"].mean == pytest.approx(expected, abs=0.06)


def test_the_wrong_cutting_half_is_said():
    swapped = process(make(), parse_config("[cutting]\ncutting_half = 'zero_to_pi'").config)
    assert swapped.removed.looks_swapped
    assert any("cutting_half" in warning for warning in swapped.warnings)


@pytest.mark.parametrize(("level_n", "rubbing_n"), [(60.0, 0.0), (-60.0, 0.0), (0.0, 60.0)])
def test_a_load_cell_that_was_not_tared_is_said_and_a_blade_that_rubs_is_not(level_n, rubbing_n):
    channels = make()
    t, force_n = channels["force_n"]
    _, angle = trial_angle()
    channels["force_n"] = (t, force_n + level_n + rubbing_n * np.sin(2.0 * angle) * (np.sin(angle) > 0.0))
    said = [warning for warning in process(channels).warnings if "tared" in warning]
    assert len(said) == bool(level_n)
    if level_n:
        assert float(said[0].split(" N while")[0].split()[-1]) == pytest.approx(level_n, rel=0.02)


@pytest.mark.parametrize("material", ["none", "oak"])
def test_no_cutting(material):
    channels = make()
    t = channels["force_n"][0]
    channels["force_n"] = (t, 3 + 0.5 * np.random.default_rng(1).standard_normal(len(t)))
    result = process(channels, material=material)
    assert result.status == "no_cutting"
    assert result.cutting_force is None
    assert result.peak_force_n is None
    assert result.folded["force_n"].n_cycles > 20
    assert result.period.confidence == "high"


def test_an_idle_trial_with_force_is_questioned():
    result = process(make(), material="none")
    assert result.status == "no_cutting"
    assert any("idle run" in warning for warning in result.warnings)


def test_stalls():
    channels = make()
    t, y = channels["displacement_mm"]
    slow = channels["motor_current_a"][0]
    stuck = {"displacement_mm": (t, 5 + 0.01 * np.random.default_rng(2).standard_normal(len(t)))}
    from_start = process({**stuck, "motor_current_a": (slow, np.full(len(slow), 40.0) + 0.1 * np.sin(slow))})
    assert from_start.status == "stalled"
    assert from_start.period is None
    assert process({**stuck, "motor_current_a": (slow, 0.01 * np.sin(slow))}).status == "no_stroke"
    halt = np.searchsorted(t, 2.0)
    y = np.where(t < 2.0, y, y[halt] + 0.01 * np.random.default_rng(3).standard_normal(len(t)))
    current = np.where(slow < 2.0, channels["motor_current_a"][1], 44.0)
    later = process({**channels, "displacement_mm": (t, y), "motor_current_a": (slow, current)})
    assert later.status == "stalled"
    assert later.phases[-1].kind == "stall"
    assert later.period.n_cycles > 15
    assert later.mean_values["motor_current_a"] < 12


@pytest.mark.parametrize("keep", list(UNITS))
def test_one_channel_only(keep):
    channels = make()
    result = process({keep: channels[keep]})
    if result.period is not None:
        assert result.period.channel == keep
        assert result.period.confidence == ("high" if keep == "displacement_mm" else "low")
        assert keep in result.folded
    assert result.angle is None or result.angle.is_absolute == (keep == "displacement_mm")


def test_nothing_and_next_to_nothing():
    assert process({}).status == "no_stroke"
    for n in (1, 2, 5, 20, 200):
        cut = {name: (t[:n], v[:n]) for name, (t, v) in make().items()}
        result = process(cut)
        assert result.status == "no_stroke"
        assert result.warnings


def test_a_dead_displacement_sensor_gives_way_to_the_force():
    channels = make()
    t = channels["displacement_mm"][0]
    result = process({**channels, "displacement_mm": (t, np.full(len(t), 3.0))})
    assert result.period.channel == "force_n"
    assert result.period.period_s == pytest.approx(1 / 14, rel=3e-3)
    assert any("constant" in warning for warning in result.warnings)


def test_gaps_take_their_cycles_away_and_nothing_else():
    channels = make()
    whole = process(channels)
    t, force = channels["force_n"]
    seen = (t < 1.5) | (t > 1.7)
    gappy = process({**channels, "force_n": (t[seen], force[seen])})
    assert gappy.folded["displacement_mm"].n_cycles == whole.folded["displacement_mm"].n_cycles
    missing = whole.folded["force_n"].n_cycles - gappy.folded["force_n"].n_cycles
    assert missing in (3, 4)
    assert gappy.peak_force_n == pytest.approx(whole.peak_force_n, rel=1e-3)
    assert any("missing" in warning for warning in gappy.warnings)


def test_units_are_questioned_in_the_quality():
    plant = parse_config(
        "[plant]\nresistance_ohm = 0.176\ninductance_h = 0.00321\nback_emf_constant_v_s_per_rad = 0.007383\n"
        "torque_constant_n_m_per_a = 0.005632\nrotor_inertia_kg_m2 = 2.4e-5\nyoke_inertia_kg_m2 = 2.38e-5\n"
        "reciprocating_mass_kg = 0.239\ncrank_radius_m = { nominal = 0.01, rel_std = 0.003 }\n"
        "motor_damping_n_m_s_per_rad = 3.4e-6\ngear_ratio = 9.333"
    ).config
    channels = make()
    t, y = channels["displacement_mm"]
    wrong = process({**channels, "displacement_mm": (t, 1e-3 * y)}, plant)
    assert any("probably in m" in warning for warning in wrong.warnings)
    assert wrong.period.rate_hz == pytest.approx(14.0, rel=2e-3)
    assert process(channels, plant).warnings == ()


@pytest.mark.parametrize("sample_rate_hz", [31.0, 40.0, 100.0])
def test_too_few_samples_a_stroke_are_told_from_no_stroke(sample_rate_hz):
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 6.0, 1.0 / sample_rate_hz)
    turning_mm = 10.0 * (1.0 - np.cos(2.0 * np.pi * 0.37 * sample_rate_hz * time_s))
    at_rest_mm = 0.01 * rng.standard_normal(len(time_s))
    (said,) = process({"displacement_mm": (time_s, turning_mm)}).warnings
    assert f"{sample_rate_hz:g} Hz are too few samples a stroke" in said
    assert "too few samples" not in " ".join(process({"displacement_mm": (time_s, at_rest_mm)}).warnings)


def test_a_clipped_displacement_costs_confidence():
    channels = make()
    t, y = channels["displacement_mm"]
    result = process({**channels, "displacement_mm": (t, np.clip(y, 2.0, 18.0))})
    assert result.period.confidence == "moderate"
    assert result.period.rate_hz == pytest.approx(14.0, rel=5e-3)
    assert any("clipped" in warning for warning in result.warnings)


def test_what_is_missing_at_the_end_counts_as_lost():
    """The force ends after half of the trial; no step of its time shows that, its gap does."""
    channels = make()
    t, force = channels["force_n"]
    half = len(t) // 2
    signals = {
        name: Signal(channel=name, unit=UNITS[name], time_s=when, values=values)
        for name, (when, values) in channels.items()
    }
    gap = Gap(start_s=t[half - 1], end_s=t[-1], n_missing=len(t) - half, reason="link lost")
    signals["force_n"] = Signal(channel="force_n", unit="N", time_s=t[:half], values=force[:half], gaps=(gap,))
    found = process_recording(Recording(trial=Trial(trial_id="t", duty=0.4375), signals=signals), BenchConfig())
    assert found.losses == (f"force_n: {len(t) - half} of {len(t)} samples are missing",)


def test_what_a_sensor_reads_is_taken_back_and_the_recording_keeps_it():
    true = make()
    read = dict(true)
    read["force_n"] = (true["force_n"][0], 1.02 * true["force_n"][1] + 3.0)
    read["motor_current_a"] = (true["motor_current_a"][0], 0.97 * true["motor_current_a"][1] - 0.2)
    config = parse_config(
        "[sensors]\nforce_n = { gain = 1.02, offset = 3.0 }\nmotor_current_a = { gain = 0.97, offset = -0.2 }\n",
        where="sensors.toml",
    ).config
    ours, theirs = process(read, config), process(true)
    for name in ("force_n", "motor_current_a", "battery_voltage_v"):
        np.testing.assert_allclose(ours.channels[name].values, theirs.channels[name].values, atol=1e-9)
    assert ours.peak_force_n == pytest.approx(theirs.peak_force_n, rel=1e-9)
    assert process(read).peak_force_n == pytest.approx(1.02 * theirs.peak_force_n + 3.0)
