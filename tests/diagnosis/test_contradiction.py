"""Recordings that are not of the configured axis: the report says so before anything else."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.diagnosis.answer.contradiction import contradiction
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.reporting.gap_page import verdict_sentence, write_gap_page

from tests.rigs import linear_axis as rig

CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
drive_channel = "drive_force_n"
"""
UNITS = {"displacement_mm": "mm", "drive_force_n": "N"}


def as_it_is(time_s, x_mm, force_n):
    return time_s, x_mm, force_n


WRONG_UNIT = {
    "time in ms": lambda t, x, f: (1e3 * t, x, f),
    "drive in kN": lambda t, x, f: (t, x, 1e3 * f),
    "displacement in m": lambda t, x, f: (t, 1e-3 * x, f),
    "time in units of 1000 s": lambda t, x, f: (1e-3 * t, x, f),
    "drive in mN": lambda t, x, f: (t, x, 1e-3 * f),
}


def report_of(change):
    recordings = []
    for name, rate_hz in (("slow", 1.0), ("fast", 2.0), ("again", 2.0)):
        seed = len(recordings)
        one = rig.run_axis(rig.Friction(coulomb=8.0), rate_hz=rate_hz, load_n=0.0, seconds=6.0, seed=seed)
        columns = one["time_s"], one["displacement_mm"], rig.FORCE_A_CURRENT * one["motor_current_a"]
        time_s, *values = change(*columns)
        signals = {
            name: Signal(channel=name, unit=unit, time_s=time_s, values=v)
            for (name, unit), v in zip(UNITS.items(), values, strict=True)
        }
        recordings.append(Recording(trial=Trial(trial_id=name, material="none"), signals=signals))
    return diagnose(
        recordings, parse_config(CONFIG), provenance={"recordings": {}, "config_sha256": "", "software": ""}
    )


@pytest.mark.pipeline
def test_a_drive_that_is_the_reference_position_is_given_no_answer(tmp_path):
    report = report_of(lambda t, x, f: (t, x, 0.05 * x))
    said = report["detail"]["contradiction"]
    assert "drive_force_n" in said and "unit and sign" in said
    assert report["warnings"][0] == said
    assert verdict_sentence(report) == f"No answer: {said}."
    assert report["improved_model"] is None
    assert "none before" in report["next_trial"]
    page = write_gap_page(tmp_path / "gap.html", report).read_text(encoding="utf-8")
    assert page.count("do not describe the same machine") == 1
    assert "The model form is right" not in page
    assert "rest on channels or numbers that cannot be right" in page


@pytest.mark.pipeline
@pytest.mark.parametrize("wrong", WRONG_UNIT)
def test_a_wrong_unit_is_refused(wrong):
    with pytest.raises(InputError, match="do not describe the same axis") as refused:
        report_of(WRONG_UNIT[wrong])
    assert "units and the unit of the time" in str(refused.value.remedy)


@pytest.mark.pipeline
def test_swapped_drive_and_displacement_are_refused():
    with pytest.raises(InputError, match=r"passive axis|same axis"):
        report_of(lambda t, x, f: (t, f, x))


@pytest.mark.pipeline
def test_a_recording_of_the_axis_is_not_contradicted():
    report = report_of(as_it_is)
    assert report["detail"]["contradiction"] == ""
    assert report["causes"][0]["effects"] == ["guide_friction"]


def shifted(value, std, *, nominal=95.0, stated=9.5):
    return {"moving_mass_kg": {"value": value, "std": std, "nominal": nominal, "sigmas": (value - nominal) / stated}}


@pytest.mark.unit
@pytest.mark.parametrize(
    ("shift", "is_impossible"),
    [
        (shifted(-20.0, 3.0), True),
        (shifted(-0.1, 1.0), True),
        (shifted(4000.0, 100.0), True),
        (shifted(20.0, 3.0), False),
        (shifted(-20.0, 30.0), False),
        # Known to hardly a factor: nothing that is positive contradicts it.
        (shifted(2.0, 1.0, stated=95.0), False),
        (shifted(95.0, 3.0), False),
    ],
)
def test_a_parameter_of_another_machine_is_told_from_one_that_is_off(shift, is_impossible):
    assert bool(contradiction("parameters", shift, {"by_channel": {}}, {})) is is_impossible
    assert bool(contradiction("no_gap", shift, {"by_channel": {}}, {})) is is_impossible
    assert contradiction("unknown", shift, {"by_channel": {}}, {}) == ""


@pytest.mark.unit
def test_a_cause_that_explains_the_drive_is_no_contradiction():
    row = {"nominal": 2.0, "retuned": 2.0, "with_effect": 0.2, "unit": "N"}
    gap = {"by_channel": {"drive_force_n": row}}
    assert contradiction("effect", {}, gap, {"drive_force_n": 2.0}) == ""
    assert "explains nothing of drive_force_n" in contradiction("unknown", {}, gap, {"drive_force_n": np.float64(2.0)})
