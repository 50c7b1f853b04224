"""Recordings of a linear axis through the commands: its own words, and one sentence where it has no place."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sawbench.analysis import load_and_process
from sawbench.commands.main import main
from sawbench.storage.reader import read_recording
from sawbench.storage.results import read_processed

from tests.rigs import linear_axis as rig
from tests.rigs.rrd import texts_of

pytestmark = pytest.mark.pipeline

CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
force_constant_n_per_a = { nominal = 25.0, rel_std = 0.02 }
load_channel = "brake_force_n"
"""
# A stroke is also the travel of an axis, in the setting of an operating point and in advice.
OF_A_SAW = re.compile(r"\b(blade|saw|crank|yoke|cutting|k_Fc|dead centre|spin-(?:up|down)|strokes|One stroke"
                      r"|(?:stroke|mean) (?:rate|period|stroke)|simulated stroke)\b", re.IGNORECASE)  # fmt: skip


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("axis")
    (folder / "bench_config.toml").write_text(CONFIG)
    entries = ['config = "bench_config.toml"\n']
    # The slow one is slower than any saw.
    for seed, (name, rate_hz, seconds) in enumerate((("slow", 0.1, 45.0), ("fast", 2.0, 6.0))):
        one = rig.run_axis(rig.Friction(coulomb=8.0), rate_hz=rate_hz, load_n=10.0, seconds=seconds, seed=seed)
        columns = one["time_s"], one["displacement_mm"], one["motor_current_a"], one["force_n"]
        np.savetxt(
            folder / f"{name}.csv", np.array(columns).T, delimiter=",", comments="",
            header="time_s,displacement_mm,motor_current_a,brake_force_n",
        )  # fmt: skip
        entries.append(f'[[trial]]\nfile = "{name}.csv"\nworkpiece = "brake"\n')
    (folder / "campaign.toml").write_text("\n".join(entries))
    assert main(["import", str(folder / "campaign.toml"), "--out", str(folder / "mcap")]) == 0
    return folder / "mcap"


def words_on(page):
    """Text that a reader sees: no script, no style, no markup."""
    text = re.sub(r"<(script|style)\b.*?</\1>", " ", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))


def test_a_channel_that_the_configuration_names_is_not_unknown(recordings, tmp_path, capsys):
    assert main(["import", str(recordings.parent / "campaign.toml"), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "not a known channel" not in said.out + said.err
    assert read_recording(tmp_path / "fast.mcap").signals["brake_force_n"].unit == "N"


def test_a_slow_axis_is_found_as_surely_as_a_fast_one(recordings, tmp_path, capsys):
    assert main(["process", str(recordings), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "0.100 Hz" in said and "2.000 Hz" in said
    assert "alternative" not in said
    assert read_processed(tmp_path / "slow.h5").frame == "linear_axis"


def test_the_page_of_a_trial_has_the_words_of_an_axis(recordings, tmp_path):
    assert main(["report", str(recordings), "--out", str(tmp_path)]) == 0
    for name in ("slow", "fast"):
        text = words_on(tmp_path / f"{name}.html")
        assert OF_A_SAW.findall(text) == []
        for said in ("Cycle rate", "Cycle period", "One cycle", "cycles averaged", "Load brake"):
            assert said in text
        assert "Duty" not in text and "Battery" not in text, "settings that an axis does not have"


def test_the_page_of_a_gap_has_the_words_of_an_axis(recordings, tmp_path, capsys):
    assert main(["diagnose", str(recordings), "--out", str(tmp_path / "gap")]) == 0
    assert OF_A_SAW.findall(capsys.readouterr().out) == []
    assert OF_A_SAW.findall(words_on(tmp_path / "gap" / "gap_report.html")) == []
    assert OF_A_SAW.findall((tmp_path / "gap" / "gap_report.json").read_text().partition('"detail"')[0]) == []


def test_the_view_shows_no_crank(recordings, tmp_path):
    path = tmp_path / "fast.rrd"
    assert main(["view", str(recordings / "fast.mcap"), "--rrd", str(path), "--no-view"]) == 0
    said = texts_of(path)
    assert "Displacement / mm" in said and "Cycle rate / Hz" in said
    assert OF_A_SAW.findall(said) == []


def test_what_an_axis_does_not_have_is_one_sentence(recordings, tmp_path, capsys):
    assert main(["compare", str(recordings), "--out", str(tmp_path / "c.html")]) == 2
    assert "linear axis, which cuts no material" in capsys.readouterr().err
    for command in (["fit"], ["runtime"]):
        assert main([*command, str(recordings / "fast.mcap")]) == 2
        said = capsys.readouterr().err
        assert "describes a linear axis" in said
        for accepts in ("diagnose", "import", "record", "info", "process", "report", "export", "view"):
            assert f"`{accepts}`" in said or f"`sawbench {accepts}`" in said


def test_a_notebook_shows_an_axis_as_one(recordings):
    trial = load_and_process(recordings / "fast.mcap", None)
    assert OF_A_SAW.findall(re.sub(r'src="[^"]+"', "", trial._repr_html_())) == []
