"""The algebra of the evidence against brute force, and what a form may miss on simulated strokes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.answer.claim import is_there
from sawbench.diagnosis.inference.columns import Column, catalogue_columns
from sawbench.diagnosis.inference.dispersion import with_noise
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, amplitudes, explain, explain_formed
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.left_over import left_over
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from scipy.stats import truncnorm

from tests.rigs.jigsaw_in_time import BASELINE
from tests.rigs.scattered_strokes import friction, problem_of, strokes

pytestmark = pytest.mark.unit

N_ROWS, N_UNITS = 60, 12


def small_problem(seed=0):
    rng = np.random.default_rng(seed)
    nuisance = rng.standard_normal((N_ROWS, 5))
    data = rng.standard_normal(N_ROWS) + nuisance @ rng.standard_normal(5)
    return LinearProblem(
        campaign=None, parts=(), data=data, known=0.0 * data, nuisance=nuisance, names=tuple("abcde"),
        prior_std=np.ones(5),
    )  # fmt: skip


def columns_of(name, n_shapes, width, seed, size=0.5):
    rng = np.random.default_rng(seed)
    effect = EFFECT_BY_NAME[name]
    return [
        Column(effect=effect, shape=effect.shapes[k], columns=size * rng.standard_normal((N_ROWS, width)))
        for k in range(n_shapes)
    ]


def log_density(data, covariance):
    """Logarithm of the normal density with mean zero, less the constant."""
    sign, log_determinant = np.linalg.slogdet(covariance)
    assert sign > 0
    return -0.5 * (data @ np.linalg.solve(covariance, data) + log_determinant)


def log_mean(logs):
    top = np.max(logs)
    return top + np.log(np.mean(np.exp(np.asarray(logs) - top)))


def fine_sizes(effect):
    """Sizes that are equally likely, many of them: log-normal about 1, the effect's range four deviations long."""
    low, high = effect.strength.low, effect.strength.high
    std = np.log(high / low) / 4.0
    ends = np.log([max(low, 0.15), high]) / std
    return np.exp(std * truncnorm(*ends).ppf(np.linspace(0.0, 1.0, 2000)))


def brute_force(problem, columns, extra=None):
    """Log evidence of the data: amplitude and shape summed over, nuisances in a full covariance matrix."""
    design = problem.nuisance if extra is None else np.hstack([problem.nuisance, extra])
    covariance = np.eye(N_ROWS) + design @ design.T
    logs = []
    for column in columns:
        sizes = fine_sizes(column.effect)
        if column.columns.shape[1] == 1:
            wave = column.columns[:, 0]
            solved = np.linalg.solve(covariance, np.column_stack([problem.data, wave]))
            gains = sizes * (wave @ solved[:, 0]) - 0.5 * sizes**2 * (wave @ solved[:, 1])
            logs.append(log_density(problem.data, covariance) + log_mean(gains))
        else:
            # A free phase: every part is normal and the mean square of the whole is the amplitude's.
            waves = column.columns @ column.columns.T
            logs.append(log_mean([log_density(problem.data, covariance + 0.5 * a**2 * waves) for a in sizes[::20]]))
    return log_mean(logs)


@pytest.mark.parametrize(("width", "n_shapes"), [(1, 1), (1, 3), (2, 1), (6, 2)])
def test_evidence_is_that_of_the_full_covariance(width, n_shapes):
    problem = small_problem(1)
    columns = columns_of("edge_force", n_shapes, width, seed=2)
    problem = replace(problem, data=problem.data + 1.5 * columns[0].columns[:, 0])
    found = explain(Marginal(problem), columns)
    without = log_density(problem.data, np.eye(N_ROWS) + problem.nuisance @ problem.nuisance.T)
    assert found.log_evidence == pytest.approx(brute_force(problem, columns) - without, abs=0.1)


