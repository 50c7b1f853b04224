"""Reported numbers of rightly named effects are compared with true ones that are known by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import sawbench.commands.blind
from sawbench.blindcheck.drawing import draw_campaign
from sawbench.blindcheck.effects.table import CATALOGUE, OUTSIDE
from sawbench.blindcheck.parameter_score import StatedParameter, parameter_score, stated_parameters
from sawbench.blindcheck.scored_case import Case, case_of
from sawbench.blindcheck.scoring import score
from sawbench.blindcheck.sensors import SensorSettings, measure
from sawbench.blindcheck.true_parameters import REPORTED, true_parameters
from sawbench.commands.main import main
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

pytestmark = pytest.mark.pipeline

# Their forms hold no number that means what the report says: see docs/blind_check.md.
WITHOUT = {"current_limit", "preload_lift_off"}


def true_value(effect: str, severity: float, *, seed: int = 3, forms="own") -> float:
    draw = draw_campaign(seed, effects={effect: severity}, background=(0, 0.01, 0.01), forms=forms)
    return true_parameters(draw)[effect]["value"]


def test_every_number_has_the_name_and_unit_of_the_report():
    assert set(CATALOGUE) - set(REPORTED) == WITHOUT
    stated = {name: (one.name, one.unit) for name, one in REPORTED.items()}
    assert stated == {
        name: (EFFECT_BY_NAME[name].strength.name, EFFECT_BY_NAME[name].strength.unit) for name in REPORTED
    }


@pytest.mark.parametrize("effect", sorted(set(CATALOGUE) - WITHOUT))
def test_every_number_is_known_and_follows_the_severity(effect):
    small, large = true_value(effect, 0.5), true_value(effect, 2.0)
    assert np.isfinite([small, large]).all()
    if effect == "carriage_resonance":
        assert small == large  # the frequency is drawn
    elif effect == "cutting_speed_exponent":
        assert 1.0 > small > large > 0.0
    elif effect == "blade_compliance":
        assert small == pytest.approx(4.0 * large)
    elif effect == "chip_thickness":
        assert 3.5 * small < large < 5.0 * small
    else:
        assert large == pytest.approx(4.0 * small)


@pytest.mark.parametrize(
    ("effect", "severity", "value"),
    [
        ("guide_friction", 0.5, 4.0),
        ("motor_coulomb_friction", 2.0, 0.01),
        ("yoke_backlash", 2.0, 5e-4),
        # 0.65 V by the logarithm, which is 1 at 10 A, and 12 mohm times 10 A.
        ("converter_diode_drop", 1.0, 0.77),
        # Half of the force at 0.7 m/s where 1/v_s is 1.25 s/m: 1 / (1 + 0.7 * 1.25).
        ("cutting_speed_exponent", 1.0, 1.0 / 1.875),
        ("battery_polarization", 1.0, 0.048),
        # 1.6 + 3.5 K/W with the coefficient of copper; 3.5 K/W with 0.18 instead of 0.15 %/K.
        ("winding_heating", 1.0, 5.1),
        ("magnet_weakening", 1.0, 4.2),
        ("blade_wear", 1.0, 0.028 * np.sqrt(10.0)),
        ("current_sensor_lag", 1.5, 1.5e-3),
        ("blade_compliance", 2.0, 8e4),
    ],
)
def test_true_values_by_hand(effect, severity, value):
    assert true_value(effect, severity) == pytest.approx(value)


def test_textbook_forms_have_their_own_numbers():
    assert true_value("blade_wear", 1.0, forms="plain") == pytest.approx(0.05)
    assert true_value("tooth_passing_ripple", 1.0, forms="plain") == pytest.approx(0.22, rel=1e-4)
    assert true_value("battery_polarization", 1.0, forms="plain") == pytest.approx(0.04)


def test_the_eccentric_torque_is_the_first_harmonic_of_the_tight_spot():
    angle = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)
    torque = 0.016 * (np.exp(0.7 * np.cos(angle)) - 1.1263) / 0.75
    assert true_value("gear_eccentricity", 1.0) == pytest.approx(2.0 * np.mean(torque * np.cos(angle)))


def test_the_tooth_depth_is_the_first_harmonic_of_the_rounded_sawtooth():
    u = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)
    saw = np.arctan2(0.75 * np.sin(u), 1.0 - 0.75 * np.cos(u)) / np.arcsin(0.75)
    assert true_value("tooth_passing_ripple", 1.0) == pytest.approx(0.22 * 2.0 * np.mean(saw * np.sin(u)))


def test_the_drift_is_that_of_the_readings_over_1000_s():
    draw = draw_campaign(3, effects={"force_offset_drift": 1.0}, background=(0, 0.01, 0.01))
    quiet = replace(draw.sensors, noise=(0.0,) * 5, step=SensorSettings().step, gain=(1.0,) * 5)
    still = np.zeros((4001, 7))
    readings = [
        measure(still, quiet, rate_hz=2000.0, session_s=at_s, rest_s=0.1, seed=[draw.seed, 0]).values["force_n"][0]
        for at_s in (draw.trials[0].rest_s, draw.trials[0].rest_s + 1000.0)
    ]
    # The readings come in steps of 0.06 N.
    assert true_parameters(draw)["force_offset_drift"]["value"] == pytest.approx(readings[1] - readings[0], abs=0.07)


def test_the_brush_voltage_is_that_at_the_working_current():
    draw = draw_campaign(3, effects={"brush_voltage_drop": 1.0})
    assert 2.0 < draw.working_current_a < 20.0
    assert 0.9 < true_parameters(draw)["brush_voltage_drop"]["value"] < 0.9 * (1.0 + 0.05 * np.log(21.0))


def test_pairs_state_both_and_what_is_outside_states_nothing():
    both = true_parameters(draw_campaign(3, effects={"edge_force": 1.0, "windage_drag": 0.5}))
    assert {name: one["value"] for name, one in both.items()} == {"edge_force": 35.0, "windage_drag": 0.003}
    assert true_parameters(draw_campaign(3, effects={next(iter(OUTSIDE)): 1.0})) == {}


TRUTH = {
    "effects": {"edge_force": 1.0},
    "reported_parameters": {"edge_force": {"name": "force_n", "value": 35.0, "unit": "N"}},
}


def report(value: float = 38.0, std: float = 2.0, **changes) -> dict:
    cause = {
        "effects": ["edge_force"], "indistinguishable_from": [], "probability": 0.9,
        "parameters": {"force_n": {"value": value, "std": std, "unit": "N"}},
        "gap_closed": 0.9, "gap_closed_ci95": [0.8, 0.95],
    }  # fmt: skip
    return {"verdict": "effect", "causes": [cause | changes], "probabilities": {"no_gap": 0.1}}


def scored(truth: dict, *reports: dict):
    label = {"kind": "effect", "truth": truth}
    return score([case_of(f"case-{k}", label, {"report": one}) for k, one in enumerate(reports)]).parameters


def test_the_interval_is_1_96_standard_deviations_wide_either_way():
    # 3.92 N either way around the stated value.
    found = scored(TRUTH, report(38.9), report(39.0), report(31.1), report(31.0))
    assert (found.coverage.hits, found.coverage.n) == (2, 4)
    assert found.relative_error.value == pytest.approx((3.9 + 4.0) / 2.0 / 35.0)
    (edge,) = found.effects
    assert (edge.effect, edge.name, edge.coverage.n) == ("edge_force", "force_n", 4)
    assert edge.ratio == pytest.approx(1.0)
    assert edge.stated_rel_std == pytest.approx(2.0 / 35.0)


def test_a_negative_truth_has_a_positive_error():
    one = StatedParameter(effect="force_offset_drift", name="d", unit="N", value=-3.0, std=0.1, true_value=-4.0)
    assert one.relative_error == pytest.approx(0.25)
    assert not one.is_inside
    assert parameter_score([one]).effects[0].ratio == pytest.approx(0.75)
    assert parameter_score([one]).effects[0].stated_rel_std == pytest.approx(0.025)


def test_wrong_claims_and_numbers_that_cannot_be_compared_do_not_count():
    wrong = report(effects=["guide_friction"])
    other_unit = report(parameters={"force_n": {"value": 0.038, "std": 0.002, "unit": "kN"}})
    silent = report(parameters={})
    assert scored(TRUTH, wrong, other_unit, silent).coverage.n == 0
    undeclared = report() | {"verdict": "unknown"}
    assert scored(TRUTH, undeclared).coverage.n == 0


def test_a_number_that_two_effects_share_is_not_told_apart():
    truth = {
        "reported_parameters": {
            "edge_force": {"name": "force_n", "value": 35.0, "unit": "N"},
            "guide_friction": {"name": "force_n", "value": 8.0, "unit": "N"},
        }
    }
    cause = report()["causes"][0] | {"effects": ["guide_friction", "edge_force"]}
    assert stated_parameters(truth, cause) == ()
    shared = {f"{name}.force_n": {"value": size, "std": 1.0, "unit": "N"} for name, size in
              (("edge_force", 34.0), ("guide_friction", 11.0))}  # fmt: skip
    told = {one.effect: one for one in stated_parameters(truth, cause | {"parameters": shared})}
    assert (told["edge_force"].value, told["edge_force"].true_value) == (34.0, 35.0)
    assert (told["guide_friction"].is_inside, told["guide_friction"].relative_error) == (False, 3.0 / 8.0)


def test_a_number_that_is_none_fails_the_answer():
    assert case_of("c", {"kind": "effect", "truth": TRUTH}, {"report": report(std=float("nan"))}).is_failed


def test_sets_sealed_without_true_parameters_still_score():
    old = {"effects": {"edge_force": 1.0}}
    found = score([case_of("c", {"kind": "effect", "truth": old}, {"report": report()})])
    assert found.row("exact").hits == 1
    assert (found.parameters.coverage.n, found.parameters.relative_error.value, found.parameters.effects) == (
        0,
        None,
        (),
    )


def claim(name: str, stated: float, oracle: float, closable: float | None) -> Case:
    return Case(
        name="c", kind="effect", effects={"edge_force": 1.0}, probabilities={name: 1.0}, gap_closed=stated,
        gap_closed_ci95=(stated - 0.1, stated + 0.1), oracle_gap_closed=oracle, closable=closable,
    )  # fmt: skip


def test_right_claims_are_held_against_what_can_be_closed():
    gap = score(
        [
            claim("edge_force", 0.60, 0.65, 0.80),
            claim("edge_force", 0.76, 0.80, 0.80),
            claim("edge_force", 0.95, 1.00, 1.00),
            claim("edge_force", 0.20, 0.0, None),
            claim("edge_force", 0.04, 0.04, 0.09),
            claim("blade_wear", 0.10, 0.90, 0.90),
        ]
    ).gap
    assert gap is not None
    assert (gap.coverage.hits, gap.coverage.n) == (4, 6)
    assert gap.share_of_oracle.n == 4
    assert (gap.share_of_closable.n, gap.share_of_closable.value) == (3, pytest.approx(0.76 / 0.80))
    assert gap.share_of_closable.low <= 0.95 <= gap.share_of_closable.high
    assert (gap.closes_enough.hits, gap.closes_enough.n) == (2, 3)


def test_a_twin_that_was_not_made_leaves_the_oracle_alone():
    gap = score([claim("edge_force", 0.6, 0.6, None)]).gap
    assert gap is not None
    assert (gap.closes_enough.n, gap.share_of_closable.value, gap.coverage.hits) == (0, None, 1)


# States the number of whichever effect the case hides, which the program under test is told through its size.
_SIZES = """
import json, pathlib, sys
pathlib.Path(sys.argv[1]).open("a").write("{}\\n")
pathlib.Path("../gap_report.json").write_text(json.dumps({
    "verdict": "effect",
    "causes": [{"effects": ["%s"], "indistinguishable_from": [], "probability": 0.9, "gap_closed": 0.9,
                "parameters": {"%s": {"value": %r, "std": %r, "unit": "%s"}}, "gap_closed_ci95": [0.8, 1.0]}],
    "probabilities": {"no_gap": 0.1}}))
