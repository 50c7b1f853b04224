"""The stated size of an effect: mixtures of its forms, what nuisances may hide of it, and where each form states it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.size import is_mixable, mixed, sized
from sawbench.diagnosis.slow_states import slow_tracks
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.heat import COPPER_HEAT, SPIN_HEAT, friction_loss_w

pytestmark = pytest.mark.unit

N_ROWS = 300
RNG = np.random.default_rng(0)
FIRST, SECOND, OTHER = 10.0 * RNG.standard_normal((3, N_ROWS))


def columns_of(name, *waves):
    effect = EFFECT_BY_NAME[name]
    return [Column(effect=effect, shape=effect.shapes[k], columns=wave[:, None]) for k, wave in enumerate(waves)]


def problem_of(data, *nuisances):
    nuisance = np.array(nuisances).T if nuisances else np.zeros((N_ROWS, 0))
    return LinearProblem(
        campaign=None, parts=(), data=data, known=0.0 * data, nuisance=nuisance,
        names=("n",) * len(nuisances), prior_std=np.ones(len(nuisances)),
    )  # fmt: skip


def size_of(problem, columns, *, small=None, dispersion=1.0):
    found = explain(Marginal(problem), columns)
    return mixed(problem, found, columns, beside=(), small=small or {}, dispersion=dispersion)


def noise(seed):
    return np.random.default_rng(seed).standard_normal(N_ROWS)


def test_a_form_between_two_of_the_catalogue_keeps_its_size():
    """A nuisance that bends the one form towards the other takes a part of the size of the best single form."""
    columns = columns_of("brush_voltage_drop", FIRST, SECOND)
    bent = 0.5 * (FIRST - SECOND) + 0.3 * FIRST
    for seed in range(20):
        problem = problem_of(0.8 * FIRST + 0.4 * SECOND + noise(seed), bent)
        alone, found = explain(Marginal(problem), columns), size_of(problem, columns)
        size, std = found.mixture
        assert abs(alone.amplitude - 1.2) > 0.2
        assert abs(size - 1.2) < 2.0 * std
        assert found.strength == pytest.approx(size * 0.8)
        assert found.strength_std >= 0.8 * std


def test_forms_that_look_alike_and_state_other_numbers_make_a_size_uncertain_not_doubtful():
    """The same wave stands for 1 or for 20: which it is nobody can say, but something is there beyond doubt."""
    nearly = FIRST + 1e-3 * OTHER
    columns = columns_of("brush_voltage_drop", FIRST, nearly / 20.0)
    size, std = size_of(problem_of(2.0 * FIRST + noise(3)), columns).mixture
    assert 0.0 < 1.96 * std < 1.2 * size


@pytest.mark.parametrize(("hidden", "is_there"), [(0.4, True), (1.5, False)])
def test_a_size_that_is_right_to_a_factor_of_two_is_there_unless_the_noise_alone_hides_it(hidden, is_there):
    """What a nuisance may hide does not add to the factor by which forms disagree."""
    columns = columns_of("brush_voltage_drop", FIRST, (FIRST + 1e-3 * OTHER) / 20.0)
    problem = problem_of(2.0 * FIRST + noise(3), hidden * FIRST)
    size, std = size_of(problem, columns).mixture
    assert std > 0.0
    assert (1.96 * std < abs(size)) == is_there


def test_what_a_nuisance_may_hide_is_known_no_better_on_a_quiet_bench():
    """Sure data, and a gain of 30 % that looks like the effect: the size is known to 30 %, whatever the noise."""
    columns = columns_of("edge_force", FIRST)
    problem = problem_of(2.0 * FIRST + noise(1), 0.3 * FIRST)
    stds = [size_of(problem, columns, dispersion=d).mixture[1] for d in (1.0, 20.0)]
    assert stds[0] == pytest.approx(0.3, rel=0.01)
    assert stds[1] == pytest.approx(0.3, rel=0.05)


def test_noise_alone_counts_as_the_weighing_counts_it():
    columns = columns_of("edge_force", FIRST)
    problem = problem_of(2.0 * FIRST + noise(2))
    one, four = (size_of(problem, columns, dispersion=d).mixture[1] for d in (1.0, 4.0))
    assert four == pytest.approx(2.0 * one)


def test_a_little_of_another_effect_widens_the_size_and_does_not_move_it():
    columns = columns_of("edge_force", FIRST)
    problem = problem_of(FIRST + 0.2 * (FIRST + OTHER) + noise(3))
    alike = {"blade_wear": 0.1 * (FIRST + OTHER)[:, None], "edge_force": 0.1 * FIRST[:, None]}
    without, beside = size_of(problem, columns), size_of(problem, columns, small=alike)
    assert beside.mixture[0] == without.mixture[0]
    assert beside.mixture[1] > 1.5 * without.mixture[1]
    own = size_of(problem, columns, small={"edge_force": alike["edge_force"]})
    assert own.mixture == pytest.approx(without.mixture)


def test_what_noise_leaves_of_a_mixture_is_half_of_its_size_at_most():
    """A size four standard deviations of the noise from zero is there, whatever nature's form may be."""
    columns = columns_of("brush_voltage_drop", FIRST, SECOND)
    size, std = size_of(problem_of(4.0 / np.linalg.norm(FIRST) * FIRST), columns).mixture
    assert 0.2 * size < std <= 0.5 * size
    size, std = size_of(problem_of(1.5 / np.linalg.norm(FIRST) * FIRST), columns).mixture
    assert std > 0.6 * size