@pytest.mark.parametrize("name", ["edge_force", "force_sensor_lag"])
@pytest.mark.parametrize("between", [0.0, 0.3, 0.5])
def test_evidence_does_not_depend_on_where_a_size_lies_that_is_known_finer_than_any_grid(name, between):
    """At 2000 times the noise a grid of sizes would miss it by up to a hundred nats."""
    problem = small_problem(6)
    (column,) = columns_of(name, 1, 1, seed=7, size=300.0)
    low, high = column.effect.strength.low, column.effect.strength.high
    coarse = amplitudes(low, high)
    middle = len(coarse) // 2
    size = (1.0 - between) * coarse[middle] + between * coarse[middle + 1]
    problem = replace(problem, data=problem.data + size * column.columns[:, 0])
    marginal = Marginal(problem)
    found = explain(marginal, [column])
    ((square,),), (moment,) = marginal.gram(column.columns)
    best, std = moment / square, 1.0 / np.sqrt(square)
    tried = best + std * np.linspace(-8.0, 8.0, 4001)
    logs = tried * moment - 0.5 * tried**2 * square
    # Cells are equally likely: within one the density is even.
    cell = np.searchsorted(coarse, best) - 1
    cells = np.searchsorted(coarse, tried) - 1
    share = 1.0 / (len(coarse) - 1) / np.diff(coarse)[cells]
    top = logs.max()
    expected = top + np.log(np.sum(share * np.exp(logs - top)) * (tried[1] - tried[0]))
    assert coarse[cell] <= best
    assert found.log_evidence == pytest.approx(expected, abs=0.01)


def test_the_marginal_is_that_of_the_full_covariance():
    problem, extra = small_problem(3), np.random.default_rng(4).standard_normal((N_ROWS, 3))
    marginal = Marginal(problem, extra=extra)
    design = np.hstack([problem.nuisance, extra])
    covariance = np.eye(N_ROWS) + design @ design.T
    assert -0.5 * (marginal.misfit + marginal.log_determinant) == pytest.approx(log_density(problem.data, covariance))
    waves = np.random.default_rng(5).standard_normal((N_ROWS, 2))
    gram, moment = marginal.gram(waves)
    assert np.allclose(gram, waves.T @ np.linalg.solve(covariance, waves))
    assert np.allclose(moment, waves.T @ np.linalg.solve(covariance, problem.data))


def test_amplitude_and_its_uncertainty_hold_the_truth():
    """Of 200 draws about two in three lie within one standard deviation, nearly all within three."""
    rng = np.random.default_rng(6)
    problem, columns = small_problem(6), columns_of("edge_force", 1, 1, seed=7)
    deviations = []
    for _ in range(200):
        data = rng.standard_normal(N_ROWS) + problem.nuisance @ rng.standard_normal(5)
        found = explain(Marginal(replace(problem, data=data + 1.2 * columns[0].columns[:, 0])), columns)
        deviations.append((found.amplitude - 1.2) / found.amplitude_std)
    assert np.std(deviations) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(deviations)) < 0.2


def test_the_whole_catalogue_at_once_says_what_each_effect_says_alone():
    problem = small_problem(8)
    wave = EFFECT_BY_NAME["yoke_backlash"].n_signatures({"waves": 1.0})
    entries = {
        "edge_force": columns_of("edge_force", 3, 1, seed=9),
        "gear_eccentricity": columns_of("gear_eccentricity", 2, 2, seed=10),
        "force_sensor_lag": [],
        "yoke_backlash": columns_of("yoke_backlash", 2, wave, seed=11),
        "preload_lift_off": columns_of("preload_lift_off", 2, 1, seed=12),
    }
    marginal = Marginal(problem, extra=np.random.default_rng(13).standard_normal((N_ROWS, 4)))
    found = Catalogue(entries, problem.data).explain(marginal)
    assert set(found) == {name for name, columns in entries.items() if columns}
    for name, together in found.items():
        alone = explain(marginal, entries[name])
        assert together.column is alone.column
        for number in ("log_evidence", "amplitude", "amplitude_std", "gain"):
            assert getattr(together, number) == pytest.approx(getattr(alone, number), rel=1e-9), (name, number)
        assert np.allclose(together.contribution, alone.contribution)


