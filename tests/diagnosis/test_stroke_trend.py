"""Wear and chip thickness are read off single strokes; wood that only scatters is not taken for them."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.hypothesis import Hypothesis, named
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.shared_course import shared_course
from sawbench.diagnosis.inference.stroke_evidence import (
    StrokesSay,
    sized_by_strokes,
    with_strokes,
)
from sawbench.diagnosis.inference.stroke_series import StrokeSeries
from sawbench.diagnosis.inference.stroke_trend import blocks_of, trend_evidence
from sawbench.diagnosis.inference.weighing import weigh
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.state import State, TrialSetting

from tests.rigs.remembering import remembering

pytestmark = pytest.mark.unit

WEAR, CHIP = "blade_wear", "chip_thickness"
TRENDS = {name: EFFECT_BY_NAME[name].strokes for name in (WEAR, CHIP)}
STROKE_M, RATE_HZ = 0.02, 13.0
# Duty, feed in mm/s, seconds: in a mixed order, as a campaign is run.
TRIALS = (
    (0.44, 4, 8), (0.35, 4, 8), (0.55, 4, 8), (0.44, 6, 8), (0.35, 4, 8), (0.55, 4, 8), (0.44, 4, 8),
    (0.55, 4, 8), (0.44, 6, 8), (0.35, 4, 8), (0.44, 4, 30),
)  # fmt: skip


def campaign(
    seed, *, trials=TRIALS, growth_per_10_m=0.0, exponent=0.0, speed_power=0.0, memory=0.3, piece=0.04, slowed=0.0,
    uneven=0.0, courses=(0.0,),
):  # fmt: skip
    """States and strokes of a bench whose wood scatters by 4.5 % a stroke and 4 % a piece; hard pieces slow the saw.

    Uneven wood is harder in some places: it is another after 60 strokes. Courses start again with every trial: one for
    all, or one for each.
    """
    rng = np.random.default_rng(seed)
    states, strokes, cut_m = [], [], 0.0
    for number, (duty, feed_mm_s, seconds) in enumerate(trials):
        hard = piece * rng.standard_normal()
        rate_hz = RATE_HZ * duty / 0.44 * np.exp(-slowed * hard)
        n = int(seconds * rate_hz)
        scatter = remembering(rng, memory, n) + uneven / 0.045 * remembering(rng, np.exp(-1.0 / 60.0), n)
        distance_m = cut_m + STROKE_M * np.arange(n)
        chip = (feed_mm_s / rate_hz) / (4 / RATE_HZ)
        k = 300.0 * np.exp(0.045 * scatter + hard)
        k *= (1.0 + growth_per_10_m * (distance_m / 10.0) ** 0.8) * chip**exponent * (rate_hz / RATE_HZ) ** speed_power
        time_s = np.arange(n) / rate_hz
        k *= np.exp(courses[number % len(courses)] * (1.0 - np.exp(-time_s / 1.5)))
        strokes.append(
            StrokeSeries(
                label=f"t{number}", material="oak", feed_m_s=1e-3 * feed_mm_s, rate_hz=rate_hz,
                log_k=np.log(k / k.mean()), k_n_s_per_m=k, time_s=time_s,
            )
        )  # fmt: skip
        states.append(running(number, duty, feed_mm_s, rate_hz, time_s, distance_m))
        cut_m = float(distance_m[-1])
    return states, strokes


def running(number, duty, feed_mm_s, rate_hz, time_s, distance_m):
    setting = TrialSetting(
        label=f"t{number}", index=number, duty=duty, is_idle=False, stock="oak, 20 mm", feed_m_s=1e-3 * feed_mm_s,
        thickness_m=0.02, operating_point=f"duty {duty}", session_s=100.0 * number,
    )  # fmt: skip
    at = np.linspace(0, len(time_s) - 1, 6).astype(int)
    wave = np.zeros((6, 4))
    return State(
        kind="running", setting=setting, angle_rad=wave, speed_rad_s=wave + 2 * np.pi * rate_hz,
        acceleration_rad_s2=wave, current_a=None, current_rate_a_s=None, force_n=wave, force_rate_n_s=None,
        battery_voltage_v=None, battery_current_a=None, motor_voltage_v=wave, time_s=time_s[at, None],
        cut_distance_m=distance_m[at, None], charge_used_as=wave[:, :1], n_strokes=np.full(6, 16.0),
    )  # fmt: skip


def trend(seed, **nature):
    return trend_evidence(blocks_of(*campaign(seed, **nature)), TRENDS)


def course(seed, **nature):
    return shared_course(blocks_of(*campaign(seed, **nature)))


def says(found, effect):
    return StrokesSay(
        effect=EFFECT_BY_NAME[effect], alone=found.alone, beside_cutting=found.beside_cutting, size=found.size,
        size_std=found.size_std,
    )  # fmt: skip


@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_a_wood_that_only_scatters_is_neither_worn_nor_thick(memory):
    found = [trend(seed, memory=memory) for seed in range(8)]
    for effect in (WEAR, CHIP):
        assert np.mean([t[effect].alone for t in found]) < 0.0
        assert max(max(t[effect].alone, t[effect].beside_cutting) for t in found) < 4.0


def test_short_trials_that_only_scatter_are_neither_worn_nor_thick():
    """Two blocks a trial leave no scatter about a line; six trials of 4 s were called worn with 40 nats and more."""
    short = tuple((duty, feed, 4) for duty, feed, _ in TRIALS[:6])
    found = [trend(seed, trials=short) for seed in range(12)]
    for effect in (WEAR, CHIP):
        assert max(max(t[effect].alone, t[effect].beside_cutting) for t in found) < 4.0


def test_wood_that_is_harder_in_some_places_is_neither_worn_nor_thick():
    """Its hardness rises or falls throughout a trial; mean strokes called that wear with 17 nats."""
    found = [trend(seed, uneven=0.045) for seed in range(16)]
    for effect in (WEAR, CHIP):
        assert max(max(t[effect].alone, t[effect].beside_cutting) for t in found) < 4.0


@pytest.mark.parametrize("seconds", [1.3, 2.2])
def test_short_trials_of_uneven_wood_show_no_trend(seconds):
    """They cannot tell a slope along the cut from a piece's own hardness, so a trial is as good as one number.

    Odds of 20 to one come by chance once in 20 times at most, where they are what they say.
    """
    trials = [(duty, feed, seconds) for duty, feed, _ in TRIALS]
    found = [trend(seed, trials=trials, uneven=0.045) for seed in range(40)]
    for effect in (WEAR, CHIP):
        assert np.mean([t[effect].alone > np.log(20.0) for t in found]) <= 1.0 / 20.0
        assert np.mean([t[effect].beside_cutting > np.log(20.0) for t in found]) <= 1.0 / 20.0


def test_a_hard_piece_that_slows_the_saw_is_no_thin_chip():
    """Cause and effect the other way round: the speed of a trial follows the hardness of its piece."""
    one_setting = ((0.44, 4, 8),) * 25
    found = [trend(seed, trials=one_setting, slowed=0.5)[CHIP] for seed in range(6)]
    assert max(max(t.alone, t.beside_cutting) for t in found) < 2.0


def test_wear_is_seen_whether_or_not_another_effect_of_the_cut_may_act():
    found = trend(3, growth_per_10_m=0.12)
    assert found[WEAR].alone > 6.0
    assert found[WEAR].beside_cutting > 4.0
    assert found[CHIP].alone < 1.0


def test_a_chips_thickness_is_seen_by_feed_and_stroke_rate():
    found = trend(4, exponent=0.6)
    assert found[CHIP].alone > 8.0
    assert found[WEAR].alone < 2.0


@pytest.mark.parametrize(
    ("effect", "true", "nature"), [(WEAR, 0.12, "growth_per_10_m"), (CHIP, 0.6, "exponent"), (CHIP, 0.3, "exponent")]
)
def test_sizes_from_the_strokes_hold_their_uncertainty(effect, true, nature):
    found = [trend(seed, **{nature: true})[effect] for seed in range(20, 26)]
    away = [(f.size - true) / f.size_std for f in found]
    assert np.max(np.abs(away)) < 3.0
    assert 0.2 < np.sqrt(np.mean(np.square(away))) < 1.6
    assert all(f.size_std < 0.6 * true for f in found)


def of_chips(shape=MappingProxyType({"exponent": 0.45}), **numbers):
    """What mean strokes say of the chip's thickness in one form."""
    found = {"log_evidence": 1.0, "amplitude": 0.1, "amplitude_std": 0.1, "gain": 1.0} | numbers
    column = Column(effect=EFFECT_BY_NAME[CHIP], shape=dict(shape), columns=np.ones((3, 1)))
    return Explanation(effect=EFFECT_BY_NAME[CHIP], column=column, contribution=np.ones(3), **found)


