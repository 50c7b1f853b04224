"""The gap page: every verdict in words, curves and tables, nothing from the network."""

from __future__ import annotations

import copy
import re

import pytest
from sawbench.reporting.cause_words import what_happens
from sawbench.reporting.gap_page import closest_description, known_effects, verdict_sentence, write_gap_page
from sawbench.reporting.standing_out_figure import stands_out

pytestmark = pytest.mark.unit

CURVE = {"unit": "A", "measured": [1.0, 2.0, 3.0, 2.0], "nominal": [0.5, 1.5, 2.5, 1.5],
         "retuned": [1.0, 2.0, 2.9, 2.0], "with_effect": [1.0, 2.0, 3.0, 2.1]}  # fmt: skip
CAUSE = {
    "effects": ["guide_friction"], "indistinguishable_from": ["windage_drag"], "probability": 0.93,
    "parameters": {"force_n": {"value": 8.3, "std": 0.4, "unit": "N"}},
    "gap_closed": 0.96, "gap_closed_ci95": [0.93, 0.97],
}  # fmt: skip
RUNNER_UP = {**CAUSE, "effects": ["motor_coulomb_friction"], "probability": 0.05, "gap_closed": -0.002}
RUNGS = {"nominal": 1.5, "retuned": 0.2, "with_effect": 0.01, "noise_floor": 0.02}
REPORT = {
    "verdict": "effect",
    "where": [{"equation": "mechanical", "channel": "motor_current_a", "share": 0.9, "grows_with": ["load"],
               "crank_angle_rad": [[0.0, 1.5707963]], "frequency_hz": None}],
    "causes": [CAUSE, RUNNER_UP],
    "probabilities": {"no_gap": 0.0, "parameters": 0.01, "unknown": 0.01},
    "parameter_shifts": {"resistance_ohm": {"value": 0.2, "std": 0.001, "nominal": 0.176, "sigmas": 4.1}},
    "gap": {"metric": "rms", **RUNGS, "by_channel": {"motor_current_a": {**RUNGS, "unit": "A"}},
            "runtime_s": {"nominal": 974.0, "retuned": 841.0, "with_effect": 838.0, "measured": 839.0}},
    "next_trial": "an idle run",
    "warnings": ["no operating point was repeated"],
    "detail": {
        "strokes": [{"trial": "t1", "operating_point": "oak, 20.0 mm, feed 1.7999999999999998 mm/s, duty 0.4",
                     "channels": {"motor_current_a": CURVE}}],
        "map": {"operating_points": ["a", "b"],
                "equations": {"mechanical": {"unit": "N*m", "values": [[0.1, -0.2, 0.0], None]}}},
        "log_evidence": {"guide_friction": 250.0, "no_gap": 0.0},
        "alike": {"effects": ["guide_friction", "motor_coulomb_friction"], "cosine": [[1.0, 0.4], [0.4, 1.0]]},
        "runtime_of": "oak",
    },
    "provenance": {"recordings": {"t1.mcap": "ab" * 32}, "config_sha256": "cd" * 32, "software": "sawbench 0"},
}  # fmt: skip


def page(tmp_path, **changes):
    report = {**copy.deepcopy(REPORT), **changes}
    return write_gap_page(tmp_path / "gap.html", report).read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")


def test_cause_is_named_with_its_size_and_the_runner_up_beside_it(tmp_path):
    text = page(tmp_path)
    above, _, below = text.partition("Error of the model, step by step</h2>")
    assert what_happens("guide_friction")[1:] in above
    assert (
        "Most probable cause: guide friction (93 %), force 8.30 ± 0.40 N. Adding it explains 96 % (93 to 97 %)" in above
    )
    assert "indistinguishable from: windage drag (same evidence within its scatter)." in above
    assert "measured 13 min 59 s; model as configured 16 min 14 s, with the cause 13 min 58 s (oak)" in above
    assert "no operating point was repeated" in above
    assert "motor coulomb friction" in below
    assert "-0 %" not in text


@pytest.mark.parametrize(
    ("held_out", "said"),
    [("operating points", "at withheld operating points."), ("trials", "at withheld trials."),
     ("nothing", "at the trial of the fit.")],
)  # fmt: skip
def test_the_page_says_what_was_withheld(tmp_path, held_out, said):
    text = page(tmp_path, detail={**REPORT["detail"], "held_out": held_out})
    assert f"of the remaining error where it acts, {said}" in text