@pytest.mark.parametrize("width", [1, 2])
def test_a_form_without_error_is_the_form_itself(width):
    problem, columns = small_problem(14), columns_of("edge_force", 2, width, seed=15)
    modes = np.random.default_rng(16).standard_normal((N_ROWS, 7))
    marginal = Marginal(problem)
    alone = explain(marginal, columns)
    log_z = -0.5 * (marginal.misfit + marginal.log_determinant)
    total, found = explain_formed(marginal, modes, columns, (0.0,))
    assert total == pytest.approx(alone.log_evidence + log_z)
    assert found.log_evidence == pytest.approx(alone.log_evidence)


@pytest.mark.parametrize("width", [1, 2])
def test_what_a_cause_leaves_is_the_misfit_less_its_gain(width):
    problem, columns = small_problem(14), columns_of("edge_force", 2, width, seed=15)
    problem = replace(problem, data=problem.data + 1.5 * columns[1].columns[:, 0])
    marginal = Marginal(problem)
    alone = explain(marginal, columns)
    as_measured = np.ones(N_ROWS)
    assert alone.gain > 5.0
    assert left_over(problem, as_measured, marginal) == pytest.approx(marginal.misfit / N_ROWS)
    left = left_over(problem, as_measured, marginal, alone)
    assert left == pytest.approx((marginal.misfit - alone.gain) / N_ROWS)


def test_what_is_left_counts_by_the_noise_as_it_was_measured():
    problem = replace(small_problem(16), nuisance=np.zeros((N_ROWS, 0)), names=(), prior_std=np.zeros(0))
    dispersion = np.where(np.arange(N_ROWS) < 20, 9.0, 1.0)
    scaled = with_noise(problem, dispersion)
    left = left_over(scaled, dispersion, Marginal(scaled))
    assert left == pytest.approx(float(problem.data @ problem.data) / N_ROWS)


def test_what_is_left_is_never_negative():
    # The nuisance takes up what is quiet, at the price of what is dispersed.
    column = np.where(np.arange(N_ROWS) < 20, 30.0, 3.0)[:, None]
    data = np.where(np.arange(N_ROWS) < 20, 10.0, -2.0)
    problem = replace(small_problem(16), data=data, nuisance=column, names=("one",), prior_std=np.ones(1))
    dispersion = np.where(np.arange(N_ROWS) < 20, 400.0, 1.0)
    scaled = with_noise(problem, dispersion)
    number = float(np.linalg.lstsq(
        np.vstack([scaled.nuisance, np.eye(1)]), np.append(scaled.data, 0.0), rcond=None
    )[0][0])  # fmt: skip
    expected = (np.sum((data - number * column[:, 0]) ** 2) + number**2) / N_ROWS
    assert left_over(scaled, dispersion, Marginal(scaled)) == pytest.approx(expected)


def test_form_error_is_a_nuisance_of_its_share():
    rng = np.random.default_rng(17)
    problem, columns = small_problem(18), columns_of("edge_force", 2, 1, seed=19)
    modes, fixed = rng.standard_normal((N_ROWS, 7)), rng.standard_normal((N_ROWS, 2))
    problem = replace(problem, data=problem.data + 1.5 * columns[1].columns[:, 0] + 0.3 * modes[:, 2])
    marginal = Marginal(problem, extra=fixed)
    single = {share: explain_formed(marginal, modes, columns, (share,))[0] for share in (0.0, 0.1, 0.4)}
    for share, total in single.items():
        expected = brute_force(problem, columns, extra=np.hstack([fixed, share * modes]))
        assert total == pytest.approx(expected, abs=0.1)
    together, _ = explain_formed(marginal, modes, columns, tuple(single))
    assert together == pytest.approx(log_mean(list(single.values())))


# --- on simulated strokes -------------------------------------------------------------------------------------


# Duty, cuts, feed in m/s.


@pytest.fixture(scope="module")
def campaign_states():
    return strokes()


@pytest.fixture(scope="module")
def problem(campaign_states):
    return problem_of(campaign_states)


