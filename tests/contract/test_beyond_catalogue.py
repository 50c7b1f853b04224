"""What is beyond the catalogue has a form of its own, which no effect of the catalogue may take for itself."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.beyond_catalogue import BENT_DISPLACEMENT, BEYOND_CATALOGUE, WARMING_FRICTION
from diagnosis.effects.catalogue import EFFECT_BY_NAME
from tests.contract.test_effects import BASELINE, running, start_up


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


def test_a_bent_sensor_says_nothing_of_a_start():
    assert not any(BENT_DISPLACEMENT.signatures(BASELINE, start_up()))


@pytest.mark.parametrize("shape", WARMING_FRICTION.shapes)
def test_friction_falls_from_the_start_of_the_trial(shape):
    state = running()
    (found,) = WARMING_FRICTION.signatures(BASELINE, state, shape)
    wave = found["mechanical"].mean(axis=1)
    expected = np.exp(-state.time_s[:, 0] / shape["time_constant_s"])
    if shape["viscous"]:
        expected = expected * BASELINE.gear * state.speed_rad_s.mean(axis=1) / 1000.0
    assert wave == pytest.approx(expected, rel=1e-6)