def test_the_form_of_a_cause_is_stated_beside_its_size(tmp_path):
    felt = "felt through 3.1 mm of play"
    text = page(tmp_path, causes=[{**CAUSE, "form": [felt]}, RUNNER_UP])
    assert f"force 8.30 ± 0.40 N, {felt}. Adding" in text
    assert text.count(felt) == 2


def test_indistinguishable_is_said_of_the_evidence_alone(tmp_path):
    # Effects without evidence may have independent signatures, and those with a cosine near 1 may be told apart.
    text = page(tmp_path)
    causes, _, similarity = text.partition("Similarity of the signatures</h3>")
    assert "within its standard deviation of that of the cause, or the odds are below 20 to 1" in causes
    assert "100: same pattern. 0: independent patterns." in similarity
    assert "100: indistinguishable" not in text


@pytest.mark.parametrize(
    ("verdict", "probabilities", "words"),
    [
        (
            "no_gap",
            {"no_gap": 0.9, "parameters": 0.05, "unknown": 0.0},
            "measurements within their noise and its own uncertainty (90 %)",
        ),
        ("unknown", {"no_gap": 0.0, "parameters": 0.1, "unknown": 0.85}, "no known cause explains it (85 %)"),
        (
            "parameters",
            {"no_gap": 0.0, "parameters": 0.999, "unknown": 0.0},
            "some parameters differ from their stated values",
        ),
    ],
)
def test_other_verdicts_claim_no_cause(tmp_path, verdict, probabilities, words):
    text = page(tmp_path, verdict=verdict, probabilities=probabilities)
    above, _, _ = text.partition("Error of the model, step by step</h2>")
    assert words in above
    assert what_happens("guide_friction")[1:] not in above
    assert "re-tuned 14 min 1 s" in above
    if verdict == "parameters":
        assert "resistance_ohm, 0.1760 stated, 0.2000 ± 0.0010 found (4.1 times its uncertainty)" in above


def test_a_page_without_a_gap_agrees_with_its_re_tuned_parameters(tmp_path):
    no_gap = {"verdict": "no_gap", "probabilities": {"no_gap": 0.9, "parameters": 0.05, "unknown": 0.0},
              "next_trial": "none", "improved_model": "[plant]"}  # fmt: skip
    shifted = page(tmp_path, **no_gap).partition("Error of the model, step by step</h2>")[0]
    said = "the model explains the measurements within their noise and its own uncertainty (90 %)."
    assert f"No gap: with re-tuned parameters {said}" in shifted
    assert "No unmodelled effect" in shifted
    assert "resistance_ohm, 0.1760 stated, 0.2000 ± 0.0010 found (4.1 times its uncertainty)" in shifted
    assert "Check the stated values of the shifted parameters." in shifted
    assert "Until then use the improved model" in shifted and "--config improved_model.toml" in shifted
    assert "Use the model as it is" not in shifted
    (tmp_path / "gap.html").unlink()
    within = {"resistance_ohm": {**REPORT["parameter_shifts"]["resistance_ohm"], "sigmas": 1.9}}
    text = page(tmp_path, **no_gap, parameter_shifts=within)
    assert "No gap: the model explains the measurements" in text and "Use the model as it is." in text
    assert "Largest shifts" not in text
    # Advice to use the model as it is must not be followed by advice to use another one.
    assert "use the improved model" not in text
    assert "Optional: the same model with parameters re-tuned within their uncertainty" in text
    assert "--config improved_model.toml" in text


def test_the_closest_description_is_that_of_an_unknown_cause_alone():
    seen = {**REPORT["detail"], "resembles": "spring on the plunger"}
    assert closest_description({**REPORT, "verdict": "unknown", "detail": seen}) == [
        "Closest description: spring on the plunger."
    ]
    assert closest_description({**REPORT, "verdict": "unknown", "detail": {**seen, "resembles": ""}}) == []
    assert closest_description({**REPORT, "verdict": "effect", "detail": seen}) == []


