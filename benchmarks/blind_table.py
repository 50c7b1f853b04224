"""The tables of docs/blind_result.md, from the scores of sealed sets: sets of one kind of bench are counted together.

    sawbench blind score SET --key SET.key.json --out SET.html      # writes SET.json as well
    python -m benchmarks.blind_table "foreign=SET1.json,SET2.json" "own=SET3.json"

Counts are summed over the sets of a column, with Wilson intervals (95 %), and calibration errors are those of all their
cases. Medians are given for each set by itself. The second table counts the first column by kind of bench.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.blindcheck.score_statistics import calibration_of, wilson

Score = Mapping[str, Any]
ROWS: Final = {
    "declared": "an effect is declared, typical single effects",
    "declared_detectable": "the same, of those above the detection limit that the report states",
    "declared_exact": "exact, of those declared",
    "claims_exact": "exactly correct, of all claims",
    "false_alarms": "false alarms: none or parameters only",
    "none": '"no gap" where no effect is hidden',
    "parameters": '"parameters" identified',
    "unknown": '"unknown" identified, effects outside the catalogue of any magnitude',
    "typical_unknown": "the same, of half the typical magnitude or more, as for all effects above",
    "unknown_formless": '"unknown", of those that the diagnosis does not look for',
    "unknown_wrongly": 'other cases called "unknown"',
    "typical_pair_both": "both of two typical effects, no other",
    "detectable_pair_both": "the same, of those with both above the detection limit that the report states",
    "pair_one": "at least one of two effects",
    "where": "largest share of `where` in an equation of a hidden effect",
    "where_stated": "the same, of reports that state a place",
    "coherent": "consistent claims",
}
KINDS: Final = {
    "declared": "declared", "declared_exact": "exact of these", "claims_exact": "claims exact",
    "false_alarms": "false alarms", "unknown": "unknown", "typical_pair_both": "typical pairs", "where": "where",
    "where_stated": "where stated", "coherent": "consistent",
}  # fmt: skip


def counted(parts: Sequence[Score], key: str) -> tuple[int, int]:
    """Hits and cases of one row, over the rows of some scores."""
    found = [row["value"] for part in parts for row in part["rows"] if row["key"] == key]
    return sum(one["hits"] for one in found), sum(one["n"] for one in found)


def share_text(hits: int, n: int) -> str:
    """Hits of n, their share and its interval."""
    found = wilson(hits, n)
    if found.share is None or found.low is None or found.high is None:
        return "none drawn"
    return f"{hits} of {n}, {100 * found.share:.0f} % ({100 * found.low:.0f} to {100 * found.high:.0f})"


def result_table(columns: Mapping[str, Sequence[Score]]) -> list[str]:
    """Lines of the table of results; `columns`: scores of the sets of each column, by its name."""
    lines = [f"| row | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]

    def add(words: str, cells: Sequence[str]) -> None:
        lines.append(f"| {words} | {' | '.join(cells)} |")

    for key, words in ROWS.items():
        add(words, [share_text(*counted(scores, key)) for scores in columns.values()])
    covered = [[s["parameters"]["coverage"] for s in scores] for scores in columns.values()]
    add(
        "stated parameter within its 95 % interval, correct claims",
        [share_text(sum(c["hits"] for c in one), sum(c["n"] for c in one)) for one in covered],
    )
    add(
        "calibration error of claims, of all answers, all sets together",
        [_errors(_pooled(s)) for s in columns.values()],
    )
    add(
        "the same, each set",
        [" and ".join(map(_errors, s)) for s in columns.values()],
    )
    add(
        "median error of a stated parameter, each set",
        [" and ".join(_percent(s["parameters"]["relative_error"]) + " %" for s in one) for one in columns.values()],
    )
    add(
        "median runtime error: as configured, re-tuned, with the claimed effect, each set",
        [" and ".join(map(_runtimes, scores)) for scores in columns.values()],
    )
    return lines


def kinds_table(scores: Sequence[Score]) -> list[str]:
    """Lines of the table by kind of bench."""
    lines = [f"| kind of bench | cases | {' | '.join(KINDS.values())} |", "|---" * (2 + len(KINDS)) + "|"]
    kinds = dict.fromkeys((part["shift"], part["value"]) for score in scores for part in score["by_shift"])
    for kind in kinds:
        parts = [part for score in scores for part in score["by_shift"] if (part["shift"], part["value"]) == kind]
        cells = ["{}/{}".format(*counted(parts, key)) for key in KINDS]
        lines.append(f"| {': '.join(map(str, kind))} | {sum(p['n_cases'] for p in parts)} | {' | '.join(cells)} |")
    return lines


def _pooled(scores: Sequence[Score]) -> Score:
    """Calibration of the cases of several sets."""
    found = {}
    for name in ("calibration_of_claims", "calibration"):
        stated, right = (np.concatenate([s[name][key] for s in scores]) for key in ("stated", "is_correct"))
        found[name] = asdict(calibration_of(stated, right.astype(bool)))
    return found


def _errors(score: Score) -> str:
    claims, answers = (score[name] for name in ("calibration_of_claims", "calibration"))
    if claims["error_by_chance"] is None:
        return "no claims"
    by_chance = f"{claims['error_by_chance']:.3f} and {answers['error_by_chance']:.3f} by chance"
    return f"{claims['error']['value']:.3f}, {answers['error']['value']:.3f} ({by_chance})"


def _runtimes(score: Score) -> str:
    return ", ".join(map(_percent, score["runtime"].values())) + " %"


def _percent(found: Mapping[str, float | None]) -> str:
    """Of a set without correct claims, or without runtimes, there is none."""
    return "-" if found["value"] is None else f"{100 * found['value']:.1f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("columns", nargs="+", metavar="NAME=SCORE.json[,SCORE.json...]")
    columns = {}
    for column in parser.parse_args(arguments).columns:
        name, is_given, paths = column.partition("=")
        if not is_given:
            parser.error(f"{column}: write NAME=SCORE.json")
        columns[name] = [json.loads(Path(path).read_text(encoding="utf-8"))["score"] for path in paths.split(",")]
    print("\n".join([*result_table(columns), "", *kinds_table(next(iter(columns.values())))]))


if __name__ == "__main__":
    main()
