"""Campaigns of the blind check follow the contract; sealed sets keep their secrets and show tampering."""

import csv
import json
import tomllib

import numpy as np
import pytest
from sawbench.bench.config import load_config
from sawbench.bench.errors import InputError
from sawbench.blindcheck import sealing
from sawbench.blindcheck.bench import OWN, Nature
from sawbench.blindcheck.campaign import make_campaign, trial_settings
from sawbench.blindcheck.csv_table import csv_bytes
from sawbench.blindcheck.drawing import draw_campaign
from sawbench.blindcheck.effects.table import ACTS_IN, CATALOGUE

pytestmark = pytest.mark.unit

COLUMNS = "time_s,force_n,displacement_mm,motor_current_a,battery_voltage_v,battery_current_a"
SHORT = {"length": 0.04}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    out = tmp_path_factory.mktemp("campaign") / "c"
    truth = make_campaign(7, out, effects={"edge_force": 1.0}, **SHORT)
    return out, truth


def test_campaign_has_the_contract_s_shape(campaign):
    out, _ = campaign
    table = tomllib.loads((out / "campaign.toml").read_text())
    trials = table["trial"]
    assert len(trials) == 18
    assert {t["duty"] for t in trials} == {0.35, 0.4375, 0.55}
    cutting = [t for t in trials if t["workpiece"] != "none"]
    assert len({t["feed_mm_s"] for t in cutting}) == 2
    assert len({t["thickness_mm"] for t in cutting}) == 2
    points = [(t["duty"], t["feed_mm_s"], t["thickness_mm"]) for t in cutting]
    assert sum(points.count(point) >= 3 for point in set(points)) == 3
    assert trials[0]["workpiece"] == trials[-1]["workpiece"] == "none"
    starts = [t["started_at"] for t in trials]
    assert starts == sorted(starts)
    for trial in trials:
        with (out / trial["file"]).open() as file:
            assert file.readline().strip() == COLUMNS
    assert load_config(out / table["config"]).plant().resistance_ohm.nominal == 0.176


def test_trial_tables_are_what_a_bench_measures(campaign):
    out, _ = campaign
    with (out / "trial-05.csv").open() as file:
        rows = np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])
    steps = np.diff(rows[:, 0])
    assert steps.min() > 0.0
    assert np.median(steps) == pytest.approx(2e-4, rel=0.02)
    assert steps.std() > 2e-6
    assert rows[0, 0] == 0.0
    at_rest = rows[rows[:, 0] < 0.04]
    assert abs(at_rest[:, 3].mean()) < 0.1
    assert 16.0 < at_rest[:, 4].mean() < 18.5
    assert 0.0 - 0.2 < rows[:, 2].min() < rows[:, 2].max() < 20.0 + 0.2


def test_nothing_of_the_truth_lies_in_the_folder(campaign):
    out, truth = campaign
    for path in out.iterdir():
        text = path.read_text()
        assert "edge_force" not in text
        assert str(truth["true_parameters"]["resistance_ohm"])[:8] not in text


def test_the_same_seed_makes_the_same_files(campaign, tmp_path):
    out, truth = campaign
    again = make_campaign(7, tmp_path / "c", effects={"edge_force": 1.0}, **SHORT)
    assert json.dumps(again) == json.dumps(truth)
    assert sealing.file_hashes(tmp_path / "c") == sealing.file_hashes(out)
    make_campaign(8, tmp_path / "d", effects={"edge_force": 1.0}, **SHORT)
    assert sealing.file_hashes(tmp_path / "d")["trial-01.csv"] != sealing.file_hashes(out)["trial-01.csv"]


def test_a_full_folder_is_not_overwritten(campaign):
    with pytest.raises(InputError, match="not empty"):
        make_campaign(7, campaign[0])


def test_charge_carries_over_between_trials(campaign):
    out, _ = campaign
    rest_v = []
    for number in (1, 18):
        with (out / f"trial-{number:02d}.csv").open() as file:
            rows = list(csv.reader(file))[1:200]
        rest_v.append(np.mean([float(row[4]) for row in rows]))
    assert rest_v[1] < rest_v[0]


