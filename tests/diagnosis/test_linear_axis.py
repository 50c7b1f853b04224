"""A linear drive axis, made by scipy with LuGre friction, diagnosed from its files to the report."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import load_config, parse_config
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.commands.main import main
from sawbench.diagnosis.answer.gap_report import diagnose

from benchmarks import davinci_axis as davinci
from tests.rigs import linear_axis as rig

pytestmark = pytest.mark.pipeline

HERE = Path(__file__).resolve()
SHARED = Path(os.environ.get("SAWBENCH_SHARED", HERE.parents[3] / "shared"))
UNITS = {"displacement_mm": "mm", "motor_current_a": "A", "force_n": "N"}
CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
force_constant_n_per_a = { nominal = 25.0, rel_std = 0.02 }
load_channel = "force_n"
"""


def recordings(trials, *, sign=1.0, without=()):
    return [
        Recording(
            trial=Trial(trial_id=name, material=workpiece),
            signals={
                k: Signal(
                    channel=k,
                    unit=unit,
                    time_s=columns["time_s"],
                    values=(sign if unit == "A" else 1.0) * columns[k],
                )
                for k, unit in UNITS.items()
                if k not in without
            },
        )
        for name, (workpiece, columns) in trials.items()
    ]


def diagnosed(friction, *, seed=3, config=CONFIG, **more):
    return diagnose(recordings(rig.campaign(friction, seed=seed, **more)), parse_config(config), provenance={})


def claimed(report):
    return sum(c["probability"] for c in report["causes"])


@pytest.fixture(scope="module")
def dry(tmp_path_factory):
    folder = tmp_path_factory.mktemp("axis")
    entries = ['config = "bench_config.toml"\n']
    for name, (workpiece, columns) in rig.campaign(rig.Friction(coulomb=8.0), seed=4).items():
        table = np.array(list(columns.values())).T
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", fmt="%.9g", comments="", header=",".join(columns))
        entries.append(f'[[trial]]\nfile = "{name}.csv"\nworkpiece = "{workpiece}"\n')
    (folder / "campaign.toml").write_text("\n".join(entries))
    (folder / "bench_config.toml").write_text(CONFIG)
    assert main(["import", str(folder / "campaign.toml"), "--out", str(folder / "mcap")]) == 0
    assert main(["diagnose", str(folder / "mcap"), "--out", str(folder / "gap")]) == 0
    return json.loads((folder / "gap" / "gap_report.json").read_text())


def test_dry_friction_is_named_from_files(dry):
    assert dry["verdict"] == "effect"
    first = dry["causes"][0]
    assert first["effects"] == ["guide_friction"]
    assert first["indistinguishable_from"] == ["motor_coulomb_friction"]
    force = first["parameters"]["force_n"]
    assert abs(force["value"] - 8.0) < 3.0 * force["std"]
    # The stated uncertainty holds what the form may miss: known to a sixth.
    assert force["std"] < 8.0 / 6.0


def test_dry_friction_closes_the_gap_on_held_out_points(dry):
    first, gap = dry["causes"][0], dry["gap"]
    assert first["gap_closed"] > 0.9
    assert first["gap_closed_ci95"][0] > 0.7
    assert gap["with_effect"] < gap["retuned"] < gap["nominal"]
    assert gap["by_channel"]["motor_current_a"]["unit"] == "A"
    assert {spot["equation"] for spot in dry["where"]} == {"mechanical"}


def test_parameters_beside_the_named_cause_are_those_of_the_machine(dry):
    # Without it the damping would stand for the friction.
    assert dry["verdict"] == "effect"
    for shift in dry["parameter_shifts"].values():
        assert abs(shift["sigmas"]) < 1.0


def test_viscous_truth_claims_no_effect():
    report = diagnosed(rig.Friction())
    assert report["verdict"] == "no_gap"
    assert "[linear_axis]" in report["improved_model"], "re-tuned parameters are for use where no effect is missing too"
    assert all(abs(c["gap_closed"]) < 0.1 for c in report["causes"])
    for shift in report["parameter_shifts"].values():
        assert abs(shift["sigmas"]) < 1.0


def test_more_viscous_friction_is_a_parameter():
    report = diagnosed(rig.Friction(viscous=90.0))
    assert report["verdict"] == "parameters"
    assert claimed(report) < 0.2
    damping = report["parameter_shifts"]["viscous_damping_n_s_per_m"]
    assert abs(damping["value"] - 90.0) < 3.0 * damping["std"]


def test_friction_of_the_load_is_told_from_that_of_the_guide():
    report = diagnosed(rig.Friction(load_share=0.1))
    first = report["causes"][0]
    assert first["effects"] == ["load_dependent_friction"]
    share = first["parameters"]["friction_share"]
    assert abs(share["value"] - 0.1) < 3.0 * share["std"]


