"""What every effect of the catalogue keeps: its name, a sane strength, finite signatures."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.diagnosis.inference.features import HARMONICS
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME, EFFECTS, MEMORIES, page
from sawbench.modeling.effects.grain_variation import WAVELENGTHS_M
from sawbench.modeling.effects.transfer import Spectrum
from sawbench.modeling.machines.table import JIGSAW, SLIDER_CRANK_SAW
from sawbench.modeling.residuals import residuals

from tests.rigs.drawn_states import (
    BASELINE,
    N_POINTS,
    N_TIMES,
    N_UNITS,
    RADIUS_M,
    make_baseline,
    running,
    setting_of,
    start_up,
)

pytestmark = pytest.mark.contract

# Names that other people's files rely on.
AGREED = (
    "guide_friction",
    "motor_coulomb_friction",
    "windage_drag",
    "load_dependent_friction",
    "yoke_backlash",
    "gear_eccentricity",
    "blade_compliance",
    "return_stroke_rubbing",
    "tooth_passing_ripple",
    "cutting_speed_exponent",
    "edge_force",
    "chip_thickness",
    "blade_wear",
    "grain_variation",
    "engagement_delay",
    "winding_heating",
    "magnet_weakening",
    "brush_voltage_drop",
    "converter_diode_drop",
    "converter_loss",
    "current_limit",
    "battery_internal_resistance",
    "battery_polarization",
    "carriage_resonance",
    "preload_lift_off",
    "force_sensor_lag",
    "current_sensor_lag",
    "clock_offset",
    "force_offset_drift",
)
# A lag of the load cell has nothing to lag where this ideal bench reads no force; a real one reads some.
NO_FORCE_TO_READ = {("force_sensor_lag", "air")}
SAW_EFFECTS = JIGSAW.effects(BASELINE)

ABSENT = (
    {},
    {"current_a": None, "current_rate_a_s": None},
    {"force_n": None, "force_rate_n_s": None},
    {"battery_current_a": None},
    {"battery_voltage_v": None, "battery_current_a": None},
    {"current_a": None, "current_rate_a_s": None, "battery_current_a": None, "force_n": None},
)


def few_shapes(effect) -> list[dict]:
    """Return every kind of shape of an effect, thinned out where there are many."""
    return [*effect.shapes[:: max(len(effect.shapes) // 12, 1)], effect.shapes[-1]]


def test_the_catalogue_holds_the_agreed_ids():
    assert set(AGREED) <= set(EFFECT_BY_NAME)
    assert len(EFFECT_BY_NAME) == len(EFFECTS)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_every_entry_is_complete(effect):
    strength = effect.strength
    assert 0.0 < strength.low < 1.0 < strength.high <= 20.0
    assert strength.typical > 0.0
    assert strength.source
    assert effect.equation
    assert effect.told_apart_by
    assert effect.name not in effect.confused_with
    assert set(effect.confused_with) <= set(EFFECT_BY_NAME)
    assert effect.words is not None
    for words in (effect.words.happens, effect.words.measure, effect.words.mend):
        assert len(words) > 10 and not words.endswith(".")
    assert len(effect.shapes) == len({tuple(sorted(shape.items())) for shape in effect.shapes})
    module = __import__(f"sawbench.modeling.effects.{effect.name}", fromlist=["EFFECT"])
    assert module.EFFECT is effect
    text = (module.__doc__ or "").lower()
    assert len(text) > 200


@pytest.mark.parametrize(
    ("mechanism", "effect"),
    [
        (mechanism, effect)
        for mechanism, machine in {"scotch_yoke": JIGSAW, "slider_crank": SLIDER_CRANK_SAW}.items()
        for effect in machine.effects(None)
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_signatures_are_finite_and_only_of_equations_that_can_be_evaluated(mechanism, effect):
    baseline = make_baseline(mechanism=mechanism)
    states = [running(), running(is_idle=True), start_up(), start_up(is_idle=True)]
    states += [running(setting=setting_of(False, feed_m_s=np.nan, thickness_m=np.nan))]
    for state, absent in itertools.product(states, ABSENT):
        reduced = replace(state, **absent)
        allowed = baseline.evaluable_equations(reduced)
        for shape in few_shapes(effect):
            parts = effect.signatures(baseline, reduced, shape)
            assert len(parts) == effect.n_signatures(shape)
            for part in parts:
                assert set(part) <= allowed
                for wave in part.values():
                    assert wave.shape == state.angle_rad.shape
                    assert np.all(np.isfinite(wave))


@pytest.mark.parametrize("state", [running(), running(is_idle=True), start_up()], ids=["cut", "air", "start"])
@pytest.mark.parametrize("absent", ABSENT, ids=str)
def test_evaluable_equations_are_those_that_the_residuals_have(state, absent):
    reduced = replace(state, **absent)
    assert BASELINE.evaluable_equations(reduced) == set(residuals(BASELINE, reduced))


@pytest.mark.parametrize("effect", SAW_EFFECTS, ids=lambda e: e.name)
def test_every_effect_leaves_a_trace_in_some_trial(effect):
    for shape in few_shapes(effect):
        parts = [p for s in (running(top_current_a=12.0), start_up()) for p in effect.signatures(BASELINE, s, shape)]
        assert any(np.max(np.abs(wave)) > 0.0 for part in parts for wave in part.values()), shape


@pytest.mark.parametrize("effect", SAW_EFFECTS, ids=lambda e: e.name)
def test_an_effect_is_silent_where_it_says_so_and_nowhere_else(effect):
    """By the formula itself: the blade in air has neither force nor cutting coefficient."""
    for phase, state in {"air": running(is_idle=True), "start_up": start_up()}.items():
        found = [effect.signatures(BASELINE, state, shape) for shape in effect.shapes]
        speaks = any(np.any(wave != 0.0) for parts in found for part in parts for wave in part.values())
        if phase in effect.silent_in:
            assert not speaks
        elif (effect.name, phase) not in NO_FORCE_TO_READ:
            assert speaks, phase


@pytest.mark.parametrize("effect", SAW_EFFECTS, ids=lambda e: e.name)
def test_the_other_cutting_half_gives_the_same_machine(effect):
    """A blade that cuts on 0..pi, watched from half a turn later, shows the same residuals.

    Where phases are free, what half a turn makes of them is another of the same waves.
    """
    here = running(speed_rad_s=np.full((N_UNITS, N_POINTS), 88.0), acceleration_rad_s2=np.zeros((N_UNITS, N_POINTS)))
    half = N_POINTS // 2

    def turned(wave):
        return None if wave is None or wave.shape[-1] == 1 else np.roll(wave, half, axis=-1)

    channels = ("current_a", "current_rate_a_s", "force_n", "force_rate_n_s", "battery_current_a")
    moved = {n: turned(getattr(here, n)) for n in (*channels, "battery_voltage_v", "motor_voltage_v")}
    there = replace(here, **moved)

    for shape in few_shapes(effect):
        firsts = effect.signatures(BASELINE, here, shape)
        seconds = effect.signatures(make_baseline(+1), there, shape)
        # Every equation in units of its largest wave; rounding errors alone are no wave.
        sizes = {name: max(np.abs(part[name]).max() for part in firsts if name in part) for p in firsts for name in p}
        sizes = {name: size for name, size in sizes.items() if size > 1e-12}

        def stacked(parts, turn, sizes=sizes):
            """One column a signature, all equations below each other."""
            nothing = np.zeros((N_UNITS, N_POINTS))
            rows = [[turn(np.array(part.get(name, nothing))).ravel() / sizes[name] for name in sizes] for part in parts]
            return np.array([np.concatenate(row) for row in rows]).T if sizes else np.zeros((1, len(parts)))

        wanted, found = stacked(firsts, turned), stacked(seconds, np.asarray)
        if effect.n_signatures(shape) > 1:
            found = found @ np.linalg.lstsq(found, wanted, rcond=None)[0]
        assert np.allclose(found, wanted, atol=1e-6), shape


def test_slow_effects_follow_their_slow_state():
    state = running()
    (early,) = EFFECT_BY_NAME["force_offset_drift"].signatures(BASELINE, state)
    later = replace(state, setting=setting_of(False, session_s=1300.0))
    (late,) = EFFECT_BY_NAME["force_offset_drift"].signatures(BASELINE, later)
    assert np.allclose(late["cutting"] - early["cutting"], 1.0)  # 1 N per 1000 s
    assert np.all(np.mean(late["mechanical"] - early["mechanical"], axis=-1) < 1e-12)
    (wear,) = EFFECT_BY_NAME["blade_wear"].signatures(BASELINE, state)
    assert np.allclose(wear["cutting"].max(axis=-1) / wear["cutting"].max(axis=-1)[0], [1.0, 2.0, 3.0], rtol=0.05)
    (sag,) = EFFECT_BY_NAME["battery_polarization"].signatures(BASELINE, state)
    assert np.allclose(sag["supply"], -4.0)


def test_chips_grow_with_feed_and_shrink_with_stroke_rate():
    effect = EFFECT_BY_NAME["chip_thickness"]
    gains = []
    for feed_m_s in (0.002, 0.008):
        (part,) = effect.signatures(BASELINE, running(setting=setting_of(False, feed_m_s=feed_m_s)), {"exponent": 0.6})
        gains.append(1.0 + part["cutting"].sum() / BASELINE.expected_force(running()).sum())
    assert np.isclose(gains[1] / gains[0], 4.0**0.6, rtol=1e-6)
    faster = running(speed_rad_s=2.0 * running().speed_rad_s)
    (slow,), (fast,) = effect.signatures(BASELINE, running()), effect.signatures(BASELINE, faster)
    assert fast["cutting"].sum() < slow["cutting"].sum()


def test_a_digital_current_sensor_reads_a_moving_average():
    """Two harmonics at 90 rad/s, averaged over 4 ms: each is smaller by its own share and 2 ms late."""
    angle, tau_s = running().angle_rad, 2e-3
    speed = np.full_like(angle, 90.0)

    def reading(phase_rad, *sizes):
        return sum(a * np.cos(k * (angle - phase_rad)) for k, a in zip((1, 3), sizes, strict=True))

    taken = [np.sinc(2.0 * tau_s * k * 90.0 / (2.0 * np.pi)) for k in (1, 3)]
    true, read = reading(0.0, 2.0, 0.5), reading(90.0 * tau_s, 2.0 * taken[0], 0.5 * taken[1])
    state = running(speed_rad_s=speed, current_a=9.0 + read, current_rate_a_s=np.zeros_like(angle))
    (part,) = EFFECT_BY_NAME["current_sensor_lag"].signatures(BASELINE, state, {"tau_s": tau_s, "moving": 1.0})
    assert np.allclose(part["converter"], -state.setting.duty * (read - true), atol=1e-6)


def test_chips_may_leave_a_part_of_the_force_as_it_is():
    """Half as thick, or twice as thick, as 0.3 mm: less by 0.3 of the force, or more by 0.6."""
    effect = EFFECT_BY_NAME["chip_thickness"]
    rate_hz = 1.0 / float(np.mean(2.0 * np.pi / running().speed_rad_s))
    for thickness, change in ((0.5, -0.3), (1.0, 0.0), (2.0, 0.6)):
        state = running(setting=setting_of(False, feed_m_s=thickness * 3e-4 * rate_hz))
        (part,) = effect.signatures(BASELINE, state, {"exponent": 0.6, "affine": 1.0})
        gain = part["cutting"].sum() / BASELINE.expected_force(state).sum()
        assert gain == pytest.approx(change, abs=1e-3)


def test_chips_follow_a_crank_that_slows_within_the_stroke():
    effect = EFFECT_BY_NAME["chip_thickness"]
    state = running(setting=setting_of(False, feed_m_s=0.006))
    speed = state.speed_rad_s * (1.0 + 0.3 * np.cos(state.angle_rad))
    (part,) = effect.signatures(BASELINE, replace(state, speed_rad_s=speed), {"exponent": 0.5, "in_stroke": 1.0})
    (force,) = BASELINE.expected_force(replace(state, speed_rad_s=speed))[:1]
    cuts = np.abs(force) > 1.0
    gain = 1.0 + part["cutting"][0][cuts] / force[cuts]
    # A bite of 6 mm/s over one turn at the present speed, against 0.3 mm.
    assert np.allclose(gain, np.sqrt(0.006 * 2.0 * np.pi / speed[0][cuts] / 3e-4))
    assert gain.max() > 1.2 * gain.min()


def test_polarization_answers_a_start_late():
    state = start_up(battery_current_a=np.full((1, N_TIMES), 10.0))
    state = replace(state, slow={memory: np.array([[0.0]]) for memory in MEMORIES})
    (part,) = EFFECT_BY_NAME["battery_polarization"].signatures(BASELINE, state, {"fast_s": 1.0, "slow_s": 1.0})
    elapsed = np.arange(1, N_TIMES + 1) * 1e-3
    assert np.allclose(part["supply"][0], -10.0 * (1.0 - np.exp(-elapsed)), atol=0.03)


def test_grain_is_a_wave_over_the_feed_path():
    wavelength = 0.004
    state = running(time_s=np.array([[0.25], [0.75], [1.25]]), n_strokes=np.ones(N_UNITS))
    sine, _ = EFFECT_BY_NAME["grain_variation"].signatures(BASELINE, state, {"wavelength_m": wavelength})
    # 4 mm/s: a quarter of a wave after 0.25 s, three quarters after 0.75 s.
    at_half_turn = sine["cutting"].sum(axis=-1) / BASELINE.expected_force(state).sum(axis=-1)
    assert np.allclose(at_half_turn, [1.0, -1.0, 1.0], atol=0.05)
    assert min(WAVELENGTHS_M) == pytest.approx(1e-3)
    assert max(WAVELENGTHS_M) == pytest.approx(20e-3)


def test_grain_averages_out_over_long_units():
    wavelength, rate_hz, n_strokes = 0.001, 88.0 / (2 * np.pi), 7
    state = running(n_strokes=np.full(N_UNITS, float(n_strokes)), speed_rad_s=np.full((N_UNITS, N_POINTS), 88.0))
    one = replace(state, n_strokes=np.ones(N_UNITS))
    effect, shape = EFFECT_BY_NAME["grain_variation"], {"wavelength_m": wavelength}
    steps = (np.arange(n_strokes) - (n_strokes - 1) / 2) / rate_hz
    waves = [effect.signatures(BASELINE, replace(one, time_s=one.time_s + s), shape)[0]["cutting"] for s in steps]
    averaged = effect.signatures(BASELINE, state, shape)[0]["cutting"]
    assert np.allclose(averaged, np.mean(waves, axis=0), atol=1e-9 * np.max(np.abs(waves)))


def test_neighbouring_tooth_pitches_stay_within_a_quarter_turn_over_the_stroke():
    shapes = EFFECT_BY_NAME["tooth_passing_ripple"].shapes
    for sharp, alternate in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)):
        kind = {"sharp": sharp} | ({"alternate": alternate} if alternate else {})
        pitches = np.array([s["pitch_m"] for s in shapes if s == {"pitch_m": s["pitch_m"], **kind}])
        assert pitches.min() <= 1.8e-3
        assert pitches.max() >= 4.5e-3
        assert np.max(np.abs(np.diff(2 * RADIUS_M / pitches))) <= 0.25


def test_every_mixture_of_losses_takes_the_same_at_ten_ampere_and_half_duty():
    state = running(setting=setting_of(False, duty=0.5), current_a=np.full((N_UNITS, N_POINTS), 10.0))
    for shape in EFFECT_BY_NAME["converter_loss"].shapes:
        (part,) = EFFECT_BY_NAME["converter_loss"].signatures(BASELINE, state, shape)
        # 1 is the whole of duty times current.
        assert np.allclose(part["converter"], 0.5 * 10.0), shape


def test_backlash_in_air_and_under_load_are_waves_of_their_own():
    effect = EFFECT_BY_NAME["yoke_backlash"]

    def strength(state):
        parts = effect.signatures(BASELINE, state, {"waves": 2.0})
        sizes = [max((np.max(np.abs(wave)) for wave in part.values()), default=0.0) for part in parts]
        return np.split(np.array(sizes), 2)

    in_air, under_load = strength(running(is_idle=True))
    assert np.all(in_air > 0.0) and np.all(under_load == 0.0)
    in_air, under_load = strength(running())
    assert np.all(in_air == 0.0) and np.all(under_load > 0.0)


def test_the_wave_of_a_play_has_the_harmonics_that_are_compared():
    assert EFFECT_BY_NAME["yoke_backlash"].n_signatures({"waves": 1.0}) == 2 * HARMONICS["electrical"]


def test_a_gap_is_read_off_the_wave_that_the_campaign_shows():
    """Without idle runs nothing is known of the wave in air."""
    rng = np.random.default_rng(5)
    effect = EFFECT_BY_NAME["yoke_backlash"]
    n, size = effect.n_signatures({"waves": 1.0}), effect.size_of
    in_air, under_load = rng.standard_normal(n), rng.standard_normal(n)
    assert size(np.concatenate([np.zeros(n), under_load])) == size(np.concatenate([under_load, under_load])) > 0.0
    assert size(np.concatenate([0.36 * under_load, under_load])) == pytest.approx(0.6 * size(under_load))
    assert size(np.concatenate([0.01 * under_load, under_load])) == pytest.approx(0.02 * size(under_load))
    assert size(np.zeros(2 * n)) == 0.0
    both = size(np.concatenate([in_air, under_load]))
    assert both == pytest.approx(np.sqrt(size(in_air) * size(under_load)))


@pytest.mark.parametrize("delay_s", [0.4e-3, 3e-3])
def test_a_start_is_delayed_on_its_time_grid(delay_s):
    state = start_up()
    t = (np.arange(N_TIMES) + 0.5)[None, :] * 1e-3
    wave = np.sin(40.0 * t) ** 2
    found = Spectrum(wave, state).through(lambda f: np.exp(-2j * np.pi * f * delay_s))
    expected = np.where(t > delay_s, np.sin(40.0 * (t - delay_s)) ** 2, 0.0)
    assert np.max(np.abs(found - expected)) < 0.01


@pytest.mark.parametrize("name", ["current_sensor_lag", "clock_offset"])
def test_a_late_current_shows_in_a_start(name):
    """Readings made late from a start that solves the electrical equation leave what the signature says."""
    t = (np.arange(N_TIMES) + 0.5)[None, :] * 1e-3
    tau = 1.5e-3

    def current(time):
        return np.where(time > 0, 40.0 * (np.exp(-time / 0.09) - np.exp(-time / 0.015)), 0.0)

    def rate(time):
        return (current(time + 1e-6) - current(time - 1e-6)) / 2e-6

    true = start_up(current_a=current(t), current_rate_a_s=rate(t))
    emf = 0.007383 * BASELINE.gear * true.speed_rad_s
    true = replace(true, motor_voltage_v=0.176 * true.current_a + 0.00321 * true.current_rate_a_s + emf)
    if name == "clock_offset":
        late = replace(true, current_a=current(t - tau), current_rate_a_s=rate(t - tau))
        shifted = 88.0 * (1.0 - np.exp(-np.maximum(t - tau, 0.0) / 0.08))
        voltage = 0.176 * late.current_a + 0.00321 * late.current_rate_a_s + 0.007383 * BASELINE.gear * shifted
        late = replace(late, motor_voltage_v=voltage)
        shape = {"device": 1.0, "tau_s": tau, "drifts": 0.0}
    else:
        fine = np.arange(0.0, 0.42, 1e-6)
        read = np.zeros_like(fine)
        drive = current(fine)
        for k in range(1, len(fine)):
            read[k] = read[k - 1] + 1e-6 * (drive[k - 1] - read[k - 1]) / tau
        late = replace(
            true,
            current_a=np.interp(t, fine, read),
            current_rate_a_s=np.interp(t, fine, (drive - read) / tau),
        )
        shape = {"tau_s": tau}
    (claimed,) = EFFECT_BY_NAME[name].signatures(BASELINE, late, shape)
    seen = residuals(BASELINE, late)["electrical"] - residuals(BASELINE, true)["electrical"]
    inside = slice(8, -8)  # the kink at the very start is sharper than the grid
    error = np.sqrt(np.mean((seen - claimed["electrical"])[0, inside] ** 2))
    assert error < 0.1 * np.sqrt(np.mean(seen[0, inside] ** 2))


def test_signs_of_drifting_zeros_come_in_both_directions():
    effect = EFFECT_BY_NAME["force_offset_drift"]
    means = [
        part["cutting"].mean() for shape in effect.shapes for part in effect.signatures(BASELINE, running(), shape)
    ]
    assert min(means) < 0.0 < max(means)
    assert effect.reported_strength(3.0, {"direction": -1.0, "power": 1.0}) == -3.0


@pytest.mark.parametrize("name", [e.name for e in SAW_EFFECTS])
def test_a_blade_that_goes_with_its_crank_changes_nothing(name):
    """A measured velocity that is the crank's leaves every signature as it is without one."""
    effect = EFFECT_BY_NAME[name]
    state = running()
    measured = replace(state, blade_excess_m_s=np.zeros_like(state.speed_rad_s))
    for without, with_it in zip(effect.signatures(BASELINE, state), effect.signatures(BASELINE, measured), strict=True):
        assert without.keys() == with_it.keys()
        for equation, wave in without.items():
            assert np.array_equal(wave, with_it[equation])


