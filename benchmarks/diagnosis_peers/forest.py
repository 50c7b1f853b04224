"""Random forest on residual features (scikit-learn), trained on development campaigns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats

from benchmarks.diagnosis_peers.hypotheses import CLASSES, spread_pairs

_GRID: tuple[tuple[int, Any], ...] = tuple(product((1, 3), ("sqrt", 0.1, 0.3)))
_POWERS = np.geomspace(0.5, 4.0, 15)


@dataclass(frozen=True, kw_only=True, slots=True)
class Forest:
    """A trained forest.

    Attributes
    ----------
    model : RandomForestClassifier
    power : float
        Probabilities are raised to it and normalised: chosen on the cases that each tree has not seen.
    settings : dict
        What was chosen.
    log_loss : float
        Out of bag, nats, over the classes.
    """

    model: Any
    power: float
    settings: dict[str, Any]
    log_loss: float


def train_forest(vectors: Floats, labels: Sequence[str], *, n_trees: int = 600, seed: int = 0) -> Forest:
    """Train on development cases; leaf size, features per split and sharpening are chosen out of bag.

    Parameters
    ----------
    vectors : ndarray, shape (n_cases, n)
    labels : sequence of str
        Of `hypotheses.CLASSES`.
    n_trees, seed : int

    Returns
    -------
    Forest
    """
    from sklearn.ensemble import RandomForestClassifier

    target = np.array([CLASSES.index(label) for label in labels])
    best: Forest | None = None
    # Balanced: fifteen per cent are "unknown" and two per cent any effect, so that unweighted "unknown" would win.
    for leaf, features in _GRID:
        model = RandomForestClassifier(
            n_estimators=n_trees, min_samples_leaf=leaf, max_features=features, oob_score=True, random_state=seed,
            class_weight="balanced_subsample",
        )  # fmt: skip
        model.fit(vectors, target)
        held_out = whole(model.oob_decision_function_, model.classes_)
        for power in _POWERS:
            loss = log_loss(sharpened(held_out, power), target)
            if best is None or loss < best.log_loss:
                chosen = {"min_samples_leaf": leaf, "max_features": features, "power": float(power)}
                best = Forest(model=model, power=float(power), settings=chosen, log_loss=loss)
    assert best is not None
    return best


def forest_probabilities(forest: Forest, vector: Floats) -> dict[str, float]:
    """Probability of every hypothesis for one campaign."""
    found = whole(forest.model.predict_proba(vector[None, :]), forest.model.classes_)
    return spread_pairs(sharpened(found, forest.power)[0])


def whole(found: Floats, classes: Sequence[int]) -> Floats:
    """Spread probabilities of the classes that occurred over all classes; none is quite impossible."""
    out = np.full((len(found), len(CLASSES)), 1e-3)
    out[:, np.asarray(classes)] += np.nan_to_num(found)
    return out / out.sum(axis=1, keepdims=True)


def sharpened(probabilities: Floats, power: float) -> Floats:
    """Raise to a power and normalise rows."""
    raised = probabilities**power
    return raised / raised.sum(axis=1, keepdims=True)


def log_loss(probabilities: Floats, target: np.ndarray) -> float:
    """Mean of -ln p of the true class, nats."""
    return float(-np.mean(np.log(np.maximum(probabilities[np.arange(len(target)), target], 1e-4))))