def share_outside(wave, columns):
    solution, *_ = np.linalg.lstsq(columns, wave, rcond=None)
    return np.linalg.norm(wave - columns @ solution) / np.linalg.norm(wave)


def test_form_modes_are_columns_of_the_problem(problem):
    modes = form_modes(problem, problem.project(friction))
    assert modes.shape[0] == len(problem.data)
    assert modes.shape[1] > 10
    assert np.isfinite(modes).all()
    assert np.all(np.abs(modes).max(axis=0) > 0.0)


def test_an_effect_that_is_not_there_may_miss_nothing(problem):
    assert form_modes(problem, np.zeros(len(problem.data))).shape == (len(problem.data), 0)


def test_what_a_form_may_miss_goes_with_its_size(problem):
    contribution = problem.project(friction)
    assert np.allclose(form_modes(problem, 3.0 * contribution), 3.0 * form_modes(problem, contribution))


def test_modes_stay_in_the_equations_of_the_effect(problem):
    modes = form_modes(problem, problem.project(friction))
    for part in problem.parts:
        places = part.layout.slices
        for mode in modes.T:
            features = part.unwhiten(mode)
            for equation in set(places) - {"mechanical"}:
                assert np.max(np.abs(features[:, places[equation]])) < 1e-9


@pytest.mark.parametrize(
    "factor",
    [
        lambda s: 1.0 + 0.3 * np.cos(s.angle_rad + 0.4),
        lambda s: 1.0 + 0.2 * np.sin(3 * s.angle_rad) - 0.2 * np.cos(2 * s.angle_rad),
        lambda s: 1.0 + 2.0 * (s.setting.duty - 0.44),
        lambda s: 1.0 + 1e-3 * s.setting.session_s - (0.2 if s.setting.is_idle else 0.0),
        lambda s: 1.0 + 0.5 * (s.setting.duty - 0.44) + 0.2 * np.cos(s.angle_rad),
    ],
    ids=["once a turn", "three times a turn", "with the duty", "with time and in air", "duty and angle"],
)
def test_a_form_that_bends_smoothly_lies_in_signature_and_modes(problem, factor):
    contribution = problem.project(friction)
    bent = problem.project(lambda s: {"mechanical": factor(s) * friction(s)["mechanical"]})
    assert share_outside(bent, contribution[:, None]) > 0.05, "the deformation is too small to say anything"
    span = np.column_stack([contribution, form_modes(problem, contribution)])
    assert share_outside(bent, span) < 0.2 * share_outside(bent, contribution[:, None])


def test_a_gap_of_another_equation_is_no_error_of_the_form(problem):
    span = np.column_stack([problem.project(friction), form_modes(problem, problem.project(friction))])
    other = problem.project(lambda s: {"electrical": 0.5 * np.tanh(s.current_a)})
    assert share_outside(other, span) > 0.95


def test_a_gap_that_jumps_from_block_to_block_is_no_error_of_the_form(problem):
    """Of four blocks that alternate, a straight line in time takes a fifth of the square; nothing else takes any."""

    def jumping(state):
        sign = (-1.0) ** np.arange(len(state.angle_rad))[:, None]
        return {"mechanical": sign * friction(state)["mechanical"]}

    span = np.column_stack([problem.project(friction), form_modes(problem, problem.project(friction))])
    assert share_outside(problem.project(jumping), span) == pytest.approx(np.sqrt(0.8), abs=0.01)


GAINS = ("motor_current_gain", "force_gain", "battery_current_gain", "battery_voltage_gain")
MISFITS = {
    "electrical": lambda s, wave: replace(s, motor_voltage_v=s.motor_voltage_v + wave),
    "cutting": lambda s, wave: replace(s, force_n=s.force_n + 20.0 * wave),
    "supply": lambda s, wave: replace(s, battery_voltage_v=s.battery_voltage_v + 0.1 * wave),
    "converter": lambda s, wave: replace(s, battery_current_a=s.battery_current_a + 0.3 * wave),
}


