"""The independent bench: its plant conserves energy, its effects start at nothing, its campaigns repeat."""

from __future__ import annotations

import ast
import dataclasses
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from sawbench.modeling.effects.catalogue import EFFECTS as KNOWN_TO_THE_PRODUCT

from benchmarks import independent_bench
from benchmarks.independent_bench import campaign as campaigns
from benchmarks.independent_bench import cases, instruments, parameters, plans, plant, scoring, visibility
from benchmarks.independent_bench.benches import HARDWOODS
from benchmarks.independent_bench.effects import CATALOGUE, EFFECTS, UNLISTED, hide, setting_of

pytestmark = pytest.mark.unit

PACKAGE = Path(independent_bench.__file__).parent
ALLOWED = {"sawbench.bench.recording", "sawbench.storage.reader"}


def test_it_imports_nothing_of_the_product_but_the_recording_and_its_writer():
    imported = set()
    for path in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported.add(node.module or "")
            elif isinstance(node, ast.Import):
                imported.update(alias.name for alias in node.names)
    assert {name for name in imported if name.partition(".")[0] == "sawbench"} == ALLOWED
    ours = {name for name in imported if name.partition(".")[0] == "benchmarks"}
    assert all(name.startswith("benchmarks.independent_bench") for name in ours)


# A motor whose two constants are equal turns all of its electrical power into heat and motion.
IDEAL = parameters.Machine(torque_constant_n_m_per_a=7.383e-3, motor_damping_n_m_s_per_rad=0.0)


@pytest.mark.parametrize("coefficient_n_s_per_m", [0.0, 240.0])
def test_energy_of_a_frictionless_plant_closes(coefficient_n_s_per_m):
    run = parameters.Run(on_s=0.02, cutting_coefficient_n_s_per_m=coefficient_n_s_per_m)
    state = np.zeros(plant.N_STATES)
    signals = plant.integrate(parameters.Plant(machine=IDEAL, run=run), state, 20_001, np.ones(1))
    force, x, current, voltage, battery_a, angle, speed = signals
    electrical = np.trapezoid(voltage * battery_a, dx=plant.STEP_S)
    heat = np.trapezoid(IDEAL.resistance_ohm * current**2, dx=plant.STEP_S)
    cut = -np.trapezoid(force, x)  # the blade cuts while x falls
    crank_speed = speed[-1] / IDEAL.gear_ratio
    blade_m_s = IDEAL.crank_radius_m * np.sin(angle[-1]) * crank_speed
    stored = 0.5 * (
        IDEAL.inductance_h * current[-1] ** 2
        + IDEAL.rotor_inertia_kg_m2 * speed[-1] ** 2
        + IDEAL.yoke_inertia_kg_m2 * crank_speed**2
        + IDEAL.reciprocating_mass_kg * blade_m_s**2
    )
    assert electrical > 5.0
    assert (cut > 1.0) == (coefficient_n_s_per_m > 0.0)
    assert electrical == pytest.approx(heat + stored + cut, rel=1e-4)


def test_without_load_the_motor_settles_where_its_back_emf_is_the_voltage():
    run = parameters.Run(duty=0.4)
    signals = plant.integrate(parameters.Plant(machine=IDEAL, run=run), np.zeros(plant.N_STATES), 80_000, np.ones(1))
    mean_speed = signals[plant.MOTOR_SPEED, -20_000:].mean()
    mean_v = run.duty * signals[plant.BATTERY_V, -20_000:].mean()
    assert mean_speed * IDEAL.back_emf_constant_v_s_per_rad == pytest.approx(mean_v, rel=2e-3)


def test_the_yoke_stands_still_until_the_pin_has_crossed_half_of_the_play():
    play = parameters.Play(gap_m=1e-3)
    signals = plant.integrate(parameters.Plant(play=play), np.zeros(plant.N_STATES), 20_000, np.ones(1))
    pin = 0.01 * (1.0 - np.cos(signals[plant.CRANK_ANGLE]))
    touched = int(np.argmax(pin > 0.5 * play.gap_m))
    assert touched > 100
    assert not signals[plant.POSITION, :touched].any()
    assert signals[plant.POSITION].max() == pytest.approx(0.02, abs=play.gap_m)


