"""The comparison: like with like, names of materials, likely causes, wear, and the files beside the page."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest
from sawbench.bench.processed import Phase
from sawbench.reporting.compared import ComparedTrial, compare, comparison_json
from sawbench.reporting.comparison_data import comparison_table, write_comparison_hdf5
from sawbench.reporting.comparison_page import write_comparison_page
from sawbench.reporting.wear import cut_length_m

from tests.reporting.test_pages import Page, make_fit, make_processed, make_rows, make_runtime

pytestmark = pytest.mark.unit
START = datetime(2026, 3, 2, 9, tzinfo=UTC)


def trial(name, material, k_fc=240.0, *, minute=0, processed=None, **settings):
    settings = {"feed_mm_s": 4.0, "thickness_mm": 20.0, "started_at": START + timedelta(minutes=minute)} | settings
    changes = {"source_path": f"folder/{name}.mcap"} | (processed or {})
    found = make_processed(name, material, peak_force_n=k_fc, trial=settings, **changes)
    return ComparedTrial(processed=found, fit=make_fit(k_fc, 3.0, 2.0), runtime=make_runtime())


def test_materials_are_compared_at_equal_settings_only():
    rows = [
        trial(f"{material}-{duty}-{k}", material, k_fc + k, duty=duty, repetition=k)
        for material, duty, k_fc in (("nylon", 0.35, 60.0), ("oak", 0.35, 240.0), ("oak", 0.55, 240.0))
        for k in (1, 2)
    ]
    found = compare(rows)
    assert [(block.setting.duty, [one.material for one in block.series]) for block in found.blocks] == [
        (0.35, ["nylon", "oak"]),
        (0.55, ["oak"]),
    ]
    pairs = [(d.first, d.second) for block in found.blocks for d in block.differences.get("k_fc_n_s_per_m", ())]
    assert pairs == [("nylon", "oak, duty 0.35")]
    assert [one["series"] for one in comparison_json(rows)["blocks"]] == [
        ["nylon", "oak, duty 0.35"],
        ["oak, duty 0.55"],
    ]


def test_settings_that_read_alike_are_one():
    """A duty that was computed is not the decimal that somebody typed."""
    rows = [trial(f"t{k}", "oak", duty=duty) for k, duty in enumerate((0.4375, 0.43750001, 0.43751, 0.46))]
    assert [[len(one.trials) for one in block.series] for block in compare(rows).blocks] == [[3], [1]]


def test_spellings_are_one_material_and_similar_names_are_asked_about():
    names = ("oak", "Oak ", "oak", "black locust", "Black_Locust", "nylon", "nylon 6")
    found = compare([trial(f"t{k}", name) for k, name in enumerate(names)])
    (block,) = found.blocks
    assert {one.material: len(one.trials) for one in block.series} == {
        "Black_Locust": 2, "nylon": 1, "nylon 6": 1, "oak": 3,
    }  # fmt: skip
    assert "Treated as one material: Oak , oak." in found.remarks
    assert any(remark.startswith("Are nylon and nylon 6 the same material?") for remark in found.remarks)
    assert compare([trial("a", "oak"), trial("b", "nylon")]).remarks == ()


@pytest.mark.parametrize(
    ("duty", "motor_a", "cause", "remedy"),
    [
        (
            0.55,
            10.0,
            "wrong duty entered: 0.55 is stated, the currents (battery over motor) show 0.438",
            "--duty 0.438",
        ),
        (0.44, 10.0, "the note of the fit", "sawbench report"),
        (0.55, None, "the note of the fit", "sawbench report"),
    ],
)
def test_a_rejected_trial_is_explained(duty, motor_a, cause, remedy):
    currents = {"battery_current_a": 4.38} | ({} if motor_a is None else {"motor_current_a": motor_a})
    row = trial("oak-1", "oak", duty=duty, processed={"mean_values": currents})
    row = replace(row, fit=make_fit(status="contradicted", notes=("the note of the fit",)), runtime=None)
    (item,) = compare([row]).left_out
    assert item.cause == cause
    assert remedy in item.remedy


def test_wear_follows_each_blade_and_the_20_per_cent_rule():
    phases = (Phase(kind="rest", start_s=0.0, end_s=1.0), Phase(kind="running", start_s=1.0, end_s=26.0))
    rows = [
        trial(f"{blade}-{minute}", "oak", k_fc, minute=minute, blade=blade, processed={"phases": phases})
        for blade, minute, k_fc in (
            ("B1", 0, 200.0),
            ("B1", 2, 250.0),
            ("B1", 1, 230.0),
            ("B2", 3, 260.0),
            ("B2", 4, 260.0),
        )
    ]
    assert cut_length_m(rows[0]) == pytest.approx(0.1)
    wear = compare(rows[::-1]).wear
    assert [(one.blade, one.growth, one.cut_m, one.is_worn) for one in wear] == [
        ("B1", 0.0, pytest.approx(0.1), False),
        ("B1", pytest.approx(0.15), pytest.approx(0.2), False),
        ("B1", pytest.approx(0.25), pytest.approx(0.3), True),
        ("B2", 0.0, pytest.approx(0.1), False),
        ("B2", 0.0, pytest.approx(0.2), False),
    ]
    # 2 N·s/m statistical uncertainty of each: relative 2/230 and 2/200, in squares.
    assert wear[1].growth_std == pytest.approx(1.15 * np.hypot(2 / 230, 2 / 200))
    unknown = trial("B1-9", "oak", minute=9, blade="B1", feed_mm_s=None)
    assert cut_length_m(unknown) is None
    assert compare([rows[0], trial("b", "oak", minute=1)]).wear == ()


def test_page_states_what_was_done_and_files_beside_it_are_the_same_every_time(tmp_path):
    rows = [
        trial(f"oak-{k}", "oak", 200.0 + 30.0 * k, minute=k, operator="Kim", blade="B1", repetition=k)
        for k in (1, 2, 3)
    ]
    page = Page(write_comparison_page(tmp_path / "a.html", rows).read_text(encoding="utf-8"))
    for words in (
        "Duty 0.4375, feed 4 mm/s, 20 mm thick", "2026-03-02 09:01 UTC", "Kim", "oak-2.mcap", "Change the blade",
        "k_Fc has grown by 20 % or more with B1",
    ):  # fmt: skip
        assert words in page.shown, words
    found = compare(rows)
    first = write_comparison_hdf5(tmp_path / "a.h5", rows, found)
    second = write_comparison_hdf5(tmp_path / "b.h5", rows[::-1], compare(rows[::-1]))
    assert first.read_bytes() == second.read_bytes()
    with h5py.File(first) as store:
        assert store["trials/k_fc_n_s_per_m"][()].tolist() == [230.0, 260.0, 290.0]
        assert store["trials/operator"].asstr()[()].tolist() == ["Kim"] * 3
        assert store["cutting_force/oak/mean_n"][()].max() == pytest.approx(260.0, rel=1e-3)


def test_columns_of_the_table_that_scripts_rely_on_come_first():
    columns = list(comparison_table(make_rows()).columns)
    assert columns[:10] == [
        "trial", "material", "repetition", "thickness_mm", "feed_mm_s", "duty", "blade", "battery", "status", "use",
    ]  # fmt: skip
    assert columns[-4:] == ["started_at", "operator", "file", "cut_length_m"]


def test_the_gain_of_the_load_cell_is_part_of_what_is_not_known_of_the_peak_force():
    """Every trial has it alike: it does not shrink with their number, and makes a difference as uncertain as itself."""
    rows = [
        replace(trial(f"{name}-{k}", name, k_fc + 0.1 * (-1) ** k, repetition=k), gain_rel_std={"force_n": 0.01})
        for name, k_fc in (("nylon", 100.0), ("oak", 300.0))
        for k in range(1, 41)
    ]
    found = compare(rows)
    means = {one.material: one.means["peak_force_n"] for one in found.series}
    assert means["oak"].std == pytest.approx(3.0, rel=0.01)
    (pair,) = found.blocks[0].differences["peak_force_n"]
    assert 0.5 * (pair.high - pair.low) == pytest.approx(1.96 * 0.01 * 200.0, rel=0.01)
    assert pair.is_significant


def test_a_trial_that_is_left_out_has_worn_the_blade_too():
    """Ten seconds at 4 mm/s each; the second one stalled at its end, the third never touched the wood."""
    phases = (Phase(kind="running", start_s=1.0, end_s=11.0),)
    status = {1: {"status": "stalled"}, 2: {"status": "no_cutting"}}
    rows = [
        trial(f"t{k}", "oak", 200.0 + k, minute=k, blade="B1", processed={"phases": phases} | status.get(k, {}))
        for k in range(4)
    ]
    assert [(one.name, pytest.approx(one.cut_m)) for one in compare(rows).wear] == [("t0", 0.04), ("t3", 0.12)]