def misfitting(states, equation, size):
    """Campaign whose equation misses a wave that no parameter has."""
    wrong = [MISFITS[equation](s, size * (np.cos(3 * s.angle_rad) - 0.5 * np.sin(2 * s.angle_rad))) for s in states]
    return problem_of(wrong)


@pytest.mark.parametrize("equation", MISFITS)
def test_gains_scale_no_misfit_away_however_large_it_is(campaign_states, equation):
    for size in (1.0, 10.0, 100.0):
        found = misfitting(campaign_states, equation, size)
        held = np.array([0.0 if name in GAINS else 1.0 for name in found.names])
        without, free = Marginal(found, scale=held).misfit, Marginal(found).misfit
        assert free > 0.97 * without, size


@pytest.mark.parametrize("equation", MISFITS)
@pytest.mark.parametrize("size", [1.0, 10.0])
def test_a_large_misfit_leaves_gains_where_they_are_known_to_be(campaign_states, equation, size):
    """From 1 V, 20 N, 0.1 V, 0.3 A on, noise as large as what is left: a gain of -100 % is a hundred sigmas."""
    found = misfitting(campaign_states, equation, size)
    share = np.sqrt(SETTINGS.weights.quiet * len(found.data) / Marginal(found).misfit)
    assert share < 0.15, "the misfit is too small to say anything"
    mean, _ = Marginal(replace(found, data=share * found.data, nuisance=share * found.nuisance)).estimate()
    shifts = {name: abs(value) for name, value in zip(found.names, mean, strict=True) if name in GAINS}
    assert len(shifts) == len(GAINS)
    assert max(shifts.values()) < 3.0, shifts


def test_without_a_misfit_nothing_is_shifted(problem):
    """Nominal numbers are the true ones here; the wood alone has to be found."""
    mean, _ = Marginal(problem).estimate()
    wood = [name for name in problem.names if name.startswith("k_fc")]
    assert len(wood) == 1 + 4  # one stock, four pieces of it
    shifts = {name: abs(value) for name, value in zip(problem.names, mean, strict=True) if name not in wood}
    assert max(shifts.values()) < 3.0, shifts
    assert dict(zip(problem.names, mean * problem.prior_std, strict=True))["k_fc of oak"] == pytest.approx(
        240, rel=0.05
    )


