"""Foreign benches differ in what they say they differ in, and every ordinary fault of a sensor is what it says."""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, replace

import numpy as np
import pytest
from sawbench.bench.config import load_config
from sawbench.bench.errors import InputError
from sawbench.blindcheck.bench import OWN, SHIFTS, Nature, draw_bench
from sawbench.blindcheck.campaign import disturbed, make_campaign, measured_trials, trial_settings
from sawbench.blindcheck.drawing import draw_campaign
from sawbench.blindcheck.draws import stream_of
from sawbench.blindcheck.effects.table import CATALOGUE, drawn_from
from sawbench.blindcheck.nuisances import NUISANCES, SENSOR_FAULTS, Moment
from sawbench.blindcheck.plans import with_batteries
from sawbench.blindcheck.plant import MATERIALS, Plant, stroke_factors
from sawbench.blindcheck.plant import column as output_of
from sawbench.blindcheck.readings import Readings
from sawbench.blindcheck.sealing import draw_cases, make

pytestmark = pytest.mark.unit

SEEDS = range(24)


@pytest.fixture(scope="module")
def draws():
    return [draw_campaign(seed, benches="foreign") for seed in SEEDS]


def test_every_constant_and_rate_and_noise_spreads_around_the_own_bench(draws):
    for name, (value, _) in OWN.nominal.items():
        found = np.array([draw.bench.nominal[name][0] for draw in draws])
        assert found.max() / found.min() > 1.5, name
        assert found.min() < value < found.max(), name
    volts = {draw.bench.nominal_voltage_v for draw in draws}
    assert (min(volts) <= 12.0, max(volts) >= 24.0) == (True, True)
    rates = np.array([draw.bench.rate_hz for draw in draws])
    assert 1e3 <= rates.min() < 2e3 < 1e4 < rates.max() <= 2e4
    factors = np.array([draw.bench.noise_factor for draw in draws])
    assert 0.3 <= factors.min() < 0.6 < 2.0 < factors.max() <= 4.0


def test_campaigns_hold_what_operators_do(draws):
    counts = [len(draw.trials) for draw in draws]
    assert 6 <= min(counts) < 10 < 25 < max(counts) <= 40
    plans = [plan for draw in draws for plan in draw.trials]
    assert {plan.workpiece for plan in plans} == set(MATERIALS)
    for habit in ("late_s", "off_s", "in_air_s", "out_s"):
        assert any(getattr(plan, habit) > 0.0 for plan in plans)
    assert all(plan.in_air_s == plan.out_s == 0.0 for plan in plans if plan.workpiece == "none")
    assert any(draw.trials[-1].battery != "P1" for draw in draws)
    idle = [any(plan.workpiece == "none" for plan in draw.trials) for draw in draws]
    assert 0 < idle.count(False) < idle.count(True)
    for draw in draws:
        rows = draw.bench.rate_hz * sum(plan.seconds for plan in draw.trials)
        assert rows < 3e6
        assert all(plan.seconds > plan.off_s + plan.in_air_s + plan.out_s + 1.0 for plan in draw.trials)


def test_the_same_seed_draws_the_same_bench_and_effects_change_nothing_of_it(draws):
    hidden = draw_campaign(3, benches="foreign", effects={"edge_force": 1.0})
    for name in ("bench", "nuisances", "parameters", "trials", "sensors", "k_fc_n_s_per_m"):
        assert getattr(hidden, name) == getattr(draws[3], name)


@pytest.mark.parametrize("left_out", SHIFTS)
def test_what_is_left_out_is_that_of_the_own_bench_and_nothing_else_changes(left_out, draws):
    name = {"noise": "noise_factor", "rate": "rate_hz"}.get(left_out)
    seed = next(k for k in SEEDS if left_out not in NUISANCES or left_out in draws[k].nuisances)
    bare, full = draw_campaign(seed, benches="foreign", without=(left_out,)), draws[seed]
    others = set(full.nuisances) - {left_out}
    assert set(bare.nuisances) == others
    assert {kind: dict(bare.nuisances[kind]) for kind in others} == {k: dict(full.nuisances[k]) for k in others}
    if name is not None:
        assert getattr(bare.bench, name) == getattr(OWN, name)
    assert (bare.bench.nominal == OWN.nominal) == (left_out == "machine")
    if left_out == "campaign":
        assert len(bare.trials) == len(draw_campaign(seed).trials)
    if left_out == "operator":
        assert all(plan.late_s == plan.off_s == plan.in_air_s == plan.out_s == 0.0 for plan in bare.trials)
    if left_out in NUISANCES:
        assert bare.trials == full.trials


def test_what_cannot_be_left_out_is_said_so():
    with pytest.raises(InputError, match="hum"):
        Nature(benches="foreign", without=("humm",))
    assert all(not Nature().differs_in(shift) for shift in SHIFTS)


