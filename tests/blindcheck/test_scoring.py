"""The score counts what it says, gives intervals that the literature gives, and puts a guesser at chance."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.blindcheck.effects.table import ACTS_IN, CATALOGUE, LOOKED_FOR_OUTSIDE, OUTSIDE
from sawbench.blindcheck.score_statistics import calibration_error, calibration_of, mean_of, wilson
from sawbench.blindcheck.scored_case import FAILED, VERDICTS, Case, case_of, hypothesis_of
from sawbench.blindcheck.scoring import score
from sawbench.blindcheck.sealing import draw_cases
from sawbench.blindcheck.shifts import shifts_of
from sawbench.diagnosis.inference.beyond.table import BEYOND_CATALOGUE
from scipy.stats import binomtest

pytestmark = pytest.mark.pipeline

N_EFFECTS = len(CATALOGUE)
TRUTH = {"none": "no_gap", "parameters": "parameters", "outside": "unknown"}


def single(effect: str, probabilities: dict, *, severity: float = 1.0, **more) -> Case:
    return Case(name="c", kind="effect", effects={effect: severity}, probabilities=probabilities, **more)


def drawn(n: int, seed: int = 1) -> list[tuple[str, dict, str]]:
    """Kind, effects and the name of the truth of many cases."""
    return [(c.kind, dict(c.effects), TRUTH.get(c.kind, " + ".join(c.effects))) for c in draw_cases(seed, n)]


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    # Newcombe, Statistics in Medicine 17, 857 (1998), table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_intervals_of_the_literature(hits, n, low, high):
    found = wilson(hits, n)
    assert found.low == pytest.approx(low, abs=5e-5)
    assert found.high == pytest.approx(high, abs=5e-5)
    other = binomtest(hits, n).proportion_ci(method="wilson")
    assert (found.low, found.high) == pytest.approx((other.low, other.high), abs=1e-12)


def test_an_interval_holds_its_share_whatever_the_rounding():
    for n in range(1, 60):
        for found in (wilson(0, n), wilson(n, n)):
            assert found.low <= found.share <= found.high


def test_the_calibration_of_claims_leaves_out_what_claims_nothing():
    claims = [single("edge_force", {"edge_force": 0.9, "no_gap": 0.1}) for _ in range(20)]
    hidden_from_view = [single("current_limit", {"no_gap": 0.8}) for _ in range(20)]
    found = score([*claims, *hidden_from_view])
    assert found.calibration_of_claims.error.n == 20
    assert found.calibration_of_claims.error.value == pytest.approx(0.1)
    assert found.calibration.error.value > 0.3


def test_no_case_has_no_share():
    assert wilson(0, 0).share is None
    assert mean_of(np.array([])).value is None
    empty = score([])
    assert empty.n_cases == 0
    assert all(row.value.n == 0 for row in empty.rows)


def test_calibration_error_by_hand():
    stated = np.array([0.9, 0.1, 0.8, 0.2])
    right = np.array([1.0, 0.0, 0.0, 0.0])
    # Bins {0.1, 0.2} and {0.8, 0.9}: 2/4 |0.15 - 0| + 2/4 |0.85 - 0.5|.
    assert calibration_error(stated, right, 2) == pytest.approx(0.25)


def test_calibrated_probabilities_are_told_from_overconfident_ones():
    rng = np.random.default_rng(4)
    stated = rng.uniform(0.2, 1.0, 2000)
    honest = calibration_of(stated, rng.random(2000) < stated)
    boastful = calibration_of(np.full(2000, 0.99), rng.random(2000) < 0.6)
    assert honest.error_by_chance is not None
    assert honest.error.value == pytest.approx(honest.error_by_chance, abs=0.02)
    assert boastful.error.value == pytest.approx(0.39, abs=0.04)
    assert boastful.error.low < 0.39 < boastful.error.high
    assert [one.correct.n for one in honest.bins] == [200] * 10


def test_the_bootstrap_interval_is_about_that_of_the_normal_mean():
    values = np.random.default_rng(5).normal(3.0, 2.0, 400)
    found = mean_of(values)
    half = 1.96 * values.std(ddof=1) / 20.0
    assert found.low == pytest.approx(values.mean() - half, abs=0.05)
    assert found.high == pytest.approx(values.mean() + half, abs=0.05)


def test_brier_and_log_loss_by_hand():
    told = single("edge_force", {"edge_force": 0.7, "blade_wear": 0.2, "no_gap": 0.1})
    assert told.brier == pytest.approx(0.3**2 + 0.2**2 + 0.1**2)
    assert told.log_loss == pytest.approx(-math.log(0.7))
    partly = single("blade_wear", {"edge_force": 0.5})
    n_unlisted = partly.n_hypotheses - 1
    each = 0.5 / n_unlisted
    assert partly.brier == pytest.approx(0.25 + (n_unlisted - 1) * each**2 + (1 - each) ** 2)
    assert partly.probability_of(hypothesis_of("blade_wear")) == pytest.approx(each)
    sure_and_wrong = single("blade_wear", {"edge_force": 1.0})
    assert sure_and_wrong.brier == pytest.approx(2.0)
    assert sure_and_wrong.log_loss == pytest.approx(-math.log(1e-4))


@pytest.mark.parametrize("n", [len(CATALOGUE), 3])
def test_there_are_as_many_hypotheses_as_effects_pairs_and_verdicts(n):
    told = single("edge_force", {"edge_force": 1.0}, n_effects=n)
    assert told.n_hypotheses == math.comb(n, 1) + math.comb(n, 2) + len(VERDICTS)


@pytest.mark.parametrize("name", [("a", "b"), frozenset({"b", "a"}), "a + b", "b + a"])
def test_a_pair_is_the_same_however_it_is_written(name):
    case = Case(name="p", kind="pair", effects={"a": 1.0, "b": 1.0}, probabilities={name: 0.8, "a": 0.2})
    assert case.answer == case.truth
    assert case.log_loss == pytest.approx(-math.log(0.8))


@pytest.mark.parametrize(
    "probabilities", [{"no_gap": 1.2}, {"no_gap": -0.1}, {"no_gap": math.nan}, {"no_gap": 0.7, "edge_force": 0.7}, {}]
)
def test_what_are_no_probabilities_is_refused(probabilities):
    with pytest.raises(InputError):
        single("edge_force", probabilities)


def several(probabilities):
    """Three hidden effects and an answer."""
    return Case(name="3", kind="several", effects=dict.fromkeys("abc", 1.0), probabilities=probabilities)


def test_rows_by_hand():
    cases = [
        single("edge_force", {"edge_force": 0.9, "no_gap": 0.1}, is_detectable=True),
        single(
            "edge_force",
            {"blade_wear": 0.6, "edge_force": 0.4},
            is_detectable=True,
            indistinguishable_from=["edge_force"],
        ),
        single("edge_force", {"blade_wear": 0.5, "no_gap": 0.2, "parameters": 0.2, "edge_force": 0.1}),
        single("edge_force", {"no_gap": 0.6, "edge_force": 0.4}, is_detectable=True),
        single("edge_force", {}, is_failed=True),
        single("edge_force", {"edge_force": 1.0}, severity=0.2, is_detectable=True),
        Case(name="n", kind="none", effects={}, probabilities={"no_gap": 1.0}),
        Case(name="m", kind="none", effects={}, probabilities={"edge_force": 0.6, "no_gap": 0.4}),
        Case(name="p", kind="parameters", effects={}, probabilities={"no_gap": 1.0}, largest_shift_sigmas=2.0),
        Case(name="q", kind="parameters", effects={}, probabilities={"no_gap": 1.0}, largest_shift_sigmas=6.0),
        Case(name="o", kind="outside", effects={"blade_whip": 1.0}, probabilities={"unknown": 1.0}),
        Case(name="g", kind="outside", effects={"grease_warming": 1.0}, probabilities={"unknown": 1.0}),
        Case(name="d", kind="outside", effects={"displacement_bow": 1.0}, probabilities={"edge_force": 1.0}),
        Case(name="r", kind="outside", effects={"blade_whip": 0.3}, probabilities={"no_gap": 1.0}),
        Case(name="s", kind="pair", effects={"a": 1.0, "b": 0.3}, probabilities={"a + b": 1.0}),
        Case(name="t", kind="pair", effects={"a": 1.0, "b": 1.0}, probabilities={"a": 1.0}),
        several({"a + b + c": 1.0}),
        several({"a + b + c + d": 1.0}),
        several({"a + d": 0.6, "a + b": 0.4}),
        several({"b + c": 1.0}),
        several({"unknown": 1.0}),
    ]
    found = score(cases)
    counted = {row.key: (row.value.hits, row.value.n) for row in found.rows}
    assert counted == {
        "exact": (1, 5),
        "group": (2, 5),
        "top_three": (3, 5),
        "declared": (3, 5),
        "declared_detectable": (2, 3),
        "declared_exact": (1, 3),
        "declared_group": (2, 3),
        "declared_top_three": (2, 3),
        "claims_exact": (4, 12),
        "false_alarms": (1, 4),
        "none": (1, 2),
        "parameters": (0, 2),
        "parameters_lenient": (1, 2),
        "unknown": (2, 4),
        "typical_unknown": (2, 3),
        "unknown_formless": (1, 2),
        "unknown_wrongly": (1, 17),
        "pair_both": (1, 2),
        "pair_group": (1, 2),
        "pair_one": (2, 2),
        "typical_pair_both": (0, 1),
        "detectable_pair_both": (0, 0),
        "several_exact": (1, 5),
        "several_all": (2, 5),
        "several_but_one": (3, 5),
        # No case of these says a place or a size, or has a faulty sensor.
        "false_alarms_spoilt": (0, 0),
        "where": (0, 0),
        "where_stated": (0, 0),
        "coherent": (0, 0),
    }
    assert found.n_failed == 1
    assert found.outside["blade_whip"].hits == 1
    # Answers of the five typical ones: once edge_force, and edge_force is the truth of all five.
    assert found.chance_exact == pytest.approx(1 / 5)
    assert [(one.low, one.exact, one.group, one.other_effect, one.not_declared) for one in found.severity] == [
        (0.1, 0, 0, 0, 0),
        (0.2, 1, 0, 0, 0),
        (0.35, 0, 0, 0, 0),
        (0.5, 0, 0, 0, 0),
        (0.7, 0, 0, 0, 0),
        (1.0, 1, 1, 1, 2),
        (1.4, 0, 0, 0, 0),
        (2.0, 0, 0, 0, 0),
    ]


def test_a_failed_answer_is_wrong_everywhere_and_has_a_column():
    failed = single("edge_force", {}, is_failed=True)
    assert failed.answer == FAILED
    assert (failed.brier, failed.probability_of(failed.truth)) == (2.0, 0.0)
    found = score([failed])
    table = found.confusion
    assert table.counts[table.rows.index("edge_force")][table.columns.index("failed")] == 1
    assert found.calibration.error.n == 0
    assert (found.failed, found.worst) == (("c",), ())


def test_the_confusion_matrix_holds_every_case_once():
    rng = np.random.default_rng(6)
    names = [*CATALOGUE, "no_gap", "parameters", "unknown", "edge_force + blade_wear"]
    truths = drawn(300)
    cases = [
        Case(name=str(k), kind=kind, effects=effects, probabilities={str(rng.choice(names)): 1.0})
        for k, (kind, effects, _) in enumerate(truths)
    ]
    for table in (score(cases).confusion, score(cases).families):
        assert sum(map(sum, table.counts)) == 300
    rows = dict(zip(score(cases).confusion.rows, score(cases).confusion.counts, strict=True))
    wanted = Counter("two effects" if " + " in name else name for _, _, name in truths)
    assert {name: sum(row) for name, row in rows.items() if sum(row)} == wanted


def test_gap_closed_is_held_against_the_oracle():
    stated = [(0.9, 0.8), (0.7, 0.9), (0.5, 0.5)]
    cases = [
        single(
            "edge_force", {"edge_force": 1.0}, gap_closed=a, gap_closed_ci95=(a - 0.15, a + 0.15), oracle_gap_closed=b
        )
        for a, b in stated
    ]
    gap = score(cases).gap
    assert gap is not None
    assert gap.error.value == pytest.approx((0.1 - 0.2 + 0.0) / 3)
    assert gap.absolute_error.value == pytest.approx(0.1)
    assert (gap.coverage.hits, gap.coverage.n) == (2, 3)
    assert score([single("edge_force", {"edge_force": 1.0}, gap_closed=0.9)]).gap is None


def test_a_perfect_answerer_is_perfect_and_at_chance_once_labels_are_shuffled():
    truths = drawn(1500)
    order = np.random.default_rng(7).permutation(len(truths))
    right = [Case(name=str(k), kind=k_, effects=e, probabilities={t: 1.0}) for k, (k_, e, t) in enumerate(truths)]
    dealt = [
        Case(name=str(k), kind=kind, effects=effects, probabilities={truths[j][2]: 1.0})
        for k, ((kind, effects, _), j) in enumerate(zip(truths, order, strict=True))
    ]
    best, shuffled = score(right), score(dealt)
    for key in ("exact", "group", "top_three", "declared_exact", "none", "parameters", "unknown", "pair_both"):
        assert best.row(key).share == 1.0
    assert (best.row("false_alarms").share, best.brier.value, best.log_loss.value) == (0.0, 0.0, 0.0)
    assert best.worst == ()
    # By the generator's shares: half of the answers name one effect, an eighth say "no gap", and so on.
    for key, chance in (
        ("exact", 0.5 / N_EFFECTS),
        ("declared", 0.6),
        ("false_alarms", 0.6),
        ("none", 0.125),
        ("parameters", 0.125),
        ("unknown", 0.15),
    ):
        row = shuffled.row(key)
        assert abs(row.share - chance) < 3.3 * math.sqrt(chance * (1 - chance) / row.n), key
    assert shuffled.chance_exact == pytest.approx(0.5 / N_EFFECTS, rel=0.35)
    assert shuffled.calibration.error.value > 0.85


def test_an_answerer_without_evidence_is_calibrated_and_names_nothing():
    prior = {"no_gap": 0.125, "parameters": 0.125, "unknown": 0.15} | dict.fromkeys(CATALOGUE, 0.5 / len(CATALOGUE))
    cases = [
        Case(name=str(k), kind=kind, effects=effects, probabilities=prior)
        for k, (kind, effects, _) in enumerate(drawn(1500))
    ]
    found = score(cases)
    assert found.row("exact").hits == 0
    assert found.row("unknown").share == 1.0
    assert found.calibration.error.value < 0.06
    entropy = (
        -2 * 0.125 * math.log(0.125)
        - 0.15 * math.log(0.15)
        - 0.5 * math.log(0.5 / N_EFFECTS)
        - 0.1 * math.log(0.1 / math.comb(N_EFFECTS, 2))
    )
    assert found.log_loss.value == pytest.approx(entropy, abs=0.1)


def test_the_worst_misses_come_first():
    cases = [
        single("edge_force", {"edge_force": p, "blade_wear": 1 - p}) for p in (0.9, 0.3, 0.01, 0.2)
    ]  # fmt: skip
    worst = score(cases).worst
    assert [miss.truth_probability for miss in worst] == pytest.approx([0.01, 0.2, 0.3])
    assert worst[0].answer == "blade_wear"
    assert worst[0].probabilities[0] == ("blade_wear", pytest.approx(0.99))


LABEL = {
    "kind": "effect",
    "truth": {"effects": {"edge_force": 1.5}, "shifts": {"resistance_ohm": -1.5, "crank_radius_m": 1}},
}
REPORT = {
    "verdict": "effect",
    "causes": [
        {
            "effects": ["edge_force"], "indistinguishable_from": ["cutting_speed_exponent"], "probability": 0.8,
            "gap_closed": 0.9, "gap_closed_ci95": [0.8, 0.95],
        },
        {
            "effects": ["edge_force", "blade_wear"], "indistinguishable_from": [], "probability": 0.1,
            "gap_closed": 0.9, "gap_closed_ci95": [0.8, 0.95],
        },
    ],
    "probabilities": {"no_gap": 0.02, "parameters": 0.03, "unknown": 0.05},
}  # fmt: skip


def test_a_gap_report_becomes_a_case():
    case = case_of("case-1", LABEL, {"report": REPORT, "time_s": 12.5}, oracle_gap_closed=0.85)
    assert case.answer == case.truth == {"edge_force"}
    assert case.group == {"edge_force", "cutting_speed_exponent"}
    assert case.probability_of(hypothesis_of("blade_wear + edge_force")) == pytest.approx(0.1)
    assert (case.largest_shift_sigmas, case.time_s, case.gap_closed, case.oracle_gap_closed) == (1.5, 12.5, 0.9, 0.85)
    unknown = case_of("case-1", LABEL, {"report": REPORT | {"verdict": "unknown"}})
    assert unknown.answer == {"unknown"}
    assert unknown.group == frozenset()


@pytest.mark.parametrize(
    "report",
    [None, {}, {"verdict": "effect"}, REPORT | {"causes": []}, REPORT | {"probabilities": {"no_gap": 7.0}}],
)
def test_no_report_or_half_a_report_is_a_failed_answer(report):
    assert case_of("case-1", LABEL, {"report": report}).is_failed


def test_the_place_is_right_where_a_hidden_effect_acts():
    def reported(label: dict, *shares: tuple[str, float]) -> Case:
        where = [{"equation": equation, "share": share} for equation, share in shares]
        return case_of("c", label, {"report": REPORT | {"where": where}})

    assert reported(LABEL, ("supply", 0.3), ("cutting", 0.6)).place == "cutting"
    battery = {"kind": "effect", "truth": {"effects": {"battery_internal_resistance": 1.0}}}
    cases = [
        reported(LABEL, ("supply", 0.3), ("cutting", 0.6)),
        reported(battery, ("cutting", 0.46), ("supply", 0.4)),
        reported(battery, ("supply", 0.9)),
        reported(battery),
        case_of("c", battery, {"report": None}),
        # Too small to count, and nothing hidden at all.
        reported({"kind": "effect", "truth": {"effects": {"edge_force": 0.2}}}, ("cutting", 1.0)),
        reported({"kind": "none", "truth": {"effects": {}}}, ("cutting", 1.0)),
        # Either of two effects will do.
        reported({"kind": "pair", "truth": {"effects": {"edge_force": 1.0, "converter_loss": 1.0}}}, ("supply", 1.0)),
    ]
    found = score(cases)
    where, stated = found.row("where"), found.row("where_stated")
    assert (where.hits, where.n) == (3, 6)
    assert (stated.hits, stated.n) == (3, 4)


def test_an_effect_that_the_report_calls_undetectable_is_not_missed():
    detail = {"log_odds_at_typical_size": {"edge_force": 4.0}, "detection_limit_log_odds": 9.0}
    silent = {"verdict": "no_gap", "causes": [], "probabilities": {"no_gap": 1.0}, "detail": detail}

    def told(severity, report):
        label = {"kind": "effect", "truth": {"effects": {"edge_force": severity}}}
        return case_of("c", label, {"report": report})

    cases = [told(1.0, silent), told(1.6, silent), told(1.6, silent | {"detail": {}})]
    assert [case.is_detectable for case in cases] == [False, True, None]
    found = score(cases)
    assert found.row("declared").n == 3
    assert (found.row("declared_detectable").hits, found.row("declared_detectable").n) == (0, 1)


def test_of_two_effects_the_weaker_one_says_whether_they_show():
    detail = {"log_odds_at_typical_size": {"edge_force": 4.0, "converter_loss": 90.0}, "detection_limit_log_odds": 9.0}
    silent = {"verdict": "no_gap", "causes": [], "probabilities": {"no_gap": 1.0}, "detail": detail}

    def told(**effects):
        return case_of("c", {"kind": "pair", "truth": {"effects": effects}}, {"report": silent})

    cases = [told(edge_force=1.0, converter_loss=1.0), told(edge_force=1.6, converter_loss=1.0)]
    cases.append(told(edge_force=1.6, grain_variation=1.0))
    assert [case.is_detectable for case in cases] == [False, True, None]
    found = score(cases).row("detectable_pair_both")
    assert (found.hits, found.n) == (0, 1)


def test_every_effect_acts_in_equations_of_the_report():
    assert set(ACTS_IN) == set(CATALOGUE) | set(OUTSIDE)
    assert set().union(*ACTS_IN.values()) == {"electrical", "mechanical", "cutting", "supply", "sensing"}
    assert all(ACTS_IN.values())


@pytest.mark.parametrize(
    ("effect", "number", "interval", "more", "is_right"),
    [
        ("edge_force", ("force_n", 35.0, 2.0), (0.5, 0.7), {}, True),
        ("edge_force", ("force_n", 3.0, 2.0), (0.5, 0.7), {}, False),
        ("edge_force", ("force_n", 35.0, 2.0), (-0.23, 0.03), {}, False),
        ("force_offset_drift", ("drift_n_per_1000_s", 0.7, 2.2), (-0.23, 0.03), {}, False),
        ("force_offset_drift", ("drift_n_per_1000_s", -9.0, 1.0), (0.2, 0.3), {}, True),
        # An exponent of 1 is no effect; 0.9 is not 1, and 0.1 of 0.04 from it not enough.
        ("cutting_speed_exponent", ("exponent", 0.97, 0.04), (0.2, 0.3), {}, False),
        ("cutting_speed_exponent", ("exponent", 0.60, 0.04), (0.2, 0.3), {}, True),
        ("grain_variation", ("depth", 0.1, 0.2), (-0.1, 0.1), {"carried_by_strokes": "waves of 4 mm"}, True),
    ],
)
def test_a_claim_agrees_with_itself_or_not(effect, number, interval, more, is_right):
    name, value, std = number
    cause = {
        "effects": [effect], "indistinguishable_from": [], "probability": 0.9, "gap_closed": np.mean(interval),
        "gap_closed_ci95": interval, "parameters": {name: {"value": value, "std": std, "unit": "N"}}, **more,
    }  # fmt: skip
    case = case_of("c", LABEL, {"report": REPORT | {"causes": [cause], "probabilities": {"no_gap": 0.1}}})
    row = score([case]).row("coherent")
    assert (row.hits, row.n) == (int(is_right), 1)


def test_a_claim_without_a_size_does_not_agree_with_itself_and_no_claim_is_not_asked():
    assert case_of("c", LABEL, {"report": REPORT}).is_coherent is False
    assert case_of("c", LABEL, {"report": REPORT | {"verdict": "unknown"}}).is_coherent is None


def test_runtimes_are_held_against_the_measured_one():
    def told(**runtimes: float) -> Case:
        return case_of("c", LABEL, {"report": REPORT | {"gap": {"runtime_s": runtimes}}})

    cases = [
        told(nominal=1044.0, retuned=1010.0, with_effect=1003.0, measured=1000.0),
        told(nominal=950.0, with_effect=1001.0, measured=1000.0),
        told(nominal=1.0, measured=0.0),
        told(),
    ]
    runtime = score(cases).runtime
    assert (runtime.nominal.n, runtime.nominal.value) == (2, pytest.approx((0.044 + 0.05) / 2))
    assert (runtime.retuned.n, runtime.retuned.value) == (1, pytest.approx(0.01))
    assert runtime.with_effect.value == pytest.approx(0.002)


def foreign(noise: float, nuisances: dict, **more) -> dict:
    return {
        "benches": "foreign", "rate_hz": 1500.0, "bench": {"noise_factor": noise}, "nuisances": nuisances,
        "trials": [{}] * 6, "effects": {"edge_force": 1.0}, **more,
    }  # fmt: skip


def test_labels_are_sorted_into_kinds_of_benches():
    old = shifts_of({"rate_hz": 5000.0, "effects": {}})
    assert (old["machine"], old["noise"], old["trials"], old["hum"]) == (
        "the paper's jigsaw", "0.7 to 1.5", "13 to 24", "without",
    )  # fmt: skip
    new = shifts_of(foreign(3.0, {"hum": {}, "jitter": {}, "spikes": {}}))
    assert new["machine"] == "another jigsaw"
    assert (new["noise"], new["sample rate"], new["trials"]) == ("1.5 to 4", "1 to 2.5 kHz", "6 to 12")
    assert (new["faults of sensors"], new["hum"], new["jitter"], new["bursts"]) == (
        "3 or more", "with", "with", "without",
    )  # fmt: skip
    assert shifts_of(foreign(1.0, {}, without=["machine"]))["machine"] == "the paper's jigsaw"


def test_every_row_is_split_by_the_kind_of_bench():
    wrong = REPORT | {"causes": [REPORT["causes"][0] | {"effects": ["blade_wear"]}]}
    labels = [({"kind": "effect", "truth": foreign(noise, {})}, noise) for noise in (0.4, 0.5, 3.0)]
    intact = {"kind": "none", "truth": foreign(3.0, {"hum": {}}, effects={})}
    cases = [case_of("c", label, {"report": wrong if noise > 1.0 else REPORT}) for label, noise in labels]
    found = score([*cases, case_of("n", intact, {"report": REPORT})])
    split = {(one.shift, one.value): one for one in found.by_shift}
    assert {shift for shift, _ in split} == {"noise", "faults of sensors", "hum"}
    rows = {value: {row.key: row.value for row in split["noise", value].rows} for value in ("0.3 to 0.7", "1.5 to 4")}
    assert (rows["0.3 to 0.7"]["exact"].hits, rows["0.3 to 0.7"]["exact"].n) == (2, 2)
    assert (rows["1.5 to 4"]["exact"].hits, rows["1.5 to 4"]["exact"].n) == (0, 1)
    assert sum(one.n_cases for (shift, _), one in split.items() if shift == "noise") == 4
    assert (found.row("false_alarms_spoilt").hits, found.row("false_alarms_spoilt").n) == (1, 1)
    assert score(cases[:2]).by_shift == ()


def test_an_effect_that_the_catalogue_at_hand_lists_counts_as_one_of_it():
    label = {"kind": "outside", "truth": {"effects": {"cogging_torque": 1.0}}}
    report = REPORT | {"causes": [REPORT["causes"][0] | {"effects": ["cogging_torque"]}]}
    listed = case_of("c", label, {"report": report}, catalogue=[*CATALOGUE, "cogging_torque"])
    assert (listed.kind, listed.answer == listed.truth, listed.n_effects) == ("effect", True, N_EFFECTS + 1)
    table = score([listed]).confusion
    assert table.counts[table.rows.index("cogging_torque")][table.columns.index("cogging_torque")] == 1
    assert sum(map(sum, score([listed]).families.counts)) == 1
    strange = case_of("c", label, {"report": report}, catalogue=[*CATALOGUE])
    assert strange.truth == {"unknown"}


def test_every_form_that_the_diagnosis_has_beyond_its_catalogue_is_accounted_for():
    forms = {
        "nonlinear displacement sensor": "displacement_bow",
        "friction that falls as the machine warms up": "grease_warming",
        "voltage ramp at every start": "soft_start",
        "force that reads something else too": "current_crosstalk",
    }
    assert forms.keys() < {effect.name for effect in BEYOND_CATALOGUE}
    assert set(forms.values()) < LOOKED_FOR_OUTSIDE < set(OUTSIDE)
