"""Forces and torques of effects are typical in proportion to what a saw carries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.heat import COPPER_HEAT
from sawbench.modeling.load import OAK, Load, load_of
from sawbench.modeling.machines.table import saw_of

from tests.rigs.drawn_states import BASELINE, running

pytestmark = pytest.mark.unit

SMALL = Load(force_n=0.5 * OAK.force_n, blade_speed_m_s=2.0 * OAK.blade_speed_m_s, torque_n_m=0.25 * OAK.torque_n_m,
             motor_speed_rad_s=2.0 * OAK.motor_speed_rad_s, heat_w=0.1 * OAK.heat_w,
             battery_v=OAK.battery_v, battery_ohm=4.0 * OAK.battery_ohm)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("edge_force", 0.5),
        # A quarter of the torque through the same gear: what the motor drives, not what the wood takes.
        ("guide_friction", 0.25),
        # A damping is a force over a speed.
        ("return_stroke_rubbing", 0.25),
        ("motor_coulomb_friction", 0.25),
        ("gear_eccentricity", 0.25),
        ("cogging_torque", 0.25),
        # At 1000 rad/s; it goes with the square of the speed at which the machine runs.
        ("windage_drag", 0.0625),
        ("brush_voltage_drop", 1.0),
        ("load_dependent_friction", 1.0),
        # A rise of the temperature is what is typical.
        ("winding_heating", 10.0),
        ("magnet_weakening", 10.0),
        # The share of the battery's voltage is.
        ("battery_internal_resistance", 4.0),
        ("battery_polarization", 4.0),
    ],
)
def test_a_machine_of_another_load_has_effects_of_another_size(name, share):
    machine = saw_of(BASELINE.plant, BASELINE.battery)
    of = {
        load: {effect.name: effect for effect in machine.effects(replace(BASELINE, load=load))} for load in (OAK, SMALL)
    }
    assert of[OAK][name].strength.typical == pytest.approx(EFFECT_BY_NAME[name].strength.typical)
    assert of[SMALL][name].strength.typical == pytest.approx(share * EFFECT_BY_NAME[name].strength.typical)


def test_the_load_is_that_of_the_usual_cutting_trial():
    usual = running()
    trials = [usual, replace(usual, force_n=1.2 * usual.force_n), replace(usual, force_n=3.0 * usual.force_n)]
    found = load_of(BASELINE, [running(is_idle=True), *trials])
    assert found.force_n == pytest.approx(1.2 * 210.0, rel=1e-3)
    # Mean of 10 A + 1.5 A sin + 1 A cos 2.
    assert found.torque_n_m == pytest.approx(0.005632 * 10.0)
    # 89 rad/s of the crank on average, 95 at its fastest near the middle of the stroke: 88 + 1 - 6 where |sin| is 1.
    assert found.motor_speed_rad_s == pytest.approx(89.0 * 28.0 / 3.0)
    assert found.blade_speed_m_s == pytest.approx(0.01 * 83.0, rel=1e-2)


def test_a_machine_that_cuts_nothing_has_the_load_of_the_paper():
    cold = replace(running(is_idle=True), slow={})
    assert load_of(BASELINE, [cold]) == OAK


def test_a_clipped_peak_does_not_lower_what_is_expected_beyond_it():
    """The force that is missing in the reading, of a piece far harder than its stock's clipped mean says."""
    speed = BASELINE.cutting_speed(running())
    true_n = 330.0 * speed
    preload_n = 200.0
    state = running(force_n=np.minimum(true_n, preload_n), k_below_n_s_per_m=330.0, peak_force_n=preload_n)
    effect = EFFECT_BY_NAME["preload_lift_off"]
    (found,) = effect.signatures(BASELINE, state, {"share": 1.0, "scale": 0.0})
    # The corner of a mean stroke is round by 2 % of the preload.
    assert np.abs(found["cutting"] - np.minimum(preload_n - true_n, 0.0)).max() < 0.02 * preload_n
    (guessed,) = effect.signatures(BASELINE, state, {"share": 1.0, "scale": 1.0})
    assert np.abs(guessed["cutting"]).max() < 0.3 * np.abs(found["cutting"]).max()


def test_the_battery_is_loaded_by_the_current_that_the_converter_draws():
    usual = running()
    found = load_of(BASELINE, [running(is_idle=True), usual])
    drawn_a = usual.setting.duty * np.abs(usual.current_a).mean()
    assert found.battery_ohm == pytest.approx(usual.battery_voltage_v.mean() / drawn_a)


def test_the_heat_is_what_a_thermal_mass_has_felt_at_most():
    cold = running(is_idle=True)
    heated = []
    for squared_a2 in (4.0, 9.0):
        slow = {memory: np.full((len(cold.time_s), 1), squared_a2) for memory in COPPER_HEAT.values()}
        heated.append(replace(cold, slow=slow))
    found = load_of(BASELINE, heated)
    assert found.heat_w == pytest.approx(9.0 * BASELINE.plant.resistance_ohm.nominal)
    assert found.force_n == OAK.force_n
