"""The oracle of the blind check: how far the gap closes when the true effects are told."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any


def oracle_gaps(
    set_dir: Path,
    labels: Mapping[str, Mapping[str, Any]],
    cache_path: Path,
    *,
    source_sha256: str,
    workers: int | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, float]:
    """Return `gap_closed` of the true effects, of every case that hides effects of the catalogue.

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
    workers : int, optional
        Processes; one per core unless given.
    on_progress : callable, optional
        (done, wanted, case).

    Returns
    -------
    dict of str to float
        By case; a case in which the campaign shows nothing of the true effects is left out.
    """
    from blindcheck.sealing import read_json, write_json

    known: dict[str, Any] = read_json(cache_path) if cache_path.exists() else {}
    found: dict[str, float | None] = known["gaps"] if known.get("source_sha256") == source_sha256 else {}
    wanted = {name: sorted(v["truth"]["effects"]) for name, v in labels.items() if v["kind"] in {"effect", "pair"}}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=workers or os.cpu_count() or 1, mp_context=context) as pool:
        futures = {
            pool.submit(gap_closed_by, set_dir / name, effects): name
            for name, effects in wanted.items()
            if name not in found
        }
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            write_json(cache_path, {"source_sha256": source_sha256, "gaps": found})
            if on_progress is not None:
                on_progress(len(found), len(wanted), futures[future])
    return {name: gap for name in wanted if (gap := found[name]) is not None}


def gap_closed_by(case_dir: Path, effects: Collection[str]) -> float | None:
    """Return the share of the held-out gap that given effects close, each in its best shape.

    Parameters
    ----------
    case_dir : Path
        Folder with a `campaign.toml`.
    effects : collection of str

    Returns
    -------
    float or None
        None where the campaign cannot be diagnosed or shows nothing of one of them.
    """
    import numpy as np

    from bench.config import load_config
    from bench.errors import SawbenchError
    from diagnosis.campaign import reduce_campaign
    from diagnosis.effects.catalogue import EFFECTS
    from diagnosis.evidence import catalogue_columns, explain
    from diagnosis.ladder import climb
    from diagnosis.linear_problem import Marginal, build_problem
    from storage.importers import import_path
    from storage.reader import read_recording

    with tempfile.TemporaryDirectory(prefix="sawbench-oracle-") as folder:
        report = import_path(case_dir / "campaign.toml", Path(folder))
        recordings = [read_recording(path) for path in report.paths]
        try:
            campaign = reduce_campaign(recordings, load_config(case_dir / "bench_config.toml"))
        except SawbenchError:
            return None
    problem = build_problem(campaign)
    columns = catalogue_columns(problem, [effect for effect in EFFECTS if effect.name in effects])
    marginal = Marginal(problem)
    found = [explain(marginal, entries) for entries in columns.values()]
    told = [one.column.columns * one.effect.strength.high for one in found if one is not None]
    if len(told) < len(effects):
        return None
    return climb(problem, np.hstack(told)).gap_closed
