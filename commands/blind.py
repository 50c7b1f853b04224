"""`sawbench blind make | answer | score`: the diagnosis on effects that it is not told."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import InputError
from sawbench.commands.batch import scheduler_option
from sawbench.commands.options import force_option, json_option, refuse_unwritable, refuse_unwritable_folder
from sawbench.commands.terminal import emit, stepper, table
from sawbench.plain import plain

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from sawbench.blindcheck.answering import Program, SealedCase
    from sawbench.blindcheck.parameter_score import EffectParameter
    from sawbench.blindcheck.score_statistics import Estimate, Proportion
    from sawbench.blindcheck.scoring import Score

# Scores on smaller seeds are no claim: thresholds and temperatures may have been fitted on them.
FIRST_CLAIM_SEED: Final = 1000
# Rows that are shown for each kind of bench; the JSON holds all of them.
BY_SHIFT: Final = (
    "declared", "declared_detectable", "declared_exact", "claims_exact", "false_alarms", "unknown", "typical_pair_both",
    "where", "where_stated", "coherent",
)  # fmt: skip
_EXAMPLE: Final = "Example: sawbench blind make --seed 4711 --cases 40 --out blind/set"
_set_argument = click.argument("set_dir", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
_workers_option = click.option(
    "--jobs",
    "--workers",
    "workers",
    type=click.IntRange(min=1),
    help="Number of cases in parallel; default: one per core.",
)
_answers_option = click.option(
    "--answers", "answers_dir", type=click.Path(path_type=Path, file_okay=False), help="Folder; default: DIR/answers."
)


@click.group(name="blind", epilog=_EXAMPLE)
def command() -> None:
    """Prove the diagnosis on campaigns whose effect it is not told: make, answer, score."""


@command.command(name="make", epilog=_EXAMPLE)
@click.option(
    "--seed", type=click.IntRange(min=0), required=True, help="Seeds 1 to 999 are for development; keep others secret."
)
@click.option("--cases", "n_cases", type=click.IntRange(min=1), required=True, help="Number of campaigns.")
@click.option("--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@click.option(
    "--key",
    "key_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File for the key; default: next to the folder.",
)
@click.option(
    "--forms", type=click.Choice(["own", "plain"]), default="own", show_default=True,
    help="Functional forms of the hidden effects: those of the generator, or textbook forms.",
)  # fmt: skip
@click.option(
    "--length", type=click.FloatRange(min=0.0, min_open=True), default=1.0, show_default=True,
    help="Factor on the duration of every trial.",
)  # fmt: skip
@click.option(
    "--benches", type=click.Choice(["own", "foreign"]), default="own", show_default=True,
    help="The paper's jigsaw on a clean bench, or other jigsaws, rates, noise, operators and faulty sensors.",
)  # fmt: skip
@click.option(
    "--mechanism", type=click.Choice(["scotch_yoke", "slider_crank"]), default="scotch_yoke", show_default=True
)
@click.option(
    "--without", multiple=True, metavar="KIND",
    help="With foreign benches: do not vary machine, rate, noise, campaign or operator, or leave out one kind of"
         " faulty sensor.",
)  # fmt: skip
@click.option(
    "--effects-per-case", type=click.IntRange(0, 4),
    help="Number of hidden effects per case, each in different equations, severity 0.5 to 2; 0: intact machines only.",
)  # fmt: skip
@_workers_option
@json_option
def make_command(
    seed: int,
    n_cases: int,
    out_dir: Path,
    key_path: Path | None,
    effects_per_case: int | None,
    workers: int | None,
    as_json: bool,
    **nature: Any,
) -> None:
    """Make a sealed set of campaigns and the key to it; a run that was broken off goes on."""
    from sawbench.blindcheck.bench import Nature
    from sawbench.blindcheck.sealing import make

    refuse_unwritable_folder(out_dir)
    with stepper("making") as step:
        key = make(
            seed, n_cases, out_dir, nature=Nature(**nature), catalogue=_catalogue(),
            effects_per_case=effects_per_case, key_path=key_path, workers=workers,
            on_progress=lambda done, wanted: step(done, wanted, ""),
        )  # fmt: skip
    lines = [f"{n_cases} cases in {out_dir}", f"key (`answer` must not have access to it): {key}"]
    emit({"set": out_dir, "key": key, "n_cases": n_cases, "seed": seed}, "\n".join(lines), as_json=as_json)


@command.command(name="answer", epilog="Example: sawbench blind answer blind/set")
@_set_argument
@_answers_option
@_workers_option
@scheduler_option
@click.option("--timeout", "timeout_s", type=click.FloatRange(min=1.0), default=3600.0, show_default=True,
              help="Time limit per case, s.")  # fmt: skip
@click.option("--until-closed", is_flag=True, help="Use `diagnose --until-closed`: several causes, one by one.")
@click.option("--force", is_flag=True, help="Discard answers of another software version.")
@json_option
def answer_command(
    set_dir: Path,
    answers_dir: Path | None,
    workers: int | None,
    scheduler: str | None,
    timeout_s: float,
    until_closed: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Diagnose every campaign of a set, each in a process that sees nothing else of it; resumable."""
    from sawbench.blindcheck.answering import answer

    with stepper("answering") as step:
        found = answer(
            set_dir, diagnose_program(until_closed=until_closed), answers_dir=answers_dir, workers=workers,
            timeout_s=timeout_s, force=force, on_progress=step,
            elsewhere=None if scheduler is None else partial(_on_cluster, scheduler=scheduler),
        )  # fmt: skip
    lines = [
        f"{found.n_cases} cases, {found.n_new} answered in this run, {found.n_failed} failed",
        f"answers: {found.answers_dir}",
        f"hash of the answers, to be noted before the key is opened: {found.index_sha256}",
    ]
    emit(found, "\n".join(lines), as_json=as_json)
    return 1 if found.n_failed else 0