def test_a_jump_of_the_blade_is_felt_by_what_goes_with_the_cut():
    state = running()
    jump = 0.05 * np.cos(9 * state.angle_rad)
    jumping = replace(state, blade_excess_m_s=jump)
    force = BASELINE.expected_force(jumping) - BASELINE.expected_force(state)
    assert np.abs(force).max() == pytest.approx(0.05 * state.k_guess_n_s_per_m, rel=0.05)
    worn = EFFECT_BY_NAME["blade_wear"]
    moved = [worn.signatures(BASELINE, s)[0]["cutting"] for s in (state, jumping)]
    assert not np.allclose(*moved)


def test_the_page_of_effects_says_what_the_files_say():
    """A row may wait until the page is next written; no row may be wrong or of an effect that is gone."""
    lines = (Path(__file__).parents[2] / "docs" / "effects.md").read_text().splitlines()
    known = page().splitlines()
    assert [line for line in lines if line not in known] == []
    is_row = [line.startswith("| `") for line in known]
    assert [line for line, row in zip(known, is_row, strict=True) if not row and line not in lines] == []
    assert len(lines) == len(set(lines) - {""}) + lines.count("")


def test_a_state_cannot_be_changed():
    state = running()
    with pytest.raises(TypeError):
        state.slow[MEMORIES[0]] = np.zeros((N_UNITS, 1))
    with pytest.raises(AttributeError):
        state.k_guess_n_s_per_m = 0.0


def test_what_follows_from_the_motion_goes_with_it():
    state = running()
    assert replace(state, force_n=None).motion is state.motion
    faster = replace(state, speed_rad_s=2.0 * state.speed_rad_s)
    assert np.allclose(2.0 * faster.motion.period_s, state.motion.period_s)
    turned = replace(state, angle_rad=state.angle_rad + 0.1)
    wanted = BASELINE.mechanism.lever(state.angle_rad + 0.1)
    assert np.array_equal(turned.motion.levers(BASELINE.mechanism)[0], wanted)
