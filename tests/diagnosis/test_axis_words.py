"""What a report says of a linear axis: its own words, plain digits, nothing of a saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.commands.diagnose import _as_text
from sawbench.diagnosis.answer.detection_limits import DetectionLimit
from sawbench.diagnosis.answer.gap_report import _hidden, diagnose
from sawbench.diagnosis.plants.axis_friction import ByDirection
from sawbench.diagnosis.plants.linear_axis import LinearAxis, reduce_axis
from sawbench.modeling.machines.linear_axis import AxisBaseline
from sawbench.processing.process import process_recording
from sawbench.reporting.trial_page import TrialReport, trust_in, verdict

from tests.rigs import linear_axis as rig

pytestmark = pytest.mark.unit

CONFIG = """[linear_axis]
moving_mass_kg = { nominal = 4.0, rel_std = 0.05 }
viscous_damping_n_s_per_m = { nominal = 60.0, rel_std = 0.1 }
drive_channel = "drive_force_n"
"""


def recording(**changes):
    one = rig.run_axis(rig.Friction(coulomb=8.0), rate_hz=1.0, load_n=0.0, seconds=6.0, seed=1)
    columns = {
        "displacement_mm": ("mm", 10.0 * one["displacement_mm"]),
        "drive_force_n": ("N", 10.0 * rig.FORCE_A_CURRENT * one["motor_current_a"]),
        **changes,
    }
    signals = {
        name: Signal(channel=name, unit=unit, time_s=one["time_s"], values=values)
        for name, (unit, values) in columns.items()
    }
    return Recording(trial=Trial(trial_id="a", material="none"), signals=signals)


def test_the_operating_point_is_in_plain_digits():
    campaign = reduce_axis([recording()], parse_config(CONFIG))
    assert campaign.states[0].setting.operating_point == "none, 1.0 Hz, stroke 400 mm"


def test_large_forces_are_in_kilonewtons():
    by = ByDirection(
        forward_n=11742.0, backward_n=9931.0, difference_n=1811.0, difference_std_n=9.0, is_significant=True
    )
    assert "11.7 kN towards larger" in by.words() and "9930 N towards smaller" in by.words()
    assert "constant force of 910 N" in by.words()


def test_a_cause_that_is_named_is_not_below_the_detection_limit():
    odds = {"elastic_load": 0.1, "windage_drag": 0.1, "guide_friction": 50.0}
    shown = {name: DetectionLimit(log_odds=value) for name, value in odds.items()}
    assert _hidden(shown, ["elastic_load"]) == [
        "below the detection limit here, at their typical magnitude: windage drag"
    ]
    assert _hidden(shown, ["elastic_load", "windage_drag"]) == []


@pytest.mark.parametrize(
    ("effect", "form", "said"),
    [
        ("guide_friction", {"presliding": 0.0, "slope": 0.0}, "the same at every speed"),
        ("guide_friction", {"gap": 0.06, "spring": 0.05}, "felt through 3.1 mm of play and a spring of 2.6 mm"),
        ("guide_friction", {"gap": 0.0, "spring": 0.01}, "felt through a spring of 0.52 mm"),
        ("guide_friction", {"presliding": 0.02, "slope": 0.0}, "turning round over a presliding distance of 1.0 mm"),
        ("guide_friction", {"presliding": 0.0, "slope": -0.25}, "25 % larger at the end of smaller displacement"),
        ("yoke_backlash", {"gap": 0.02}, ""),
        ("yoke_backlash", {"gap": 0.1, "spring": 0.05, "before": 0.0}, "in series with a spring of 2.6 mm"),
    ],
)
def test_a_form_is_stated_in_millimetres(effect, form, said):
    config = parse_config(CONFIG).config.linear_axis
    model = AxisBaseline(config=config, force_scale_n=1e4, stroke_m=0.0516, top_speed_m_s=0.16)
    (one,) = [e for e in LinearAxis(model=model).effects if e.name == effect]
    assert form in one.shapes
    assert one.form_words(form) == said


def test_every_form_of_an_axis_has_words_in_plain_digits():
    config = parse_config(CONFIG).config.linear_axis
    model = AxisBaseline(config=config, force_scale_n=1e4, stroke_m=0.0516, top_speed_m_s=0.16)
    for effect in LinearAxis(model=model).effects:
        assert not any("e-0" in effect.form_words(shape) for shape in effect.shapes)


@pytest.mark.parametrize("material", ["none", "brake"])
def test_the_page_of_a_trial_says_nothing_of_a_saw(material):
    made = recording(force_n=("N", 200.0 * np.sin(np.linspace(0.0, 12.0 * np.pi, 6000))))
    made = replace(made, trial=replace(made.trial, material=material))
    processed = process_recording(made, parse_config(CONFIG).config)
    assert processed.status == "moving"
    assert processed.peak_force_n is None and processed.removed is None
    said = [verdict(processed, None, None), *trust_in(TrialReport(processed=processed)).reasons]
    assert said[0].startswith("The axis moved back and forth at ")
    assert not [text for text in said if any(word in text for word in ("saw", "blade", "yoke", "plausible", "cut"))]


def test_a_report_on_an_axis_has_the_words_of_an_axis():
    about = {"recordings": {}, "config_sha256": "", "software": ""}
    report = diagnose([recording()], parse_config(CONFIG), provenance=about)
    assert "k_Fc" not in report["gap"]["metric"]
    text = _as_text(report)
    table = text.partition("cause ")[2].partition("RMSE")[0].splitlines()
    assert any(line.startswith("guide friction ") for line in table)
    # The columns of a table are as wide as the words that stand in it.
    assert len({len(line.partition("%")[0]) for line in table[1:] if "%" in line}) == 1
    for name in ("current_sensor_lag", "current sensor lag", "windage", "guide_friction", "k_Fc", "crank"):
        assert name not in text