def test_constants_stay_within_their_uncertainty_or_go_beyond_as_asked():
    within = np.array([list(draw_campaign(seed).shifts.values()) for seed in range(60)])
    assert np.abs(within).max() <= 2.0
    clipped_std = np.sqrt(0.7385 + 4.0 * 0.0455)  # of a unit normal clipped at +-2: E[x^2; |x| < 2] + 4 P(|x| > 2)
    assert within.std() == pytest.approx(clipped_std, abs=0.08)
    for seed in range(10):
        far = [abs(shift) for shift in draw_campaign(seed, parameters="beyond").shifts.values() if abs(shift) > 2]
        assert len(far) == 3
        assert all(4.0 <= shift <= 8.0 for shift in far)
    assert set(OWN.nominal) <= set(draw_campaign(1).parameters)


def test_background_is_small_and_never_the_effect_itself():
    for seed in range(30):
        draw = draw_campaign(seed, effects={"windage_drag": 1.0}, background=(28, 0.003, 0.02))
        assert "windage_drag" not in draw.background
        assert all(0.003 <= size <= 0.02 for size in draw.background.values())


def test_a_background_by_name_is_taken_as_it_is_and_changes_nothing_else():
    name, size = next(iter(draw_campaign(7).background.items()))
    hidden = draw_campaign(7, effects={name: 1.0})
    bare = draw_campaign(7, background=hidden.background)
    assert name not in hidden.background
    assert name in draw_campaign(7).background
    assert dict(bare.background) == dict(hidden.background)
    for field in ("parameters", "k_fc_n_s_per_m", "width_exponent", "trials", "session_seed"):
        assert getattr(bare, field) == getattr(hidden, field)
    both = draw_campaign(7, effects={"edge_force": 0.5}, background={"edge_force": size})
    assert (both.effects["edge_force"], both.background["edge_force"]) == (0.5, size)


def test_csv_is_exact_to_its_decimals():
    rng = np.random.default_rng(5)
    columns = {"a": rng.normal(0.0, 300.0, 500), "b": rng.uniform(-0.01, 0.01, 500)}
    lines = csv_bytes(columns, {"a": 3, "b": 5}).decode().splitlines()
    parsed = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    np.testing.assert_allclose(parsed[:, 0], columns["a"], atol=5.1e-4)
    np.testing.assert_allclose(parsed[:, 1], columns["b"], atol=5.1e-6)


def test_case_kinds_have_the_stated_shares():
    cases = sealing.draw_cases(3, 2000)
    share = {kind: np.mean([case.kind == kind for case in cases]) for kind in ("effect", "pair", "outside")}
    none = np.mean([not case.effects for case in cases])
    assert none == pytest.approx(0.25, abs=0.03)
    assert share["effect"] == pytest.approx(0.5, abs=0.035)
    assert share["pair"] == pytest.approx(0.1, abs=0.02)
    assert share["outside"] == pytest.approx(0.15, abs=0.025)
    assert all(len(case.effects) == 2 for case in cases if case.kind == "pair")
    severities = [size for case in cases for size in case.effects.values()]
    assert np.mean([(0.5 <= size <= 2.0) for size in severities]) == pytest.approx(0.8, abs=0.03)
    assert len({case.seed for case in cases}) == 2000


def test_a_set_without_effects_holds_intact_machines_alone():
    cases = sealing.draw_cases(3, 50, effects_per_case=0)
    assert {(case.kind, len(case.effects)) for case in cases} == {("none", 0)}
    assert len({case.seed for case in cases}) == 50


@pytest.mark.parametrize(("count", "kind"), [(1, "effect"), (2, "pair"), (3, "several"), (4, "several")])
def test_several_effects_of_a_case_share_no_equation(count, kind):
    cases = sealing.draw_cases(3, 200, effects_per_case=count)
    assert {case.kind for case in cases} == {kind}
    assert {len(case.effects) for case in cases} == {count}
    for case in cases:
        equations = [ACTS_IN[name] for name in case.effects]
        assert len(frozenset().union(*equations)) == sum(map(len, equations)), case.effects
    assert all(0.5 <= size <= 2.0 for case in cases for size in case.effects.values())
    named = {name for case in cases for name in case.effects}
    assert len(named) > 0.9 * len(CATALOGUE), "no effect is left out for good"
    assert sealing.draw_cases(3, 7, effects_per_case=count)[6] == cases[6]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    out = tmp_path_factory.mktemp("sealed") / "set"
    return out, sealing.make(5, 2, out, nature=Nature(length=0.02), workers=1)


