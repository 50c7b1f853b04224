"""What is beyond the catalogue has a form of its own, which no effect of the catalogue may take for itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.beyond.bent_displacement import BENT_DISPLACEMENT, straightened
from sawbench.diagnosis.inference.beyond.drive import SOFTENING_FRICTION, WARMING_FRICTION
from sawbench.diagnosis.inference.beyond.table import BEYOND_CATALOGUE
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.residuals import residuals

from tests.rigs.drawn_states import BASELINE, N_POINTS, running, start_up

pytestmark = pytest.mark.contract


@pytest.mark.parametrize("effect", BEYOND_CATALOGUE, ids=lambda e: e.name)
def test_no_name_of_the_catalogue_is_taken(effect):
    assert effect.name not in EFFECT_BY_NAME


def test_a_bent_sensor_reads_the_same_wave_in_air_and_under_load():
    """Play moves other columns in air than under load; a bent sensor moves the same ones."""
    in_air, under_load = running(is_idle=True), running()
    for effect, is_same in ((BENT_DISPLACEMENT, True), (EFFECT_BY_NAME["yoke_backlash"], False)):
        moved = [
            [bool(part) and np.abs(part["electrical"]).max() > 0 for part in effect.signatures(BASELINE, state)]
            for state in (in_air, under_load)
        ]
        assert any(moved[0]) and any(moved[1])
        assert (moved[0] == moved[1]) is is_same


# Bends over the displacement from its middle, -1 to 1, that vanish at both ends, and their slopes.
BENDS = {
    "bow": (lambda u: 1.0 - u**2, lambda u: -2.0 * u),
    "s": (lambda u: u - u**3, lambda u: 1.0 - 3.0 * u**2),
}


def read_bent(state, bend, slope, size):
    """A steady crank as a sensor reads it that adds `size * bend`, on an even grid of the true angle."""
    angle = (np.arange(N_POINTS) + 0.5) * 2.0 * np.pi / N_POINTS
    u = np.cos(angle)
    read = np.arccos(np.clip(u + size * bend(u), -1.0, 1.0))
    read = np.where(angle < np.pi, read, 2.0 * np.pi - read)
    rate = np.sin(angle) * (1.0 + size * slope(u)) / np.sin(read)
    faster = np.fft.irfft(1j * np.arange(N_POINTS // 2 + 1) * np.fft.rfft(rate), N_POINTS)
    speed_rad_s = 80.0
    wide = np.ones((len(state.angle_rad), 1))
    return angle, replace(
        state,
        angle_rad=wide * read,
        speed_rad_s=wide * speed_rad_s * rate,
        acceleration_rad_s2=wide * speed_rad_s**2 * faster,
    )


@pytest.mark.parametrize("name", BENDS)
def test_any_bend_of_the_displacement_is_undone_by_sines_of_the_read_angle(name):
    """Geometry alone: the sines are fitted to how far the angle is off, once, and speed and acceleration follow."""
    angle, state = read_bent(running(is_idle=True), *BENDS[name], 0.05)
    read = state.angle_rad[0]
    sines = np.sin(np.outer(read, np.arange(1, 5))) / np.arange(1, 5) ** 2
    off = read - angle
    assert np.abs(off).max() > 0.02
    coefficients = np.linalg.lstsq(sines, off, rcond=None)[0]
    straight = straightened(state, coefficients)
    assert np.abs(straight.angle_rad - angle).max() < 0.01 * np.abs(off).max()
    assert np.abs(straight.speed_rad_s - 80.0).max() < 0.01 * np.ptp(state.speed_rad_s)
    assert np.abs(straight.acceleration_rad_s2).max() < 0.03 * np.abs(state.acceleration_rad_s2).max()


@pytest.mark.parametrize("make", [running, start_up])
def test_the_signature_of_a_small_bend_is_what_straightening_it_takes_away(make):
    state, bend = make(), np.array([0.3e-3, -1e-3, 0.5e-3, 2e-3])
    columns = BENT_DISPLACEMENT.signatures(BASELINE, state)
    before, after = residuals(BASELINE, state), residuals(BASELINE, straightened(state, bend))
    for equation in ("electrical", "mechanical"):
        taken = before[equation] - after[equation]
        expected = sum(c * column[equation] for c, column in zip(bend, columns, strict=True))
        assert np.abs(taken).max() > 0.0
        assert expected == pytest.approx(taken, abs=0.02 * np.abs(taken).max())
    # The force is read right: the cut is missed by as much as the straight motion asks for more.
    missed = BASELINE.expected_force(straightened(state, bend)) - BASELINE.expected_force(state)
    expected = sum(c * column["cutting"] for c, column in zip(bend, columns, strict=True))
    assert np.abs(missed).max() > 0.0
    assert expected == pytest.approx(missed, abs=0.02 * np.abs(missed).max())


def test_a_bent_sensor_says_nothing_without_an_angle():
    state = running(angle_rad=np.full((3, N_POINTS), np.nan))
    assert not any(BENT_DISPLACEMENT.signatures(BASELINE, state))


@pytest.mark.parametrize("shape", WARMING_FRICTION.shapes)
def test_friction_falls_from_the_start_of_the_trial(shape):
    state = running(time_s=np.array([[1.0], [2.0], [40.0]]))
    (found,) = WARMING_FRICTION.signatures(BASELINE, state, shape)
    wave = found["mechanical"].mean(axis=1)
    expected = np.exp(-state.time_s[:, 0] / shape["time_constant_s"])
    if shape["viscous"]:
        expected = expected * BASELINE.gear * state.speed_rad_s.mean(axis=1) / 1000.0
    assert wave == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", SOFTENING_FRICTION.shapes)
def test_friction_falls_with_what_the_machine_has_run_in_the_session(shape):
    """Cold, after running at the usual speed for one time constant, and after a rest as long as that."""
    usual_rad_s = BASELINE.load.motor_speed_rad_s / BASELINE.gear
    ran = 1.0 - np.exp(-1.0)
    squares = usual_rad_s**2 * np.array([[0.0], [ran], [ran * np.exp(-1.0)]])
    state = running()
    state = replace(state, slow=dict.fromkeys(state.slow, squares))
    (found,) = SOFTENING_FRICTION.signatures(BASELINE, state, shape)
    assert set(found) == {"mechanical"}
    expected = np.exp(-shape["softens"] * np.array([0.0, ran, ran * np.exp(-1.0)]))
    assert found["mechanical"] == pytest.approx(np.broadcast_to(expected[:, None], found["mechanical"].shape), rel=1e-6)


@pytest.mark.parametrize("shape", WARMING_FRICTION.shapes)
def test_viscous_friction_that_hardly_falls_within_a_trial_is_a_wrong_number_of_the_model(shape):
    """A wrong damping or torque constant is the same from the first stroke to the last; dry friction is an effect."""
    state = running(time_s=shape["time_constant_s"] * np.array([[0.1], [0.4], [0.9]]))
    (found,) = WARMING_FRICTION.signatures(BASELINE, state, shape)
    assert set(found) == (set() if shape["viscous"] else {"mechanical"})
