"""An answer that is none is visible to a script: `sawbench diagnose` ends with 1."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sawbench.commands.main import main

from tests.rigs import linear_axis as rig

pytestmark = pytest.mark.pipeline

CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
drive_channel = "drive_force_n"
"""


def imported(folder, drive_of):
    """Recordings of three runs of an axis whose drive is read as `drive_of` says."""
    folder.mkdir()
    entries = ['config = "bench_config.toml"\n']
    (folder / "bench_config.toml").write_text(CONFIG)
    for seed, (name, rate_hz) in enumerate((("slow", 1.0), ("fast", 2.0), ("again", 2.0))):
        one = rig.run_axis(rig.Friction(coulomb=8.0), rate_hz=rate_hz, load_n=0.0, seconds=6.0, seed=seed)
        columns = one["time_s"], one["displacement_mm"], drive_of(one)
        np.savetxt(
            folder / f"{name}.csv", np.array(columns).T, delimiter=",", comments="",
            header="time_s,displacement_mm,drive_force_n",
        )  # fmt: skip
        entries.append(f'[[trial]]\nfile = "{name}.csv"\nworkpiece = "none"\n')
    (folder / "campaign.toml").write_text("\n".join(entries))
    assert main(["import", str(folder / "campaign.toml"), "--out", str(folder / "mcap")]) == 0
    return folder / "mcap"


def test_no_answer_ends_with_1_and_an_answer_with_0(tmp_path, capsys):
    contradicted = imported(tmp_path / "reference_for_drive", lambda one: 0.05 * one["displacement_mm"])
    right = imported(tmp_path / "right", lambda one: rig.FORCE_A_CURRENT * one["motor_current_a"])
    assert main(["diagnose", str(contradicted), "--out", str(tmp_path / "gap")]) == 1
    assert "No answer: " in capsys.readouterr().out
    assert main(["diagnose", str(right), "--out", str(tmp_path / "right_gap")]) == 0
    capsys.readouterr()
    assert main(["diagnose", str(right), "--each", "--out", str(tmp_path / "gaps"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["contradiction"] == ""
    assert main(["diagnose", str(contradicted), "--each", "--out", str(tmp_path / "more_gaps")]) == 1
    assert "no answer" in capsys.readouterr().out