"""


def test_the_page_and_the_terminal_show_what_the_key_knows(sealed, program, monkeypatch, capsys, tmp_path):
    key = json.loads((tmp_path / "safe" / "key.json").read_text())
    hidden = [
        (effect, one)
        for case in key["cases"].values()
        for effect, one in case["label"]["truth"]["reported_parameters"].items()
        if case["label"]["kind"] == "effect"
    ]
    effect, one = hidden[0]
    code = _SIZES % (effect, one["name"], one["value"] * 1.1, abs(one["value"]) * 0.01, one["unit"])
    monkeypatch.setattr(sawbench.commands.blind, "diagnose_program", lambda **_: program(code))
    assert main(["blind", "answer", str(sealed[0])]) == 0
    capsys.readouterr()
    page = tmp_path / "page.html"
    assert main(["blind", "score", str(sealed[0]), "--key", str(sealed[1]), "--out", str(page)]) == 0
    line = next(text for text in capsys.readouterr().out.splitlines() if f"{effect}: {one['name']}" in text)
    assert "0/1" in line
    assert "10.0%" in line
    found = json.loads(page.with_suffix(".json").read_text())["score"]["parameters"]
    assert (found["coverage"]["hits"], found["coverage"]["n"]) == (0, 1)
    assert f"{effect.replace('_', ' ')}: {one['name']}" in page.read_text()
