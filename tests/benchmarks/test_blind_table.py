"""Counts of several sealed sets are summed, and everything else is given for each set."""

from __future__ import annotations

import json

import pytest

from benchmarks import blind_table

pytestmark = pytest.mark.unit


def score(hits, n, *, error, kinds=("hum", "with")):
    """Scores of claims that all state 80 %."""
    of_cases = {"stated": [0.8] * n, "is_correct": [True] * hits + [False] * (n - hits)}
    rows = [{"key": key, "value": {"hits": hits, "n": n}} for key in blind_table.ROWS]
    estimate = {"value": error}
    return {
        "rows": rows,
        "by_shift": [{"shift": kinds[0], "value": kinds[1], "n_cases": n, "rows": rows}],
        "parameters": {"coverage": {"hits": hits, "n": n}, "relative_error": estimate},
        "calibration_of_claims": {"error": estimate, "error_by_chance": 0.05, **of_cases},
        "calibration": {"error": estimate, "error_by_chance": 0.06, **of_cases},
        "runtime": {"nominal": estimate, "retuned": estimate, "with_effect": estimate},
    }


def test_sets_of_one_column_are_counted_together():
    lines = blind_table.result_table({"foreign": [score(9, 10, error=0.04), score(81, 90, error=0.02)]})
    (row,) = [line for line in lines if "exactly correct" in line]
    # Wilson's interval of 90 of 100.
    assert "90 of 100, 90 % (83 to 94)" in row
    (row,) = [line for line in lines if "median error" in line]
    assert "4.0 % and 2.0 %" in row


def test_the_calibration_error_of_sets_together_is_that_of_all_their_cases():
    """One set is right too seldom, the other too often, both by a fifth: together they are right as often as stated."""
    too_few, too_many = score(3, 5, error=0.2), score(5, 5, error=0.2)
    lines = blind_table.result_table({"both": [too_few, too_many], "one": [too_few]})
    (row,) = [line for line in lines if "all sets together" in line]
    _, _, both, one, _ = row.split("|")
    assert both.startswith(" 0.000, 0.000")
    assert one.startswith(" 0.200, 0.200")
    (row,) = [line for line in lines if "the same, each set" in line]
    assert "0.200, 0.200 (0.050 and 0.060 by chance) and 0.200, 0.200" in row


def test_a_set_without_claims_has_no_medians():
    none = {"value": None}
    intact = score(0, 0, error=0.1) | {
        "parameters": {"coverage": {"hits": 0, "n": 0}, "relative_error": none},
        "runtime": {"nominal": none, "retuned": none, "with_effect": none},
    }
    lines = blind_table.result_table({"intact": [intact, score(9, 10, error=0.04)]})
    for words, cells in (("median error", "- % and 4.0 %"), ("median runtime", "-, -, - % and 4.0, 4.0, 4.0 %")):
        (row,) = [line for line in lines if words in line]
        assert row.endswith(f"| {cells} |")


def test_what_was_not_drawn_has_no_share():
    (row,) = [line for line in blind_table.result_table({"own": [score(0, 0, error=0.1)]}) if "consistent" in line]
    assert "none drawn" in row


def test_kinds_of_benches_are_counted_over_all_sets():
    lines = blind_table.kinds_table(
        [score(1, 2, error=0.1), score(2, 3, error=0.1), score(4, 4, error=0.1, kinds=("hum", "without"))]
    )
    assert [line.split("|")[1:4] for line in lines[2:]] == [
        [" hum: with ", " 5 ", " 3/5 "],
        [" hum: without ", " 4 ", " 4/4 "],
    ]


def test_the_command_reads_the_files_of_the_score(tmp_path, capsys):
    paths = []
    for number, hits in enumerate((3, 4)):
        path = tmp_path / f"set{number}.json"
        path.write_text(json.dumps({"score": score(hits, 5, error=0.03)}), encoding="utf-8")
        paths.append(str(path))
    blind_table.main([f"foreign={','.join(paths)}"])
    assert "7 of 10, 70 %" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        blind_table.main(["foreign"])
    assert "NAME=SCORE.json" in capsys.readouterr().err
