"""Every effect of the blind check does something, does it where it should, and nothing at severity 0."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.blindcheck.campaign import measured_trials
from sawbench.blindcheck.drawing import CampaignDraw, draw_campaign
from sawbench.blindcheck.effects.table import CATALOGUE, NOT_AS_BACKGROUND, OUTSIDE
from sawbench.blindcheck.plans import TrialPlan
from sawbench.blindcheck.readings import Readings

pytestmark = pytest.mark.unit

# The identifiers are a contract with the catalogue; written out here, not read from the code under test.
CONTRACT_IDS = [
    "guide_friction", "motor_coulomb_friction", "windage_drag", "load_dependent_friction", "yoke_backlash",
    "gear_eccentricity", "blade_compliance", "return_stroke_rubbing", "tooth_passing_ripple",
    "cutting_speed_exponent", "edge_force", "chip_thickness", "blade_wear", "grain_variation",
    "engagement_delay", "winding_heating", "magnet_weakening", "brush_voltage_drop", "converter_diode_drop",
    "converter_loss", "current_limit", "battery_internal_resistance", "battery_polarization",
    "carriage_resonance", "preload_lift_off", "force_sensor_lag", "current_sensor_lag", "clock_offset",
    "force_offset_drift",
]  # fmt: skip
QUIET = (0, 0.01, 0.01)
SEED = 2


def _plan(duty: float, workpiece: str, seconds: float, *, feed: float = 4.0, mm: float = 20.0) -> TrialPlan:
    return TrialPlan(duty=duty, workpiece=workpiece, thickness_mm=mm, feed_mm_s=feed, seconds=seconds, rest_s=60.0)


PLANS = (
    _plan(0.4375, "none", 0.6),
    _plan(0.4375, "oak", 2.0),
    _plan(0.4375, "oak", 0.6, feed=6.0),
    _plan(0.35, "none", 0.6),
)


def _draw(effects: dict[str, float], *plans: TrialPlan) -> CampaignDraw:
    draw = draw_campaign(SEED, effects=effects, background=QUIET)
    return replace(draw, trials=plans or PLANS)


def _readings(effects: dict[str, float], *plans: TrialPlan) -> list[Readings]:
    return [readings for _, _, readings in measured_trials(_draw(effects, *plans))]


@pytest.fixture(scope="module")
def base() -> list[Readings]:
    return _readings({})


def _largest_change(a: list[Readings], b: list[Readings], draw: CampaignDraw) -> float:
    """Largest root mean square difference of a channel in a trial, in units of that channel's noise."""
    names = list(a[0].values)
    return max(
        float(np.sqrt(np.mean((x.values[name] - y.values[name]) ** 2))) / draw.sensors.noise[k]
        for x, y in zip(a, b, strict=True)
        for k, name in enumerate(names)
    )


def test_tables_hold_the_contract_and_enough_outside_of_it():
    assert sorted(CATALOGUE) == sorted(CONTRACT_IDS)
    assert len(OUTSIDE) >= 8
    assert not set(OUTSIDE) & set(CATALOGUE)
    assert set(CATALOGUE) >= NOT_AS_BACKGROUND


@pytest.mark.parametrize("effect", [*CONTRACT_IDS, *OUTSIDE])
def test_effect_shows_beyond_noise_and_vanishes_at_zero(effect, base):
    draw = _draw({effect: 1.0})
    assert _largest_change(_readings({effect: 1.0}), base, draw) > 1.0
    none = _draw({effect: 0.0})
    assert none.change.plant == {}
    assert none.change.shape == {}
    assert none.change.sensors == {}
    assert none.sensors == _draw({}).sensors


def test_a_little_of_a_late_engagement_takes_little_of_the_force(base):
    """Backgrounds are a hundredth of the typical size: a form that does not shrink with its size is no background."""
    oak = 1
    lost = {
        severity: float(np.mean(base[oak].values["force_n"]) - np.mean(found[oak].values["force_n"]))
        for severity in (0.01, 1.0)
        for found in [_readings({"engagement_delay": severity})]
    }
    assert lost[1.0] > 1.0
    assert abs(lost[0.01]) < 0.01 * lost[1.0]


def test_the_other_draws_do_not_depend_on_the_effect():
    plain, hidden = draw_campaign(SEED), draw_campaign(SEED, effects={"edge_force": 2.0})
    assert plain.parameters == hidden.parameters
    assert plain.trials == hidden.trials
    assert plain.background == hidden.background
    assert plain.sensors == hidden.sensors


