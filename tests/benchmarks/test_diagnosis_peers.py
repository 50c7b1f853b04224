"""Plumbing of the peers: features, dictionary, votes, probabilities; no trained model and no heavy library."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.blindcheck.scored_case import Case

from benchmarks.diagnosis_peers import (
    bic,
    cases,
    forest,
    hypotheses,
    isolability,
    page,
    sparse,
    table,
    terms,
    vector,
)

pytestmark = pytest.mark.unit

NAMES = ("resistance_ohm", "k_fc of oak", "guide_friction/0", "edge_force/0", "gear_eccentricity/0",
         "gear_eccentricity/1", "nameless cutting/0/1")  # fmt: skip


def dictionary(truth, *, noise=1.0, size=30.0, seed=0):
    """Terms with random columns and a residual made of some of them."""
    rng = np.random.default_rng(seed)
    columns = size * rng.standard_normal((400, len(NAMES)))
    data = noise * rng.standard_normal(400)
    for name, amount in truth.items():
        data = data + amount * columns[:, NAMES.index(name)]
    rows = np.column_stack([data, columns])
    return terms.Terms(names=NAMES, gram=rows.T @ rows, rows=rows / size, n_samples=400)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A short campaign with one effect, reduced."""
    from sawbench.blindcheck.campaign import make_campaign

    from benchmarks.diagnosis_peers.reduction import read_campaign, reduce

    folder = tmp_path_factory.mktemp("peers") / "case"
    make_campaign(31, folder, effects={"motor_coulomb_friction": 1.5}, length=0.3, rate_hz=2500.0)
    return reduce(*read_campaign(folder))


class TestHypotheses:
    def test_prior_covers_every_hypothesis_once(self):
        prior = hypotheses.log_prior()
        assert len(prior) == len(CATALOGUE) + len(CATALOGUE) * (len(CATALOGUE) - 1) // 2 + 3
        assert np.exp(list(prior.values())).sum() == pytest.approx(1.0)

    def test_effects_are_those_of_the_catalogue(self):
        assert set(hypotheses.EFFECTS) == set(CATALOGUE)

    def test_pair_class_goes_to_pairs_of_likely_effects(self):
        by_class = np.zeros(len(hypotheses.CLASSES))
        for name, share in (("edge_force", 0.3), ("blade_wear", 0.2), (hypotheses.PAIR, 0.5)):
            by_class[hypotheses.CLASSES.index(name)] = share
        found = hypotheses.spread_pairs(by_class)
        assert found["blade_wear + edge_force"] == pytest.approx(0.5, abs=1e-6)
        assert found["edge_force"] == pytest.approx(0.3, abs=1e-6)

    def test_group_holds_nearly_as_probable_effects_only(self):
        said = {"edge_force": 0.5, "blade_wear": 0.2, "guide_friction": 0.05}
        assert hypotheses.indistinguishable(said) == ("blade_wear",)
        assert hypotheses.indistinguishable({"no_gap": 0.6, "edge_force": 0.4}) == ()

    def test_what_is_left_out_does_not_make_probabilities_exceed_one(self):
        scores = {f"h{k}": -0.01 * k for k in range(300)}
        assert sum(hypotheses.normalised(scores).values()) < 1.0