@command.command(
    name="score", epilog="Example: sawbench blind score blind/set --key blind/set.key.json --out score.html"
)
@_set_argument
@click.option("--key", "key_path", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Of `make`.")
@_answers_option
@click.option(
    "--out", "page_path", type=click.Path(path_type=Path, dir_okay=False),
    help="HTML page; a JSON file with the same content is written next to it.",
)  # fmt: skip
@click.option("--oracle", "with_oracle", is_flag=True, help="Also compute gap_closed with the true effects (slow).")
@click.option(
    "--oracle-cases", "n_oracle", type=click.IntRange(1), help="Compute the oracle for this number of random cases."
)
@click.option(
    "--shuffle",
    "shuffle_seed",
    type=int,
    help="Shuffle the labels with this seed: the score must then be at chance level.",
)
@_workers_option
@force_option
@json_option
def score_command(  # one parameter an option
    set_dir: Path,
    key_path: Path,
    answers_dir: Path | None,
    page_path: Path | None,
    with_oracle: bool,
    n_oracle: int | None,
    shuffle_seed: int | None,
    workers: int | None,
    force: bool,
    as_json: bool,
) -> None:
    """Check seal and answers, then score: what is named, what is missed, how far probabilities can be trusted."""
    from sawbench.blindcheck.sealing import verify, write_json
    from sawbench.reporting.blind_page import write_blind_page

    json_path = page_path.with_suffix(".json") if page_path else None
    if page_path is not None and page_path == json_path:
        raise InputError(
            "page and JSON would have the same name", where=page_path, remedy="give a page name that ends in .html"
        )
    for path in (page_path, json_path):
        if path is not None:
            refuse_unwritable(path, force=force)
    labels = verify(set_dir, key_path)
    oracle = _oracle(set_dir, labels, key_path, workers, n_oracle) if with_oracle or n_oracle else None
    found, record = score_set(
        set_dir, key_path, labels, answers_dir=answers_dir, oracle=oracle, shuffle_seed=shuffle_seed
    )
    lines = [as_text(found)]
    if page_path is not None and json_path is not None:
        write_blind_page(page_path, record, overwrite=force)
        write_json(json_path, record)
        lines += [str(page_path), str(json_path)]
    emit(record, "\n".join(lines), as_json=as_json)


def _on_cluster(
    work: Callable[[SealedCase], dict[str, Any]], cases: Sequence[SealedCase], *, scheduler: str
) -> Generator[tuple[int, dict[str, Any]]]:
    """Yield number and answer of every case; a case whose worker dies again and again is a failed one."""
    from sawbench.archive.batch import WorkerDied, Workers, run_batch

    for outcome in run_batch(work, cases, Workers(scheduler=scheduler)):
        if isinstance(outcome.error, WorkerDied):
            failed = {"status": "failed", "report": None, "exit_code": None, "time_s": 0.0}
            yield outcome.index, failed | {"message": str(outcome.error)}
        else:
            yield outcome.index, outcome.result()


def _catalogue() -> list[str]:
    """Effects that the diagnosis at hand can name."""
    from sawbench.modeling.effects.catalogue import EFFECTS

    return [effect.name for effect in EFFECTS]


def diagnose_program(*, until_closed: bool = False) -> Program:
    """What answers a case: `sawbench import`, then `sawbench diagnose`, on a copy of its campaign."""
    from sawbench.bench.source_identity import software_identity, source_fingerprint
    from sawbench.blindcheck.answering import Program

    sawbench = (sys.executable, "-m", "sawbench.commands.main")
    return Program(
        steps=(
            (*sawbench, "import", "campaign.toml", "--out", "../recordings"),
            (
                *sawbench,
                "diagnose",
                "../recordings",
                "--config",
                "bench_config.toml",
                "--out",
                "../gap",
                *(["--until-closed"] if until_closed else []),
            ),
        ),
        report="../gap/gap_report.json",
        software=software_identity() | {"catalogue": _catalogue()} | ({"until_closed": True} if until_closed else {}),
        fingerprint=source_fingerprint,
    )


def score_set(
    set_dir: Path,
    key_path: Path,
    labels: Mapping[str, Mapping[str, Any]],
    *,
    answers_dir: Path | None = None,
    oracle: Mapping[str, Mapping[str, float | None]] | None = None,
    shuffle_seed: int | None = None,
) -> tuple[Score, dict[str, Any]]:
    """Score the answers to a set.

    Parameters
    ----------
    set_dir, key_path : Path
    labels : mapping
        Of `sealing.verify`.
    answers_dir : Path, optional
    oracle : mapping of str to mapping, optional
        Of `blind_oracle.oracle_gaps`.
    shuffle_seed : int, optional
        Deal the labels at random among the cases.

    Returns
    -------
    score : Score
    record : dict
        The score with what it is a score of, ready for JSON.

    Raises
    ------
    InputError
        If the answers are not those that were given.
    """
    from sawbench.blindcheck.answering import INDEX, read_answers
    from sawbench.blindcheck.scored_case import PROBABILITY_FLOOR, case_of
    from sawbench.blindcheck.scoring import score
    from sawbench.blindcheck.sealing import read_key, sha256_of

    index, answers = read_answers(set_dir, answers_dir)
    names = list(labels)
    dealt = _dealt(names, shuffle_seed)
    cases = []
    for name in names:
        asked = (oracle or {}).get(dealt[name], {})
        told = {"oracle_gap_closed": asked.get("gap_closed"), "closable": asked.get("closable")}
        catalogue = index["software"].get("catalogue", ())
        cases.append(case_of(name, labels[dealt[name]], answers[name], catalogue=catalogue, **told))
    found = score(cases)
    key = read_key(key_path)
    return found, plain(
        {
            "schema_version": 1,
            "set": {"seed": key["seed"], "n_cases": len(names), **key["options"], "is_claim": is_claim(key["seed"])},
            "software": index["software"],
            "answered_at": [index["started_at"], index["finished_at"]],
            "scored_at": datetime.now(UTC).isoformat(timespec="seconds"),
            "commitments_sha256": index["commitments_sha256"],
            "answers_sha256": sha256_of((answers_dir or set_dir / "answers") / INDEX),
            "shuffle_seed": shuffle_seed,
            "probability_floor": PROBABILITY_FLOOR,
            "score": found,
        }
    )


def _dealt(names: list[str], shuffle_seed: int | None) -> dict[str, str]:
    """Whose label each case gets: its own, unless they are shuffled."""
    import numpy as np

    order = range(len(names)) if shuffle_seed is None else np.random.default_rng(shuffle_seed).permutation(len(names))
    return {name: names[k] for name, k in zip(names, order, strict=True)}


def is_claim(seed: int) -> bool:
    """Whether a seed is outside of those that thresholds may be fitted on."""
    return seed >= FIRST_CLAIM_SEED


def as_text(found: Score) -> str:
    """Lay the score out for a terminal."""
    rows = [[row.text, *_cells(row.value)] for row in found.rows]
    lines = [table([f"{found.n_cases} cases", "n", "share", "95 % interval"], rows), ""]
    lines.append(table(["", "n", "value", "95 % interval"], _means(found)))
    if found.parameters.effects:
        sizes = [[f"{one.effect}: {one.name}", *_cells(one.coverage), *_sizes(one)] for one in found.parameters.effects]
        head = ["parameter within its interval", "n", "share", "95 % interval", "error", "stated std", "stated / true"]
        lines += ["", table(head, sizes), ""]
    if found.by_shift:
        lines += ["", table(["kind of bench", "cases", *map(_words, BY_SHIFT), "ECE"], _by_shift(found)), ""]
    if found.calibration.error_by_chance is not None:
        lines.append(
            f"(calibrated probabilities would give an ECE of {found.calibration.error_by_chance:.3f} by chance)"
        )
    if found.chance_exact is not None:
        lines.append(f"exact, if the same answers were assigned at random: {found.chance_exact:.1%}")
    if found.time_median_s is not None:
        lines.append(f"time per case: median {found.time_median_s:.1f} s, 95th percentile {found.time_p95_s:.1f} s")
    if found.failed:
        lines.append(f"without an answer (scored as wrong): {', '.join(found.failed)}")
    lines += [
        f"worst: {miss.name}: {miss.truth}; answered {miss.answer}, truth at {miss.truth_probability:.2g}"
        for miss in found.worst[:5]
    ]
    return "\n".join(lines)


def _means(found: Score) -> list[list[str]]:
    """Rows of the table of means and medians."""
    from sawbench.blindcheck.gap_score import ENOUGH

    numbers = [
        ["Brier score (0 best, 2 worst)", *_numbers(found.brier)],
        ["log-loss / nats", *_numbers(found.log_loss)],
        ["calibration error (ECE)", *_numbers(found.calibration.error)],
        ["calibration error of claims", *_numbers(found.calibration_of_claims.error)],
    ]
    if found.gap is None:
        numbers.append(["gap_closed against the oracle", "-", "not computed", ""])
    else:
        numbers += [
            ["gap_closed: stated - oracle", *_numbers(found.gap.error)],
            ["gap_closed: |stated - oracle|", *_numbers(found.gap.absolute_error)],
            ["gap_closed: oracle inside the 95 % interval", *_cells(found.gap.coverage)],
            ["gap_closed: median stated / median oracle, correct claims", *_numbers(found.gap.share_of_oracle)],
            ["gap_closed: median stated / median closable, correct claims", *_numbers(found.gap.share_of_closable)],
            [f"gap_closed: at least {ENOUGH:.0%} of the closable, correct claims", *_cells(found.gap.closes_enough)],
        ]
    known, runtime = found.parameters, found.runtime
    return [
        *numbers,
        ["parameter within its stated 95 % interval (1.96 std), correct claims", *_cells(known.coverage)],
        ["parameter: median relative error, correct claims", *_numbers(known.relative_error)],
        ["runtime: median relative error of the model as configured, correct claims", *_numbers(runtime.nominal)],
        ["runtime: the same with parameters re-tuned", *_numbers(runtime.retuned)],
        ["runtime: the same with the claimed effect", *_numbers(runtime.with_effect)],
    ]


def _by_shift(found: Score) -> list[list[str]]:
    rows = []
    for one in found.by_shift:
        shares = {row.key: row.value for row in one.rows}
        error = "-" if one.calibration_error is None else f"{one.calibration_error:.3f}"
        counts = [f"{shares[key].hits}/{shares[key].n}" for key in BY_SHIFT]
        rows.append([f"{one.shift}: {one.value}", str(one.n_cases), *counts, error])
    return rows


def _words(key: str) -> str:
    return key.replace("_", " ")


def _cells(value: Proportion) -> list[str]:
    if value.share is None:
        return ["0", "-", ""]
    return [f"{value.hits}/{value.n}", f"{value.share:.1%}", f"{value.low:.1%} to {value.high:.1%}"]


def _numbers(value: Estimate) -> list[str]:
    if value.value is None:
        return ["0", "-", ""]
    return [str(value.n), f"{value.value:.3f}", f"{value.low:.3f} to {value.high:.3f}"]


def _sizes(one: EffectParameter) -> list[str]:
    """Medians over the cases of one effect."""
    return [f"{one.relative_error.value:.1%}", f"{one.stated_rel_std:.1%}", f"{one.ratio:.3f}"]


def _oracle(
    set_dir: Path, labels: Mapping[str, Mapping[str, Any]], key_path: Path, workers: int | None, n_cases: int | None
) -> dict[str, dict[str, float | None]]:
    from sawbench.bench.source_identity import source_fingerprint
    from sawbench.commands.blind_oracle import oracle_gaps

    # Beside the key, not in the set: which cases an oracle has a number for tells their labels.
    cache = key_path.with_name(key_path.name.removesuffix(".json") + ".oracle.json")
    with stepper("computing the oracle") as step:
        return oracle_gaps(
            set_dir, labels, cache, source_sha256=source_fingerprint(), n_cases=n_cases, workers=workers,
            on_progress=step,
        )  # fmt: skip
