"""Wear and chip thickness are read off single strokes; wood that only scatters is not taken for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effects.catalogue import EFFECT_BY_NAME
from diagnosis.evidence import Column, Explanation
from diagnosis.posterior import _STROKES_PRICE, STROKE_WEIGHT, _add_strokes, sized_by_strokes
from diagnosis.state import State, TrialSetting
from diagnosis.stroke_series import Grain, StrokeSeries
from diagnosis.stroke_trend import CHIP, WEAR, bends_force, blocks_of, trend_evidence
from diagnosis.weighing import weigh

STROKE_M, RATE_HZ = 0.02, 13.0
# Duty, feed in mm/s, seconds: in a mixed order, as a campaign is run.
TRIALS = (
    (0.44, 4, 8), (0.35, 4, 8), (0.55, 4, 8), (0.44, 6, 8), (0.35, 4, 8), (0.55, 4, 8), (0.44, 4, 8),
    (0.55, 4, 8), (0.44, 6, 8), (0.35, 4, 8), (0.44, 4, 30),
)  # fmt: skip


def campaign(seed, *, growth_per_10_m=0.0, exponent=0.0, speed_power=0.0, memory=0.3, piece=0.04):
    """States and strokes of a bench whose wood scatters by 4.5 % a stroke and 4 % a piece."""
    rng = np.random.default_rng(seed)
    states, strokes, cut_m = [], [], 0.0
    for number, (duty, feed_mm_s, seconds) in enumerate(TRIALS):
        rate_hz = RATE_HZ * duty / 0.44
        n = int(seconds * rate_hz)
        scatter = rng.standard_normal(n)
        for k in range(1, n):
            scatter[k] = memory * scatter[k - 1] + np.sqrt(1.0 - memory**2) * scatter[k]
        distance_m = cut_m + STROKE_M * np.arange(n)
        chip = (feed_mm_s / rate_hz) / (4 / RATE_HZ)
        k = 300.0 * np.exp(0.045 * scatter + piece * rng.standard_normal())
        k *= (1.0 + growth_per_10_m * (distance_m / 10.0) ** 0.8) * chip**exponent * (rate_hz / RATE_HZ) ** speed_power
        time_s = np.arange(n) / rate_hz
        strokes.append(
            StrokeSeries(
                label=f"t{number}", feed_m_s=1e-3 * feed_mm_s, rate_hz=rate_hz, log_k=np.log(k / k.mean()),
                k_n_s_per_m=k, time_s=time_s,
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
    return trend_evidence(blocks_of(*campaign(seed, **nature)))


@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_a_wood_that_only_scatters_is_neither_worn_nor_thick(memory):
    found = [trend(seed, memory=memory) for seed in range(8)]
    for effect in (WEAR, CHIP):
        assert np.mean([t.alone[effect] for t in found]) < 0.0
        assert max(max(t.alone[effect], t.beside_cutting[effect]) for t in found) < 4.0


def test_wear_is_seen_whether_or_not_another_effect_of_the_cut_may_act():
    found = trend(3, growth_per_10_m=0.12)
    assert found.alone[WEAR] > 6.0
    assert found.beside_cutting[WEAR] > 4.0
    assert found.alone[CHIP] < 1.0


def test_a_chips_thickness_is_seen_by_feed_and_stroke_rate():
    found = trend(4, exponent=0.6)
    assert found.alone[CHIP] > 8.0
    assert found.alone[WEAR] < 2.0


@pytest.mark.parametrize(
    ("effect", "true", "nature"), [(WEAR, 0.12, "growth_per_10_m"), (CHIP, 0.6, "exponent"), (CHIP, 0.3, "exponent")]
)
def test_sizes_from_the_strokes_hold_their_uncertainty(effect, true, nature):
    found = [trend(seed, **{nature: true}).sizes[effect] for seed in range(20, 26)]
    away = [(mean - true) / std for mean, std in found]
    assert np.max(np.abs(away)) < 3.0
    assert 0.2 < np.sqrt(np.mean(np.square(away))) < 1.6
    assert all(std < 0.6 * true for _, std in found)


def test_strokes_state_the_size_where_they_speak_for_it():
    explanation = Explanation(
        effect=EFFECT_BY_NAME[CHIP], log_evidence=1.0, amplitude=0.1, amplitude_std=0.1, gain=1.0,
        column=Column(effect=EFFECT_BY_NAME[CHIP], shape={"exponent": 0.45}, columns=np.ones((3, 1))),
        contribution=np.ones(3),
    )  # fmt: skip
    no_grain = Grain(log_evidence=0.0, depth=0.0, wavelength_m=np.nan, in_time=0.0)
    said = trend(4, exponent=0.6)
    sized = sized_by_strokes(explanation, no_grain, said)
    assert (sized.strength, sized.strength_std) == pytest.approx(said.sizes[CHIP])
    silent = trend(3, growth_per_10_m=0.12)
    assert silent.beside_cutting[CHIP] < 0.0
    assert sized_by_strokes(explanation, no_grain, silent) is explanation
    assert sized_by_strokes(explanation, no_grain, trend_evidence(None)) is explanation


def test_a_cutting_law_that_bends_with_speed_is_no_chip_where_it_may_act():
    """Hardness falls with speed as it would for a thick chip; the feed changes nothing."""
    found = [trend(seed, speed_power=-0.5) for seed in (5, 6, 7)]
    assert np.mean([t.alone[CHIP] for t in found]) > 3.0
    assert np.mean([t.beside_cutting[CHIP] for t in found]) < 0.5


def test_a_wave_that_lasts_longer_than_a_trial_is_no_wear():
    """Scatter whose memory outlasts a block is fitted as such."""
    found = [trend(seed, memory=0.95) for seed in range(8)]
    assert max(t.alone[WEAR] for t in found) < 4.0


def test_few_trials_say_nothing():
    states, strokes = campaign(1)
    assert blocks_of(states[:2], strokes[:2]) is None
    assert trend_evidence(None).alone == {}
    assert blocks_of(states, []) is None


def test_a_trial_whose_force_has_no_slope_is_left_out():
    states, strokes = campaign(1)
    dead = replace(strokes[2], k_n_s_per_m=np.zeros_like(strokes[2].k_n_s_per_m))
    blocks = blocks_of(states, [*strokes[:2], dead, *strokes[3:]])
    assert blocks is not None
    assert len(np.unique(blocks.trial)) == len(TRIALS) - 1
    assert np.isfinite(blocks.log_k).all()


def test_effects_that_leave_the_force_alone_do_not_make_the_cut_seem_harder():
    bending = {name for name, effect in EFFECT_BY_NAME.items() if bends_force(effect)}
    assert {"edge_force", "preload_lift_off", "force_sensor_lag", "clock_offset"} <= bending
    assert not bending & {"force_offset_drift", "current_sensor_lag", "guide_friction", "winding_heating"}


def added(log_evidence, *, alone, beside=None, is_whole=True):
    resting = _add_strokes(log_evidence, WEAR, alone=alone, beside=beside or {}, is_whole=is_whole)
    return log_evidence, resting


def test_strokes_speak_for_an_effect_alone_and_beside_the_strongest_others():
    found, resting = added({WEAR: 5.0, "edge_force": 100.0, "guide_friction": 40.0}, alone=3.0)
    assert found[WEAR] == 5.0 + STROKE_WEIGHT * 3.0 - _STROKES_PRICE
    assert found[f"{WEAR} + edge_force"] == 100.0 + STROKE_WEIGHT * 3.0 - _STROKES_PRICE
    assert found["edge_force"] == 100.0
    assert resting == {WEAR, f"{WEAR} + edge_force", f"{WEAR} + guide_friction"}


def test_what_mean_strokes_say_is_not_believed_where_single_strokes_speak_against_it():
    pair = f"{WEAR} + edge_force"
    found, resting = added({WEAR: 80.0, "edge_force": 100.0, pair: 190.0}, alone=-2.0)
    assert found[WEAR] == pytest.approx(-2.0 * STROKE_WEIGHT)
    assert found[pair] == pytest.approx(100.0 - 2.0 * STROKE_WEIGHT)
    assert not resting


def test_beside_another_effect_of_the_cut_the_strokes_say_less():
    pair = f"{WEAR} + edge_force"
    found, _ = added({WEAR: 5.0, "edge_force": 100.0, "guide_friction": 40.0}, alone=5.0, beside={"edge_force": 1.0})
    assert found[pair] == 100.0 + STROKE_WEIGHT - _STROKES_PRICE
    assert found[f"{WEAR} + guide_friction"] == 40.0 + 5.0 * STROKE_WEIGHT - _STROKES_PRICE


def test_a_grain_that_strokes_show_costs_nothing_beside_another_effect():
    found, _ = added({WEAR: 5.0, "edge_force": 100.0}, alone=50.0, is_whole=False)
    assert found[f"{WEAR} + edge_force"] == 100.0 + 50.0 * STROKE_WEIGHT


@pytest.mark.parametrize(("effect", "is_whole"), [(WEAR, True), ("grain_variation", False)])
def test_a_second_name_does_not_make_the_strokes_speak_louder(effect, is_whole):
    """An effect that says nothing of its own beside it gains nothing."""
    log_evidence = {"no_gap": 0.0, "parameters": -1.0, "unknown": -5.0, effect: 0.0, "guide_friction": 0.0}
    _add_strokes(log_evidence, effect, alone=400.0, beside={}, is_whole=is_whole)
    pair = " + ".join(sorted((effect, "guide_friction")))
    assert log_evidence[pair] <= log_evidence[effect]
    left = dict.fromkeys(log_evidence, 0.2) | {"no_gap": 3.0}
    found = weigh(log_evidence, left, n_effects=29, shared={pair: 0.0})
    assert found[effect] > 0.9