def test_own_benches_have_no_nuisance_and_the_paper_s_machine():
    assert draw_bench(5, Nature()) == OWN
    assert dict(draw_campaign(5).nuisances) == {}


@pytest.mark.parametrize("benches", ["own", "foreign"])
def test_a_slider_crank_is_in_the_configuration_and_in_the_plant(benches, tmp_path):
    truth = make_campaign(3, tmp_path / "c", mechanism="slider_crank", benches=benches, length=0.02, rate_hz=1000.0)
    plant = load_config(tmp_path / "c" / "bench_config.toml").plant()
    assert plant.mechanism == "slider_crank"
    assert plant.rod_length_m == truth["bench"]["rod_length_m"]
    assert 0.2 <= plant.crank_radius_m.nominal / plant.rod_length_m <= 0.45
    assert draw_campaign(3, mechanism="slider_crank").parameters == draw_campaign(3).parameters


def test_the_label_of_a_foreign_bench_makes_the_same_campaign_again(tmp_path):
    truth = make_campaign(6, tmp_path / "a", benches="foreign", length=0.05, without=("rate",))
    label = json.loads(json.dumps(truth))
    campaign = tomllib.loads((tmp_path / "a" / "campaign.toml").read_text())["trial"]
    assert [one["battery"] for one in campaign] == [plan["battery"] for plan in label["trials"]]
    again = make_campaign(label["seed"], tmp_path / "b", **asdict(Nature.of(label)))
    assert again["bench"] == truth["bench"]
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_batteries_are_swapped_before_they_are_empty():
    plans = draw_campaign(2).trials
    swapped = with_batteries(plans, usual_current_a=20.0, capacity_ah=1.0, swap_share=0.0, rng=np.random.default_rng(0))
    used = {
        name: sum(20.0 * plan.seconds * max(plan.thickness_mm, 20.0) / 20.0 for plan in swapped if plan.battery == name)
        for name in {plan.battery for plan in swapped}
    }
    assert len(used) > 1
    assert max(used.values()) <= 0.5 * 3600.0


def test_a_fresh_battery_rests_at_full_voltage():
    campaigns = (draw_campaign(seed, benches="foreign", length=0.3) for seed in SEEDS)
    draw = next(one for one in campaigns if one.trials[-1].battery != "P1")
    first = next(k for k, plan in enumerate(draw.trials) if plan.battery == "P2")
    rest_v = {}
    for index, (_, _, readings) in enumerate(measured_trials(draw)):
        if index in (0, first - 1, first):
            rest_v[index] = float(np.median(readings.values["battery_voltage_v"][readings.time_s < 0.04]))
    # Over the voltage of its own battery, as read by the same sensor.
    share = {index: volts / trial_settings(draw, index).nominal_voltage_v for index, volts in rest_v.items()}
    assert share[first - 1] < share[first]
    assert share[first] == pytest.approx(share[0], rel=1e-3)


def test_batteries_of_one_type_differ_a_little_and_each_is_always_the_same():
    campaigns = [draw_campaign(seed, benches="foreign", length=0.3) for seed in SEEDS]
    swapped = [draw for draw in campaigns if draw.trials[-1].battery != "P1"]
    assert swapped
    ratios = []
    for draw in swapped:
        by_battery = {}
        for index, plan in enumerate(draw.trials):
            settings = trial_settings(draw, index)
            numbers = (settings.nominal_voltage_v, settings.capacity_ah, settings.internal_resistance_ohm)
            assert by_battery.setdefault(plan.battery, numbers) == numbers
        first = np.array(by_battery.pop("P1"))
        ratios += [np.array(numbers) / first for numbers in by_battery.values()]
    off = np.abs(np.array(ratios) - 1.0)
    assert np.all(off > 0.0)
    assert np.all(off < 5.0 * np.array([0.003, 0.02, 0.06]))


def test_a_tool_that_is_switched_off_coasts_and_one_that_starts_late_rests():
    draw = draw_campaign(2)
    plan = replace(draw.trials[0], seconds=1.5, off_s=0.5, late_s=1.0)
    (_, _, readings), *_ = measured_trials(replace(draw, trials=(plan,)))
    current_a, time_s = readings.values["motor_current_a"], readings.time_s
    assert abs(np.mean(current_a[time_s < 1.0])) < 0.1
    assert np.mean(current_a[(time_s > 1.6) & (time_s < 1.9)]) > 0.4
    assert abs(np.mean(current_a[time_s > time_s[-1] - 0.2])) < 0.1