def test_strokes_state_the_size_where_they_speak_for_it():
    explanation = of_chips()
    said = says(trend(4, exponent=0.6)[CHIP], CHIP)
    sized = sized_by_strokes(explanation, {CHIP: said})
    assert (sized.strength, sized.strength_std) == pytest.approx((said.size, said.size_std))
    silent = says(trend(3, growth_per_10_m=0.12)[CHIP], CHIP)
    assert silent.beside_cutting < 0.0
    assert sized_by_strokes(explanation, {CHIP: silent}) is explanation
    assert sized_by_strokes(explanation, {}) is explanation


def test_mean_strokes_state_the_size_where_they_know_it_better():
    explanation = of_chips(log_evidence=50.0, amplitude=1.3, amplitude_std=0.01, gain=100.0)
    said = says(trend(4, exponent=0.6)[CHIP], CHIP)
    assert said.size_std / said.size > 2.0 * explanation.strength_std / explanation.strength
    assert sized_by_strokes(explanation, {CHIP: said}) is explanation


def test_a_cutting_law_that_bends_with_speed_is_no_chip_where_it_may_act():
    """Hardness falls with speed as it would for a thick chip; the feed changes nothing."""
    found = [trend(seed, speed_power=-0.5) for seed in (5, 6, 7)]
    assert np.mean([t[CHIP].alone for t in found]) > 1.0
    assert np.mean([t[CHIP].beside_cutting for t in found]) < 0.5