def test_an_asynchronous_line_is_told_once_with_its_place(tmp_path):
    line = {"equation": "cutting", "channel": "force_n", "share": 1.0, "grows_with": [], "crank_angle_rad": []}
    seen, told = (f"{name} swings by 2.6 N at 9.33 cycles a stroke" for name in ("force_n", "force"))
    unknown = {"no_gap": 0.0, "parameters": 0.0, "unknown": 0.99}
    detail = {**REPORT["detail"], "resembles": seen}

    def with_lines(lines_hz, folder):
        folder.mkdir()
        return page(
            folder, verdict="unknown", probabilities=unknown, warnings=[seen], detail=detail,
            where=[{**line, "frequency_hz": lines_hz}],
        )  # fmt: skip

    several = with_lines([101.8, 166.8, 210.0], tmp_path / "several")
    assert (several.count(told), several.count(seen)) == (1, 0)
    assert "a part that rotates, slips or switches at 101.8 to 210.0 Hz, with the stroke rate" in several
    assert "of the gap lies" not in several
    assert "asynchronous" in several
    assert "See the map" not in several
    assert "a part that rotates, slips or switches at 68.20 Hz." in with_lines([68.2], tmp_path / "one")


def test_limits_of_an_answer_name_channels_plainly(tmp_path):
    lost = "t1: motor_current_a left out: it is missing in most of the strokes; see edge_force.force_n"
    text = page(tmp_path, warnings=[lost])
    assert "t1: motor current left out: it is missing in most of the strokes; see edge_force.force_n" in text


def test_a_doubtful_cause_is_called_doubtful():
    doubtful = {**REPORT, "causes": [{**CAUSE, "probability": 0.5}, RUNNER_UP]}
    assert verdict_sentence(doubtful).startswith("Most probable cause, not certain: guide friction (50 %)")


def test_figures_have_titles_and_descriptions_and_nothing_is_fetched(tmp_path):
    text = page(tmp_path)
    pictures = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    assert len(pictures) == 3
    for picture in pictures:
        assert re.search(r"<title[^>]*>.+</title><desc[^>]*>.+</desc>", picture)
    assert "feed 1.8 mm/s" in text
    assert 'src="' not in text and 'href="http' not in text and "data:" not in text


def test_captions_are_right_on_a_dark_screen_too(tmp_path):
    # Figures are inverted there: what is white on paper is black.
    detail = {**REPORT["detail"], "standing_out": STANDING_OUT}
    text = page(tmp_path, detail=detail)
    assert "Blank: not compared." in text and "Not coloured: no gap." in text
    assert not re.search(r"\b(white|black):", text, flags=re.IGNORECASE)


def test_a_report_without_detail_still_gives_a_page(tmp_path):
    report = copy.deepcopy(REPORT)
    del report["detail"]
    report["gap"].pop("runtime_s")
    report["gap"]["by_channel"] = {}
    text = write_gap_page(tmp_path / "plain.html", report).read_text(encoding="utf-8")
    assert "<svg" not in text
    assert "guide friction" in text


def cells(times, q_value):
    return {"times_expected": times, "q_value": q_value}


STANDING_OUT = {
    "false_discovery_rate": 0.05, "n_cells": 5, "n_found": 1,
    "found_in": [{"equation": "mechanical", "channel": "motor_current_a"}],
    "partitions": {
        "crank_angle": {"places": ["0 to 180 deg", "180 to 360 deg"],
                        "equations": {"mechanical": cells([40.0, 2.0], [0.001, 0.4]),
                                      "cutting": cells([1.0, 1.0], [1.0, 1.0])}},
        "operating_point": {"places": ["a"], "equations": {"mechanical": cells([1.0], [1.0])}},
    },
}  # fmt: skip


def test_equations_without_a_place_that_stands_out_are_greyed(tmp_path):
    detail = {**copy.deepcopy(REPORT["detail"]), "standing_out": STANDING_OUT}
    where = [REPORT["where"][0], {**REPORT["where"][0], "equation": "cutting", "channel": "force_n"}]
    text = page(tmp_path, where=where, detail=detail)
    rows = re.findall(r"<tr[^>]*><th scope=\"row\">.*?</tr>", text.partition("Where the gap lies</h2>")[2])
    assert "motor and drive, mechanical side" in rows[0] and "unproven" not in rows[0]
    assert "cutting" in rows[1] and "no region is significant" in rows[1] and 'class="unproven"' in rows[1]
    assert "1 of 5 region is significant, false discovery rate 5 %" in text
    assert len(re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)) == 4