class TestBic:
    @pytest.mark.parametrize(
        ("truth", "expected"),
        [
            ({}, "no_gap"),
            ({"resistance_ohm": 40.0}, "parameters"),
            ({"guide_friction/0": 1.0, "k_fc of oak": 2.0}, "guide_friction"),
            ({"gear_eccentricity/0": 0.7, "gear_eccentricity/1": -0.7}, "gear_eccentricity"),
            ({"guide_friction/0": 1.0, "edge_force/0": 1.0}, "edge_force + guide_friction"),
        ],
    )
    def test_finds_what_made_the_residual(self, truth, expected):
        found = bic.bic_probabilities(dictionary(truth), bic.BicSettings())
        assert max(found, key=found.get) == expected

    def test_an_effect_cannot_be_subtracted(self):
        found = bic.bic_probabilities(dictionary({"guide_friction/0": -1.0}), bic.BicSettings())
        assert max(found, key=found.get) != "guide_friction"

    def test_nameless_terms_count_as_unknown_where_they_compete(self):
        made = dictionary({"nameless cutting/0/1": 1.0})
        with_unknown = bic.bic_probabilities(made, bic.BicSettings(has_unknown=True))
        assert max(with_unknown, key=with_unknown.get) == "unknown"
        without = bic.bic_probabilities(made, bic.BicSettings(has_unknown=False))
        assert without["unknown"] == pytest.approx(hypotheses.PRIOR["unknown"])

    def test_probabilities_are_those_of_a_case(self):
        found = bic.bic_probabilities(dictionary({"edge_force/0": 1.0}), bic.BicSettings())
        case = Case(name="x", kind="effect", effects={"edge_force": 1.0}, probabilities=found)
        assert case.answer == case.truth


class TestSparseVotes:
    def made(self, truth, coefficients):
        return sparse.contributions(dictionary(truth), np.array([coefficients] * 3, dtype=float))

    @pytest.mark.parametrize(
        ("coefficients", "expected"),
        [
            ([0.5, 9.0, 0, 0, 0, 0, 0], "no_gap"),
            ([5.0, 9.0, 0, 0, 0, 0, 0], "parameters"),
            ([5.0, 0, 1.0, 0, 0, 0, 0], "guide_friction"),
            ([0, 0, -1.0, 0, 0, 0, 0], "no_gap"),
            ([0, 0, 1.0, 0.9, 0, 0, 0], "edge_force + guide_friction"),
            ([0, 0, 0.1, 0, 0, 0, 2.0], "unknown"),
        ],
    )
    def test_a_model_votes_for_what_it_is_made_of(self, coefficients, expected):
        assert sparse.votes(self.made({}, coefficients), 0.01, 3.0) == Counter({expected: 3})

    def test_prior_votes_pull_towards_the_shares_of_a_set(self):
        counted = Counter({"edge_force": 20})
        sure = sparse.vote_probabilities(counted, 0.1)["edge_force"]
        unsure = sparse.vote_probabilities(counted, 20.0)["edge_force"]
        assert sure > 0.98
        assert unsure == pytest.approx(0.5 * (1.0 + 0.5 / len(CATALOGUE)), rel=1e-6)


class TestReduction:
    def test_vector_has_the_length_that_the_layout_gives(self, campaign):
        found = vector.feature_vector(campaign)
        per_stroke, start_up = 25 + 17 + 65 + 9 + 13, 3 * 14
        shared = len(campaign.problem.campaign.plant.nuisances())
        assert len(found) == 8 * per_stroke + 2 * (2 * per_stroke + start_up) + per_stroke + shared + 5 + 3
        assert np.isfinite(found).all()

    def test_operating_points_are_ranked_within_the_campaign(self, campaign):
        settings = [p.setting for p in campaign.problem.parts if p.state.kind == "running"]
        found = Counter(vector.operating_classes(settings).values())
        assert found == Counter(
            {"idle low": 1, "idle middle": 2, "idle high": 1, "cut low": 3, "cut middle": 4, "cut high": 3,
             "other feed": 2, "other stock": 2}
        )  # fmt: skip

    def test_noise_of_the_samples_is_found(self, campaign):
        from sawbench.blindcheck.drawing import draw_campaign

        force_n = draw_campaign(31, effects={"motor_coulomb_friction": 1.5}).sensors.noise[0]
        assert campaign.noise["force_n"] == pytest.approx(force_n, rel=0.1)

    def test_naive_noise_shrinks_with_the_number_of_samples(self, campaign):
        from benchmarks.diagnosis_peers.reduction import naive_std

        part = next(p for p in campaign.problem.parts if p.state.kind == "running")
        period_s = 2 * np.pi / part.state.speed_rad_s.mean()
        n = ((part.blocks > 0) @ part.state.n_strokes)[0] * period_s * campaign.rate_hz
        place = part.layout.slices["cutting"]
        expected = campaign.noise["force_n"] / np.sqrt(n)
        assert naive_std(campaign, part)[0, place.start] == pytest.approx(expected)

    def test_features_come_back_from_a_file(self, campaign, tmp_path):
        kept = cases.CaseFeatures(
            vector=vector.feature_vector(campaign), vector_time_s=1.5, terms=dictionary({}), terms_time_s=2.5
        )
        cases.save(tmp_path / "case-0001.npz", kept)
        found = cases.load(tmp_path / "case-0001.npz")
        assert np.array_equal(found.vector, kept.vector)
        assert found.terms.names == NAMES
        assert np.array_equal(found.terms.gram, kept.terms.gram)
        assert found.terms_time_s == 2.5