def test_of_two_effects_each_is_sized_beside_the_other():
    both = {"edge_force": columns_of("edge_force", FIRST), "blade_wear": columns_of("blade_wear", 0.7 * FIRST + OTHER)}
    problem = problem_of(1.5 * FIRST + 1.0 * (0.7 * FIRST + OTHER) + noise(4))
    members = [explain(Marginal(problem), columns) for columns in both.values()]
    found = sized(problem, members, both, small={}, dispersion=1.0)
    assert [m.mixture[0] for m in found] == pytest.approx([1.5, 1.0], abs=0.05)
    assert members[0].amplitude > 1.8


def test_a_falling_zero_is_a_negative_drift():
    effect = EFFECT_BY_NAME["force_offset_drift"]
    columns = [
        Column(effect=effect, shape=shape, columns=shape["direction"] * wave[:, None])
        for shape, wave in zip(effect.shapes, np.repeat([FIRST, SECOND, FIRST + SECOND, OTHER], 2, axis=0), strict=True)
    ]
    found = size_of(problem_of(-0.5 * FIRST - 0.7 * SECOND + noise(5)), columns)
    assert found.strength == pytest.approx(-1.2 * effect.strength.typical, rel=0.3)
    assert found.strength < 0.0 < found.strength_std


def test_forms_that_carry_their_number_in_their_shape_are_not_mixed():
    assert not is_mixable(columns_of("cutting_speed_exponent", FIRST, SECOND))
    assert not is_mixable(columns_of("current_sensor_lag", FIRST, SECOND))
    eccentric = EFFECT_BY_NAME["gear_eccentricity"]
    assert not is_mixable([Column(effect=eccentric, shape=eccentric.shapes[0], columns=np.stack([FIRST, OTHER], 1))])
    columns = columns_of("cutting_speed_exponent", FIRST, SECOND)
    problem = problem_of(FIRST + noise(6))
    found = explain(Marginal(problem), columns)
    assert mixed(problem, found, columns, beside=(), small={}, dispersion=1.0) is found


def test_forms_that_are_alike_or_hidden_have_no_size_of_their_own_and_of_the_wrong_sign_there_is_none():
    twice = columns_of("edge_force", FIRST, FIRST, SECOND)
    assert size_of(problem_of(2.0 * FIRST + noise(7)), twice).mixture[0] == pytest.approx(2.0, abs=0.1)
    hidden = columns_of("edge_force", FIRST, 1e5 * OTHER)
    found = size_of(problem_of(FIRST + noise(8), 1e5 * OTHER), hidden)
    assert np.isfinite(found.strength) and found.strength_std < 40.0 * 2.0
    negative = problem_of(-2.0 * FIRST + noise(9))
    assert size_of(negative, columns_of("edge_force", FIRST)).strength == 0.0


def state_of(**known):
    ones = np.ones((1, 1))
    setting = {"duty": 0.4, "is_idle": False, "thickness_m": 0.02, "session_s": 1000.0} | known.pop("setting", {})
    return SimpleNamespace(
        current_a=10.0 * ones, cut_distance_m=10.0 * ones, time_s=0.0 * ones, kind="running",
        k_guess_n_s_per_m=240.0, setting=SimpleNamespace(**setting), **known,
    )  # fmt: skip


CUTTING = SimpleNamespace(
    cutting_sign=1,
    radius_m=0.01,
    travelled=lambda _: np.full((1, 1), 0.01),
    cutting_speed=lambda _: np.full((1, 1), 0.5),
    blade_velocity=lambda _: np.full((1, 1), -0.5),
    expected_force=lambda _: np.full((1, 1), 100.0),
    stock_force=lambda _: np.full((1, 1), 100.0),
    load_torque=lambda _, force: 0.0 * force,
)


@pytest.mark.parametrize(
    ("name", "equation", "expected", "tolerance"),
    [
        ("brush_voltage_drop", "electrical", 1.0, 0.005),  # V at 10 A
        ("blade_wear", "cutting", 100.0, 1e-9),  # growth over 10 m
        ("force_offset_drift", "cutting", 1.0, 1e-9),  # over 1000 s
        ("edge_force", "cutting", 1.0, 0.005),  # for 20 mm, 240 N*s/m
        ("return_stroke_rubbing", "cutting", -0.5, 1e-9),  # at 0.5 m/s and mid stroke, for 20 mm, 240 N*s/m
    ],
)
def test_every_form_states_the_same_number(name, equation, expected, tolerance):
    effect = EFFECT_BY_NAME[name]
    for shape in effect.shapes:
        found = effect.signature(CUTTING, state_of(), **shape)[0][equation]
        assert float(found[0, 0]) == pytest.approx(expected * shape.get("direction", 1.0), rel=tolerance), shape


