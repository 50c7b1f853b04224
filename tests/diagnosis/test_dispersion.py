"""Noise that is raised only in the equations where the best two causes leave something."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.dispersion import columns_with_noise, noise_factor, stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Catalogue, explain
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import WeighedAlone
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

from tests.rigs.two_equations import N_BLOCKS, N_CUTTING, N_ELECTRICAL, QUIET, noise, problem_of

pytestmark = pytest.mark.unit


def factor_of(problem, columns=MappingProxyType({}), beyond=MappingProxyType({})):
    return noise_factor(WeighedAlone(problem, columns), Catalogue(dict(beyond), problem.data))


def by_equation(factor):
    rows = factor.reshape(N_BLOCKS, -1)
    return rows[:, :N_CUTTING], rows[:, N_CUTTING:]


def cause(name, wave):
    return {name: [Column(effect=EFFECT_BY_NAME[name], shape={}, columns=wave.reshape(-1, 1))]}


def test_intact_equations_keep_their_noise():
    problem = problem_of(noise(0, N_CUTTING, 0.3), noise(1, N_ELECTRICAL, 0.3))
    assert np.all(factor_of(problem) == 1.0)


def test_noise_rises_only_in_the_equation_where_something_is_left():
    cutting, electrical = noise(2, N_CUTTING, 4.0), noise(3, N_ELECTRICAL, 0.3)
    in_cutting, in_electrical = by_equation(factor_of(problem_of(cutting, electrical)))
    assert in_cutting == pytest.approx(np.full_like(in_cutting, np.mean(cutting**2) / QUIET))
    assert np.all(in_electrical == 1.0)


def test_a_start_has_its_own_noise():
    electrical = noise(4, N_ELECTRICAL, 0.3)
    electrical[-10:] *= 20.0
    factor = factor_of(problem_of(noise(5, N_CUTTING, 0.3), electrical, n_start_up=10))
    _, in_electrical = by_equation(factor)
    assert np.all(in_electrical[:-10] == 1.0)
    assert np.all(in_electrical[-10:] > 20.0)


def test_what_the_best_cause_explains_is_no_noise():
    wave = np.zeros((N_BLOCKS, N_CUTTING + N_ELECTRICAL))
    wave[:, :N_CUTTING] = np.random.default_rng(6).standard_normal((N_BLOCKS, N_CUTTING))
    cutting, electrical = noise(7, N_CUTTING, 0.3) + 1.2 * wave[:, :N_CUTTING], noise(8, N_ELECTRICAL, 0.3)
    problem = problem_of(cutting, electrical)
    named = cause("edge_force", wave)
    assert np.max(factor_of(problem)) > 5.0
    for columns, beyond in ((named, {}), ({}, named)):
        assert np.all(factor_of(problem, columns, beyond) == 1.0)


def test_what_a_second_cause_explains_is_no_noise_and_what_a_third_would_is():
    rng = np.random.default_rng(14)
    waves = 3.0 * rng.standard_normal((3, N_BLOCKS, N_CUTTING + N_ELECTRICAL))
    waves[:2, :, N_CUTTING:] = 0.0
    waves[2, :, :N_CUTTING] = 0.0
    cutting, electrical = noise(15, N_CUTTING, 0.3), noise(16, N_ELECTRICAL, 0.3)
    names = ("edge_force", "return_stroke_rubbing", "brush_voltage_drop")
    columns = {name: column for k, name in enumerate(names) for name, column in cause(name, waves[k]).items()}
    two = problem_of(cutting + (waves[0] + waves[1])[:, :N_CUTTING], electrical)
    assert np.all(factor_of(two, columns) == 1.0)
    three = problem_of(two.data.reshape(N_BLOCKS, -1)[:, :N_CUTTING], electrical + 0.5 * waves[2, :, N_CUTTING:])
    in_cutting, in_electrical = by_equation(factor_of(three, columns))
    assert np.all(in_cutting == 1.0)
    assert np.all(in_electrical > 5.0)


def test_a_second_effect_keeps_its_evidence_where_the_first_leaves_nothing():
    rng = np.random.default_rng(9)
    first, second = np.zeros((2, N_BLOCKS, N_CUTTING + N_ELECTRICAL))
    first[:, :N_CUTTING] = 20.0 * rng.standard_normal((N_BLOCKS, N_CUTTING))
    second[:, N_CUTTING:] = 0.5 * rng.standard_normal((N_BLOCKS, N_ELECTRICAL))
    # Nature's form of the first differs by a tenth; the second is as large as the noise.
    other_form = 2.0 * rng.standard_normal((N_BLOCKS, N_CUTTING))
    problem = problem_of(
        first[:, :N_CUTTING] + other_form + noise(10, N_CUTTING, 0.3),
        second[:, N_CUTTING:] + noise(11, N_ELECTRICAL, 0.3),
    )
    columns = cause("edge_force", first) | cause("brush_voltage_drop", second)
    factor = factor_of(problem, columns)

    def evidence_of_second(variance):
        scaled = columns_with_noise(problem, columns, variance)
        marginal = Marginal(with_noise(problem, variance), extra=scaled["edge_force"][0].columns)
        return explain(marginal, scaled["brush_voltage_drop"]).log_evidence

    alike = np.full_like(factor, np.mean(factor))
    assert evidence_of_second(factor) > 10.0
    assert evidence_of_second(alike) < 3.0


def test_noise_scales_data_nuisances_and_columns_alike():
    problem = problem_of(noise(12, N_CUTTING, 1.0), noise(13, N_ELECTRICAL, 1.0))
    n = len(problem.data)
    variance = np.linspace(1.0, 9.0, n)
    wave = np.arange(1.0, n + 1.0)
    scaled = with_noise(problem, variance)
    assert scaled.data == pytest.approx(problem.data / np.sqrt(variance))
    stacked = stacked_with_noise(problem, [wave[:, None], 2.0 * wave[:, None]], variance)
    assert stacked == pytest.approx(np.column_stack([wave, 2.0 * wave]) / np.sqrt(variance)[:, None])
    found = columns_with_noise(problem, cause("edge_force", wave), 4.0)["edge_force"][0]
    assert found.columns[:, 0] == pytest.approx(0.5 * wave)
    assert stacked_with_noise(problem, [], variance).shape == (n, 0)