def test_unknown_effects_and_negative_severities_are_refused():
    with pytest.raises(InputError, match="edge_forse"):
        draw_campaign(1, effects={"edge_forse": 1.0})
    with pytest.raises(InputError, match="allowed is 0"):
        draw_campaign(1, effects={"edge_force": -1.0})


def _steady(readings: Readings, channel: str) -> np.ndarray:
    return readings.values[channel][readings.time_s > 0.6]


def test_guide_friction_draws_idle_current_and_leaves_idle_force(base):
    idle = _readings({"guide_friction": 1.0}, PLANS[0])[0]
    assert np.mean(_steady(idle, "motor_current_a")) > np.mean(_steady(base[0], "motor_current_a")) + 0.3
    np.testing.assert_allclose(idle.values["force_n"], base[0].values["force_n"])


def test_load_dependent_friction_is_silent_at_idle():
    idle, cut = _readings({"load_dependent_friction": 1.0}, PLANS[0], PLANS[1])
    idle0, cut0 = _readings({}, PLANS[0], PLANS[1])
    assert abs(np.mean(idle.values["motor_current_a"] - idle0.values["motor_current_a"])) < 0.02
    assert np.mean(_steady(cut, "motor_current_a")) > np.mean(_steady(cut0, "motor_current_a")) + 0.2


def test_rubbing_pulls_the_force_below_zero_on_the_return_half(base):
    cut = _readings({"return_stroke_rubbing": 1.0}, *PLANS[:2])[1]
    moving_up = np.gradient(cut.values["displacement_mm"], cut.time_s) > 300.0
    assert np.median(cut.values["force_n"][moving_up & (cut.time_s > 0.6)]) < -8.0


def test_current_limit_caps_the_start_up(base):
    limited = _readings({"current_limit": 1.0}, PLANS[0])[0]
    assert base[0].values["motor_current_a"].max() > 32.0
    assert limited.values["motor_current_a"].max() < 26.0


def test_preload_clips_the_force_and_leaves_the_current(base):
    clipped = _readings({"preload_lift_off": 1.0}, *PLANS[:2])[1]
    assert np.percentile(clipped.values["force_n"], 99.5) < np.percentile(base[1].values["force_n"], 99.5) - 20
    np.testing.assert_array_equal(clipped.values["motor_current_a"], base[1].values["motor_current_a"])


def test_converter_loss_lies_between_the_two_currents(base):
    lossy = _readings({"converter_loss": 1.0}, *PLANS[:2])[1]
    share = np.mean(_steady(lossy, "battery_current_a")) / np.mean(_steady(lossy, "motor_current_a"))
    share0 = np.mean(_steady(base[1], "battery_current_a")) / np.mean(_steady(base[1], "motor_current_a"))
    assert 1.03 < share / share0 < 1.15


def test_force_lag_delays_the_force_by_its_size_and_nothing_else(base):
    late = _readings({"force_sensor_lag": 2.0}, *PLANS[:2])[1]
    np.testing.assert_array_equal(late.values["motor_current_a"], base[1].values["motor_current_a"])
    t = np.arange(0.7, 1.8, 1e-4)
    a = np.interp(t, base[1].time_s, base[1].values["force_n"])
    shifts_s = np.arange(0.0, 5e-3, 1e-4)
    scores = [np.dot(a - a.mean(), np.interp(t + shift, late.time_s, late.values["force_n"])) for shift in shifts_s]
    assert shifts_s[int(np.argmax(scores))] == pytest.approx(2e-3, abs=3e-4)


def test_blade_compliance_delays_the_force_and_reaches_the_current(base):
    soft = _readings({"blade_compliance": 1.0}, *PLANS[:2])[1]
    assert np.abs(soft.values["motor_current_a"] - base[1].values["motor_current_a"]).max() > 0.2
    after_turn = np.gradient(soft.values["displacement_mm"], soft.time_s) > 50.0
    after_turn &= (soft.values["displacement_mm"] < 0.35) & (soft.time_s > 0.6)
    before = np.gradient(base[1].values["displacement_mm"], base[1].time_s) > 50.0
    before &= (base[1].values["displacement_mm"] < 0.35) & (base[1].time_s > 0.6)
    assert soft.values["force_n"][after_turn].mean() > base[1].values["force_n"][before].mean() + 3.0