def test_a_cause_without_a_place_is_explained(tmp_path):
    quiet = {**STANDING_OUT, "n_found": 0, "found_in": []}
    detail = {**copy.deepcopy(REPORT["detail"]), "standing_out": quiet}
    assert "identified from its pattern over all regions together" in page(tmp_path, detail=detail)


def test_a_sensor_at_fault_goes_by_its_channel():
    found = {"found_in": [{"equation": "cutting", "channel": "force_n"}]}
    assert stands_out({"equation": "sensing", "channel": "force_n"}, found)
    assert not stands_out({"equation": "sensing", "channel": "motor_current_a"}, found)
    assert not stands_out({"equation": "mechanical", "channel": "force_n"}, found)


@pytest.mark.parametrize(
    ("name", "parameter", "words"),
    [
        ("delay_s", {"value": 0.00162, "std": 8.7e-5, "unit": "s"}, "delay 1.620 ± 0.087 ms"),
        ("frequency_hz", {"value": 262.0, "std": 123.4, "unit": "Hz"}, "frequency 260 ± 120 Hz"),
        ("time_constant_s", {"value": 12.5, "std": None, "unit": "s"}, "time constant 12.5 s"),
        ("drift_n_per_1000_s", {"value": -1100.0, "std": 3100.0, "unit": "N"}, "drift −1100 ± 3100 N per 1000 s"),
        ("growth_per_10_m", {"value": 0.12, "std": 0.034, "unit": "1"}, "growth 12.0 ± 3.4 % per 10 m of blade travel"),
        ("stiffness_n_per_m", {"value": 160400.0, "std": 24000.0, "unit": "N/m"}, "stiffness 160000 ± 24000 N/m"),
    ],
)
def test_sizes_are_written_without_powers_of_ten(tmp_path, name, parameter, words):
    assert words in page(tmp_path, causes=[{**CAUSE, "parameters": {name: parameter}}, RUNNER_UP])


def test_a_magnitude_that_may_be_nothing_is_not_determined_unless_its_cause_is_named(tmp_path):
    def wide(value):
        return {"exponent": {"value": value, "std": 0.2, "unit": "1"}}

    limits = {"cutting_speed_exponent": {"name": "exponent", "unit": "1", "change": 0.5, "without_effect": 1.0}}
    detail = {**copy.deepcopy(REPORT["detail"]), "detection_limits": limits}
    causes = [
        {**CAUSE, "parameters": {"force_n": {"value": 8.3, "std": 20.0, "unit": "N"}}},
        {**RUNNER_UP, "parameters": {"torque_n_m": {"value": 2.5, "std": 11.7, "unit": "N*m"}}},
        {**RUNNER_UP, "effects": ["cutting_speed_exponent"], "parameters": wide(1.1)},
        {**RUNNER_UP, "effects": ["cutting_speed_exponent"], "parameters": wide(0.3)},
    ]
    text = page(tmp_path, causes=causes, detail=detail)
    assert "force 8 ± 20 N" in text
    assert "torque not determined" in text and "± 12 N·m" not in text
    assert text.count("exponent not determined") == 1 and "exponent 0.30 ± 0.20" in text


def test_large_magnitudes_and_whole_minutes_read_as_people_write_them(tmp_path):
    stiff = {"stiffness_n_per_m": {"value": 2.0e15, "std": 4.46e14, "unit": "N/m"}}
    gap = {**REPORT["gap"], "runtime_s": {"nominal": 4319.7, "measured": 59.6}}
    text = page(tmp_path, causes=[{**CAUSE, "parameters": stiff}, RUNNER_UP], gap=gap)
    assert "stiffness (2.00 ± 0.45) × 10¹⁵ N/m" in text
    assert "measured 1 min 0 s; model as configured 1 h 12 min" in text


def test_cards_credit_re_tuning_and_the_cause_apart(tmp_path):
    assert "<dd>1.5 → 0.20 → 0.010 A<span>as configured → re-tuned → with the cause; noise 0.020 A</span>" in page(
        tmp_path
    )
    unknown = {"no_gap": 0.0, "parameters": 0.1, "unknown": 0.85}
    (tmp_path / "gap.html").unlink()
    text = page(tmp_path, verdict="unknown", probabilities=unknown)
    assert "<dd>1.5 → 0.20 A<span>as configured → re-tuned; noise 0.020 A</span>" in text


def test_the_caption_of_the_ladder_allows_what_the_numbers_show(tmp_path):
    text = page(tmp_path)
    assert "lower limit" not in text
    assert "standard uncertainty of a measured mean stroke" in text and "the RMSE can be below the noise" in text


