"""Plans of a series: what a design makes, what a file or a table is read as, what is refused."""

from __future__ import annotations

from collections import Counter

import pytest
from sawbench.acquisition.series.plan import SeriesPlan, departures, is_plan, load_plan, missing_metadata
from sawbench.acquisition.series.plan_design import SeriesDesign, designed_trials, plan_text
from sawbench.bench.errors import ConfigError

pytestmark = pytest.mark.unit

WOODS = ("oak", "nylon", "black_locust")


def design(**changes):
    return SeriesDesign(**{"materials": WOODS, "duties": (0.4,), "feeds_mm_s": (2.0, 4.0, 6.0), "seed": 5, **changes})


def test_blocks_of_a_setting_hold_its_repetitions_on_a_blade_of_their_own():
    trials = designed_trials(design())
    assert len(trials) == 27
    for block in range(1, 10):
        own = [trial for trial in trials if trial.block == block]
        assert len({t.setting for t in own}) == 1 and len({t.blade for t in own}) == 1
        assert [t.repetition for t in own] == [1, 2, 3]
    assert len({trial.blade for trial in trials}) == 9
    assert not departures(SeriesPlan(trial=trials))


def test_blocks_of_a_repetition_hold_every_setting_once_in_another_order():
    trials = designed_trials(design(block="repetition"))
    blocks = [[t.setting for t in trials if t.block == block] for block in (1, 2, 3)]
    assert all(len(set(block)) == len(block) == 9 for block in blocks)
    assert blocks[0] != blocks[1] != blocks[2]
    assert all({t.repetition for t in trials if t.block == block} == {block} for block in (1, 2, 3))
    assert any("blades cut more than one setting" in text for text in departures(SeriesPlan(trial=trials)))


def test_the_order_is_that_of_the_seed():
    assert designed_trials(design()) == designed_trials(design())
    assert [t.setting for t in designed_trials(design())] != [t.setting for t in designed_trials(design(seed=6))]


def test_batteries_are_changed_before_they_are_empty_and_air_comes_first():
    trials = designed_trials(design(seconds=10.0, battery_seconds=65.0, has_idle=True))
    assert trials[0].is_idle and not any(t.is_idle for t in trials[1:])
    assert max(Counter(t.battery for t in trials).values()) == 6
    assert [t.battery for t in trials[5:7]] == ["P1", "P2"]


def test_a_written_plan_is_read_as_it_was(tmp_path):
    trials = designed_trials(design(batches={"oak": 'lot "7"'}))
    plan = SeriesPlan(trial=trials, seed=5, operator="Kim", required=("operator", "batch"), recordings="here")
    path = tmp_path / "wood.toml"
    path.write_text(plan_text(plan), encoding="utf-8")
    loaded = load_plan(path)
    assert loaded.plan == plan
    assert loaded.folder == tmp_path / "here"
    assert sum(line.startswith("    { id = ") for line in path.read_text().splitlines()) == 27


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[trial]]\nid = "a"\nmaterial = "oak"\nfeeed_mm_s = 4', ["trial 1", "feeed_mm_s", "feed_mm_s"]),
        ('[[trial]]\nid = "a"\nmaterial = "oak"\nduty = 44', ["trial 1", "duty", "44"]),
        ('[[trial]]\nid = "../a"\nmaterial = "oak"', ["trial 1", "id", "../a"]),
        ('[[trial]]\nid = "a"\nmaterial = "oak"\n[[trial]]\nid = "A"\nmaterial = "oak"', ["more than once"]),
        ("seed = 1", ["missing key 'trial'"]),
        ('[[trial]]\nid = "a"', ["trial 1", "material"]),
    ],
)
def test_a_wrong_plan_is_named(text, words, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_plan(path)
    assert all(word in str(caught.value) for word in [str(path), *words])


def test_a_table_is_a_plan(tmp_path):
    path = tmp_path / "next.csv"
    path.write_text("duty,feed,thickness,length,material,idle\n0.5,4,20,12,oak,no\n0.4,,,8,,yes\n0.5,4,20,12,oak,\n")
    first, air, again = load_plan(path).plan.trial
    assert first.setting == again.setting == ("oak", 0.5, 4.0, 20.0)
    assert (first.seconds, first.repetition, again.repetition) == (12.0, 1, 2)
    assert air.setting == ("none", 0.4, None, None) and air.seconds == 8.0
    assert len({first.id, air.id, again.id}) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("duty,speed\n0.5,3\n", ["'speed'", "feed"]),
        ("duty,material\nhalf,oak\n", ["line 2", "'half'"]),
        ("duty,material\n0.5,\n", ["line 2", "material"]),
        ("duty,material,idle\n0.5,oak,perhaps\n", ["line 2", "'perhaps'"]),
        ("trial,id,material\na,b,oak\n", ["more than one column", "'trial'"]),
        ("block,material\n1.5,oak\n", ["line 2", "block is '1.5'", "whole number"]),
        ("", ["is empty"]),
        ("material,feed (furlong/min)\noak,4\n", ["'feed' is in 'furlong/min'", "mm/s"]),
        ("material,feed (mm)\noak,4\n", ["'feed' is in 'mm'", "mm/s"]),
        ("material,duty (V)\noak,4\n", ["'duty' is in 'V'", "%"]),
    ],
)
def test_a_wrong_table_is_named(text, words, tmp_path):
    path = tmp_path / "next.csv"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_plan(path)
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    ("header", "cells", "expected"),
    [
        ("feed (mm/min),thickness (cm),length (min),rest (min)", "240,2,1,15", (4.0, 20.0, 60.0, 900.0)),
        ("feed [m/min],thickness (in),length [ms],rest (s)", "0.24,0.75,1500,9", (4.0, 19.05, 1.5, 9.0)),
        ("feed (mm/s),thickness (mm),length (s),rest", "4,2,3,5", (4.0, 2.0, 3.0, 5.0)),
    ],
)
def test_a_unit_in_the_header_is_converted(header, cells, expected, tmp_path):
    path = tmp_path / "next.csv"
    path.write_text(f"Workpiece (wood),duty (%),{header}\noak,44,{cells}\n")
    (trial,) = load_plan(path).plan.trial
    assert (trial.material, trial.duty) == ("oak", 0.44)
    assert (trial.feed_mm_s, trial.thickness_mm, trial.seconds, trial.rest_s) == expected