@pytest.fixture(scope="module", autouse=True)
def soon_settled():
    """Trials here are shorter than a machine takes to settle."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaigns, "SETTLED_S", 0.1)
        patch.setattr(visibility, "SETTLED_S", 0.1)
        yield


@pytest.fixture(scope="module")
def drawn():
    """An intact campaign of two short trials, both from rest: in air and in wood."""
    campaign = campaigns.draw_campaign(7, cases.Case(number=1, kind="intact", effects={}))
    idle = next(trial for trial in campaign.plan.trials if trial.material is None)
    cut = next(trial for trial in campaign.plan.trials if trial.material in HARDWOODS)
    short = (
        dataclasses.replace(idle, number=1, duration_s=0.3, on_s=0.04, has_run_up=True),
        dataclasses.replace(cut, number=2, duration_s=0.6, on_s=0.04, has_run_up=True),
    )
    return dataclasses.replace(campaign, plan=dataclasses.replace(campaign.plan, trials=short))


def recorded(campaign):
    """Times and values of all channels, in one array."""
    found = campaigns.recordings_of(campaign, _signals(campaign), "")
    return np.concatenate([np.concatenate([s.time_s, s.values]) for r in found for s in r.signals.values()])


@pytest.fixture(scope="module")
def intact(drawn):
    return recorded(drawn)


def with_effect(campaign, name, severity):
    setting = setting_of(campaign.bench, campaign.plan, campaign.instruments)
    hidden = hide({name: severity}, campaign.intact.plant, np.random.default_rng(2), setting)
    return dataclasses.replace(campaign, hidden=hidden)


def test_a_second_battery_is_full_has_numbers_of_its_own_and_is_named(drawn):
    first = drawn.bench.battery
    second = first._replace(nominal_voltage_v=1.01 * first.nominal_voltage_v)
    swapped = dataclasses.replace(drawn, second_battery=(2, second))
    assert [r.trial.battery for r in campaigns.recordings_of(drawn, _signals(drawn), "")] == ["P1", "P1"]
    assert [r.trial.battery for r in campaigns.recordings_of(swapped, _signals(swapped), "")] == ["P1", "P2"]
    rest_v = [float(one[plant.BATTERY_V, 5]) for one in _signals(swapped)]
    assert rest_v[1] == pytest.approx(1.01 * rest_v[0], rel=1e-6)


def _signals(campaign):
    return [one for one, _ in campaigns.simulate(campaign, campaign.hidden)]


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_severity_0_changes_nothing(name, drawn, intact):
    assert np.array_equal(recorded(with_effect(drawn, name, 0.0)), intact)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_severity_1_changes_something(name, drawn, intact):
    assert not np.array_equal(recorded(with_effect(drawn, name, 1.0)), intact)


def test_the_same_seed_gives_the_same_files(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(campaigns, "draw_plan", lambda *_: drawn.plan)
    case = cases.Case(number=3, kind="single", effects={"grain_variation": 1.0})
    entries = [campaigns.write_case(7, case, tmp_path / name) for name in "ab"]
    other = campaigns.write_case(8, case, tmp_path / "c")
    assert entries[0] == entries[1] != other
    assert json.loads(json.dumps(entries[0])) == entries[0]
    first, second, third = (
        {path.name: path.read_bytes() for path in (tmp_path / name / "case-03").iterdir()} for name in "abc"
    )
    assert sorted(first) == ["bench_config.toml", "trial-01.mcap", "trial-02.mcap"]
    assert first == second
    assert all(first[name] != third[name] for name in first)


def test_the_kinds_are_spread_evenly_and_hide_what_their_lists_hold():
    drawn_cases = [cases.draw_case(5, number) for number in range(1, 89)]
    for n in range(1, 89):
        counts = Counter(case.kind for case in drawn_cases[:n])
        assert all(abs(counts[kind] - n * share / 44) <= 1.0 for kind, share in cases.SHARES.items())
    for case in drawn_cases:
        allowed = {"unknown": UNLISTED, "parameters": cases.MISSET, "intact": {}}.get(case.kind, CATALOGUE)
        assert set(case.effects) <= set(allowed)
        assert len(case.effects) == {"intact": 0, "pair": 2}.get(case.kind, 1)
    assert {name for case in drawn_cases if case.kind == "single" for name in case.effects} == set(CATALOGUE)
    assert drawn_cases == [cases.draw_case(5, number) for number in range(1, 89)]
    assert drawn_cases != [cases.draw_case(6, number) for number in range(1, 89)]


def test_its_catalogue_is_part_of_the_products_and_the_rest_is_not():
    known = {effect.name for effect in KNOWN_TO_THE_PRODUCT}
    assert set(CATALOGUE) < known
    assert not set(UNLISTED) & known


@pytest.mark.parametrize("seed", range(20))
def test_a_plan_has_what_was_asked_for(seed):
    rng = np.random.default_rng(seed)
    bench = campaigns.draw_campaign(seed, cases.Case(number=1, kind="intact", effects={})).bench
    plan = plans.draw_plan(rng, bench, {plans.DUTIES, plans.FEEDS, plans.STARTS})
    cutting = [trial for trial in plan.trials if trial.material is not None]
    assert 10 <= len(plan.trials) <= 24
    assert plan.trials[0].material is None
    assert len({trial.duty for trial in plan.trials}) >= 3
    assert len({trial.feed_mm_s for trial in cutting}) == 2
    assert all(trial.has_run_up for trial in plan.trials)
    assert all(instruments.draw_instruments(rng, {instruments.FAST_CAN}).devices["can"].rate_hz == 2000.0 for _ in "ab")


def test_a_late_clock_delays_the_channels_of_its_device(drawn):
    setting = setting_of(drawn.bench, drawn.plan, drawn.instruments)
    hidden = hide({"clock_offset": 1.0}, drawn.intact.plant, np.random.default_rng(2), setting)
    signals = [one for one, _ in campaigns.simulate(drawn, drawn.intact)]
    late = dataclasses.replace(drawn, hidden=hidden)
    pairs = zip(*(campaigns.recordings_of(one, signals, "") for one in (late, drawn)), strict=True)
    for one, other in pairs:
        for channel, signal in one.signals.items():
            delay_s = signal.time_s - other.signals[channel].time_s
            assert delay_s == pytest.approx(1.58e-3 if signal.device == hidden.sensors.late_device else 0.0, abs=1e-9)


def entry(kind, effects, numbers=None):
    return {"kind": kind, "effects": effects, "numbers": numbers or {}}


def report(verdict, effects=(), alike=(), probability=0.9, parameters=None):
    cause = {
        "effects": list(effects), "indistinguishable_from": list(alike), "probability": probability,
        "parameters": parameters or {},
    }  # fmt: skip
    return {"verdict": verdict, "causes": [cause], "probabilities": {"no_gap": 0.05, "parameters": 0.0, "unknown": 0.0}}


def test_answers_are_counted_apart():
    force = {"force_n": {"value": 5.5, "std": 0.3, "unit": "N"}}
    told = [
        (entry("single", {"edge_force": 1.0}, {"edge_force": {"force_n": 5.0}}),
         report("effect", ["edge_force"], ["blade_wear"], parameters=force)),
        (entry("single", {"blade_wear": 1.0}), report("effect", ["edge_force"], ["blade_wear"], 0.5)),
        (entry("single", {"grain_variation": 1.0}), report("indistinguishable", ["grain_variation"], ["blade_wear"])),
        (entry("single", {"engagement_delay": 1.0}), report("no_gap", ["engagement_delay"])),
        (entry("pair", {"a": 1.0, "b": 1.0}), report("effects", ["b", "a"], probability=0.7)),
        (entry("pair", {"a": 1.0, "b": 1.0}), report("effect", ["a"], ["b"], probability=1.0)),
        (entry("intact", {}), report("effect", ["a"])),
        (entry("parameters", {"resistance_ohm": 4.0}), report("parameters", ["a"])),
        (entry("unknown", {"belt_slip": 1.0}), report("unknown", ["a"])),
        (entry("unknown", {"belt_slip": 1.0}), None),
    ]  # fmt: skip
    made = [scoring.answered(f"case-{n:02d}", *one) for n, one in enumerate(told, start=1)]
    rows = {(of, what): count for of, what, count in scoring.score_rows(made)}
    assert rows[("single effects", "exact")] == "1 of 4"
    assert rows[("single effects that are declared", "exact")] == "1 of 3"
    assert rows[("pairs", "both named")] == "1 of 2"
    assert rows[("single effects and pairs", "hidden effects within the claim")] == "5 of 6"
    assert rows[("intact benches", "accused")] == "1 of 1"
    assert rows[("mis-set parameters", "accused")] == "0 of 1"
    assert rows[("effects that no catalogue lists", "called unknown")] == "1 of 2"
    assert rows[("all claims", "exact")] == "2 of 6"
    assert rows[("all claims", "mean stated probability")] == "82%"
    assert rows[("declared magnitudes with a plain true value", "true within 2 std")] == "1 of 1"
    assert rows[("all cases", "without an answer")] == "1 of 10"
    assert "| case-10 | unknown | belt_slip 1 |" in scoring.score_page(made)


def test_a_magnitude_beyond_two_standard_uncertainties_does_not_hold_the_truth():
    stated = {"force_n": {"value": 5.7, "std": 0.3, "unit": "N"}}
    numbers = {"edge_force": {"force_n": 5.0}}
    made = scoring.answered(
        "a", entry("single", {"edge_force": 1.0}, numbers), report("effect", ["edge_force"], parameters=stated)
    )
    assert made.magnitudes() == [False]
    both = {**numbers, "guide_friction": {"force_n": 3.0}}
    made = scoring.answered(
        "b", entry("pair", {"edge_force": 1.0, "guide_friction": 1.0}, both),
        report("effects", ["edge_force", "guide_friction"], parameters=stated),
    )  # fmt: skip
    assert made.magnitudes() == []