def test_a_blade_that_is_out_of_the_wood_feels_no_force():
    draw = draw_campaign(2)
    plan = replace(next(plan for plan in draw.trials if plan.feed_mm_s > 0.0), seconds=3.0, in_air_s=1.0, out_s=0.5)
    (_, _, readings), *_ = measured_trials(replace(draw, trials=(plan,)))
    on_s = readings.time_s[-1] - plan.seconds
    of_time = {name: (readings.time_s > on_s + a) & (readings.time_s < on_s + b)
               for name, (a, b) in {"before": (0.1, 0.9), "in": (1.3, 2.4), "behind": (2.6, 2.9)}.items()}  # fmt: skip
    swing_n = {name: float(np.std(readings.values["force_n"][inside])) for name, inside in of_time.items()}
    assert swing_n["in"] > 20.0
    assert max(swing_n["before"], swing_n["behind"]) < 0.1 * swing_n["in"]


def test_foreign_sets_sort_effects_by_the_catalogue_at_hand():
    known = drawn_from([*CATALOGUE, "cogging_torque"])
    assert "cogging_torque" in known.catalogue
    assert "cogging_torque" in drawn_from([*CATALOGUE]).outside
    hidden = {name for case in draw_cases(1, 800, known) if case.kind == "effect" for name in case.effects}
    assert "cogging_torque" in hidden
    assert "interference_bursts" not in known.outside  # on a foreign bench an ordinary fault of a sensor


def test_a_set_of_foreign_benches_keeps_its_options_in_the_key(tmp_path):
    nature = Nature(benches="foreign", length=0.02, without=("hum", "rate"), rate_hz=1000.0)
    key = json.loads(make(3, 1, tmp_path / "set", nature=nature, catalogue=[*CATALOGUE], workers=1).read_text())
    assert key["options"]["without"] == ["hum", "rate"]
    assert Nature.of(key["options"]) == nature
    assert Nature.of(key["cases"]["case-0001"]["label"]["truth"]) == nature


# --- faults of sensors -----------------------------------------------------------------------------------------


def still(rate_hz: float = 4000.0, seconds: float = 8.0) -> Readings:
    time_s = np.arange(round(rate_hz * seconds)) / rate_hz
    names = ("force_n", "displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")
    return Readings(time_s=time_s, values=dict.fromkeys(names, np.sin(2.0 * np.pi * 17.0 * time_s)))


def spoilt(
    name: str, numbers: dict[str, float], *, session_s: float = 500.0, trial: int = 0, seed: int = 1
) -> Readings:
    moment = Moment(session_s=session_s, session=stream_of(seed, name, 23), trial=stream_of(seed, name, 24, trial))
    return NUISANCES[name].disturb(still(), numbers, moment)


def added(name: str, numbers: dict[str, float], channel: str = "force_n", **more) -> np.ndarray:
    return spoilt(name, numbers, **more).values[channel] - still().values[channel]


@pytest.mark.parametrize("name", sorted(SENSOR_FAULTS))
def test_every_fault_draws_numbers_and_changes_the_readings_the_same_way_twice(name):
    numbers = NUISANCES[name].draw(np.random.default_rng(4))
    assert numbers and all(np.isfinite(value) for value in numbers.values())
    once, again = spoilt(name, numbers), spoilt(name, numbers)
    assert np.all(np.diff(once.time_s) > 0.0)
    assert any(
        len(once.time_s) != len(still().time_s) or not np.array_equal(once.values[k], still().values[k])
        for k in once.values
    ) or not np.array_equal(once.time_s, still().time_s)
    np.testing.assert_array_equal(once.time_s, again.time_s)
    for channel, column in once.values.items():
        np.testing.assert_array_equal(column, again.values[channel])


def test_the_zero_walks_as_far_as_it_says_and_on_between_trials():
    numbers = {"n_in_8_s": 0.7, "memory_s": 2000.0}
    ways = np.array([added("wandering_zero", numbers, seed=seed)[[0, -1]] for seed in range(300)])
    assert np.std(ways[:, 1] - ways[:, 0]) == pytest.approx(0.7, rel=0.15)
    end = added("wandering_zero", numbers, session_s=500.0)[-1]
    assert added("wandering_zero", numbers, session_s=508.0)[0] == pytest.approx(end, abs=0.05)


def test_flicker_has_the_power_of_one_over_f():
    noise = added("flicker_zero", {"rms_n": 0.5})
    assert noise.std() == pytest.approx(0.5, rel=0.02)
    power = np.abs(np.fft.rfft(noise)) ** 2
    hz = np.fft.rfftfreq(len(noise), 1 / 4000.0)
    octave = [power[(hz > low) & (hz < 2 * low)].sum() for low in (2.0, 20.0, 200.0)]
    np.testing.assert_allclose(octave, np.mean(octave), rtol=0.6)


def test_a_restart_moves_the_zero_once_a_trial():
    moved = [added("stepping_zero", {"step_n": 2.0}, trial=k) for k in range(200)]
    assert all(np.ptp(one) < 1e-12 for one in moved)
    assert np.std([one[0] for one in moved]) == pytest.approx(2.0, rel=0.2)


