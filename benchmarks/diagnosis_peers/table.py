"""Answers of the peers to a sealed set, their score beside that of the diagnosis, and the page."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sawbench.bench.errors import InputError
from sawbench.blindcheck.answering import INDEX, read_answers, refuse_key_inside
from sawbench.blindcheck.scored_case import Case, case_of
from sawbench.blindcheck.scoring import Score, score
from sawbench.blindcheck.sealing import COMMITMENTS, read_json, read_key, verify, write_json

from benchmarks.diagnosis_peers.cases import Progress, load, peers_dir
from benchmarks.diagnosis_peers.hypotheses import answer_of, case_arguments
from benchmarks.diagnosis_peers.training import PEERS, trained, uses_terms

OURS = "this diagnosis"


def answer_set(set_dir: Path, models_dir: Path, peers: Sequence[str], *, on_progress: Progress | None = None) -> None:
    """Let peers answer every case whose features are there; a case without features has no answer.

    Parameters
    ----------
    set_dir, models_dir : Path
    peers : sequence of str
    on_progress : callable, optional
    """
    refuse_key_inside(Path(set_dir))
    names = sorted(read_json(Path(set_dir) / COMMITMENTS)["cases"])
    folder = peers_dir(set_dir)
    for peer in peers:
        ask = trained(peer, models_dir)
        found: dict[str, Any] = {}
        for done, name in enumerate(names):
            path = folder / "features" / f"{name}.npz"
            if path.exists():
                features = load(path)
                begun = time.perf_counter()
                probabilities = ask(features)
                own_s = time.perf_counter() - begun
                before_s = features.terms_time_s if uses_terms(peer) else features.vector_time_s
                found[name] = asdict(answer_of(probabilities, round(before_s + own_s, 3)))
            if on_progress is not None:
                on_progress(done + 1, len(names), f"{peer}, {name}")
        record = read_json(models_dir / f"{peer}.json")
        write_json(folder / f"{peer}.json", {"trained": record, "answers": found})


def peer_cases(labels: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Mapping[str, Any]]) -> list[Case]:
    """Bring labels and a peer's answers together; a case without an answer has failed.

    Parameters
    ----------
    labels : mapping
        Of `sealing.verify`.
    answers : mapping
        By case: probabilities, indistinguishable_from, time_s.
    """
    cases = []
    for name, label in labels.items():
        truth = label["truth"]
        told: dict[str, Any] = {
            "name": name, "kind": label["kind"], "effects": dict(truth["effects"]),
            "largest_shift_sigmas": max((abs(z) for z in truth.get("shifts", {}).values()), default=None),
        }  # fmt: skip
        if name in answers:
            cases.append(Case(**told, **case_arguments(answers[name])))
        else:
            cases.append(Case(**told, probabilities={}, is_failed=True))
    return cases


def score_set(
    set_dir: Path, key_path: Path, *, answers_dir: Path | None = None, n_cases: int | None = None
) -> tuple[dict[str, Score], dict[str, Any]]:
    """Score the diagnosis and every peer that has answered.

    Parameters
    ----------
    set_dir, key_path : Path
    answers_dir : Path, optional
        Of `sawbench blind answer`; without answers there the diagnosis is left out.
    n_cases : int, optional
        Only the first so many by name, of the diagnosis too.

    Returns
    -------
    scores : dict of str to Score
    about : dict
        Seed, number of cases, software of the diagnosis, what the peers were trained on.

    Raises
    ------
    InputError
        If the seal is broken or nobody has answered.
    """
    from sawbench.bench.source_identity import software_identity

    set_dir = Path(set_dir)
    sealed = verify(set_dir, key_path)
    labels = dict(sorted(sealed.items())[:n_cases])
    scores: dict[str, Score] = {}
    software = software_identity()
    if ((answers_dir or set_dir / "answers") / INDEX).exists():
        index, answers = read_answers(set_dir, answers_dir)
        software = index["software"]
        scores[OURS] = score([case_of(name, labels[name], answers[name]) for name in labels])
    training = {}
    for peer, title in PEERS.items():
        path = peers_dir(set_dir) / f"{peer}.json"
        if path.exists():
            record = json.loads(path.read_text(encoding="utf-8"))
            scores[title] = score(peer_cases(labels, record["answers"]))
            training[title] = record["trained"]
    if not scores:
        raise InputError("nobody has answered", where=set_dir, remedy="run the step `answer` first")
    about = {
        "seed": read_key(key_path)["seed"], "options": read_key(key_path)["options"], "n_cases": len(labels),
        "n_in_set": len(sealed),
        "version": software["version"], "commit": software["commit"], "is_dirty": software["is_dirty"],
        "date": datetime.now(UTC).date().isoformat(), "training": training,
    }  # fmt: skip
    return scores, about


def table(scores: Mapping[str, Score]) -> str:
    """Every row of the score, one column a method; the best of each row is bold."""
    titles = list(scores)
    lines = ["| row | " + " | ".join(titles) + " |", "|---|" + "---|" * len(titles)]
    first = scores[titles[0]]
    for row in first.rows:
        values = [scores[title].row(row.key) for title in titles]
        shares = [value.share for value in values]
        cells = [
            "-"
            if v.share is None
            else f"{100 * v.share:.0f} % ({100 * v.low:.0f} to {100 * v.high:.0f}), {v.hits}/{v.n}"  # type: ignore[operator]
            for v in values
        ]
        lines.append(_line(row.text, cells, shares, is_less_better=row.key in ("false_alarms", "unknown_wrongly")))
    for text, get in (
        ("mean size of the group", lambda s: s.group_size.value),
        ("Brier score (0 best, 2 worst)", lambda s: s.brier.value),
        ("log-loss / nats", lambda s: s.log_loss.value),
        ("calibration error (ECE)", lambda s: s.calibration.error.value),
        ("the same by chance", lambda s: s.calibration.error_by_chance),
        ("time per case, median / s", lambda s: s.time_median_s),
        ("cases without an answer", lambda s: float(s.n_failed)),
    ):
        values = [get(scores[title]) for title in titles]
        cells = ["-" if value is None else f"{value:.3g}" for value in values]
        is_rated = text.startswith(("Brier", "log-loss", "calibration"))
        lines.append(_line(text, cells, values if is_rated else [None] * len(values), is_less_better=True))
    return "\n".join(lines) + "\n"


def _line(text: str, cells: list[str], values: Sequence[float | None], *, is_less_better: bool) -> str:
    known = [value for value in values if value is not None]
    best = (min(known) if is_less_better else max(known)) if known else None
    marked = [
        f"**{cell}**" if value is not None and value == best else cell
        for cell, value in zip(cells, values, strict=True)
    ]
    return f"| {text} | " + " | ".join(marked) + " |"