def test_a_plan_of_many_repetitions_compares_no_trial_with_all_others(monkeypatch):
    n_compared = 0

    class Counted(str):
        def __eq__(self, other):
            nonlocal n_compared
            n_compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    trials = designed_trials(SeriesDesign(materials=(Counted("oak"), Counted("nylon")), repetitions=300, seed=1))
    assert [t.repetition for t in trials] == [*range(1, 301)] * 2
    assert n_compared < 10 * len(trials)


def test_the_line_of_excel_before_the_header_is_no_header(tmp_path):
    path = tmp_path / "next.csv"
    path.write_text("sep=;\r\nduty;material\r\n0,5;oak\r\nhalf;oak\r\n")
    with pytest.raises(ConfigError, match="line 4: duty is 'half'"):
        load_plan(path)
    path.write_text("sep=;\r\nduty;material\r\n0,5;oak\r\n")
    assert load_plan(path).plan.trial[0].setting == ("oak", 0.5, None, None)


def test_required_metadata_that_nobody_stated_are_all_named():
    trials = designed_trials(design(materials=("oak",), has_idle=True))
    plan = SeriesPlan(trial=trials, required=("operator", "blade", "batch"))
    missing = missing_metadata(plan, None)
    assert "operator" in missing and "batch of 02-oak" in missing
    assert "blade" not in missing and "idle" not in missing
    assert "operator" not in missing_metadata(plan, "Kim")


@pytest.mark.parametrize(
    ("name", "text", "is_one"),
    [
        ("a.csv", "id,material,idle,duty,feed,thickness,length,rest,blade,battery\n", True),
        ("b.csv", "sep=;\r\nDuty;Workpiece (wood)\r\n0,5;oak\r\n", True),
        ("with_a_mistake.csv", "material,duty,feeed,comment\noak,0.5,4,\n", True),
        ("results.csv", "trial,material,duty,feed_mm_s,status,peak_force_n,k_fc_n_s_per_m,runtime_s,source\n", False),
        ("signals.csv", "time_s,force_n\n0,1\n", False),
        ("other.csv", "id,blade\n1,B1\n", False),
        ("empty.csv", "", False),
        ("plan.toml", "[[trial]]\nid = 7\n", True),
        ("campaign.toml", '[[trial]]\nfile = "a.csv"\n', False),
        ("bench.toml", "[plant]\ngear_ratio = 9.3\n", False),
    ],
)
def test_a_plan_is_told_from_results_by_its_columns(tmp_path, name, text, is_one):
    (tmp_path / name).write_text(text)
    assert is_plan(tmp_path / name) == is_one