def test_hum_is_at_the_mains_in_force_and_current():
    numbers = {"hz": 50.0, "force_n": 4.0, "motor_current_a": 0.4, "second": 0.0, "third": 0.25}
    for channel in ("force_n", "motor_current_a"):
        wave = added("hum", numbers, channel)
        lines = np.abs(np.fft.rfft(wave)) * 2.0 / len(wave)
        assert lines[400] == pytest.approx(numbers[channel], rel=1e-6)  # 50 Hz in 8 s
        assert lines[1200] == pytest.approx(0.25 * numbers[channel], rel=1e-6)


def test_coarse_steps_are_those_of_the_bits():
    values = np.unique(spoilt("coarse_steps", {"bits": 10.0}).values["force_n"])
    assert np.diff(values).min() == pytest.approx(1000.0 / 2**10)


def test_rows_are_missing_at_random_and_in_gaps():
    found = spoilt("missing_samples", {"share": 0.02, "gaps_per_s": 1.0, "gap_s": 0.03})
    lost = 1.0 - len(found.time_s) / len(still().time_s)
    assert 0.02 < lost < 0.02 + 2 * 8 * 0.03 / 8
    assert np.diff(found.time_s).max() > 0.025


def test_written_times_are_off_by_their_share_of_a_period():
    found = spoilt("jitter", {"sample_periods": 0.1})
    kept = np.searchsorted(still().time_s, found.time_s + 0.5 / 4000.0) - 1
    assert np.std(found.time_s - still().time_s[kept]) * 4000.0 == pytest.approx(0.1, rel=0.05)


def test_spikes_are_single_and_bursts_are_short():
    spikes = added("spikes", {"per_s": 2.0, "size": 0.5, "channel": 1.0}, "displacement_mm")
    assert 4 < np.count_nonzero(spikes) < 32
    assert np.abs(spikes).max() == pytest.approx(1.0)  # half of the range from -1 to 1
    bursts = added("bursts", {"per_s": 1.0, "force_n": 40.0, "seconds": 0.004})
    assert np.abs(bursts).max() > 40.0
    assert np.mean(np.abs(bursts) > 1.0) < 0.1


def test_a_gain_drifts_to_its_number():
    for session_s, share in ((0.0, 0.0), (1e5, 0.01)):
        change = added("gain_drift", {"force_n": 0.01, "motor_current_a": -0.01}, session_s=session_s)
        slope = np.dot(change, still().values["force_n"]) / np.dot(still().values["force_n"], still().values["force_n"])
        assert slope == pytest.approx(share, abs=1e-4)


def test_a_campaign_s_readings_carry_its_faults(draws):
    draw = next(draw for draw in draws if "hum" in draw.nuisances and "missing_samples" not in draw.nuisances)
    changed = disturbed(draw, still(), 100.0, 0).values["force_n"]
    assert len(changed) == pytest.approx(len(still().time_s), abs=20)
    assert np.std(changed) > np.std(still().values["force_n"])


def test_uneven_wood_changes_what_is_cut_and_no_reading(draws):
    seed = next(k for k in SEEDS if "uneven_wood" in draws[k].nuisances)
    numbers = draws[seed].nuisances["uneven_wood"]
    even = draw_campaign(seed, benches="foreign", without=("uneven_wood",))
    for index, plan in enumerate(draws[seed].trials):
        uneven, usual = (trial_settings(draw, index) for draw in (draws[seed], even))
        assert replace(uneven, uneven_rel_std=0.0, uneven_mm=usual.uneven_mm) == usual
        assert (uneven.uneven_rel_std, uneven.uneven_mm) == (numbers["rel_std"], numbers["mm"])
        hardness = stroke_factors(uneven)
        assert np.array_equal(hardness, stroke_factors(usual)) == (plan.feed_mm_s == 0.0)
    read = spoilt("uneven_wood", dict(numbers))
    assert all(np.array_equal(read.values[name], values) for name, values in still().values.items())


def test_a_battery_with_a_curve_of_its_own_has_another_voltage_and_nothing_else(draws):
    seed = next(k for k in SEEDS if "battery_curve" in draws[k].nuisances)
    numbers = draws[seed].nuisances["battery_curve"]
    without = draw_campaign(seed, benches="foreign", without=("battery_curve",))
    of_its_own, usual = (trial_settings(draw, 0) for draw in (draws[seed], without))
    assert replace(of_its_own, extras=usual.extras) == usual
    full_v = [output_of(Plant(settings).advance(1e-3), "battery_v")[0] for settings in (of_its_own, usual)]
    assert full_v[0] - full_v[1] == pytest.approx(numbers["surplus_share"] * usual.nominal_voltage_v, rel=0.01)
