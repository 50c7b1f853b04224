"""A withheld group is predicted by all that the others know of the cause: its size, its form, and how well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.answer.hold_out import HoldOut
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

SIZE = 3.0


@pytest.fixture(scope="module")
def problem():
    return problem_of(strokes())


@pytest.fixture(scope="module")
def waves(problem):
    """Signatures of a friction and of a rubbing blade, which have nothing in common."""
    effects = [EFFECT_BY_NAME[name] for name in ("motor_coulomb_friction", "return_stroke_rubbing")]
    found = catalogue_columns(problem, effects)
    return [found[effect.name][0].columns[:, 0] for effect in effects]


def climbed(problem, data, forms):
    """The groups, and what each form of a cause predicts of them."""
    hold_out = HoldOut(replace(problem, data=problem.data + data))
    ladder = hold_out.climb([[SIZE * form[:, None]] for form in forms])
    return hold_out, ladder


def strongest(problem, wave):
    hold_out = HoldOut(problem)
    sizes = {group: float(np.sum(wave[rows] ** 2)) for group, rows in hold_out.rows.items()}
    group = max(sizes, key=lambda name: sizes[name])
    return hold_out.groups.index(group), hold_out.rows[group]


def of_group(ladder, k):
    return {name: float(values[k]) for name, values in ladder.energy.items()}


def test_a_form_that_the_other_groups_leave_open_is_no_error_of_the_prediction(problem, waves):
    """Two forms that differ in one group alone: without it nobody can tell them apart."""
    wave = waves[0]
    k, rows = strongest(problem, wave)
    turned = np.where(rows, -wave, wave)
    for forms in ([turned, wave], [wave, turned]):
        _, ladder = climbed(problem, SIZE * wave, forms)
        energy = of_group(ladder, k)
        # The wrong one of the two misses twice the wave.
        assert energy["with_effect"] < 0.1 * np.sum((2.0 * SIZE * wave[rows]) ** 2)


def test_a_form_that_the_other_groups_exclude_predicts_nothing(problem, waves):
    friction, rubbing = waves
    k, rows = strongest(problem, friction)
    excluded = np.where(rows, -friction, rubbing)
    hold_out, ladder = climbed(problem, SIZE * np.where(rows, -friction, friction), [friction, excluded])
    energy = of_group(ladder, k)
    # The others say the other sign and know the size to one in seventy: it is missed by twice as much.
    fit = ladder.fits[hold_out.groups[k]]
    assert fit.amplitudes == pytest.approx([1.0], abs=0.05)
    assert energy["with_effect"] > 0.9 * (2.0 / fit.root.item()) ** 2
    squares = sum(float(of[k]) for of in ladder.squares["with_effect"].values())
    assert squares == pytest.approx(energy["with_effect"], rel=0.01)


def test_forms_that_fit_with_the_wrong_sign_do_not_push_out_the_right_one(problem, waves):
    """An amplitude is not below 0: four forms that would explain more backwards explain nothing."""
    friction, rubbing = waves
    data = SIZE * friction + 2.0 * SIZE * rubbing
    backwards = [-(SIZE * friction + share * SIZE * rubbing) for share in (1.7, 1.9, 2.1, 2.3)]
    hold_out, ladder = climbed(problem, data, [friction, *backwards])
    assert {ladder.fits[group].alternative for group in hold_out.groups} == {0}
    amplitudes = np.concatenate([ladder.fits[group].amplitudes for group in hold_out.groups])
    assert amplitudes == pytest.approx(np.ones(len(amplitudes)), abs=0.5)


def test_squares_leave_out_what_the_other_groups_do_not_know_of_the_size(problem, waves):
    """A part of the cause that one group alone shows: its size there is open, within its prior."""
    wave = waves[0]
    k, rows = strongest(problem, wave)
    parts = SIZE * np.stack([np.where(rows, 0.0, wave), np.where(rows, wave, 0.0)], axis=1)
    hold_out = HoldOut(replace(problem, data=problem.data + SIZE * wave))
    found = hold_out.climb([[parts]])
    left = {name: float(squares["mechanical"][k]) for name, squares in found.squares.items()}
    assert left["with_effect"] - left["noise_floor"] < 0.1 * (left["retuned"] - left["noise_floor"])
    # The prediction itself misses all of it, and says so in the unit of the channel.
    current, _ = found.by_channel["motor_current_a"]
    assert current.with_effect > 2.0 * current.noise_floor


def test_a_sensor_is_retuned_within_what_is_stated_of_it(problem):
    """A converter that loses a tenth is no gain of a current that is off by ten times what it is stated to be.

    The gains and zeros of both currents, and their change while an amplifier warms up, each take three times what is
    stated. Without that bound what is left would grow as the square of the loss.
    """
    wave = problem.nuisance[:, problem.names.index("battery_current_gain")]
    left = {n: HoldOut(replace(problem, data=n * wave)).climb([]).energy["retuned"].sum() for n in (2.0, 10.0, 20.0)}
    assert left[2.0] < 0.01 * len(wave)
    assert left[10.0] > 3.0 * (10.0 / 2.0) ** 2 * left[2.0]
    assert left[20.0] > len(wave)


def test_nuisances_may_be_nearly_alike_and_known_far_better_than_stated(problem, waves):
    """The shapes of a battery's curve, of which a campaign sees the beginning: their sum is known to a part in 10^6."""
    rng, nuisance = np.random.default_rng(5), problem.nuisance.copy()
    shapes = [k for k, name in enumerate(problem.names) if name.startswith("open_circuit_voltage")]
    assert len(shapes) >= 4
    common = rng.standard_normal(len(nuisance))
    for k in shapes:
        nuisance[:, k] = 1e4 * (common + 1e-4 * rng.standard_normal(len(nuisance)))
    _, ladder = climbed(replace(problem, nuisance=nuisance), SIZE * waves[0], [waves[0]])
    assert ladder.closed[0] > 0.9
