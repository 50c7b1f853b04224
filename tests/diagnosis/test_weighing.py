"""Probabilities are a distribution, follow the evidence, and leave room for what nobody thought of."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.inference.hypothesis import OTHERS, Hypothesis, named
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.weighing import odds_of_further, weigh, weigh_further

pytestmark = pytest.mark.unit

N_EFFECTS = 29
WEIGHTS = SETTINGS.weights
# Log evidence that pays for the choice of one effect among all.
CHOICE = np.log(N_EFFECTS)
# The same in mean strokes, where the likeliest of all gains something where none is there.
EVEN = CHOICE + WEIGHTS.gained_by_none
NAMES = ("blade_wear", "edge_force", "guide_friction")
PAIR = " + ".join(NAMES[:2])


def probabilities(log_evidence, left_over, *, shared=1.0):
    """By name, most likely first."""
    hypotheses = [
        named(name, value, left_over=left_over.get(name, np.inf), shared=shared) for name, value in log_evidence.items()
    ]
    return {h.name: h.probability for h in weigh(hypotheses, n_effects=N_EFFECTS)}


def weighed(evidence=None, left=None, *, nominal_left=10.0, unknown=-1.0):
    """All names with nothing to say, but for those that are given."""
    log_evidence = {"no_gap": 0.0, "parameters": -0.6, "unknown": unknown} | dict.fromkeys((*NAMES, PAIR), -0.4)
    log_evidence |= evidence or {}
    left_over = dict.fromkeys(log_evidence, nominal_left)
    return probabilities(log_evidence, left_over | (left or {}))


def first(found):
    return next(iter(found))


def test_probabilities_sum_to_one_and_come_in_order():
    rng = np.random.default_rng(4)
    for _ in range(50):
        evidence = dict(zip((*NAMES, PAIR, "parameters"), rng.normal(0, 60, 5), strict=True))
        left = dict(zip((*NAMES, PAIR), rng.uniform(0, 20, 4), strict=True))
        found = weighed(evidence, left, nominal_left=20.0, unknown=rng.normal(0, 60))
        values = list(found.values())
        assert sum(values) == pytest.approx(1.0)
        assert values == sorted(values, reverse=True)
        assert min(values) >= 0.0
        assert set(found) == {"no_gap", "parameters", "unknown", *NAMES, PAIR}


def test_without_evidence_nothing_is_wrong():
    quiet = dict.fromkeys(("no_gap", "parameters", *NAMES, PAIR), WEIGHTS.quiet)
    assert first(weighed({}, quiet)) == "no_gap"


def test_what_the_likeliest_effect_has_on_a_machine_without_any_names_none():
    """Of mean strokes; a few nats more do, and those of single strokes from the first on."""
    quiet = dict.fromkeys(("no_gap", "parameters", *NAMES, PAIR), WEIGHTS.quiet)
    assert first(weighed({"edge_force": WEIGHTS.gained_by_none}, quiet)) == "no_gap"
    assert first(weighed({"edge_force": WEIGHTS.gained_by_none + 2.0 * CHOICE}, quiet)) == "edge_force"
    others = [named(name, 0.0, left_over=WEIGHTS.quiet) for name in ("no_gap", "parameters", "unknown")]
    evidence = WEIGHTS.gained_by_none + 0.5 * CHOICE
    for of_strokes, expected in ((0.0, "no_gap"), (evidence, "blade_wear")):
        worn = Hypothesis(
            effects=("blade_wear",), log_evidence=evidence, left_over=WEIGHTS.quiet, of_strokes=of_strokes
        )
        assert weigh([*others, worn], n_effects=N_EFFECTS)[0].name == expected


def test_a_strong_effect_that_leaves_little_is_named():
    found = weighed({"edge_force": 80.0}, {"edge_force": WEIGHTS.quiet, PAIR: WEIGHTS.quiet})
    assert first(found) == "edge_force"
    assert found["edge_force"] > 0.9


def test_a_strong_effect_that_leaves_more_of_the_gap_than_it_explains_is_not_believed():
    assert first(weighed({"edge_force": 80.0}, {"edge_force": 6.0})) == "unknown"
    assert first(weighed({"edge_force": 80.0}, {"edge_force": 4.0})) == "edge_force"


def test_the_odds_of_unknown_are_what_is_left_over_what_is_explained():
    found = weighed({"edge_force": 80.0}, {"edge_force": 60.0}, nominal_left=100.0)
    assert found["unknown"] / found["edge_force"] == pytest.approx(60.0 / 40.0, rel=0.01)


def test_what_is_left_makes_unknown_more_likely_step_by_step():
    shares = [weighed({"edge_force": 80.0}, {"edge_force": left})["unknown"] for left in (0.2, 1.0, 2.0, 4.0, 8.0)]
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert shares[-1] > 0.5, "four fifths of the gap are left"


def test_a_small_gap_is_not_unknown_for_what_an_intact_machine_leaves():
    quiet = 1.3 * WEIGHTS.quiet
    found = weighed({"edge_force": 20.0}, {"edge_force": quiet, "no_gap": 0.6, "parameters": 0.6})
    assert found["unknown"] < found["edge_force"]


def test_retuned_parameters_win_where_they_explain_it_all():
    quiet = {"parameters": WEIGHTS.quiet, "edge_force": WEIGHTS.quiet}
    assert first(weighed({"parameters": 60.0, "edge_force": 50.0}, quiet)) == "parameters"


def pair_odds(more, *, alone=80.0, shared=1.0):
    """Odds of the pair against its stronger member, for log evidence beside its own, `alone`."""
    log_evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -5.0, "edge_force": alone, "blade_wear": 1.0}
    log_evidence[PAIR] = log_evidence["edge_force"] + more
    left = dict.fromkeys(log_evidence, WEIGHTS.quiet) | {"no_gap": 10.0, "parameters": 10.0}
    found = probabilities(log_evidence, left, shared=shared)
    return found[PAIR] / found["edge_force"]


def test_what_a_second_effect_is_given_goes_to_the_one_that_has_evidence():
    """Also where a strong form may miss more than that, and another one, which adds nothing, acts elsewhere."""
    alone = 1400.0
    quiet = {"no_gap": 10.0, "parameters": 10.0}
    evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -5.0, "edge_force": alone}
    hypotheses = [named(name, value, left_over=quiet.get(name, WEIGHTS.quiet)) for name, value in evidence.items()]
    beside, elsewhere = PAIR, "edge_force + guide_friction"
    for name, more, shared in ((beside, 7.0, 1.0), (elsewhere, -3.0, 0.0)):
        hypotheses.append(named(name, alone + more, left_over=WEIGHTS.quiet, shared=shared))
    found = {h.name: h.probability for h in weigh(hypotheses, n_effects=N_EFFECTS)}
    assert found[beside] > 0.1
    assert found[elsewhere] < 0.01


def test_a_second_effect_pays_for_itself():
    """Hardly any evidence more names one; from there the pair gains with every step, but in e-folds, not in nats."""
    odds = [pair_odds(more) for more in (0.0, 5.0, 30.0, 200.0, 1000.0)]
    assert odds[0] < 0.1
    assert odds == sorted(odds)
    assert odds[-1] > 10.0
    assert pair_odds(2000.0) / pair_odds(1000.0) == pytest.approx(2.0)


def test_a_second_effect_that_is_not_believed_does_not_speak_for_the_first():
    log_evidence = {"no_gap": 0.0, "parameters": -10.0, "unknown": -10.0, "edge_force": 12.0, "blade_wear": 0.0}
    left = dict.fromkeys((*log_evidence, PAIR), WEIGHTS.quiet)
    without = probabilities(log_evidence, left)
    beside = probabilities(log_evidence | {PAIR: 12.0 + 0.5 * CHOICE}, left)
    assert beside["edge_force"] < 1.5 * without["edge_force"]


def test_the_form_of_a_stronger_effect_may_miss_more():
    assert pair_odds(100.0, alone=2000.0) < pair_odds(100.0, alone=20.0)


def test_a_second_effect_where_the_first_does_nothing_is_no_error_of_its_form():
    assert pair_odds(100.0, alone=2000.0, shared=0.0) > pair_odds(100.0, alone=2000.0, shared=0.5)
    assert pair_odds(100.0, alone=2000.0, shared=0.0) == pytest.approx(pair_odds(100.0, alone=20.0, shared=0.0))


def test_what_single_strokes_add_is_no_error_of_a_form():
    """Beside a strong effect a few nats of mean strokes say little, and make no more of those of single strokes."""
    pair, alone = PAIR.split(" + "), Hypothesis(effects=("edge_force",), log_evidence=2000.0)

    def odds(in_means, of_strokes):
        evidence = alone.log_evidence + in_means + of_strokes
        together = Hypothesis(effects=tuple(sorted(pair)), log_evidence=evidence, of_strokes=of_strokes)
        return odds_of_further(together, alone, N_EFFECTS)

    assert odds(0.0, 30.0) == pytest.approx(30.0 / CHOICE)
    assert odds(30.0, 0.0) == pytest.approx(30.0 / (EVEN + np.sqrt(2000.0)))
    assert odds(30.0, 0.5) == pytest.approx(odds(30.0, 0.0) + 0.5 / CHOICE)
    assert odds(-30.0, 30.0) == pytest.approx(0.0)


def test_two_effects_stand_against_all_others_with_all_their_evidence():
    """Unknown explains more than either effect alone, less than both."""
    log_evidence = {"no_gap": 0.0, "parameters": 0.0, "edge_force": 40.0, "blade_wear": 30.0}
    log_evidence |= {PAIR: 100.0, "unknown": 60.0}
    left = dict.fromkeys(log_evidence, 5.0) | {PAIR: WEIGHTS.quiet, "no_gap": 10.0}
    assert first(probabilities(log_evidence, left)) == PAIR


def test_a_pair_that_nobody_fitted_is_no_measure_of_what_is_left():
    """Its rest is unknown: `inf`; the best single effect still tells how much of the gap is explained."""
    found = weighed({"edge_force": 80.0, PAIR: 80.1}, {"edge_force": WEIGHTS.quiet, PAIR: np.inf})
    assert first(found) == "edge_force"
    assert np.isfinite(list(found.values())).all()


def three_effects(more):
    """Probabilities where a pair is sure and a third effect adds some evidence to it."""
    evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -5.0, **dict.fromkeys(NAMES, 100.0), PAIR: 700.0}
    three = " + ".join(NAMES)
    left = dict.fromkeys((*evidence, three), WEIGHTS.quiet) | {"no_gap": 10.0, "parameters": 10.0}
    found = probabilities(evidence | {three: 700.0 + more}, left)
    return found[PAIR], found[three]


def test_a_third_effect_pays_for_itself_as_a_second_one_does():
    without, with_nothing = three_effects(0.0)
    assert without > 0.9 > 0.1 > with_nothing
    pair, three = three_effects(2000.0)
    assert three > 10.0 * pair
    more = three_effects(4000.0)
    assert more[1] / more[0] == pytest.approx(2.0 * three / pair)


def beside_a_sure_pair(added, *, alone=0.0, shared=0.0, unknown=-5.0, left=WEIGHTS.quiet):
    """Probabilities of the pair alone, with a third effect that adds so much, and of "unknown"."""
    base = named(PAIR, alone, left_over=left)
    further = [named(" + ".join(NAMES), alone + added, left_over=left, shared=shared)]
    found = weigh_further(base, further, named("unknown", unknown), n_effects=N_EFFECTS, gap=10.0)
    return {h.name: h.probability for h in found}


def test_a_further_effect_beside_sure_ones_is_even_at_the_least_log_evidence_of_a_second_one():
    found = beside_a_sure_pair(EVEN)
    assert sum(found.values()) == pytest.approx(1.0)
    assert found[" + ".join(NAMES)] == pytest.approx(found[PAIR])
    assert beside_a_sure_pair(0.0)[" + ".join(NAMES)] < 0.01
    assert beside_a_sure_pair(10.0 * EVEN)[" + ".join(NAMES)] > 0.9


def test_a_further_effect_pays_for_what_the_forms_of_sure_ones_may_miss_where_it_acts():
    alone, common = 4800.0, 0.3
    even = EVEN + np.sqrt(common * alone)
    found = beside_a_sure_pair(even, alone=alone, shared=common)
    assert found[" + ".join(NAMES)] == pytest.approx(found[PAIR])
    elsewhere = beside_a_sure_pair(even, alone=alone, shared=0.0)
    assert elsewhere[" + ".join(NAMES)] > 3.0 * elsewhere[PAIR]


def test_what_sure_effects_leave_of_the_whole_gap_is_unknown_where_it_is_most_of_it():
    assert beside_a_sure_pair(0.0, left=9.0)["unknown"] > 0.8
    assert beside_a_sure_pair(0.0, left=1.0)["unknown"] < 0.2
    assert beside_a_sure_pair(0.0, unknown=30.0)["unknown"] > 0.99


def test_of_second_effects_one_elsewhere_ranks_before_one_that_may_mend_the_form_of_the_first():
    """Beside 40 000 nats in an equation shared by a third, chance adds 115 nats to whatever acts there."""
    strong, mends, elsewhere = NAMES
    evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -5.0, strong: 40_000.0, mends: 0.0, elsewhere: 0.0}
    hypotheses = [named(name, value, left_over=WEIGHTS.quiet) for name, value in evidence.items()]
    pairs = {
        other: named(f"{strong} + {other}", 40_000.0 + added, left_over=WEIGHTS.quiet, shared=shared)
        for other, added, shared in ((mends, 110.0, 1.0 / 3.0), (elsewhere, 90.0, 0.0))
    }
    found = {h.name: h.probability for h in weigh([*hypotheses, *pairs.values()], n_effects=N_EFFECTS)}
    assert found[pairs[elsewhere].name] > 0.8 > 0.1 > found[pairs[mends].name]


def answer_of(**probabilities):
    """Answer of a posterior; names of effects are joined by "_and_"."""
    hypotheses = [
        Hypothesis(other=name, log_evidence=0.0, probability=p) if name in OTHERS else
        Hypothesis(effects=tuple(name.split("_and_")), log_evidence=0.0, probability=p)
        for name, p in sorted(probabilities.items(), key=lambda one: -one[1])
    ]  # fmt: skip
    return Posterior(
        hypotheses=tuple(hypotheses), explanations=(), strokes={}, finding=None, unlisted={"": 0.0},
        dispersion=np.ones(1), little={}, freed=(),
    ).best.name  # fmt: skip


def test_an_effect_that_is_likelier_there_than_not_is_named():
    assert answer_of(unknown=0.45, clock=0.3, clock_and_teeth=0.25) == "clock"
    assert answer_of(unknown=0.4, clock_and_teeth=0.35, clock=0.25) == "clock + teeth"


def test_claims_that_have_no_effect_in_common_do_not_add_up():
    assert answer_of(unknown=0.4, clock=0.3, wear=0.3) == "unknown"
    assert answer_of(no_gap=0.4, clock=0.3, clock_and_teeth=0.19, unknown=0.11) == "no_gap"


def test_the_likeliest_claim_stays_the_answer():
    assert answer_of(clock_and_teeth=0.4, clock=0.35, unknown=0.25) == "clock + teeth"