def test_both_frictions_at_once_are_both_named():
    report = diagnosed(rig.Friction(coulomb=6.0, load_share=0.1))
    assert report["verdict"] == "effects"
    first = report["causes"][0]
    assert set(first["effects"]) == {"guide_friction", "load_dependent_friction"}
    # Each size in the presence of the other: alone, the dry friction would be called a quarter larger.
    for name, truth in (("force_n", 6.0), ("friction_share", 0.1)):
        found = first["parameters"][name]
        assert abs(found["value"] - truth) < min(3.0 * found["std"], 0.15 * truth)


def test_what_is_missing_beside_a_friction_that_is_known_is_named():
    both = rig.Friction(coulomb=8.0, load_share=0.15)
    known = CONFIG + "[effects]\nguide_friction = { force_n = 8.0, std = 0.8 }\n"
    report = diagnosed(both, config=known)
    assert report["causes"][0]["effects"] == ["load_dependent_friction"]
    named = {name for cause in report["causes"] for name in cause["effects"]}
    assert "guide_friction" not in named


def test_the_improved_model_of_an_axis_leaves_no_cause(dry):
    report = diagnosed(rig.Friction(coulomb=8.0), seed=4, config=dry["improved_model"])
    assert report["verdict"] in {"no_gap", "parameters"}


def test_damping_that_is_not_there_leaves_an_improved_model_that_can_be_read():
    """Dry friction alone, where the model has viscous damping known to a half: hardly any of it is left."""
    stated = CONFIG.replace("nominal = 60.0, rel_std = 0.1", "nominal = 60.0, rel_std = 0.5")
    report = diagnosed(rig.Friction(coulomb=8.0, viscous=0.0), seed=4, config=stated)
    assert "guide_friction" in report["causes"][0]["effects"]
    damping = parse_config(report["improved_model"]).config.linear_axis.viscous_damping_n_s_per_m
    assert 0.0 < damping.nominal < 20.0
    # Its absolute uncertainty stays what it was, as far as a configuration can state it.
    assert damping.std == pytest.approx(30.0, rel=1e-3)


def test_ripple_locked_to_the_position_is_cogging():
    report = diagnosed(rig.Friction(), ripple_n=3.0)
    assert "cogging" in report["causes"][0]["effects"]
    assert abs(report["causes"][0]["parameters"]["amplitude_n"]["value"] - 3.0) < 0.5


def test_a_force_may_drive_instead_of_a_current():
    trials = rig.campaign(rig.Friction(coulomb=8.0), seed=5)
    found = recordings(trials)
    with_force = [
        Recording(
            trial=r.trial,
            signals={
                **{k: s for k, s in r.signals.items() if k != "motor_current_a"},
                "drive_force_n": Signal(
                    channel="drive_force_n", unit="N", time_s=r.signals["motor_current_a"].time_s,
                    values=rig.FORCE_A_CURRENT * r.signals["motor_current_a"].values,
                ),
            },
        )
        for r in found
    ]  # fmt: skip
    config = CONFIG.replace(
        "force_constant_n_per_a = { nominal = 25.0, rel_std = 0.02 }", 'drive_channel = "drive_force_n"'
    )
    report = diagnose(with_force, parse_config(config), provenance={})
    assert report["causes"][0]["effects"] == ["guide_friction"]
    assert report["gap"]["by_channel"]["drive_force_n"]["unit"] == "N"


def test_a_load_that_is_not_measured_is_said_to_weaken_the_answer():
    trials = rig.campaign(rig.Friction(coulomb=8.0), seed=6)
    config = CONFIG.replace('load_channel = "force_n"\n', "")
    report = diagnose(recordings(trials, without=("force_n",)), parse_config(config), provenance={})
    assert any("no load_channel" in text for text in report["warnings"])
    assert "guide_friction" in report["causes"][0]["effects"]


def test_a_drive_of_the_wrong_sign_is_refused():
    trials = recordings(rig.campaign(rig.Friction(coulomb=8.0), seed=7), sign=-1.0)
    with pytest.raises(InputError, match="check the signs"):
        diagnose(trials, parse_config(CONFIG), provenance={})


def test_trials_without_the_drive_say_so():
    trials = recordings(rig.campaign(rig.Friction(), seed=8), without=("motor_current_a",))
    with pytest.raises(InputError, match="no motor_current_a") as refused:
        diagnose(trials, parse_config(CONFIG), provenance={})
    assert "the recordings have displacement_mm, force_n: name the drive as drive_channel," in str(refused.value)


def test_a_load_that_no_recording_has_says_what_to_do():
    trials = recordings({"a": ("brake", rig.campaign(rig.Friction(), seed=8).popitem()[1][1])}, without=("force_n",))
    with pytest.raises(InputError, match="it has no force_n") as refused:
        diagnose(trials, parse_config(CONFIG), provenance={})
    assert "leave load_channel out" in str(refused.value) and "--material none" in str(refused.value)