def test_a_wave_that_lasts_longer_than_a_trial_is_no_wear():
    """Scatter whose memory outlasts a block is fitted as such."""
    found = [trend(seed, memory=0.95) for seed in range(8)]
    assert max(t[WEAR].alone for t in found) < 4.0


@pytest.mark.parametrize("memory", [0.0, 0.8])
@pytest.mark.parametrize("reach", [-0.2, 0.15])
def test_a_course_that_starts_again_with_every_trial_is_no_wood_and_no_wear(memory, reach):
    nature = {"memory": memory, "courses": (reach,)}
    assert course(3, **nature) > max(5.0, trend(3, **nature)[WEAR].alone + 5.0)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_trials_that_each_have_a_course_of_their_own_are_wood(memory):
    found = []
    for seed in range(6):
        reaches = tuple(np.random.default_rng(seed).normal(0.0, 0.15, len(TRIALS)))
        found += [course(seed, memory=memory), course(seed, memory=memory, courses=reaches)]
    assert max(found) < 1.0


def test_a_course_as_small_as_pieces_of_wood_differ_is_no_evidence():
    assert course(3, courses=(0.12,)) > 5.0
    assert course(3, courses=(0.04,)) <= 0.0


def test_wear_does_not_start_again_with_every_trial():
    nature = {"growth_per_10_m": 0.2}
    assert course(3, **nature) < trend(3, **nature)[WEAR].alone - 5.0


def test_two_trials_do_not_tell_a_shared_course_from_their_own():
    assert course(3, courses=(0.2,), trials=TRIALS[:2]) == 0.0


def test_trials_with_one_state_each_say_nothing_of_a_course():
    states, strokes = campaign(3, courses=(0.2,))
    one = [replace(s, time_s=s.time_s[:1], cut_distance_m=s.cut_distance_m[:1]) for s in states]
    blocks = blocks_of(one, strokes)
    assert shared_course(blocks) == 0.0
    assert np.isfinite(trend_evidence(blocks, TRENDS)[WEAR].alone)


@pytest.mark.parametrize("seconds", [1.3, 2.2])
def test_the_thickness_of_a_chip_is_found_in_short_trials(seconds):
    trials = [(duty, feed, seconds) for duty, feed, _ in TRIALS]
    cut = campaign(4, trials=trials, exponent=0.7, piece=0.01)
    assert max(len(series.log_k) for series in cut[1]) < 2 * SETTINGS.strokes.block
    found = trend_evidence(blocks_of(*cut), TRENDS)[CHIP]
    assert found.alone > 5.0
    assert found.size == pytest.approx(0.7, abs=2.0 * found.size_std)
    assert found.size_std < 0.2


def test_few_trials_say_nothing():
    states, strokes = campaign(1)
    assert blocks_of(states[:2], strokes[:2]) is None
    assert trend_evidence(None, TRENDS) == {}
    assert blocks_of(states, []) is None


def test_a_trial_whose_force_has_no_slope_is_left_out():
    states, strokes = campaign(1)
    dead = replace(strokes[2], k_n_s_per_m=np.zeros_like(strokes[2].k_n_s_per_m))
    blocks = blocks_of(states, [*strokes[:2], dead, *strokes[3:]])
    assert blocks is not None
    assert len(np.unique(blocks.trial)) == len(TRIALS) - 1
    assert np.isfinite(blocks.log_k).all()


def test_effects_that_leave_the_force_alone_do_not_make_the_cut_seem_harder():
    bending = {name for name, effect in EFFECT_BY_NAME.items() if effect.bends_hardness}
    assert {"edge_force", "preload_lift_off", "force_sensor_lag", "clock_offset"} <= bending
    assert not bending & {"force_offset_drift", "current_sensor_lag", "guide_friction", "winding_heating"}


