"""The live estimate of a saw with known effects: strokes of machines integrated in time, runtimes of the long way."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.effect_discharge import discharge_with_effects
from sawbench.modeling.effect_tables import TrialEffects
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.operating_point import OperatingPoint
from sawbench.modeling.recursive import RecursiveCuttingEstimator, StrokeSummary

from tests.rigs.jigsaw_in_time import BASELINE, DUTY, K_CUT, RADIUS, Machine

pytestmark = pytest.mark.contract

N_STROKES = 12
MACHINES = {
    "guide_friction": (Machine(guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01)), 6.0),
    "edge_force": (Machine(cut=lambda v, x, m: K_CUT * v + 40.0 * np.tanh(v / 0.01)), 40.0),
}
CASES = [("guide_friction", "current"), ("edge_force", "force")]


def known(name, value, std=0.0):
    effect = EFFECT_BY_NAME[name]
    one = KnownEffect(effect=effect, value=value, std=std, form=dict(effect.shapes[0]))
    return TrialEffects(known=(one,))


@lru_cache
def stroke_of(name, channels):
    """One settled stroke of a machine as the stream would give it."""
    state = MACHINES[name][0].run()

    def mean(wave):
        return float(np.average(wave[0], weights=1.0 / state.speed_rad_s[0]))

    return StrokeSummary(
        period_s=2.0 * np.pi * float(np.mean(1.0 / state.speed_rad_s[0])),
        mean_force_n=None if channels == "current" else mean(state.force_n),
        mean_current_a=None if channels == "force" else mean(state.current_a),
        battery_voltage_v=mean(state.battery_voltage_v),
    )


@lru_cache
def after(name, channels, value, std=0.0):
    """Estimate after strokes of a machine, its effect known at a value; None where it is not known."""
    effects = None if value is None else known(name, value, std)
    live = RecursiveCuttingEstimator(plant=BASELINE.plant, battery=BASELINE.battery, duty=DUTY, effects=effects)
    for _ in range(N_STROKES):
        found = live.update(stroke_of(name, channels))
    return found


def runtime_at(k_fc, force_n):
    baseline = replace(BASELINE, known=tuple(known("guide_friction", force_n).known))
    return discharge_with_effects(baseline, OperatingPoint(k_fc_n_s_per_m=k_fc, duty=DUTY)).runtime_s


@pytest.mark.parametrize(("name", "channels"), CASES)
def test_known_effects_are_taken_off_the_strokes(name, channels):
    found, plain = after(name, channels, MACHINES[name][1]), after(name, channels, None)
    assert found.k_fc_n_s_per_m == pytest.approx(K_CUT, rel=0.005)
    assert abs(plain.k_fc_n_s_per_m / K_CUT - 1.0) > 0.02, "without the effect the same comparison must fail"


def test_the_runtime_left_is_that_of_a_discharge_with_the_effect_less_what_has_passed():
    found, passed_s = (
        after("guide_friction", "current", 6.0),
        N_STROKES * stroke_of("guide_friction", "current").period_s,
    )
    long_way_s = runtime_at(K_CUT, 6.0)
    assert found.remaining_s + passed_s == pytest.approx(long_way_s, rel=0.006)
    assert abs(runtime_at(K_CUT, 0.0) / long_way_s - 1.0) > 0.03, "without the effect the same comparison must fail"


def test_the_uncertainty_of_the_effect_is_in_that_of_k_fc_and_cancels_in_the_runtime():
    """Friction F takes the power (2/pi) F r w, the cut k (r w)^2 / 4: one gains what the other loses."""
    unsure, sure = (after("guide_friction", "current", 6.0, std) for std in (1.0, 0.0))
    speed = RADIUS * 2.0 * np.pi / stroke_of("guide_friction", "current").period_s
    own = np.sqrt(unsure.std_n_s_per_m**2 - sure.std_n_s_per_m**2)
    assert own == pytest.approx(8.0 / (np.pi * speed), rel=0.1)
    as_if_of_k_alone_s = own * (runtime_at(220.0, 6.0) - runtime_at(260.0, 6.0)) / 40.0
    own_s = np.sqrt(unsure.remaining_std_s**2 - sure.remaining_std_s**2)
    assert own_s < 0.5 * as_if_of_k_alone_s


def test_a_saw_that_its_effects_stop_has_no_runtime_left():
    """300 N at the edge are more than the motor can lift at the half of the stroke; only its swing carries it over."""
    live = RecursiveCuttingEstimator(
        plant=BASELINE.plant, battery=BASELINE.battery, duty=DUTY, effects=known("edge_force", 300.0)
    )
    found = live.update(StrokeSummary(period_s=0.2, mean_force_n=800.0))
    assert (found.remaining_s, found.remaining_std_s) == (None, None)
    assert "does not reach the cut-off" in found.notes[-1]


def test_what_the_effects_need_is_asked_for():
    with pytest.raises(InputError, match="needs a battery"):
        RecursiveCuttingEstimator(plant=BASELINE.plant, duty=DUTY, effects=known("guide_friction", 6.0))
    with pytest.raises(InputError, match="chip_thickness needs the feed"):
        after("chip_thickness", "both", 0.5)
