"""What every effect of the catalogue keeps: its name, a sane strength, finite signatures."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.config import BatteryConfig, PlantConfig
from diagnosis.effects.catalogue import EFFECT_BY_NAME, EFFECTS, page
from diagnosis.effects.grain_variation import WAVELENGTHS_M
from diagnosis.effects.transfer import filtered
from diagnosis.equations import Baseline, residuals
from diagnosis.slow_states import HEAT_TIMES_S, POLARIZATION_TIMES_S
from diagnosis.state import State, TrialSetting

IDS = (
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
# Fixed to the crank angle with a free phase: half a turn on, every harmonic keeps its size and may change its sign.
ANGLE_PHASES = {"gear_eccentricity", "yoke_backlash"}
# Free phases along the blade's travel or the feed, which know nothing of the cutting half.
PATH_PHASES = {"tooth_passing_ripple", "grain_variation"}
# What an effect of the cut or of the force's size can do in a trial whose blade runs in air: nothing.
SILENT_IN_AIR = (
    "load_dependent_friction",
    "blade_compliance",
    "return_stroke_rubbing",
    "tooth_passing_ripple",
    "cutting_speed_exponent",
    "edge_force",
    "chip_thickness",
    "blade_wear",
    "grain_variation",
    "engagement_delay",
    "carriage_resonance",
    "preload_lift_off",
    "force_sensor_lag",
)
RADIUS_M, N_UNITS, N_POINTS, N_TIMES = 0.01, 3, 128, 400


def make_baseline(cutting_sign: int = -1) -> Baseline:
    plant = PlantConfig.model_validate(
        {
            "resistance_ohm": 0.176,
            "inductance_h": 0.00321,
            "back_emf_constant_v_s_per_rad": 0.007383,
            "torque_constant_n_m_per_a": 0.005632,
            "rotor_inertia_kg_m2": 2.4e-05,
            "yoke_inertia_kg_m2": 2.38e-05,
            "reciprocating_mass_kg": 0.239,
            "crank_radius_m": RADIUS_M,
            "motor_damping_n_m_s_per_rad": 3.4274e-06,
            "gear_ratio": 9.333333333333334,
        }
    )
    battery = BatteryConfig(
        nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02, cutoff_soc=0.2
    )
    return Baseline(plant=plant, battery=battery, cutting_sign=cutting_sign)


BASELINE = make_baseline()


def n_signatures(name: str, shape: dict) -> int:
    """Sine and cosine for each free wave of an effect."""
    if name == "tooth_passing_ripple":
        return 2 * (3 if shape["sharp"] else 1)  # the tooth, and two overtones of a sharp one
    if name == "yoke_backlash":
        return 2 * 10 * int(shape["waves"])  # air and load; both as they change
    if name == "carriage_resonance":
        return 5 if shape.get("upper") else 1  # the first mode, and four above it
    return 2 if name in {"gear_eccentricity", "grain_variation"} else 1


def slow_states(n_units: int, k_n_s_per_m: float) -> dict:
    column = np.ones((n_units, 1))
    slow = {"k_guess_n_s_per_m": k_n_s_per_m * column, "peak_force_n": 200.0 * column}
    slow |= {"top_current_a": 35.0 * column}
    slow |= {f"heat_{tau}_a2": 100.0 * column for tau in HEAT_TIMES_S}
    slow |= {f"spin_{tau}_rad2_s2": 8000.0 * column for tau in HEAT_TIMES_S}
    return slow | {f"polarization_{tau}_a": 4.0 * column for tau in POLARIZATION_TIMES_S}


def setting_of(is_idle: bool, **changes) -> TrialSetting:
    given = {
        "label": "t",
        "index": 0,
        "duty": 0.4375,
        "is_idle": is_idle,
        "stock": "oak",
        "feed_m_s": 0.004,
        "thickness_m": 0.02,
        "operating_point": "p",
        "session_s": 300.0,
    }
    return TrialSetting(**{**given, **changes})


def running(is_idle: bool = False, **changes) -> State:
    """Strokes with the ripple of a loaded jigsaw; waves need not solve the equations."""
    angle = np.broadcast_to((np.arange(N_POINTS) + 0.5) * 2 * np.pi / N_POINTS, (N_UNITS, N_POINTS))
    speed = 88.0 + 6.0 * np.cos(2 * angle) + np.arange(N_UNITS)[:, None]
    acceleration = speed * -12.0 * np.sin(2 * angle)
    current = 10.0 + 1.5 * np.sin(angle) + np.cos(2 * angle)
    current_rate = speed * (1.5 * np.cos(angle) - 2.0 * np.sin(2 * angle))
    force = 0.0 * angle if is_idle else 210.0 * np.maximum(-np.sin(angle), 0.0)
    force_rate = -speed * np.where(force > 0.0, 210.0 * np.cos(angle), 0.0)
    voltage = 17.8 - 0.01 * current
    state = State(
        kind="running", setting=setting_of(is_idle), angle_rad=angle, speed_rad_s=speed,
        acceleration_rad_s2=acceleration, current_a=current, current_rate_a_s=current_rate, force_n=force,
        force_rate_n_s=force_rate, battery_voltage_v=voltage, battery_current_a=0.44 * current,
        motor_voltage_v=0.4375 * voltage, time_s=np.array([[1.0], [2.0], [3.0]]),
        cut_distance_m=np.array([[1.0], [2.0], [3.0]]), charge_used_as=np.full((N_UNITS, 1), 50.0),
        n_strokes=np.full(N_UNITS, 2.0), slow=slow_states(N_UNITS, 0.0 if is_idle else 240.0),
    )  # fmt: skip
    return replace(state, **changes)


def start_up(is_idle: bool = False, **changes) -> State:
    """Spin-up on the 1 ms grid."""
    t = (np.arange(N_TIMES) + 0.5)[None, :] * 1e-3
    speed = 88.0 * (1.0 - np.exp(-t / 0.08))
    angle = 88.0 * (t - 0.08 * (1.0 - np.exp(-t / 0.08)))
    current = 3.0 + 45.0 * (np.exp(-t / 0.09) - np.exp(-t / 0.015))
    voltage = 17.9 - 0.01 * current
    force = 0.0 * t if is_idle else 240.0 * np.maximum(-RADIUS_M * speed * np.sin(angle), 0.0)
    state = State(
        kind="start_up", setting=setting_of(is_idle), angle_rad=angle, speed_rad_s=speed,
        acceleration_rad_s2=np.gradient(speed, 1e-3, axis=1), current_a=current,
        current_rate_a_s=np.gradient(current, 1e-3, axis=1), force_n=force,
        force_rate_n_s=np.gradient(force, 1e-3, axis=1), battery_voltage_v=voltage,
        battery_current_a=0.44 * current, motor_voltage_v=0.4375 * voltage, time_s=np.array([[0.3]]),
        cut_distance_m=np.array([[0.0]]), charge_used_as=np.array([[0.0]]), n_strokes=np.ones(1),
        slow=slow_states(1, 0.0 if is_idle else 240.0),
    )  # fmt: skip
    return replace(state, **changes)


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


def test_the_catalogue_holds_the_agreed_ids_and_no_other():
    assert sorted(EFFECT_BY_NAME) == sorted(IDS)
    assert len(EFFECTS) == len(IDS)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_every_entry_is_complete(effect):
    strength = effect.strength
    assert 0.0 < strength.low < 1.0 < strength.high <= 10.0
    assert strength.typical > 0.0
    assert strength.source
    assert effect.equation
    assert effect.told_apart_by
    assert effect.name not in effect.confused_with
    assert set(effect.confused_with) <= set(IDS)
    assert len(effect.shapes) == len({tuple(sorted(shape.items())) for shape in effect.shapes})
    module = __import__(f"diagnosis.effects.{effect.name}", fromlist=["EFFECT"])
    assert module.EFFECT is effect
    text = (module.__doc__ or "").lower()
    assert len(text) > 200


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_signatures_are_finite_and_only_of_equations_that_can_be_evaluated(effect):
    states = [running(), running(is_idle=True), start_up(), start_up(is_idle=True)]
    states += [running(setting=setting_of(False, feed_m_s=np.nan, thickness_m=np.nan))]
    for state, absent in itertools.product(states, ABSENT):
        reduced = replace(state, **absent)
        allowed = BASELINE.evaluable_equations(reduced)
        for shape in few_shapes(effect):
            parts = effect.signatures(BASELINE, reduced, shape)
            assert len(parts) == n_signatures(effect.name, shape)
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


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_every_effect_leaves_a_trace_in_some_trial(effect):
    state = running(slow={**slow_states(N_UNITS, 240.0), "top_current_a": np.full((N_UNITS, 1), 12.0)})
    for shape in few_shapes(effect):
        parts = effect.signatures(BASELINE, state, shape)
        assert any(np.max(np.abs(wave)) > 0.0 for part in parts for wave in part.values()), shape


@pytest.mark.parametrize("name", SILENT_IN_AIR)
def test_effects_of_the_cut_are_silent_in_air(name):
    effect = EFFECT_BY_NAME[name]
    for shape in effect.shapes if name != "load_dependent_friction" else effect.shapes[:1]:
        for part in effect.signatures(BASELINE, running(is_idle=True), shape):
            assert all(np.max(np.abs(wave)) == 0.0 for wave in part.values())


@pytest.mark.parametrize("name", sorted(set(IDS) - PATH_PHASES))
def test_the_other_cutting_half_gives_the_same_machine(name):
    """A blade that cuts on 0..pi, watched from half a turn later, shows the same residuals."""
    effect = EFFECT_BY_NAME[name]
    here = running(speed_rad_s=np.full((N_UNITS, N_POINTS), 88.0), acceleration_rad_s2=np.zeros((N_UNITS, N_POINTS)))
    half = N_POINTS // 2

    def turned(wave):
        return None if wave is None or wave.shape[-1] == 1 else np.roll(wave, half, axis=-1)

    channels = ("current_a", "current_rate_a_s", "force_n", "force_rate_n_s", "battery_current_a")
    moved = {n: turned(getattr(here, n)) for n in (*channels, "battery_voltage_v", "motor_voltage_v")}
    there = replace(here, **moved)
    signs = (1.0, -1.0) if name in ANGLE_PHASES else (1.0,)
    for shape in few_shapes(effect):
        firsts = effect.signatures(BASELINE, here, shape)
        seconds = effect.signatures(make_baseline(+1), there, shape)
        for first, second in zip(firsts, seconds, strict=True):
            # One sign for all equations: the wave turns over as a whole or not at all.
            assert any(
                all(
                    np.allclose(turned(wave), sign * second[equation], atol=1e-6 * np.max(np.abs(wave)) + 1e-12)
                    for equation, wave in first.items()
                )
                for sign in signs
            ), shape


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


def test_polarization_answers_a_start_late():
    state = start_up(battery_current_a=np.full((1, N_TIMES), 10.0))
    state = replace(state, slow={**state.slow, "polarization_1_a": np.array([[0.0]])})
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
    for sharp in (0.0, 1.0):
        pitches = np.array([shape["pitch_m"] for shape in shapes if shape["sharp"] == sharp])
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
        return np.array(sizes[:20]), np.array(sizes[20:])

    in_air, under_load = strength(running(is_idle=True))
    assert np.all(in_air > 0.0) and np.all(under_load == 0.0)
    in_air, under_load = strength(running())
    assert np.all(in_air == 0.0) and np.all(under_load > 0.0)


@pytest.mark.parametrize("delay_s", [0.4e-3, 3e-3])
def test_a_start_is_delayed_on_its_time_grid(delay_s):
    state = start_up()
    t = (np.arange(N_TIMES) + 0.5)[None, :] * 1e-3
    wave = np.sin(40.0 * t) ** 2
    found = filtered(wave, state, lambda f: np.exp(-2j * np.pi * f * delay_s))
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


@pytest.mark.parametrize("name", IDS)
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
    assert np.abs(force).max() == pytest.approx(0.05 * float(state.slow["k_guess_n_s_per_m"].max()), rel=0.05)
    worn = EFFECT_BY_NAME["blade_wear"]
    moved = [worn.signatures(BASELINE, s)[0]["cutting"] for s in (state, jumping)]
    assert not np.allclose(*moved)


def test_the_page_of_effects_is_up_to_date():
    path = Path(__file__).parents[2] / "docs" / "effects.md"
    assert path.read_text() == page(), "write diagnosis.effects.catalogue.page() to docs/effects.md"
