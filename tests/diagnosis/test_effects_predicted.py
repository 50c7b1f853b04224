"""The coupled prediction against an independent integration in time: what an effect does to every channel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.transfer import force_error
from sawbench.modeling.stroke import Term, mean_stroke, predict

from tests.rigs.jigsaw_in_time import BASELINE, K_CUT, Machine

pytestmark = pytest.mark.contract


# Largest root mean square error by channel; an effect moves most of them ten to a thousand times as far.
TOLERANCE = {
    "speed_rad_s": 0.005, "current_a": 0.002, "force_n": 0.06, "battery_voltage_v": 2e-4, "battery_current_a": 1e-3,
}  # fmt: skip
CASES = {
    "guide_friction": (Machine(guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01)), 6.0, None),
    "motor_coulomb_friction": (Machine(cuts=False, drag=lambda w, load: 0.006), 0.006, None),
    "cutting_speed_exponent": (Machine(cut=lambda v, x, m: K_CUT * 0.7 * (v / 0.7) ** 0.4), 1.0, {"exponent": 0.4}),
    "current_sensor_lag": (Machine(lag_current_s=3e-3), 1.0, {"tau_s": 3e-3}),
    "battery_internal_resistance": (Machine(battery_resistance=0.1), 0.08, None),
    "force_sensor_lag": (Machine(lag_force_s=2e-3), 1.0, {"tau_s": 2e-3, "damping": 0.0}),
}


def rms(a, b):
    return float(np.sqrt(np.mean((np.asarray(a) - np.asarray(b)) ** 2)))


@pytest.mark.parametrize("name", CASES)
def test_prediction_agrees_with_the_machine_in_every_channel(name):
    machine, amplitude, shape = CASES[name]
    measured = mean_stroke(machine.run())
    # The search starts from a machine without the effect; only the force is that of the trial, to fit the wood.
    start = replace(mean_stroke(Machine(cuts=machine.cuts).run()), force_n=measured.force_n)
    effect = EFFECT_BY_NAME[name]
    term = Term(amplitude=amplitude, signature=lambda state: effect.signatures(BASELINE, state, shape)[0])
    found = predict(BASELINE, start, [term])
    nominal = predict(BASELINE, start, [])
    assert found.is_settled
    assert found.wood_n_s_per_m == pytest.approx(K_CUT if machine.cuts else 0.0, rel=1e-3, abs=1e-9)
    for channel, tolerance in TOLERANCE.items():
        assert rms(getattr(found.state, channel), getattr(measured, channel)) < tolerance, channel
    missed = [rms(getattr(nominal.state, c), getattr(measured, c)) / t for c, t in TOLERANCE.items()]
    assert max(missed) > 10.0, "without the effect the same comparison must fail"


def test_a_term_that_holds_the_derivative_of_the_force_it_changes_is_solved_for():
    """Putting the force in again and again would raise its high harmonics with every step."""
    lag_s = 2e-3
    measured = mean_stroke(Machine(lag_force_s=lag_s).run())
    start = replace(mean_stroke(Machine().run()), force_n=measured.force_n)
    undone = Term(amplitude=1.0, signature=lambda s: force_error(BASELINE, s, -lag_s * s.force_rate_n_s))
    found = predict(BASELINE, start, [undone])
    assert found.is_settled
    assert rms(found.state.force_n, measured.force_n) < TOLERANCE["force_n"]
    assert rms(predict(BASELINE, start, []).state.force_n, measured.force_n) > 10.0 * TOLERANCE["force_n"]


def test_a_term_that_takes_all_of_the_force_ends_in_an_answer():
    """As one fitted far off may: no force answers, and the matrix of the answers has no inverse."""
    start = mean_stroke(Machine().run())
    found = predict(BASELINE, start, [Term(amplitude=1.0, signature=lambda state: {"cutting": state.force_n})])
    assert np.isfinite(found.state.speed_rad_s).all()


def test_a_brake_that_holds_the_motor_is_not_called_settled():
    start = mean_stroke(Machine().run())
    brake = Term(amplitude=1.0, signature=lambda state: {"mechanical": np.full_like(state.angle_rad, 5.0)})
    assert not predict(BASELINE, start, [brake]).is_settled


def test_wood_that_is_given_is_not_fitted():
    start = mean_stroke(Machine().run())
    harder = predict(BASELINE, start, [], wood_n_s_per_m=1.5 * K_CUT)
    assert harder.wood_n_s_per_m == pytest.approx(1.5 * K_CUT)
    assert harder.state.force_n.max() > 1.2 * start.force_n.max()
    assert harder.state.speed_rad_s.mean() < start.speed_rad_s.mean()
