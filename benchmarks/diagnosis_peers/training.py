"""Training and settings of the peers, all from development cases."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.blindcheck.scored_case import Case

from benchmarks.diagnosis_peers.bic import SETTINGS as BIC_SETTINGS
from benchmarks.diagnosis_peers.bic import BicSettings, bic_probabilities
from benchmarks.diagnosis_peers.cases import CaseFeatures, development_cases
from benchmarks.diagnosis_peers.sparse import (
    PRIOR_VOTES,
    SHARES,
    SIGMAS,
    SparseSettings,
    coefficients,
    contributions,
    sparse_probabilities,
    vote_probabilities,
    votes,
)
from benchmarks.diagnosis_peers.sparse import SETTINGS as SPARSE_SETTINGS

PEERS: Mapping[str, str] = {
    "bic": "plain BIC",
    "forest": "random forest",
    "pysindy": "pysindy terms",
    "bayesflow": "BayesFlow classifier",
}
Labelled = tuple[dict[str, Any], CaseFeatures]
# Probabilities of all hypotheses from the features of a case.
Peer = Callable[[CaseFeatures], dict[str, float]]


def train(peer: str, folders: list[Path], models_dir: Path) -> dict[str, Any]:
    """Train one peer and keep what it needs.

    Parameters
    ----------
    peer : str
        Of `PEERS`.
    folders : list of Path
        Of `cases.develop`.
    models_dir : Path

    Returns
    -------
    dict
        What was chosen, and on how many cases.

    Raises
    ------
    InputError
        If there are too few cases, or the peer is not known.
    """
    cases = list(development_cases(folders))
    models_dir.mkdir(parents=True, exist_ok=True)
    if peer in ("forest", "bayesflow"):
        record = _train_classifier(peer, cases, models_dir)
    elif peer == "bic":
        record = _tune_bic(_with_terms(cases))
    elif peer == "pysindy":
        record = _tune_sparse(_with_terms(cases))
    else:
        raise InputError(f"there is no peer called {peer}", remedy=f"choose from {', '.join(PEERS)}")
    (models_dir / f"{peer}.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    return record


def trained(peer: str, models_dir: Path) -> Peer:
    """Return a trained peer.

    Raises
    ------
    InputError
        If it is not trained.
    """
    path = models_dir / f"{peer}.json"
    if peer not in PEERS or not path.exists():
        raise InputError(f"{peer} is not trained", where=path, remedy="run the step `train`")
    record = json.loads(path.read_text(encoding="utf-8"))
    settings = record["settings"]
    if peer == "bic":
        return lambda features: bic_probabilities(_terms(features), BicSettings(**settings))
    if peer == "pysindy":
        return lambda features: sparse_probabilities(_terms(features), SparseSettings(**settings))
    if peer == "forest":
        import joblib

        from benchmarks.diagnosis_peers.forest import forest_probabilities

        forest = joblib.load(models_dir / "forest.joblib")
        return lambda features: forest_probabilities(forest, _vector(features, record["n_features"]))
    from benchmarks.diagnosis_peers.neural import load_networks, network_probabilities

    networks = load_networks(models_dir / "bayesflow")
    return lambda features: network_probabilities(networks, _vector(features, record["n_features"]))


def uses_terms(peer: str) -> bool:
    """Whether a peer needs the dictionary of terms, whose time then counts."""
    return peer in ("bic", "pysindy")


def mean_log_loss(cases: list[Labelled], probabilities: list[dict[str, float]]) -> float:
    """Log-loss of the blind check's score, nats; what the settings are chosen by."""
    return float(
        np.mean(
            [
                Case(name="", kind=label["kind"], effects=label["effects"], probabilities=found).log_loss
                for (label, _), found in zip(cases, probabilities, strict=True)
            ]
        )
    )


def _terms(features: CaseFeatures) -> Any:
    if features.terms is None:
        raise InputError("the features hold no dictionary of terms", remedy="run `features` again")
    return features.terms


def _vector(features: CaseFeatures, length: int) -> Floats:
    if len(features.vector) != length:
        raise InputError(
            f"features have length {len(features.vector)}, the peer was trained on {length}",
            remedy="the reduction has changed: run `develop` and `features` again with this code",
        )
    return features.vector


def _with_terms(cases: list[Labelled]) -> list[Labelled]:
    found = [(label, features) for label, features in cases if features.terms is not None]
    if not found:
        raise InputError("no development case has a dictionary of terms", remedy="run `develop` with --terms 60")
    return found


def _train_classifier(peer: str, cases: list[Labelled], models_dir: Path) -> dict[str, Any]:
    if not cases:
        raise InputError("there are no development cases", remedy="run the step `develop`")
    length = len(cases[0][1].vector)
    vectors = np.array([_vector(features, length) for _, features in cases])
    labels = [label["class"] for label, _ in cases]
    if peer == "forest":
        import joblib

        from benchmarks.diagnosis_peers.forest import train_forest

        forest = train_forest(vectors, labels)
        joblib.dump(forest, models_dir / "forest.joblib", compress=3)
        return {"n_cases": len(cases), "n_features": length, "settings": forest.settings, "log_loss": forest.log_loss}
    from benchmarks.diagnosis_peers.neural import save_networks, train_networks

    networks = train_networks(vectors, labels)
    save_networks(models_dir / "bayesflow", networks)
    settings = {"power": networks.power}
    return {"n_cases": len(cases), "n_features": length, "settings": settings, "log_loss": networks.log_loss}


def _tune_bic(cases: list[Labelled]) -> dict[str, Any]:
    tried = [
        (mean_log_loss(cases, [bic_probabilities(_terms(features), settings) for _, features in cases]), settings)
        for settings in BIC_SETTINGS
    ]
    loss, best = min(tried, key=lambda item: item[0])
    return {"n_cases": len(cases), "settings": asdict(best), "log_loss": loss}


def _tune_sparse(cases: list[Labelled]) -> dict[str, Any]:
    best: tuple[float, SparseSettings] | None = None
    for base in SPARSE_SETTINGS:
        made = [contributions(_terms(features), coefficients(_terms(features), base)) for _, features in cases]
        for share, sigmas in product(SHARES, SIGMAS):
            counted = [votes(item, share, sigmas) for item in made]
            for prior_votes in PRIOR_VOTES:
                loss = mean_log_loss(cases, [vote_probabilities(item, prior_votes) for item in counted])
                if best is None or loss < best[0]:
                    best = (
                        loss,
                        SparseSettings(
                            threshold=base.threshold, alpha=base.alpha, share=share, sigmas=sigmas,
                            prior_votes=prior_votes,
                        ),
                    )  # fmt: skip
    assert best is not None
    return {"n_cases": len(cases), "settings": asdict(best[1]), "log_loss": best[0]}
