"""The figures page: what is counted, judged and written."""

from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ET

import pytest

from benchmarks.measuring import Clock, Goal, Plot, Section, Table, time_words
from benchmarks.page import GOALS_HEAD, PLAN, draw, goal_row, section_text, updated
from benchmarks.recordings_speed import plan

pytestmark = pytest.mark.unit


@pytest.fixture
def section():
    return Section(
        title="Storage",
        words=["Twenty seconds."],
        tables=[Table(head=("format", "bytes"), rows=[("MCAP", "4.5")])],
        goals=[Goal(what="passes", value=4.0, bound=5.0)],
        plots=[Plot(name="sizes", title="Sizes", x_label="bytes", bars={"sawbench": 4.5, "CSV": 33.0})],
        numbers={"bytes_a_sample": 4.5},
    )


@pytest.fixture
def looks(monkeypatch):
    """A clock that advances by a second a look: whatever is timed lasts one look."""
    now = iter(range(10_000))
    monkeypatch.setattr("benchmarks.measuring.time.perf_counter", lambda: float(next(now)))


@pytest.mark.usefixtures("looks")
def test_works_are_called_in_turns():
    order = []
    found = Clock().together({name: lambda name=name: order.append(name) for name in "ab"}, seconds=3.0)
    assert set(found) == {"a", "b"}
    assert "".join(order) == "aabb" + 3 * "ab"  # two calls of each to warm up, then three seconds of each


@pytest.mark.usefixtures("looks")
def test_the_median_is_that_of_one_call():
    timing = Clock()(lambda: None, seconds=5.0)
    assert timing.median_s == timing.low_s == timing.high_s == 1.0


@pytest.mark.parametrize(
    ("value", "at_least", "met"), [(4.0, False, True), (6.0, False, False), (6.0, True, True), (4.0, True, False)]
)
def test_a_goal_is_judged_by_its_side(value, at_least, met):
    goal = Goal(what="x", value=value, bound=5.0, at_least=at_least)
    assert goal.is_met is met
    assert ("**not met**" in goal_row(goal)) is not met


def test_what_was_not_measured_is_neither_met_nor_missed():
    assert Goal(what="x", value=None, bound=1.0).is_met is None
    assert "not measured here" in goal_row(Goal(what="x", value=None, bound=1.0))


def test_a_section_survives_the_way_through_json(section):
    back = Section.of(json.loads(json.dumps(dataclasses.asdict(section))))
    assert section_text(back) == section_text(section)
    assert (back.goals, back.plots, back.numbers) == (section.goals, section.plots, section.numbers)


def test_a_section_is_written_with_its_table_and_picture(section):
    text = section_text(section, {"sizes": "pictures/benchmark-sizes.svg"})
    assert "| MCAP | 4.5 |" in text
    assert "![Sizes](pictures/benchmark-sizes.svg)" in text


def test_a_picture_is_svg_and_the_same_every_time(section, tmp_path):
    plots = [*section.plots, Plot(name="l", title="L", x_label="x", y_label="y", lines={"a": ([1, 10], [2, 20])})]
    for plot in plots:
        draw(plot, tmp_path / "one.svg")
        draw(plot, tmp_path / "two.svg")
        assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
        assert ET.parse(tmp_path / "one.svg").getroot().tag.endswith("svg")


def test_the_plan_multiplies_what_was_measured():
    steps = dict.fromkeys(("read_s", "process_s", "fit_s", "runtime, compiled_s", "page_s"), 0.0864)
    words = " ".join(plan({**steps, "samples": 1e5, "bytes_a_sample": 5.0}).words)
    # 4 x 0.0864 s x 1e6 = 4 days of one core, 3 hours of 32; 1e6 x 1e5 x 5 bytes = 0.5 TB. The page is not among it.
    assert "32 cores need 3 hours" in words
    assert "Storage: 0.5 TB" in words


@pytest.mark.parametrize(
    ("seconds", "words"), [(2.5, "2.5 s"), (0.0314, "31.4 ms"), (4e-5, "40 µs"), (4.4e-7, "440 ns")]
)
def test_times_have_their_unit(seconds, words):
    assert time_words(seconds) == words


def test_a_section_measured_apart_takes_its_place_and_its_goals():
    page = "\n\n".join(
        [
            "# Speed", "2 of 2 goals are met. Measured on a quiet machine.",
            f"{GOALS_HEAD}\n| speed of A | ≥ 2 | 3 | met |\n| memory of B | ≤ 1 GB | 0.5 GB | met |",
            "## A\n\nold words of A", "## B\n\nwords of B", f"## {PLAN}\n\nplan",
        ]
    ) + "\n"  # fmt: skip
    assert updated(page, [], {}, "note") == page
    again = Section(
        title="A", words=["new words"], goals=[Goal(what="speed of A", value=1.0, bound=2.0, at_least=True)]
    )
    other = Section(title="C", words=["words of C"], goals=[Goal(what="time of C", value=1.0, bound=2.0, unit="s")])
    text = updated(page, [again, other], {}, "measured apart")
    assert [line for line in text.splitlines() if line.startswith("## ")] == ["## A", "## B", "## C", f"## {PLAN}"]
    assert "old words" not in text
    assert "## A\n\nmeasured apart\n\nnew words" in text
    assert "words of B" in text
    assert "2 of 3 goals are met. Measured" in text
    assert "| speed of A | ≥ 2 | 1 | **not met** |\n| memory of B | ≤ 1 GB | 0.5 GB | met |\n| time of C |" in text