def added(log_evidence, *, alone, beside=None, effect=WEAR):
    """Log evidence by hypothesis with what strokes say, and which hypotheses rest on them."""
    said = StrokesSay(
        effect=EFFECT_BY_NAME[effect], alone=alone, beside_cutting=alone if beside is None else beside, size=0.1,
        size_std=0.01,
    )  # fmt: skip
    found = with_strokes([named(name, value) for name, value in log_evidence.items()], said, EFFECT_BY_NAME, SETTINGS)
    return {h.name: h.log_evidence for h in found}, {h.name for h in found if h.of_strokes > 0.0}


def test_strokes_speak_for_an_effect_alone_and_beside_the_strongest_others():
    found, resting = added({WEAR: 5.0, "edge_force": 100.0, "guide_friction": 40.0}, alone=3.0)
    assert found[WEAR] == 3.0  # what mean strokes say of how hard a trial cuts is not counted again
    assert found[f"{WEAR} + edge_force"] == 100.0 + 3.0
    assert found["edge_force"] == 100.0
    assert resting == {WEAR, f"{WEAR} + edge_force", f"{WEAR} + guide_friction"}


@pytest.mark.parametrize(("shape", "expected"), [({"in_stroke": 1.0}, 60.0), ({}, 3.0)])
def test_a_chip_that_shapes_the_stroke_is_more_than_strokes_show(shape, expected):
    """Where the thickness follows the crank within the stroke, mean strokes know more of it than single ones."""
    member = of_chips({"exponent": 0.6} | shape)
    said = StrokesSay(effect=member.effect, alone=3.0, beside_cutting=3.0, size=0.6, size_std=0.1)
    by_means = Hypothesis(effects=(CHIP,), members=(member,), log_evidence=60.0)
    (found,) = with_strokes([by_means], said, EFFECT_BY_NAME, SETTINGS)
    assert found.log_evidence == expected


def test_what_mean_strokes_say_is_not_believed_where_single_strokes_speak_against_it():
    pair = f"{WEAR} + edge_force"
    found, resting = added({WEAR: 80.0, "edge_force": 100.0, pair: 190.0}, alone=-2.0)
    assert found[WEAR] == pytest.approx(-2.0)
    assert found[pair] == pytest.approx(100.0 - 2.0)
    assert not resting


def test_beside_another_effect_of_the_cut_the_strokes_say_less():
    found, _ = added({WEAR: 5.0, "edge_force": 100.0, "guide_friction": 40.0}, alone=5.0, beside=1.0)
    assert found[f"{WEAR} + edge_force"] == 100.0 + 1.0
    assert found[f"{WEAR} + guide_friction"] == 40.0 + 5.0


def test_strokes_count_for_two_effects_beside_a_third():
    three = f"{WEAR} + edge_force + guide_friction"
    evidence = {
        WEAR: 5.0,
        "edge_force": 90.0,
        "guide_friction": 40.0,
        "edge_force + guide_friction": 130.0,
        three: 150.0,
    }
    found, resting = added(evidence, alone=3.0, beside=2.0)
    assert found[three] == 130.0 + 2.0
    assert three in resting
    against, _ = added(evidence, alone=-2.0)
    assert against[three] == pytest.approx(130.0 - 2.0)


@pytest.mark.parametrize("alone", [0.0, -3.0])
def test_slow_changes_of_mean_strokes_are_no_grain_where_single_strokes_show_none(alone):
    pair = "edge_force + grain_variation"
    evidence = {"grain_variation": 12.0, "edge_force": 100.0, pair: 114.0}
    found, _ = added(evidence, alone=alone, effect="grain_variation")
    assert found["grain_variation"] == pytest.approx(alone)
    assert found[pair] == pytest.approx(100.0 + alone)


def test_a_grain_that_strokes_show_costs_nothing_beside_another_effect():
    found, _ = added({"grain_variation": 5.0, "edge_force": 100.0}, alone=50.0, effect="grain_variation")
    assert found["edge_force + grain_variation"] == 100.0 + 50.0


@pytest.mark.parametrize("effect", [WEAR, "grain_variation"])
def test_a_second_name_does_not_make_the_strokes_speak_louder(effect):
    """An effect that says nothing of its own beside it gains nothing."""
    log_evidence = {"no_gap": 0.0, "parameters": -1.0, "unknown": -5.0, effect: 0.0, "guide_friction": 0.0}
    found, _ = added(log_evidence, alone=400.0, effect=effect)
    pair = " + ".join(sorted((effect, "guide_friction")))
    assert found[pair] <= found[effect]
    weighed = weigh(
        [named(n, v, left_over=3.0 if n == "no_gap" else 0.2, shared=0.0) for n, v in found.items()], n_effects=29
    )
    assert {h.name: h.probability for h in weighed}[effect] > 0.9
