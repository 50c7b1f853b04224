"""Each law of a part beyond the catalogue, against the machine that has it or the reading that is off by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.beyond.cutting import PINCHING_KERF, UNEVEN_CUT
from sawbench.diagnosis.inference.beyond.drive import (
    FALLING_FLUX,
    REGULATED_DUTY,
    SPRUNG_PLUNGER,
    YIELDING_TRANSMISSION,
)
from sawbench.diagnosis.inference.beyond.sensing import BENT_READING, CREEPING_ZERO, CROSSTALK
from sawbench.diagnosis.inference.beyond.supply import ANOTHER_DISCHARGE
from sawbench.modeling.load import OAK
from sawbench.modeling.residuals import residuals

from tests.rigs.drawn_states import BASELINE, N_POINTS, RADIUS_M, make_baseline, running, start_up

pytestmark = pytest.mark.contract

PLANT = BASELINE.plant
USUAL_A = OAK.torque_n_m / PLANT.torque_constant_n_m_per_a.nominal
ANGLE_STEP = 2.0 * np.pi / N_POINTS


def rate(state, wave):
    """Time derivative of a periodic wave by central differences over the angle."""
    return state.speed_rad_s * (np.roll(wave, -1, axis=-1) - np.roll(wave, 1, axis=-1)) / (2.0 * ANGLE_STEP)


def missed(found, state, read):
    """By how much a signature misses what a reading that is off changes in the residuals: the largest share of it."""
    before, after = residuals(BASELINE, state), residuals(BASELINE, read)
    taken = {equation: after[equation] - before[equation] for equation in before}
    return max(
        np.abs(found.get(equation, 0.0) - wave).max() / max(np.abs(wave).max(), 1e-12)
        for equation, wave in taken.items()
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_cell_that_bends_reads_more_the_more_it_reads(sign):
    state = running()
    (found,) = BENT_READING.signatures(BASELINE, state, {"channel": 0.0, "sign": sign})
    assert missed(found, state, replace(state, force_n=state.force_n + sign * state.force_n**2 / OAK.force_n)) <= 0.02


@pytest.mark.parametrize("make", [running, start_up])
def test_a_current_sensor_that_saturates_hides_current_from_every_equation(make):
    state = make()
    hidden = -(state.current_a**2) / USUAL_A
    (found,) = BENT_READING.signatures(BASELINE, state, {"channel": 1.0, "sign": -1.0})
    off = rate(state, hidden) if state.kind == "running" else 0.0
    read = replace(state, current_a=state.current_a + hidden, current_rate_a_s=state.current_rate_a_s + off)
    assert missed(found, state, read) <= 0.02


def test_a_force_may_read_the_current_or_the_shaken_mass():
    state = running()
    (current,) = CROSSTALK.signatures(BASELINE, state, {"of": 0.0, "sign": 1.0})
    assert (
        missed(current, state, replace(state, force_n=state.force_n + OAK.force_n * state.current_a / USUAL_A)) <= 0.02
    )
    (mass,) = CROSSTALK.signatures(BASELINE, state, {"of": 1.0, "sign": -1.0})
    blade_m_s2 = rate(state, BASELINE.lever(state) * state.speed_rad_s)
    assert missed(mass, state, replace(state, force_n=state.force_n - blade_m_s2)) <= 0.02


def test_a_load_cell_creeps_after_the_mean_load():
    state = running()
    (found,) = CREEPING_ZERO.signatures(BASELINE, state, {"time_constant_s": 2.0})
    crept = state.force_n.mean(axis=1) * (1.0 - np.exp(-state.time_s[:, 0] / 2.0))
    assert missed(found, state, replace(state, force_n=state.force_n + crept[:, None])) <= 0.02


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_a_flux_that_falls_is_a_motor_of_smaller_constants(power):
    """At one current all the time, the constants are smaller by one share."""
    state = running(current_a=np.full((3, N_POINTS), 1.5 * USUAL_A))
    share = 1e-3 * 1.5**power
    weaker = {
        name: (1.0 - share) * getattr(PLANT, name).nominal
        for name in ("back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a")
    }
    plant = type(PLANT).model_validate({**{name: getattr(value, "nominal", value) for name, value in PLANT}, **weaker})
    true = residuals(replace(BASELINE, plant=plant), state)
    (found,) = FALLING_FLUX.signatures(BASELINE, state, {"power": power})
    for equation, wave in residuals(BASELINE, state).items():
        expected = (wave - true[equation]) / 1e-3
        assert found.get(equation, 0.0) == pytest.approx(expected, abs=1e-6 * max(np.abs(expected).max(), 1e-9))


def test_a_shaft_that_twists_gives_back_what_it_takes_and_a_belt_that_slips_does_not():
    smooth = 210.0 * np.maximum(-np.sin(running().angle_rad), 0.0) ** 3
    state = running(force_n=smooth)
    twist, (slip, square) = (YIELDING_TRANSMISSION.signatures(BASELINE, state, {"slips": s}) for s in (0.0, 1.0))
    period = 1.0 / state.speed_rad_s
    lead_rad = {
        name: (part["electrical"] / PLANT.back_emf_constant_v_s_per_rad.nominal * period).sum(axis=1) * ANGLE_STEP
        for name, part in (("twist", twist[0]), ("slip", slip), ("square", square))
    }
    assert lead_rad["twist"] == pytest.approx(0.0, abs=1e-6)
    assert lead_rad["slip"].min() > 0.1
    # The rotor is accelerated with the speed that is not the crank's.
    extra = twist[0]["electrical"] / PLANT.back_emf_constant_v_s_per_rad.nominal
    torque = PLANT.rotor_inertia_kg_m2.nominal * rate(state, extra)
    torque += PLANT.motor_damping_n_m_s_per_rad.nominal * extra
    assert np.abs(twist[0]["mechanical"] - torque).max() < 0.02 * np.abs(torque).max()


def test_a_motor_that_runs_up_says_nothing_of_a_transmission_that_yields():
    for shape in YIELDING_TRANSMISSION.shapes:
        assert not any(YIELDING_TRANSMISSION.signatures(BASELINE, start_up(), shape))


@pytest.mark.parametrize("mechanism", ["scotch_yoke", "slider_crank"])
@pytest.mark.parametrize("begins", [0.0, 0.6])
def test_a_spring_gives_its_work_back_and_a_tight_place_keeps_it(mechanism, begins):
    baseline, state = make_baseline(mechanism=mechanism), running()
    for rubs in (0.0, 1.0):
        ends = SPRUNG_PLUNGER.signatures(baseline, state, {"begins": begins, "rubs": rubs})
        for end, found in zip((1.0, -1.0), ends, strict=True):
            torque = found["mechanical"][0]
            work_j = baseline.gear * torque.sum() * ANGLE_STEP
            at = baseline.mechanism.displacement(state.angle_rad[0]) / baseline.radius_m - 1.0
            assert not torque[end * at < begins].any()
            if rubs:
                assert torque.min() >= 0.0
                # Twice over the way from there to the end of the stroke, half of the force on average.
                assert work_j == pytest.approx(baseline.radius_m * (1.0 - begins), rel=0.02)
            else:
                # The motor works against the spring on the way to the end.
                towards = np.sign(baseline.lever(state)[0]) == end
                assert work_j == pytest.approx(0.0, abs=1e-6)
                assert torque[towards].sum() > 0.0


@pytest.mark.parametrize("of_mean", [0.0, 1.0])
def test_a_duty_that_rises_with_the_load_draws_the_power_that_it_adds(of_mean):
    state = running()
    (found,) = REGULATED_DUTY.signatures(BASELINE, state, {"of_mean": of_mean, "sign": 1.0})
    added_v, drawn_a = -found["electrical"], found["converter"]
    assert added_v.min() > 0.0
    assert drawn_a * state.battery_voltage_v == pytest.approx(added_v * state.current_a, rel=1e-9)
    load = state.current_a if of_mean == 0.0 else state.current_a.mean(axis=1, keepdims=True)
    assert added_v == pytest.approx(load / state.top_current_a * state.motor_voltage_v, rel=1e-9)


@pytest.mark.parametrize("cutting_sign", [-1, 1])
@pytest.mark.parametrize("over_m", [0.0, 0.012])
def test_a_kerf_pinches_on_both_ways_and_the_more_the_longer_it_is(cutting_sign, over_m):
    baseline, state = make_baseline(cutting_sign), running()
    (found,) = PINCHING_KERF.signatures(baseline, state, {"over_m": over_m, "by_stock": 0.0})
    force, velocity = found["cutting"], cutting_sign * baseline.blade_velocity(state)
    assert np.all(force * velocity > 0.0)  # positive force is against the way of the cut
    assert force.mean(axis=1) == pytest.approx(0.0, abs=1e-3)
    cut_m = state.setting.feed_m_s * state.time_s[:, 0]
    expected = 1.0 - np.exp(-cut_m / over_m) if over_m else np.ones(3)
    assert force.max(axis=1) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("cutting_sign", [-1, 1])
@pytest.mark.parametrize("power", [1.0, 2.0])
def test_a_cut_is_harder_towards_the_end_of_its_stroke(cutting_sign, power):
    baseline, state = make_baseline(cutting_sign), running()
    (late,), (early,) = (UNEVEN_CUT.signatures(baseline, state, {"power": power, "sign": sign}) for sign in (1.0, -1.0))
    cuts = np.flatnonzero(baseline.expected_force(state)[0])
    way = np.cumsum(np.abs(baseline.lever(state)[0, cuts])) * ANGLE_STEP / (2.0 * RADIUS_M)
    share = late["cutting"][0, cuts] / baseline.expected_force(state)[0, cuts]
    assert share == pytest.approx(way**power - 1.0 / (power + 1.0), abs=0.03)
    assert np.array_equal(early["cutting"], -late["cutting"])


def test_another_discharge_begins_where_the_full_battery_does():
    full = running(charge_used_as=np.zeros((3, 1)))
    half_as = 0.5 * 3600.0 * BASELINE.battery.capacity_ah
    used = running(charge_used_as=np.full((3, 1), half_as))
    for of_load, unit_v in ((0.0, 18.0), (1.0, 0.02 * used.battery_current_a)):
        shape = {"of_load": of_load}
        assert not any(part["supply"].any() for part in ANOTHER_DISCHARGE.signatures(BASELINE, full, shape))
        straight, square = (part["supply"] for part in ANOTHER_DISCHARGE.signatures(BASELINE, used, shape))
        assert straight == pytest.approx(-0.5 * unit_v * np.ones_like(straight))
        assert square == pytest.approx(0.5 * straight)