def test_a_sealed_set_opens_with_its_key(sealed):
    out, key = sealed
    labels = sealing.verify(out, key)
    assert [label["kind"] for label in labels.values()] == [case.kind for case in sealing.draw_cases(5, 2)]
    assert out not in key.parents
    open_text = (out / sealing.COMMITMENTS).read_text()
    secret = json.loads(key.read_text())
    for case in secret["cases"].values():
        assert case["salt"] not in open_text
        assert str(case["label"]["truth"]["seed"]) not in open_text


def test_a_broken_off_run_goes_on_and_keeps_what_is_there(sealed, tmp_path):
    out = tmp_path / "set"
    key = sealing.make(5, 1, out, nature=Nature(length=0.02), workers=1)
    (out / "case-0002.part").mkdir()
    first = (out / "case-0001" / "trial-01.csv").stat().st_mtime_ns
    calls: list[tuple[int, int]] = []
    sealing.make(
        5, 2, out, nature=Nature(length=0.02), workers=1, on_progress=lambda done, wanted: calls.append((done, wanted))
    )
    assert calls == [(2, 2)]
    assert (out / "case-0001" / "trial-01.csv").stat().st_mtime_ns == first
    again, once = sealing.verify(out, key), sealing.verify(*sealed)
    assert json.dumps(again) == json.dumps(once)
    with pytest.raises(InputError, match="seed"):
        sealing.make(6, 2, out, nature=Nature(length=0.02), workers=1)


@pytest.mark.parametrize("what", ["label", "salt", "campaign", "commitments", "missing"])
def test_tampering_is_found(what, tmp_path):
    out = tmp_path / "set"
    key_path = sealing.make(9, 1, out, nature=Nature(length=0.02), workers=1)
    sealing.verify(out, key_path)
    key = json.loads(key_path.read_text())
    if what == "label":
        key["cases"]["case-0001"]["label"]["truth"]["effects"] = {"blade_wear": 1.0}
    elif what == "salt":
        key["cases"]["case-0001"]["salt"] = "00" * 32
    elif what == "campaign":
        path = out / "case-0001" / "trial-03.csv"
        path.write_bytes(path.read_bytes().replace(b"1", b"2", 1))
    elif what == "commitments":
        path = out / sealing.COMMITMENTS
        path.write_text(path.read_text() + " ")
    else:
        (out / "case-0001" / "trial-03.csv").unlink()
    key_path.write_text(json.dumps(key))
    with pytest.raises(InputError, match="seal is broken"):
        sealing.verify(out, key_path)


def test_a_key_inside_the_set_and_a_file_that_is_no_key_are_refused(sealed, tmp_path):
    with pytest.raises(InputError, match="inside"):
        sealing.make(1, 1, tmp_path / "s", key_path=tmp_path / "s" / "key.json")
    with pytest.raises(InputError, match="no key"):
        sealing.read_key(sealed[0] / sealing.COMMITMENTS)
    with pytest.raises(InputError, match="no such file"):
        sealing.verify(tmp_path, tmp_path / "none.json")


def test_a_repetition_is_another_session_with_the_same_machine():
    first, again, third = (draw_campaign(7, effects={"force_offset_drift": 1.0}, repetition=k) for k in (0, 1, 2))
    for name in ("seed", "parameters", "background", "sensors", "k_fc_n_s_per_m", "width_exponent"):
        assert getattr(again, name) == getattr(first, name)
    assert dict(again.change.sensors) == dict(first.change.sensors)

    def settings(draw):
        return [(t.duty, t.workpiece, t.thickness_mm, t.feed_mm_s, t.seconds) for t in draw.trials]

    assert sorted(settings(again)) == sorted(settings(first))
    assert settings(again) != settings(first)
    assert settings(again) != settings(third)
    assert [t.rest_s for t in again.trials] != [t.rest_s for t in first.trials]
    assert first.session_seed == first.seed
    assert len({first.session_seed, again.session_seed, third.session_seed}) == 3
    wood = [trial_settings(draw, 3) for draw in (first, again)]
    assert wood[0].seed != wood[1].seed
    assert wood[0].resistance_ohm == wood[1].resistance_ohm
    assert draw_campaign(7, repetition=1).trials == again.trials