def test_every_form_of_the_diode_states_its_voltage_at_10_ampere():
    effect = EFFECT_BY_NAME["converter_diode_drop"]
    for shape in effect.shapes:
        found = effect.signature(CUTTING, state_of(), **shape)[0]["electrical"]
        assert float(found[0, 0]) == pytest.approx(0.6 + shape["dead_share"]), shape


@pytest.mark.parametrize("name", ["edge_force", "return_stroke_rubbing"])
def test_a_force_by_stock_follows_the_thickness_and_the_coefficient_where_that_is_unknown(name):
    effect = EFFECT_BY_NAME[name]
    by_thickness, by_coefficient = (next(s for s in effect.shapes if s["by_stock"] == way) for way in (1.0, 2.0))

    def force(thickness_m, k_n_s_per_m, shape=by_thickness):
        state = state_of(setting={"thickness_m": thickness_m})
        state = replace_guess(state, k_n_s_per_m)
        return abs(float(effect.signature(CUTTING, state, **shape)[0]["cutting"][0, 0]))

    assert force(0.03, 300.0) == pytest.approx(1.5 * force(0.02, 300.0))
    assert force(0.03, 600.0) == force(0.03, 300.0)
    assert force(np.nan, 600.0) == pytest.approx(2.0 * force(np.nan, 300.0))
    # In harder wood the edge meets more force, whatever its thickness.
    assert force(0.03, 480.0, by_coefficient) == pytest.approx(2.0 * force(0.02, 240.0, by_coefficient))
    assert force(0.03, 240.0, by_coefficient) == pytest.approx(force(0.02, 240.0))


def replace_guess(state, k_n_s_per_m):
    state.k_guess_n_s_per_m = k_n_s_per_m
    return state


STARTED = datetime(2026, 11, 24, tzinfo=UTC)


def spinning(rad_s, seconds, **trial):
    setting = {"started_at": None, "is_idle": True, "duty": 0.4, "battery": None, "blade": None} | trial
    time_s = np.linspace(0.0, seconds, 1001)
    angle = SimpleNamespace(time_s=time_s, angle_rad=rad_s * time_s)
    return SimpleNamespace(trial=SimpleNamespace(**setting), channels={}, angle=angle)


def test_friction_warms_the_housing_of_an_idle_machine():
    """At 90 rad/s of the crank for 45 s: a mass of 15 s is warm but for exp(-3), one of 900 s for nearly all."""
    (track,) = slow_tracks([spinning(90.0, 45.0)], stroke_m=0.02)
    end = {memory: track.at(held, np.array([45.0])) for memory, held in track.memories.items()}
    for tau, memory in SPIN_HEAT.items():
        assert float(end[memory][0, 0]) == pytest.approx(8100.0 * (1.0 - np.exp(-45.0 / tau)), rel=0.01)
        assert float(end[COPPER_HEAT[tau]][0, 0]) == 0.0
    damping = SimpleNamespace(nominal=5e-6)
    baseline = SimpleNamespace(gear=10.0, plant=SimpleNamespace(motor_damping_n_m_s_per_rad=damping))
    heat_w = friction_loss_w(baseline, SimpleNamespace(slow=end), 15.0, 15.0, 1.0)
    assert float(heat_w[0, 0]) == pytest.approx(5e-6 * 900.0**2 * (1.0 - np.exp(-3.0)), rel=0.01)


def test_a_battery_that_is_swapped_rests_meanwhile_and_the_machine_does_not():
    def trial(start_s, battery):
        found = spinning(90.0, 30.0, started_at=STARTED + timedelta(seconds=start_s), battery=battery)
        time_s = np.linspace(0.0, 30.0, 601)
        found.channels = {"battery_current_a": SimpleNamespace(time_s=time_s, values=np.full(601, 8.0))}
        return found

    tracks = slow_tracks([trial(0.0, "A"), trial(40.0, "B"), trial(80.0, "A")], stroke_m=0.02)
    assert [track.battery for track in tracks] == [0, 1, 0]
    drawn = [memory for memory in tracks[0].memories if memory.drive == "battery_current_a"]
    assert drawn
    for memory in drawn:
        tau = memory.time_constant_s
        first, second, third = (track.memories[memory] for track in tracks)
        assert second == pytest.approx(first)
        # Its first value is of the end of the first step of 20 ms.
        step = np.exp(-0.02 / tau)
        assert third[0] == pytest.approx(step * first[-1] * np.exp(-50.0 / tau) + 8.0 * (1.0 - step), rel=1e-3)
    for memory in SPIN_HEAT.values():
        first, second, _ = (track.memories[memory] for track in tracks)
        assert second[0] > 0.5 * first[-1] * np.exp(-10.0 / memory.time_constant_s)
