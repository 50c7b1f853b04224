"""The paper's squared error over time: the global minimum, for windows with several local ones."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.parts.measured import MeasuredForce
from sawbench.modeling.supplies import FixedVoltage
from sawbench.modeling.transient import simulate

from benchmarks.annealing import anneal
from benchmarks.current_trace import anneal_current_trace, current_trace, fit_current_trace

pytestmark = pytest.mark.unit

SUPPLY = FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V)


def run(cutting, seconds):
    trajectory = simulate(paper.PARAMETERS, supply=SUPPLY, cutting=cutting, duration_s=seconds)
    return trajectory.time_s, trajectory.motor_current_a


def fit(time_s, current_a, **changes):
    return fit_current_trace(time_s, current_a, parameters=paper.PARAMETERS, supply=SUPPLY, **changes)


@pytest.mark.parametrize("seconds", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("truth", [115.0, 240.29, 333.0, 470.0])
def test_finds_the_truth_in_few_simulations(seconds, truth):
    time_s, current_a = run(LinearCutting(k_fc_n_s_per_m=truth), seconds)
    noisy = current_a + np.random.default_rng(7).normal(scale=0.5, size=len(time_s))
    found = fit(time_s, noisy)
    assert found.status == "ok"
    assert found.k_fc_n_s_per_m == pytest.approx(truth, rel=5e-3)
    assert found.rmse_a == pytest.approx(0.5, rel=0.1)
    assert found.simulation_times < 35


@pytest.mark.parametrize("seconds", [1.0, 5.0])
def test_is_the_global_minimum_when_the_model_does_not_fit(seconds):
    angle = 2 * np.pi * np.arange(128) / 128
    share = np.clip(angle / np.pi - 1.0, 0.0, 1.0)
    force = np.where(angle >= np.pi, 260.0 * np.sin(np.pi * share**1.8), 0.0)
    time_s, current_a = run(MeasuredForce(force_n=np.maximum(force, 0.0)), seconds)
    trace = current_trace(time_s, current_a, parameters=paper.PARAMETERS, supply=SUPPLY)
    grid = np.linspace(100.0, 500.0, 801)
    values = np.array([trace.ise(k) for k in grid])
    inner = values[1:-1]
    if seconds == 5.0:
        assert np.sum((inner < values[:-2]) & (inner < values[2:])) > 2, "several minima are the point"
    found = fit(time_s, current_a)
    assert found.ise_a2 <= values.min() * (1 + 1e-6)
    assert found.k_fc_n_s_per_m == pytest.approx(grid[np.argmin(values)], abs=0.6)


def test_truth_outside_the_bounds_is_reported():
    time_s, current_a = run(LinearCutting(k_fc_n_s_per_m=600.0), 1.0)
    found = fit(time_s, current_a)
    assert found.status == "at_bound"
    assert found.k_fc_n_s_per_m == pytest.approx(500.0, abs=0.01)


def test_annealing_of_appendix_b_ends_in_the_same_minimum():
    time_s, current_a = run(LinearCutting(k_fc_n_s_per_m=240.29), 1.0)
    found = anneal_current_trace(time_s, current_a, parameters=paper.PARAMETERS, supply=SUPPLY, seed=3)
    assert found.is_settled
    assert found.value == pytest.approx(240.29, abs=0.05)
    assert found.n_evaluations > 15 * fit(time_s, current_a).n_calls


def test_annealing_stays_in_its_bounds_and_repeats_with_its_seed():
    seen = []

    def cost(x):
        seen.append(x)
        return -x

    first = anneal(cost, bounds=(100.0, 500.0), start=130.0, seed=5, most_evaluations=700)
    assert min(seen) >= 100.0
    assert max(seen) <= 500.0
    assert first.value == pytest.approx(500.0, abs=1e-3)
    assert anneal(cost, bounds=(100.0, 500.0), start=130.0, seed=5, most_evaluations=700) == first


def test_nonsense_is_refused_by_name():
    with pytest.raises(InputError, match="start"):
        anneal(lambda x: x, bounds=(100.0, 500.0), start=50.0)
    with pytest.raises(InputError, match="bounds"):
        fit([0.0, 0.1, 0.2], [0.0, 1.0, 2.0], bounds=(500.0, 100.0))
    with pytest.raises(InputError, match="current_a"):
        fit([0.0, 0.1, 0.2], [0.0, np.nan, 2.0])
    with pytest.raises(InputError, match="time_s"):
        fit([0.0, 0.2, 0.1], [0.0, 1.0, 2.0])