def test_an_axis_that_is_read_as_a_saw_is_told_of_the_table():
    saw = load_config(HERE.parents[2] / "bench_config.toml")
    with pytest.raises(InputError, match=r"\[linear_axis\]"):
        diagnose(recordings(rig.campaign(rig.Friction(), seed=8)), saw, provenance={})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CONFIG.replace("force_constant_n_per_a", "force_constant"), "did you mean 'force_constant_n_per_a'"),
        (CONFIG + 'drive_channel = "drive_force_n"\n', "leave out force_constant_n_per_a"),
        (CONFIG + 'drive_channel = "speed"\n', "must end in _a"),
        (CONFIG.replace('"force_n"', '"force"'), "must end in _n"),
        (CONFIG + (HERE.parents[2] / "bench_config.toml").read_text(), "has both"),
    ],
)
def test_wrong_configurations_are_explained(text, said):
    with pytest.raises(ConfigError, match=said):
        parse_config(text)


@pytest.mark.parametrize(
    "command", [["simulate"], ["fit", "recordings/oak-01.mcap"], ["runtime", "recordings/oak-01.mcap"]]
)
def test_a_command_for_saws_refuses_an_axis(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(HERE.parents[2])
    (tmp_path / "axis.toml").write_text(CONFIG)
    assert main([*command, "--config", str(tmp_path / "axis.toml")]) == 2
    assert "describes a linear axis, which this command cannot handle" in capsys.readouterr().err


@pytest.mark.skipif(not (SHARED / "data" / "davinci_motor").is_dir(), reason="the logs of the tool drive are not here")
def test_dry_friction_of_a_real_cable_tool_is_named(tmp_path):
    campaign = davinci.write_campaign(SHARED / "data" / "davinci_motor", tmp_path, "tool")
    assert main(["import", str(campaign), "--out", str(tmp_path / "mcap")]) == 0
    assert main(["diagnose", str(tmp_path / "mcap"), "--out", str(tmp_path / "gap")]) == 0
    report = json.loads((tmp_path / "gap" / "gap_report.json").read_text())
    assert report["verdict"] in {"effect", "effects"}
    assert "guide_friction" in report["causes"][0]["effects"]
    assert claimed(report) > 0.9
    assert report["causes"][0]["gap_closed"] > 0.8
    channel = report["gap"]["by_channel"]["back_force_n"]
    assert channel["with_effect"] < 0.5 * min(channel["nominal"], channel["retuned"])


@pytest.mark.skipif(not (SHARED / "data" / "emps").is_dir(), reason="the record of the ball screw is not here")
def test_dry_friction_of_a_ball_screw_is_named_and_closed(tmp_path):
    (tmp_path / "map.toml").write_text(
        """[columns]
time_s = "t"
displacement_mm = { column = "qm", unit = "m" }
drive_force_n = { column = "vir", scale = 35.15065188, unit = "N" }
"""
    )
    (tmp_path / "axis.toml").write_text(
        """[linear_axis]
moving_mass_kg = { nominal = 95.0, rel_std = 0.1 }
viscous_damping_n_s_per_m = { nominal = 200.0, rel_std = 0.3 }
drive_channel = "drive_force_n"
"""
    )
    table = str(SHARED / "data" / "emps" / "DATA_EMPS.mat")
    command = ["import", table, "--map", str(tmp_path / "map.toml"), "--material", "none", "--out", str(tmp_path)]
    assert main(command) == 0
    record = str(tmp_path / "DATA_EMPS.mcap")
    for config, out in (("axis.toml", "gap"), ("gap/improved_model.toml", "again")):
        assert main(["diagnose", record, "--config", str(tmp_path / config), "--out", str(tmp_path / out)]) == 0
    report = json.loads((tmp_path / "gap" / "gap_report.json").read_text())
    first = report["causes"][0]
    assert first["effects"] == ["guide_friction"]
    assert first["probability"] > 0.9
    # As published: Coulomb friction 20.39 N, offset -3.16 N.
    assert abs(first["parameters"]["force_n"]["value"] - 20.39) < first["parameters"]["force_n"]["std"]
    assert first["by_direction"]["difference_n"] == pytest.approx(2.0 * -3.16, abs=1.5)
    assert any("F+ ≠ F-" in text for text in report["warnings"])
    page = (tmp_path / "gap" / "gap_report.html").read_text().lower()
    assert not any(word in page for word in ("plunger", "blade", "crank"))
    assert json.loads((tmp_path / "again" / "gap_report.json").read_text())["verdict"] == "no_gap"


def test_the_example_of_the_documentation_works_as_written(tmp_path, monkeypatch):
    text = (HERE.parents[2] / "docs" / "linear_axis.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```(?:toml|sh)\n(.*?)```", text, re.DOTALL)
    _, config, campaign, commands, *_ = blocks
    assert parse_config(config).config.linear_axis is not None
    monkeypatch.chdir(tmp_path)
    Path("bench_config.toml").write_text(config)
    Path("campaign.toml").write_text(campaign)
    record = SHARED / "data" / "emps" / "DATA_EMPS.mat"
    if not record.exists():
        pytest.skip("the record of the ball screw is not here")
    Path("DATA_EMPS.mat").write_bytes(record.read_bytes())
    for command in commands.splitlines():
        assert main(shlex.split(command)[1:]) == 0
    report = json.loads(Path("gap", "gap_report.json").read_text())
    assert report["causes"][0]["effects"] == ["guide_friction"]
    assert "form" in report["causes"][0]