def test_the_picture_comes_before_any_explanation_and_a_simulated_bench_is_announced(tmp_path):
    text = page(tmp_path)
    assert text.index("<svg") < text.index("What it means")
    assert "Simulated bench" not in text
    (tmp_path / "gap.html").unlink()
    provenance = {**REPORT["provenance"], "is_simulated": True}
    assert '<p class="banner">Simulated bench' in page(tmp_path, provenance=provenance)


def test_the_place_that_is_told_is_where_the_cause_acts(tmp_path):
    elsewhere = {**REPORT["where"][0], "equation": "cutting", "channel": "force_n", "share": 0.7, "crank_angle_rad": []}
    own = {**REPORT["where"][0], "share": 0.3}
    text = page(tmp_path, where=[elsewhere, own])
    assert "30 % of the gap lies on the mechanical side of motor and drive" in text
    assert text.index("This is where the cause acts.") < text.index("This is a consequence of the cause.")
    (tmp_path / "gap.html").unlink()
    assert "a consequence of the cause" not in page(tmp_path)


def test_evidence_stands_beside_its_probability(tmp_path):
    detail = {**copy.deepcopy(REPORT["detail"]), "probabilities": {"guide_friction": 0.93, "no_gap": 0.0}}
    text = page(tmp_path, detail=detail)
    assert '<th scope="row">guide friction</th><td class="number">250.0</td><td class="number">93 %</td>' in text
    assert "so large evidence alone does not mean certainty" in text


def test_faults_of_sensors_have_a_section_of_their_own(tmp_path):
    words = "hum of 4.1 N at 50.0 Hz: pickup from the mains"
    hum = {"channel": "force_n", "finding": "hum", "frequency_hz": 50.0, "magnitude": 4.1, "unit": "N", "words": words}
    assert f"<li>force: {words}</li>" in page(tmp_path, signals=[hum]).partition("<h2>Signals</h2>")[2]
    (tmp_path / "gap.html").unlink()
    assert "<h2>Signals</h2>" not in page(tmp_path, signals=[])


LEARNED = {
    "equation": "cutting", "channel": "force_n", "stands_in": "cutting", "cutting_only": False,
    "quantities": [
        {"name": "motor_current_a", "words": "motor current", "unit": "A", "range": [1.0, 4.0],
         "dependence": "rises with"},
        {"name": "crank_angle_rad", "words": "crank angle", "unit": "rad", "range": [0.0, 6.283185307179586],
         "dependence": "varies with"},
    ],
    "table": {
        "unit": "N", "nodes": [[1.0, 2.0, 3.0, 4.0], [0.0, 1.5707963, 3.1415927, 4.712389]],
        "values": [[1.0 * k] * 4 for k in range(4)], "low": [[1.0 * k - 0.5] * 4 for k in range(4)],
        "high": [[1.0 * k + 0.5] * 4 for k in range(4)], "typical": [2.0, 3.0],
    },
    "rel_std": 0.1, "gap_closed": 0.91, "gap_closed_ci95": [0.85, 0.95], "held_out": "operating points",
    "resembles": [{"effect": "edge_force", "correlation": 0.62}],
    "words": "in the cutting force; it rises with motor current, and resembles no known effect",
}  # fmt: skip


def test_a_learned_term_is_drawn_with_its_range_and_what_it_closes(tmp_path):
    text = page(tmp_path, verdict="unknown", causes=[], learned_term=LEARNED)
    assert "The learned term</h2>" in text
    assert "91 % (85 to 95 %) of the remaining error at withheld operating points" in text
    assert "motor current from 1 to 4 A. It must not be used outside" in text
    assert "edge force 0.62" in text
    (tmp_path / "without").mkdir()
    without = page(tmp_path / "without", verdict="unknown", causes=[], learned_term=None)
    assert "learned term" not in without


def test_effects_that_the_model_has_already_are_said():
    known = {"guide_friction.force_n": {"value": 20.4, "std": 6.1, "unit": "N"}}
    said = known_effects({**REPORT, "detail": {"known_effects": known}})
    assert said == ["In the model as configured: guide friction: force 20.4\xa0±\xa06.1\xa0N."]
    assert known_effects({**REPORT, "detail": {"known_effects": {}}}) == []
