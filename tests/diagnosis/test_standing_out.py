"""Which places stand out: nothing where there is only chance, the right places where something is missing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.answer import gap_detail, standing_out, where
from sawbench.diagnosis.answer.standing_out import Cell, find_cells
from sawbench.diagnosis.inference.features import START_UP_EDGES_S, Layout
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from scipy.stats import false_discovery_control, spearmanr

FALSE_DISCOVERY_RATE = SETTINGS.report.false_discovery_rate
pytestmark = pytest.mark.unit

ORDERS = {"electrical": 4, "cutting": 9}
N_BLOCKS, N_POINTS, N_REPEATS = 4, 5, 2
N_DRAWS = 40


def trial(kind, point, start, rng):
    equations = ("electrical", "cutting") if kind == "running" else ("electrical",)
    layout = Layout(kind=kind, equations=equations, n_harmonics=ORDERS)
    n_blocks = N_BLOCKS if kind == "running" else 1
    # Neighbouring features of one equation share noise.
    covariance = np.zeros((layout.size, layout.size))
    for place in layout.slices.values():
        size = place.stop - place.start
        mixed = rng.standard_normal((size, size))
        covariance[place, place] = np.eye(size) + mixed @ mixed.T / size
    state = SimpleNamespace(kind=kind, setting=SimpleNamespace(operating_point=point))
    return Part(
        state=state, smooth=state, layout=layout, times=np.ones((n_blocks, 1)), blocks=np.eye(n_blocks),
        whitener=np.linalg.inv(np.linalg.cholesky(covariance)), common=np.eye(layout.size),
        scatter=np.ones(layout.size), place=slice(start, start + n_blocks * layout.size),
    )  # fmt: skip


def campaign(seed=1):
    rng = np.random.default_rng(seed)
    parts, start = [], 0
    for point in range(N_POINTS):
        for kind in ("running", "start_up") * N_REPEATS:
            parts.append(trial(kind, f"duty {point}", start, rng))
            start = parts[-1].place.stop
    plant = SimpleNamespace(effects=(), nuisances=lambda: ())
    return LinearProblem(
        campaign=SimpleNamespace(plant=plant), parts=tuple(parts), data=np.zeros(start),
        known=np.zeros(start),
        nuisance=0.05 * rng.standard_normal((start, 6)), names=tuple("abcdef"), prior_std=np.ones(6),
    )  # fmt: skip


def with_data(problem, data):
    return replace(problem, data=data)


def noise_of(problem, rng):
    """What nobody can know: independent noise, and mistuned parameters."""
    return rng.standard_normal(len(problem.data)) + problem.nuisance @ rng.standard_normal(problem.nuisance.shape[1])


def same_in_every_block(problem, rng):
    """The worst the model of an intact machine may miss: all of the noise, alike in blocks and repeats."""
    data, known = np.zeros(len(problem.data)), {}
    for part in problem.parts:
        key = (part.state.setting.operating_point, part.layout.kind)
        row = known.setdefault(key, rng.standard_normal(part.layout.size))
        data[part.place] = np.tile(row, part.blocks.shape[0])
    return data


@pytest.mark.parametrize("draw", [noise_of, same_in_every_block])
def test_chance_seldom_stands_out(draw):
    problem, rng = campaign(), np.random.default_rng(2)
    cells = [find_cells(with_data(problem, draw(problem, rng))) for _ in range(N_DRAWS)]
    # With nothing to be found, the false discovery rate is the chance of any find.
    assert sum(any(cell.stands_out for cell in found) for found in cells) <= 2 * FALSE_DISCOVERY_RATE * N_DRAWS
    p_values = np.array([[cell.p_value for cell in found] for found in cells])
    assert np.mean(p_values < 0.01) < 0.02


def half_in_every_block(problem, rng):
    """What scatters, and as much that the model of an intact machine misses."""
    return np.sqrt(0.5) * (same_in_every_block(problem, rng) + noise_of(problem, rng))


def with_common(problem, share):
    parts = tuple(replace(part, common=share * np.eye(part.layout.size)) for part in problem.parts)
    return replace(problem, parts=parts)


def test_what_scatters_is_another_noise_in_every_block():
    problem, rng = with_common(campaign(), 0.5), np.random.default_rng(5)
    cells = [find_cells(with_data(problem, half_in_every_block(problem, rng))) for _ in range(N_DRAWS)]
    assert sum(any(cell.stands_out for cell in found) for found in cells) <= 2 * FALSE_DISCOVERY_RATE * N_DRAWS


def test_a_gap_in_every_block_stands_out_where_an_intact_machine_could_not_show_it():
    problem, rng = campaign(), np.random.default_rng(6)
    problem = replace(problem, nuisance=np.zeros_like(problem.nuisance))
    data = 0.8 * same_in_every_block(problem, rng) + noise_of(problem, rng)
    found = [find_cells(with_data(with_common(problem, share), data)) for share in (1.0, 0.0)]
    by_point = [sum(c.stands_out for c in cells if c.partition == "operating_point") for cells in found]
    assert by_point[0] == 0
    assert by_point[1] > N_POINTS


def test_small_effects_do_not_stand_out_but_the_same_effect_at_size_does():
    problem, rng = campaign(), np.random.default_rng(3)
    # Parameters that a strong effect drags along would carry it into the other equation.
    problem = replace(problem, nuisance=np.zeros_like(problem.nuisance))
    effect = np.zeros(len(problem.data))
    for part in problem.parts:
        if part.state.kind == "running":
            wave = np.zeros(part.layout.size)
            wave[part.layout.slices["cutting"]] = 3.0
            effect[part.place] = np.tile(wave, N_BLOCKS)
    little = [
        find_cells(with_data(problem, noise_of(problem, rng) + size * effect), effect[:, None])
        for size in rng.standard_normal(N_DRAWS)
    ]
    assert sum(any(cell.stands_out for cell in found) for found in little) <= 2 * FALSE_DISCOVERY_RATE * N_DRAWS
    strong = find_cells(with_data(problem, noise_of(problem, rng) + 8.0 * effect), effect[:, None])
    assert {cell.equation for cell in strong if cell.stands_out} == {"cutting"}


def raised(problem, equation, kind, features, block=None):
    """Whitened data of a constant on the given features of an equation, in its own unit."""
    data = np.zeros(len(problem.data))
    for part in problem.parts:
        if part.layout.kind != kind or equation not in part.layout.slices:
            continue
        rows = np.zeros((part.blocks.shape[0], part.layout.size))
        rows[slice(None) if block is None else block, part.layout.slices[equation].start + features] = 12.0
        data[part.place] = (rows @ part.whitener.T).ravel()
    return data


def found_of(problem, data, partition):
    cells = find_cells(with_data(problem, data + noise_of(problem, np.random.default_rng(4))))
    return {(c.equation, c.place) for c in cells if c.partition == partition and c.stands_out}


def test_a_harmonic_is_found_as_that_harmonic_of_its_equation():
    problem = campaign()
    cosine_and_sine_of_5 = np.array([5, 14])
    data = raised(problem, "cutting", "running", cosine_and_sine_of_5)
    assert ("cutting", "5 to 6") in found_of(problem, data, "harmonic")
    assert {equation for equation, _ in found_of(problem, data, "crank_angle")} == {"cutting"}


def test_a_constant_is_found_in_no_harmonic_above_it_in_most_sectors():
    problem = campaign()
    data = raised(problem, "electrical", "running", np.array([0]))
    assert ("electrical", "0") in found_of(problem, data, "harmonic")
    assert len(found_of(problem, data, "crank_angle")) > 0.5 * standing_out.N_SECTORS
    assert len(found_of(problem, data, "operating_point")) == N_POINTS


def test_the_start_up_has_places_of_its_own():
    problem, third = campaign(), 3
    data = raised(problem, "electrical", "start_up", np.array([third]))
    name = f"{1e3 * START_UP_EDGES_S[third]:.0f} to {1e3 * START_UP_EDGES_S[third + 1]:.0f} ms"
    assert found_of(problem, data, "start_up") == {("electrical", name)}
    assert found_of(problem, data, "time") == {("electrical", "start-up")}
    assert found_of(problem, data, "crank_angle") == set()


def test_what_is_there_in_the_last_quarter_only_is_found_there():
    problem = campaign()
    data = raised(problem, "cutting", "running", np.arange(6), block=N_BLOCKS - 1)
    assert found_of(problem, data, "time") == {("cutting", "75 to 100 %")}


def test_cells_that_nuisances_take_up_are_left_out():
    problem = campaign()
    n = len(problem.data)
    everything = replace(problem, nuisance=1e6 * np.eye(n), names=("a",) * n, prior_std=np.ones(n))
    assert find_cells(everything) == ()


def test_cells_of_which_rounding_leaves_less_than_nothing_are_left_out(monkeypatch):
    misfits_of = standing_out._Sums.misfits
    calls = []

    def rounded_once(sums):
        calls.append(sums)
        misfits, expected = misfits_of(sums)
        if len(calls) == 1:
            expected[0] = -1e-12
        return misfits, expected

    problem = campaign()
    problem = with_data(problem, noise_of(problem, np.random.default_rng(5)))
    n_cells = len(find_cells(problem))
    monkeypatch.setattr(standing_out._Sums, "misfits", rounded_once)
    cells = find_cells(problem)
    assert len(cells) == n_cells - 1
    assert all(0.0 <= cell.q_value <= 1.0 for cell in cells)


def test_what_the_nuisances_take_up_leaves_the_inverse_covariance():
    problem = campaign()
    found = Marginal(problem).taken_up()
    n = len(problem.data)
    covariance = np.eye(n) + problem.nuisance @ problem.nuisance.T
    assert found.shape == (problem.nuisance.shape[1], n)
    np.testing.assert_allclose(np.eye(n) - found.T @ found, np.linalg.inv(covariance), atol=1e-10)


def test_the_report_counts_as_found_what_its_own_numbers_say_is_found(monkeypatch):
    just_found, just_not = FALSE_DISCOVERY_RATE - 4e-5, FALSE_DISCOVERY_RATE + 4e-5
    cells = [
        Cell(partition="harmonic", equation="cutting", place=place, misfit=9.0, expected=2.0, p_value=q / 10, q_value=q)
        for place, q in (("0", just_found), ("1", just_not))
    ]
    monkeypatch.setattr(gap_detail, "find_cells", lambda problem, small: cells)
    forms = {"cutting": SimpleNamespace(place="cutting", channel="force_n")}
    problem = SimpleNamespace(campaign=SimpleNamespace(plant=SimpleNamespace(equations=forms)))
    report = gap_detail._standing_out(problem, np.zeros((0, 0)))
    q_values = report["partitions"]["harmonic"]["equations"]["cutting"]["q_value"]
    assert [q < report["false_discovery_rate"] for q in q_values] == [True, False]
    assert report["n_found"] == 1


def test_rates_of_false_discovery_are_those_of_scipy():
    p_values = np.random.default_rng(4).uniform(size=40) ** 3
    expected = false_discovery_control(p_values, method="by")
    assert standing_out._false_discovery_rates(p_values) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("other", [[3.0, 1.0, 2.0, 5.0, 4.0], [1.0, 1.0, 2.0, 2.0, 0.0]])
def test_the_rank_correlation_is_that_of_scipy(other):
    one = [0.2, 0.1, 0.3, 0.3, 0.5]
    assert where._rank_correlation(one, other) == pytest.approx(float(spearmanr(one, other).statistic), rel=1e-12)
