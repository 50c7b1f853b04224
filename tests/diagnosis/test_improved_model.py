"""The fit behind the improved model: what the form of a cause misses moves no parameter beyond what is stated of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.diagnosis.answer.improved_model import Solution, retuned_with, sensors_of, with_true_scales
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect

from tests.rigs.two_equations import N_BLOCKS, N_CUTTING, N_ELECTRICAL, noise, problem_of

pytestmark = pytest.mark.unit

SIZE, MISSED_BY_FORM = 60.0, 0.3
CAUSE, GAIN, MISSED = (noise(seed, N_CUTTING, 1.0) for seed in (20, 21, 22))


def in_cutting(wave):
    return np.hstack([wave, np.zeros((N_BLOCKS, N_ELECTRICAL))]).reshape(-1, 1)


def problem_with(cutting):
    problem = problem_of(noise(23, N_CUTTING, 0.3) + cutting, noise(24, N_ELECTRICAL, 0.3))
    return replace(problem, nuisance=in_cutting(GAIN), names=("gain",), prior_std=np.ones(1))


def gain_beside_the_cause(problem):
    strength = SimpleNamespace(high=10.0 * SIZE)
    member = SimpleNamespace(
        column=SimpleNamespace(of_any_size=strength.high * in_cutting(CAUSE), columns=in_cutting(CAUSE)),
        effect=SimpleNamespace(strength=strength),
    )
    found = retuned_with(problem, [member])
    return float(found.values[0]), float(found.stds[0]), float(found.amplitudes[0]) * strength.high


def test_a_strong_cause_of_another_form_leaves_the_parameters_within_their_uncertainty():
    # Nature's form misses a third of the catalogue's, and a quarter of that looks like a gain that nobody changed.
    problem = problem_with(SIZE * CAUSE + SIZE * MISSED_BY_FORM * (MISSED + 0.25 * GAIN))
    gain, std, size = gain_beside_the_cause(problem)
    ideal, ideal_std = Marginal(problem, extra=100.0 * in_cutting(CAUSE)).estimate()
    assert ideal[0] > 3.0
    assert ideal_std[0] < 0.1
    assert abs(gain) < min(2.0 * std, 1.0)
    assert size == pytest.approx(SIZE, rel=0.1)


def test_a_gain_that_did_change_is_found_where_the_form_is_right():
    gain, std, size = gain_beside_the_cause(problem_with(SIZE * CAUSE + 2.5 * GAIN))
    assert gain == pytest.approx(2.5, abs=3.0 * std)
    assert std < 0.1
    assert size == pytest.approx(SIZE, rel=0.01)


def test_sensors_are_stated_as_the_campaign_reads_them():
    """A force 2 % high and a current with 0.03 A too much, behind a current gain that the configuration states."""
    found = Solution(
        names=("force_gain", "motor_current_offset_a"), values=np.array([2.0, 1.0]), stds=np.ones(2),
        width=np.array([0.01, 0.03]), reach=np.array([0.03, 0.09]), amplitudes=np.zeros(0),
    )  # fmt: skip
    loaded = parse_config("[sensors]\nmotor_current_a = { gain = 0.98, offset = 0.1 }\n", where="bench_config.toml")
    assert sensors_of(loaded, found) == {
        "force_n": {"gain": 1.02, "offset": 0.0},
        "motor_current_a": {"gain": 0.98, "offset": pytest.approx(0.1 + 0.98 * 0.03)},
    }


def test_no_sensor_moves_farther_than_it_may():
    found = Solution(
        names=("force_gain",), values=np.array([-50.0]), stds=np.ones(1), width=np.array([0.01]),
        reach=np.array([0.03]), amplitudes=np.zeros(0),
    )  # fmt: skip
    loaded = parse_config("", where="bench_config.toml")
    assert sensors_of(loaded, found) == {"force_n": {"gain": 0.97, "offset": 0.0}}


def test_a_form_is_stated_relative_to_true_values():
    """A preload as a share of 204 N that were read where 200 were, beside a scale that no such sensor reads."""
    found = Solution(
        names=("force_gain",), values=np.array([2.0]), stds=np.ones(1), width=np.array([0.01]),
        reach=np.array([0.03]), amplitudes=np.zeros(0),
    )  # fmt: skip
    effect = EFFECT_BY_NAME["preload_lift_off"]
    known = KnownEffect(effect=effect, value=0.96, form={}, scales={"peak_force_n": 204.0, "stroke_m": 0.02})
    assert with_true_scales(known, found).scales == {"peak_force_n": pytest.approx(200.0), "stroke_m": 0.02}