def _damper(readings: Readings) -> float:
    """Least-squares slope of the force over the speed in the cutting half, N s/m."""
    speed = -1e-3 * np.gradient(readings.values["displacement_mm"], readings.time_s)
    speed = np.convolve(speed, np.ones(9) / 9, mode="same")
    fast = speed > 0.3
    force = readings.values["force_n"][fast]
    return float(np.dot(force, speed[fast]) / np.dot(speed[fast], speed[fast]))


def test_wear_grows_with_the_distance_cut_and_survives_the_rest():
    plans = [_plan(0.4375, "oak", 2.0) for _ in range(4)]
    worn, fresh = _readings({"blade_wear": 2.0}, *plans), _readings({}, *plans)
    ratio = [_damper(a) / _damper(b) for a, b in zip(worn, fresh, strict=True)]
    assert ratio[0] > 1.01
    assert all(later > earlier + 0.003 for earlier, later in itertools.pairwise(ratio))
    assert ratio[1] - ratio[0] > ratio[3] - ratio[2]


def test_heat_decays_over_a_rest_and_wear_does_not():
    hot = _plan(0.55, "oak", 6.0)
    long_rest = replace(_plan(0.55, "oak", 0.5), rest_s=3000.0)
    no_rest = replace(_plan(0.55, "oak", 0.5), rest_s=0.1)
    effects = {"winding_heating": 2.0}
    start_cold = _readings(effects, hot, long_rest)[1].values["motor_current_a"].max()
    start_hot = _readings(effects, hot, no_rest)[1].values["motor_current_a"].max()
    assert start_hot < start_cold - 0.2


def test_backlash_lets_the_plunger_overrun_the_pin():
    tight, loose = (_readings(e, PLANS[0])[0] for e in ({}, {"yoke_backlash": 2.0}))
    stroke = [np.ptp(_steady(r, "displacement_mm")) for r in (tight, loose)]
    assert 0.2 < stroke[1] - stroke[0] < 0.7


def test_carriage_rings_at_its_own_frequency_at_both_speeds():
    draw = _draw({"carriage_resonance": 1.0}, _plan(0.4375, "oak", 2.0), _plan(0.55, "oak", 2.0))
    expected_hz = draw.sensors.carriage_hz[0]
    plain = [r for _, _, r in measured_trials(replace(draw, sensors=_draw({}).sensors))]
    for (_, _, ringing), quiet in zip(measured_trials(draw), plain, strict=True):
        t = np.arange(0.5, 1.9, 2e-4)
        power = [
            np.abs(np.fft.rfft(np.interp(t, r.time_s, r.values["force_n"]) * np.hanning(len(t)))) ** 2
            for r in (ringing, quiet)
        ]
        hz = np.fft.rfftfreq(len(t), 2e-4)
        band = (hz > 50.0) & (hz < 1.6 * expected_hz)
        gain = np.convolve(power[0], np.ones(23), mode="same") / np.convolve(power[1], np.ones(23), mode="same")
        assert hz[band][np.argmax(gain[band])] == pytest.approx(expected_hz, rel=0.12)
        assert gain[band].max() > 10.0


def test_clock_offset_delays_one_device():
    draw = _draw({"clock_offset": 1.0}, PLANS[0])
    assert draw.sensors.late_device in {"force", "displacement", "electrical"}
    assert draw.sensors.late_s == pytest.approx(1.8e-3)


def test_idle_speed_rises_with_hot_magnets():
    plans = (
        _plan(0.55, "none", 1.5),
        _plan(0.55, "oak", 20.0),
        replace(_plan(0.55, "none", 1.5), rest_s=1.0),
    )
    pairs = {}
    for size in (0.0, 2.0):
        runs = _readings({"magnet_weakening": size}, *plans)
        pairs[size] = [_crossing_rate_hz(runs[0]), _crossing_rate_hz(runs[2])]
    assert pairs[2.0][1] / pairs[2.0][0] > pairs[0.0][1] / pairs[0.0][0] + 0.004


def _crossing_rate_hz(readings: Readings) -> float:
    x = readings.values["displacement_mm"] - 10.0
    smooth = np.convolve(x, np.ones(15) / 15, mode="same")
    up = np.flatnonzero((smooth[:-1] < 0) & (smooth[1:] >= 0))
    up = up[readings.time_s[up] > 0.7]
    part = -smooth[up] / (smooth[up + 1] - smooth[up])
    times = readings.time_s[up] + part * (readings.time_s[up + 1] - readings.time_s[up])
    return (len(times) - 1) / (times[-1] - times[0])