def test_columns_of_the_catalogue_are_the_signatures_of_every_trial(problem):
    names = ("edge_force", "gear_eccentricity", "tooth_passing_ripple", "yoke_backlash", "converter_diode_drop")
    effects = [EFFECT_BY_NAME[name] for name in names]
    found = catalogue_columns(problem, effects)
    for effect in effects:
        assert [column.shape for column in found[effect.name]] == list(effect.shapes)
        for column in found[effect.name][:: max(len(effect.shapes) // 4, 1)]:
            waves = [
                problem.project(lambda s, k=k, e=effect, c=column: e.signatures(BASELINE, s, c.shape)[k])
                for k in range(column.columns.shape[1])
            ]
            assert np.allclose(column.columns, effect.strength.typical * np.column_stack(waves), atol=1e-9)


def test_an_effect_that_no_trial_can_show_has_no_columns(campaign_states):
    in_air = problem_of([s for s in campaign_states if s.setting.is_idle])
    found = catalogue_columns(in_air, [EFFECT_BY_NAME["edge_force"], EFFECT_BY_NAME["windage_drag"]])
    assert found["edge_force"] == []
    assert len(found["windage_drag"]) == len(EFFECT_BY_NAME["windage_drag"].shapes)


def test_unwhitened_features_are_those_of_the_signature(problem):
    stacked = problem.project(friction)
    for part in problem.parts:
        waves = {"mechanical": np.broadcast_to(friction(part.smooth)["mechanical"], part.smooth.angle_rad.shape)}
        assert np.allclose(part.unwhiten(stacked), part.layout.place(waves, part.times), atol=1e-12)


def test_a_gain_leaves_nothing_however_the_speed_is_read_within_the_stroke(campaign_states):
    """A battery current that is a tenth too large, read beside an angle that swings: both are weighted alike."""
    swing = 1.0 + 0.3 * np.cos(7.0 * campaign_states[0].angle_rad[:1])
    states = [
        replace(s, speed_rad_s=s.speed_rad_s * swing, battery_current_a=1.1 * s.setting.duty * s.current_a)
        for s in campaign_states
        if s.kind == "running"
    ]
    problem = problem_of(states)
    for part in problem.parts:
        place = part.layout.slices["converter"]
        excess = {"converter": 0.1 * part.setting.duty * part.smooth.current_a}
        data, column = (
            x.reshape(-1, part.layout.size)[:, place] for x in (problem.data[part.place], part.whiten(excess))
        )
        left = data - column * (np.sum(data * column) / np.sum(column**2))
        assert np.linalg.norm(left) < 0.02 * np.linalg.norm(data)


def sharp_teeth(first, overtone, seed=5):
    """Evidence of a sharp tooth's six columns, and of its fundamental alone, for a gap of that composition."""
    problem = small_problem(1)
    effect = EFFECT_BY_NAME["tooth_passing_ripple"]
    columns = 3.0 * np.random.default_rng(seed).standard_normal((N_ROWS, 6))
    gap = columns @ np.array([first, 0.0, 0.0, overtone, 0.0, 0.0])
    problem = replace(problem, data=problem.data + gap)
    marginal = Marginal(problem)
    shape = next(shape for shape in effect.shapes if shape["sharp"])
    whole, alone = (
        explain(marginal, [Column(effect=effect, shape=shape, columns=columns[:, :count])]).log_evidence
        for count in (6, 2)
    )
    return whole, alone


def test_overtones_without_a_fundamental_are_no_tooth():
    whole, alone = sharp_teeth(0.0, 1.0)
    assert whole <= alone < 10.0


def test_overtones_beside_their_fundamental_count():
    whole, alone = sharp_teeth(1.0, 1.0)
    assert whole > alone + 20.0


def test_the_form_of_an_exponent_misses_a_share_of_what_it_differs_from_one():
    """0.8 with a form known to a quarter is 0.8 +- 0.05, and is there; a force of 8 N is known to 2 N."""
    found = {}
    for name, shape, amplitude in (
        ("cutting_speed_exponent", {"exponent": 0.8}, 1.0), ("guide_friction", None, 1.0),
    ):  # fmt: skip
        effect = EFFECT_BY_NAME[name]
        column = Column(effect=effect, shape=shape or effect.shapes[0], columns=np.ones((3, 1)))
        found[name] = Explanation(
            effect=effect, log_evidence=1.0, column=column, amplitude=amplitude, amplitude_std=1e-6, gain=1.0,
            contribution=np.ones(3), form_share=0.25,
        )  # fmt: skip
    exponent, force = found.values()
    assert exponent.strength == pytest.approx(0.8)
    assert exponent.absent == 1.0
    assert exponent.strength_std == pytest.approx(0.25 * 0.2, rel=1e-3)
    assert force.absent == 0.0
    assert force.strength_std == pytest.approx(0.25 * force.strength, rel=1e-3)


@pytest.mark.parametrize(("amplitude_std", "is_seen"), [(0.25, True), (0.45, True), (0.6, False)])
def test_forms_make_a_magnitude_uncertain_and_only_noise_makes_an_effect_doubtful(amplitude_std, is_seen):
    """A compliant blade of 1.6 typical sizes, 3.6 standard deviations of the noise, was "no gap" for its forms."""
    effect = EFFECT_BY_NAME["guide_friction"]
    column = Column(effect=effect, shape=effect.shapes[0], columns=np.ones((3, 1)))
    found = Explanation(
        effect=effect, log_evidence=6.0, column=column, amplitude=1.0, amplitude_std=amplitude_std, gain=6.0,
        contribution=np.ones(3), form_share=0.4,
    )  # fmt: skip
    assert found.strength_std == pytest.approx(max(0.5, amplitude_std) * found.strength)
    assert is_there(found) == is_seen
