"""The oracle of the blind check: how far the gap closes with the true effects told, and how far it could."""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sawbench.diagnosis.answer.ladder import Ladder
    from sawbench.diagnosis.inference.linear_problem import LinearProblem
    from sawbench.modeling.residuals import Equation

# A gap above the noise that is less than this share of the noise's energy cannot be closed by a measurable share.
_LEAST_GAP: Final = 0.02


def oracle_gaps(
    set_dir: Path,
    labels: Mapping[str, Mapping[str, Any]],
    cache_path: Path,
    *,
    source_sha256: str,
    n_cases: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, dict[str, float | None]]:
    """Ask the oracle about every case that hides effects of the catalogue.

    Parameters
    ----------
    set_dir : Path
    labels : mapping
        Of `sealing.verify`.
    cache_path : Path
        Keeps what is computed, so that a run that was broken off goes on; it tells labels, so keep it with
        the key. What other sources computed is not used.
    source_sha256 : str
        Of the sources that compute.
    n_cases : int, optional
        Ask about that many only: drawn by the hash of their names, so that more of them hold the fewer.
    workers : int, optional
        Processes; one per core unless given.
    on_progress : callable, optional
        (done, wanted, case).

    Returns
    -------
    dict of str to dict
        By case, what `ask` returns; a case in which the campaign shows nothing of the true effects is left out.
    """
    from sawbench.blindcheck.sealing import read_json, write_json

    known: dict[str, Any] = read_json(cache_path) if cache_path.exists() else {}
    found: dict[str, Any] = known["asked"] if known.get("source_sha256") == source_sha256 and "asked" in known else {}
    wanted = {name: label["truth"] for name, label in labels.items() if label["kind"] in {"effect", "pair", "several"}}
    wanted = {name: wanted[name] for name in sorted(wanted, key=_hash_of)[:n_cases]}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=workers or os.cpu_count() or 1, mp_context=context) as pool:
        futures = {
            pool.submit(ask, set_dir / name, truth): name for name, truth in wanted.items() if name not in found
        }  # fmt: skip
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            write_json(cache_path, {"source_sha256": source_sha256, "asked": found})
            if on_progress is not None:
                on_progress(len(wanted.keys() & found.keys()), len(wanted), futures[future])
    return {name: asked for name in wanted if (asked := found[name]) is not None}


def _hash_of(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


def ask(case_dir: Path, truth: Mapping[str, Any]) -> dict[str, float | None] | None:
    """Return how far the withheld gap closes with the true effects told, and how far it could.

    Parameters
    ----------
    case_dir : Path
        Folder with a `campaign.toml`.
    truth : mapping
        Of the label.

    Returns
    -------
    dict or None
        Where the effects act, as the report has it. `gap_closed`: by the true effects, each in the catalogue's best
        form; `closable`: by taking the effects out of nature, see `closable_share`. None where the campaign cannot be
        diagnosed or shows nothing of one of them.
    """
    import numpy as np
    from sawbench.diagnosis.answer.hold_out import climb
    from sawbench.diagnosis.inference.acts_in import equations_of
    from sawbench.diagnosis.inference.columns import catalogue_columns
    from sawbench.diagnosis.inference.evidence import explain
    from sawbench.diagnosis.inference.marginal import Marginal
    from sawbench.modeling.effects.catalogue import EFFECTS

    problem = _problem_of(case_dir)
    if problem is None:
        return None
    columns = catalogue_columns(problem, [effect for effect in EFFECTS if effect.name in truth["effects"]])
    marginal = Marginal(problem)
    found = [explain(marginal, entries) for entries in columns.values()]
    told = [one.column.columns * one.effect.strength.high for one in found if one is not None]
    if len(told) < len(truth["effects"]):
        return None
    ladder = climb(problem, np.hstack(told))
    where = equations_of(problem, [one for one in found if one is not None])
    with tempfile.TemporaryDirectory(prefix="sawbench-twin-") as folder:
        make_twin(truth, Path(folder) / "twin")
        twin = _problem_of(Path(folder) / "twin")
    closable = None
    if twin is not None:
        closable = closable_share(_rms_in(ladder, where), _rms_in(climb(twin, None), where))
    return {"gap_closed": ladder.closed_in(where)[0], "closable": closable}


def _rms_in(ladder: Ladder, equations: Sequence[Equation]) -> tuple[float, float]:
    """Withheld residual after re-tuning and noise floor in some equations, over the noise."""
    squares = ladder.squares_in(equations)
    n = sum(float(ladder.n_features[equation].sum()) for equation in equations if equation in ladder.n_features)
    retuned, floor = (math.sqrt(float(squares[name].sum()) / n) for name in ("retuned", "noise_floor"))
    return retuned, floor


def make_twin(truth: Mapping[str, Any], out_dir: Path) -> dict[str, Any]:
    """Make a campaign again without its hidden effects.

    Its small background effects are those of the label: drawn again, one that is also the hidden effect would come in.

    Parameters
    ----------
    truth : mapping
        Of the label.
    out_dir : Path
        Empty or new.

    Returns
    -------
    dict
        The truth of the twin.
    """
    from dataclasses import asdict

    from sawbench.blindcheck.bench import Nature
    from sawbench.blindcheck.campaign import make_campaign

    return make_campaign(
        truth["seed"], out_dir, background=truth["background"], parameters=truth["parameters"],
        **asdict(Nature.of(truth)),
    )  # fmt: skip


def closable_share(hidden: tuple[float, float], bare: tuple[float, float]) -> float | None:
    """Return the share of the gap that is gone in a twin simulated without the hidden effects.

    The twin of a campaign has the same seed: the same machine, sensors, small background effects, wood and noise. What
    re-tuning leaves of it is not for the hidden effects to close.

    Parameters
    ----------
    hidden, bare : tuple of (float, float)
        Withheld residual after re-tuning and noise floor, both over the noise, of the campaign and of its twin.

    Returns
    -------
    float or None
        At most 1; None where re-tuning leaves nothing of the gap.

    Examples
    --------
    >>> closable_share((3.0, 1.0), (1.0, 1.0)), closable_share((3.0, 1.0), (5**0.5, 1.0))
    (1.0, 0.5)
    """
    gap, rest = (retuned**2 - floor**2 for retuned, floor in (hidden, bare))
    if gap <= _LEAST_GAP * hidden[1] ** 2:
        return None
    return round(1.0 - max(rest, 0.0) / gap, 12)


def _problem_of(campaign_dir: Path) -> LinearProblem | None:
    """Import and reduce a campaign; None where it cannot be diagnosed."""
    from sawbench.bench.config import load_config
    from sawbench.bench.errors import SawbenchError
    from sawbench.diagnosis.campaign import reduce_campaign
    from sawbench.diagnosis.inference.linear_problem import build_problem
    from sawbench.storage.importers import import_path
    from sawbench.storage.reader import read_recording

    with tempfile.TemporaryDirectory(prefix="sawbench-oracle-") as folder:
        report = import_path(campaign_dir / "campaign.toml", Path(folder))
        recordings = [read_recording(path) for path in report.paths]
        try:
            return build_problem(reduce_campaign(recordings, load_config(campaign_dir / "bench_config.toml")))
        except SawbenchError:
            return None