class TestIsolability:
    def test_signatures_of_a_campaign(self, campaign):
        from sawbench.diagnosis.inference.columns import catalogue_columns
        from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

        chosen = [EFFECT_BY_NAME[name] for name in ("brush_voltage_drop", "converter_diode_drop", "converter_loss")]
        found = isolability.computed_isolability(campaign.problem, catalogue_columns(campaign.problem, chosen))
        brush, diode, loss = (hypotheses.EFFECTS.index(effect.name) for effect in chosen)
        assert found.cosine[brush, diode] > 0.9 > found.cosine[brush, loss]
        assert np.all(found.distance[[brush, diode, loss], [brush, diode, loss]] >= found.distance[brush, diode])
        assert np.isnan(found.cosine[brush, hypotheses.EFFECTS.index("edge_force")])

    def test_every_effect_stands_in_one_equation_of_the_structure(self):
        found = [effect for _, effects in isolability.EQUATIONS.values() for effect in effects]
        assert sorted(found) == sorted(hypotheses.EFFECTS)


class TestSets:
    def test_training_on_seeds_of_claims_is_refused(self, tmp_path):
        with pytest.raises(InputError, match="allowed for training is 1 to 999"):
            cases.develop(1000, 1, tmp_path)

    def test_classes_that_never_occurred_keep_a_little(self):
        found = forest.whole(np.array([[0.25, 0.75]]), [3, 5])
        assert found.sum() == pytest.approx(1.0)
        assert found[0, 5] > found[0, 3] > found[0, 0] > 0

    def test_sharpening_keeps_the_order_and_the_sum(self):
        found = forest.sharpened(np.array([[0.5, 0.3, 0.2]]), 2.0)[0]
        assert found == pytest.approx(np.array([0.25, 0.09, 0.04]) / 0.38)

    def test_a_case_without_an_answer_has_failed(self):
        labels = {
            "a": {"kind": "none", "truth": {"effects": {}}},
            "b": {"kind": "effect", "truth": {"effects": {"edge_force": 1.0}}},
        }
        answers = {"b": {"probabilities": {"edge_force": 0.9}, "indistinguishable_from": [], "time_s": 2.0}}
        first, second = table.peer_cases(labels, answers)
        assert first.is_failed
        assert second.answer == second.truth

    def test_page_marks_the_best_of_a_row(self):
        from sawbench.blindcheck.scoring import score

        told = {"kind": "effect", "effects": {"edge_force": 1.0}}
        right = score([Case(name="a", **told, probabilities={"edge_force": 0.9})])
        wrong = score([Case(name="a", **told, probabilities={"blade_wear": 0.9})])
        about = {"n_cases": 1, "n_in_set": 1, "seed": 7, "options": {}, "version": "0", "commit": "abc",
                 "is_dirty": False, "date": "2026-01-01", "training": {}}  # fmt: skip
        text = page.page({"left": wrong, "right": right}, about, None)
        line = next(line for line in text.splitlines() if line.startswith("| exact effect, typical single effects |"))
        assert line.count("**") == 2
        assert line.split(" | ")[2].startswith("**100 %")
        assert "a seed for tuning" in text
