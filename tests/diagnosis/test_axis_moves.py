"""An axis whose position is prescribed: the force of every instant follows from Newton's law alone."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.diagnosis.plants.axis_motion import find_cycles
from sawbench.diagnosis.plants.linear_axis import reduce_axis
from scipy.ndimage import gaussian_filter1d

MASS_KG, DAMPING, FORCE_A_CURRENT, DRY_N = 30.0, 150.0, 60.0, 12.0
FINE_HZ, RATE_HZ, TRAVEL_M, ACCELERATION = 8000, 1000, 0.25, 2.0
CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 31.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 120.0, rel_std = 0.2 }
force_constant_n_per_a = { nominal = 60.5, rel_std = 0.02 }
"""


def set_points(rng, top_m_s, seconds):
    """Velocity of trapezoidal moves to random set points, with rests between; the last one is cut off."""
    n = int(seconds * FINE_HZ)
    velocity, at_m, begin = np.zeros(n), 0.0, int(0.3 * FINE_HZ)
    while begin < n:
        to_m = rng.uniform(0.0, TRAVEL_M)
        way = abs(to_m - at_m)
        ramp_s = min(top_m_s * rng.uniform(0.3, 1.0) / ACCELERATION, np.sqrt(way / ACCELERATION))
        top = ACCELERATION * ramp_s
        since = np.arange(min(int((way / top + ramp_s) * FINE_HZ), n - begin)) / FINE_HZ
        ramps = np.minimum(since, way / top + ramp_s - since) / ramp_s
        velocity[begin : begin + len(since)] = np.sign(to_m - at_m) * top * np.clip(ramps, 0.0, 1.0)
        at_m, begin = to_m, begin + len(since) + int(rng.uniform(0.05, 0.4) * FINE_HZ)
    return velocity


def back_and_forth(_, top_m_s, seconds):
    ramp_s = top_m_s / ACCELERATION
    move_s = TRAVEL_M / top_m_s + ramp_s
    since = (np.arange(int(seconds * FINE_HZ)) / FINE_HZ) % (2.0 * move_s + 0.3)

    def move(begun):
        return np.clip(np.minimum(begun, move_s - begun) / ramp_s, 0.0, 1.0)

    return top_m_s * (move(since) - move(since - move_s - 0.15))


def recording(name, velocity, rng, *, dry_n=DRY_N, constant_n=0.0, material="none"):
    velocity = gaussian_filter1d(velocity, 0.01 * FINE_HZ)
    force_n = MASS_KG * np.gradient(velocity, 1.0 / FINE_HZ) + DAMPING * velocity + constant_n
    force_n += dry_n * np.tanh(velocity / 5e-4)
    every = slice(None, None, FINE_HZ // RATE_HZ)
    position_m, force_n = np.cumsum(velocity)[every] / FINE_HZ, force_n[every]
    time_s = np.arange(len(force_n)) / RATE_HZ
    values = {
        "displacement_mm": ("mm", 1e3 * position_m + 2e-3 * rng.normal(size=len(time_s))),
        "motor_current_a": ("A", force_n / FORCE_A_CURRENT + 0.02 * rng.normal(size=len(time_s))),
    }
    return Recording(
        trial=Trial(trial_id=name, material=material),
        signals={k: Signal(channel=k, unit=u, time_s=time_s, values=v) for k, (u, v) in values.items()},
    )


def campaign(motion, seed, **more):
    rng = np.random.default_rng(seed)
    tops = {0.1: 36.0, 0.2: 21.0, 0.3: 16.0}
    return [recording(f"{top} m/s", motion(rng, top, seconds), rng, **more) for top, seconds in tops.items()]


@pytest.mark.parametrize(("seed", "trial"), [(22, 0), (30, 1)])
def test_moves_of_which_no_two_are_alike_have_no_cycles(seed, trial):
    displacement = campaign(set_points, seed)[trial].signals["displacement_mm"]
    cycles, reason = find_cycles(displacement)
    assert cycles is None
    assert "cycles" in reason


def test_a_record_that_is_cut_off_in_a_move_is_balanced_to_its_end():
    rng = np.random.default_rng(0)
    velocity = set_points(rng, 0.3, 8.0)
    braking = np.flatnonzero(np.diff(np.abs(velocity)) < 0.0)
    velocity = velocity[: braking[-1] - int(0.02 * FINE_HZ)]
    found = reduce_axis([recording("cut off", velocity, rng, dry_n=0.0)], parse_config(CONFIG))
    for state in found.states:
        scaled = state.drive_n * FORCE_A_CURRENT / 60.5
        left_n = scaled - MASS_KG * state.acceleration_m_s2 - DAMPING * state.velocity_m_s
        # The braking force is 60 N; the noise of the current is 1.2 N a sample.
        assert np.abs(left_n).max() < 6.0


def test_a_rest_between_moves_is_no_evidence_of_friction():
    rng = np.random.default_rng(1)
    moves = set_points(rng, 0.2, 12.0)
    rest = np.zeros(8 * FINE_HZ)
    found = reduce_axis([recording("rest", np.concatenate([moves, rest]), rng)], parse_config(CONFIG))
    assert len(found.states) > 2
    for state in found.states:
        # The noise of a displacement at rest has a velocity of either sign.
        assert np.abs(state.velocity_m_s).max() > 0.02


@pytest.mark.parametrize("motion", [back_and_forth, set_points])
def test_friction_beside_a_weight_is_named(motion):
    report = diagnose(campaign(motion, 3, constant_n=294.0, material="weight"), parse_config(CONFIG), provenance={})
    first = report["causes"][0]
    assert first["effects"] == ["guide_friction"]
    assert first["probability"] > 0.8
    force = first["parameters"]["force_n"]
    assert abs(force["value"] - DRY_N) < 2.0 * force["std"] < 0.6 * DRY_N
    damping = report["parameter_shifts"]["viscous_damping_n_s_per_m"]
    assert abs(damping["value"] - DAMPING) < 2.0 * damping["std"]
    # At the force constant that is stated.
    assert 0.5 * first["by_direction"]["difference_n"] == pytest.approx(294.0 * 60.5 / FORCE_A_CURRENT, abs=3.0)
    assert any("acts a constant force of" in text for text in report["warnings"])


@pytest.mark.parametrize(("constant_n", "is_significant"), [(0.5, False), (6.0, True)])
def test_the_zero_of_the_drive_is_no_friction_that_differs_by_direction(constant_n, is_significant):
    report = diagnose(campaign(back_and_forth, 2, constant_n=constant_n), parse_config(CONFIG), provenance={})
    by = report["causes"][0]["by_direction"]
    # The zero is known to 2 % of a force of some 60 N; it is added to one direction and taken from the other.
    assert by["difference_n"] == pytest.approx(2.0 * constant_n, abs=0.3)
    assert by["is_significant"] == is_significant
    assert any("F+ ≠ F-" in text for text in report["warnings"]) == is_significant
