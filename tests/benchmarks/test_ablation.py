from benchmarks import ablation
from benchmarks.development_campaigns import truth

EDGE = {"kind": "effect", "effects": {"edge_force": 1.0}}
INTACT = {"kind": "none", "effects": {}}


def test_every_kind_of_campaign_stands_on_both_kinds_of_benches():
    rows = ablation.rows(48)
    assert {(row["kind"], row["benches"]) for row in rows} == {
        (kind, benches)
        for kind in ("none", "parameters", "effect", "pair", "outside")
        for benches in ("own", "foreign")
    }
    assert len({row["seed"] for row in rows}) == 48


def test_the_table_counts_right_answers_claims_and_accusations():
    answers = {
        ablation.AS_IT_IS: ({"edge_force": 0.9, "no_gap": 0.1}, {"no_gap": 0.7, "edge_force": 0.3}),
        "without": ({"edge_force": 0.6, "no_gap": 0.4}, {"edge_force": 0.8, "no_gap": 0.2}),
    }
    found = [
        {**row, "answers": {words: said[k] for words, said in answers.items()}} for k, row in enumerate((EDGE, INTACT))
    ]
    _, usual, without = ablation.table(found)
    # right, claims, of them right, accused "n of m"
    assert usual.removeprefix(ablation.AS_IT_IS).split()[:6] == ["2", "1", "1", "0", "of", "1"]
    assert without.removeprefix("without").split()[:6] == ["1", "2", "1", "1", "of", "1"]
    assert truth(EDGE) == "edge_force"


def test_every_ablation_changes_one_topic_of_the_settings():
    usual = ablation.ABLATIONS[ablation.AS_IT_IS]
    for words, settings in (ablation.ABLATIONS | ablation.NOISES).items():
        changed = [t for t in ("weights", "noise", "forms", "strokes") if getattr(settings, t) != getattr(usual, t)]
        assert len(changed) == (words != ablation.AS_IT_IS), words
