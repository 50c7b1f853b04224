"""The score counts what it says, gives intervals that the literature gives, and puts a guesser at chance."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from bench.errors import InputError
from blindcheck.effects.table import CATALOGUE, LOOKED_FOR_OUTSIDE, OUTSIDE
from blindcheck.score_statistics import calibration_error, calibration_of, mean_of, wilson
from blindcheck.scored_case import FAILED, N_HYPOTHESES, Case, case_of, hypothesis_of
from blindcheck.scoring import score
from blindcheck.sealing import draw_cases
from diagnosis.beyond_catalogue import BEYOND_CATALOGUE

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
    n_unlisted = N_HYPOTHESES - 1
    partly = single("blade_wear", {"edge_force": 0.5})
    each = 0.5 / n_unlisted
    assert partly.brier == pytest.approx(0.25 + (n_unlisted - 1) * each**2 + (1 - each) ** 2)
    assert partly.probability_of(hypothesis_of("blade_wear")) == pytest.approx(each)
    sure_and_wrong = single("blade_wear", {"edge_force": 1.0})
    assert sure_and_wrong.brier == pytest.approx(2.0)
    assert sure_and_wrong.log_loss == pytest.approx(-math.log(1e-4))


def test_there_are_as_many_hypotheses_as_effects_pairs_and_verdicts():
    n = len(CATALOGUE)
    assert math.comb(n, 1) + math.comb(n, 2) + 3 == N_HYPOTHESES


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


def test_rows_by_hand():
    cases = [
        single("edge_force", {"edge_force": 0.9, "no_gap": 0.1}),
        single("edge_force", {"blade_wear": 0.6, "edge_force": 0.4}, indistinguishable_from=["edge_force"]),
        single("edge_force", {"blade_wear": 0.5, "no_gap": 0.2, "parameters": 0.2, "edge_force": 0.1}),
        single("edge_force", {"no_gap": 0.6, "edge_force": 0.4}),
        single("edge_force", {}, is_failed=True),
        single("edge_force", {"edge_force": 1.0}, severity=0.2),
        Case(name="n", kind="none", effects={}, probabilities={"no_gap": 1.0}),
        Case(name="m", kind="none", effects={}, probabilities={"edge_force": 0.6, "no_gap": 0.4}),
        Case(name="p", kind="parameters", effects={}, probabilities={"no_gap": 1.0}, largest_shift_sigmas=2.0),
        Case(name="q", kind="parameters", effects={}, probabilities={"no_gap": 1.0}, largest_shift_sigmas=6.0),
        Case(name="o", kind="outside", effects={"blade_whip": 1.0}, probabilities={"unknown": 1.0}),
        Case(name="g", kind="outside", effects={"grease_warming": 1.0}, probabilities={"unknown": 1.0}),
        Case(name="d", kind="outside", effects={"displacement_bow": 1.0}, probabilities={"edge_force": 1.0}),
        Case(name="r", kind="outside", effects={"blade_whip": 1.0}, probabilities={"no_gap": 1.0}),
        Case(name="s", kind="pair", effects={"a": 1.0, "b": 0.3}, probabilities={"a + b": 1.0}),
        Case(name="t", kind="pair", effects={"a": 1.0, "b": 1.0}, probabilities={"a": 1.0}),
    ]
    found = score(cases)
    counted = {row.key: (row.value.hits, row.value.n) for row in found.rows}
    assert counted == {
        "exact": (1, 5),
        "group": (2, 5),
        "top_three": (3, 5),
        "declared": (3, 5),
        "declared_exact": (1, 3),
        "declared_group": (2, 3),
        "declared_top_three": (2, 3),
        "claims_exact": (3, 8),
        "false_alarms": (1, 4),
        "none": (1, 2),
        "parameters": (0, 2),
        "parameters_lenient": (1, 2),
        "unknown": (2, 4),
        "unknown_formless": (1, 2),
        "unknown_wrongly": (0, 12),
        "pair_both": (1, 2),
        "pair_group": (1, 2),
        "pair_one": (2, 2),
        "typical_pair_both": (0, 1),
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
    # By the generator's shares: half of the answers name one of 29 effects, an eighth say "no gap", and so on.
    for key, chance in (
        ("exact", 0.5 / 29),
        ("declared", 0.6),
        ("false_alarms", 0.6),
        ("none", 0.125),
        ("parameters", 0.125),
        ("unknown", 0.15),
    ):
        row = shuffled.row(key)
        assert abs(row.share - chance) < 3.3 * math.sqrt(chance * (1 - chance) / row.n), key
    assert shuffled.chance_exact == pytest.approx(0.5 / 29, rel=0.35)
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
        -2 * 0.125 * math.log(0.125) - 0.15 * math.log(0.15) - 0.5 * math.log(0.5 / 29) - 0.1 * math.log(0.1 / 406)
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


def test_the_score_shares_no_code_with_the_diagnosis():
    for name in ("scoring", "scored_case", "score_statistics", "answering"):
        text = (Path(__file__).parents[2] / "blindcheck" / f"{name}.py").read_text()
        assert "import diagnosis" not in text
        assert "from diagnosis" not in text


def test_every_form_that_the_diagnosis_has_beyond_its_catalogue_is_accounted_for():
    forms = {
        "bent displacement sensor": "displacement_bow",
        "friction that falls as the machine warms up": "grease_warming",
        "voltage that is ramped up at every start": "soft_start",
    }
    assert {forms[effect.name] for effect in BEYOND_CATALOGUE} < LOOKED_FOR_OUTSIDE < set(OUTSIDE)
