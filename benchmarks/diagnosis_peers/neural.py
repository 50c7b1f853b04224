"""Amortised model comparison (BayesFlow): a network that gives the posterior over the hypotheses from the features.

`ModelComparisonApproximator` on residual features (Radev and others, J. Open Source Softw. 8(89), 5702 (2023)), backend
JAX on the processor. The features are squashed, whitened by principal components and jittered; a few networks with
different seeds are averaged; the temperature is chosen on cases withheld from the training.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sawbench.bench.recording import Floats

from benchmarks.diagnosis_peers.forest import log_loss, sharpened
from benchmarks.diagnosis_peers.hypotheses import CLASSES, spread_pairs

Inputs = npt.NDArray[np.float32]
_POWERS = np.geomspace(0.2, 3.0, 20)
_WIDTHS = (128, 128)
_DROPOUT = 0.3
_BATCH = 32
_N_FOLDS = 5


@dataclass(frozen=True, kw_only=True, slots=True)
class Squash:
    """From features to network inputs.

    Attributes
    ----------
    middle, scale : ndarray, shape (n,)
        Median and scaled median deviation of each feature.
    mean : ndarray, shape (n,)
    directions : ndarray, shape (n, d)
        Principal components, each divided by its standard deviation.
    """

    middle: Floats
    scale: Floats
    mean: Floats
    directions: Floats

    def __call__(self, vectors: Floats) -> Inputs:
        """Inputs of shape (n_cases, d)."""
        squashed = np.arcsinh((np.atleast_2d(vectors) - self.middle) / self.scale)
        return ((squashed - self.mean) @ self.directions).astype(np.float32)


def squash_of(vectors: Floats, n_components: int = 64) -> Squash:
    """Learn the inputs' scales from development cases."""
    middle = np.median(vectors, axis=0)
    scale = 1.4826 * np.median(np.abs(vectors - middle), axis=0)
    scale = np.where(scale > 0, scale, np.std(vectors, axis=0) + 1e-12)
    squashed = np.arcsinh((vectors - middle) / scale)
    mean = squashed.mean(axis=0)
    _, values, vectors_t = np.linalg.svd(squashed - mean, full_matrices=False)
    kept = min(n_components, int(np.sum(values > 1e-6 * values[0])))
    std = values[:kept] / np.sqrt(len(vectors))
    return Squash(middle=middle, scale=scale, mean=mean, directions=(vectors_t[:kept] / std[:, None]).T)


@dataclass(frozen=True, kw_only=True, slots=True)
class Networks:
    """Trained networks.

    Attributes
    ----------
    members : tuple
        `ModelComparisonApproximator`s.
    squash : Squash
    power : float
        Inverse temperature.
    log_loss : float
        On withheld cases, nats.
    """

    members: tuple[Any, ...]
    squash: Squash
    power: float
    log_loss: float


def train_networks(vectors: Floats, labels: Sequence[str], *, epochs: int = 30, seed: int = 0) -> Networks:
    """Train one network a fold, each compared with the fold that it has not seen.

    Parameters
    ----------
    vectors : ndarray, shape (n_cases, n)
    labels : sequence of str
        Of `hypotheses.CLASSES`.
    epochs, seed : int

    Returns
    -------
    Networks
    """
    target = np.array([CLASSES.index(label) for label in labels])
    squash = squash_of(vectors)
    inputs = squash(vectors)
    fold = np.random.default_rng(seed).permutation(len(target)) % _N_FOLDS
    held_out = np.empty((len(target), len(CLASSES)))
    members = []
    for number in range(_N_FOLDS):
        seen = fold != number
        member = _member(inputs.shape[1], seed + number)
        _fit(member, inputs[seen], target[seen], epochs=epochs, seed=seed + number)
        held_out[~seen] = _predict(member, inputs[~seen])
        members.append(member)
    losses = [log_loss(sharpened(held_out, power), target) for power in _POWERS]
    best = int(np.argmin(losses))
    return Networks(members=tuple(members), squash=squash, power=float(_POWERS[best]), log_loss=losses[best])


def network_probabilities(networks: Networks, vector: Floats) -> dict[str, float]:
    """Probability of every hypothesis for one campaign."""
    inputs = networks.squash(vector)
    found = np.mean([_predict(member, inputs) for member in networks.members], axis=0)
    return spread_pairs(sharpened(found, networks.power)[0])


def _bayesflow() -> Any:
    os.environ.setdefault("KERAS_BACKEND", "jax")
    import bayesflow

    return bayesflow


def _member(n_inputs: int, seed: int) -> Any:
    bayesflow = _bayesflow()
    import keras

    keras.utils.set_random_seed(seed)
    adapter = bayesflow.approximators.ModelComparisonApproximator.build_adapter(
        inference_variables="model_indices", inference_conditions="features"
    )
    member = bayesflow.approximators.ModelComparisonApproximator(
        num_models=len(CLASSES), adapter=adapter,
        classifier_network=bayesflow.networks.MLP(widths=_WIDTHS, dropout=_DROPOUT),
    )  # fmt: skip
    member.compile(optimizer=keras.optimizers.AdamW(learning_rate=1e-3, weight_decay=1e-2))
    return member


def _fit(member: Any, inputs: Inputs, target: np.ndarray, *, epochs: int, seed: int) -> None:
    bayesflow = _bayesflow()
    rng = np.random.default_rng(seed)
    # Copies with jitter: a campaign costs seconds, and there are more weights than cases.
    many = np.concatenate([inputs + 0.2 * rng.standard_normal(inputs.shape).astype(np.float32) for _ in range(4)])
    dataset = bayesflow.datasets.OfflineDataset(
        data={"features": many, "model_indices": np.eye(len(CLASSES), dtype=np.float32)[np.tile(target, 4)]},
        batch_size=_BATCH, adapter=member.adapter,
    )  # fmt: skip
    member.fit(dataset=dataset, epochs=epochs, verbose=0)


def _predict(member: Any, inputs: Inputs) -> Floats:
    return np.asarray(member.predict(conditions={"features": inputs}), dtype=np.float64)


def save_networks(folder: Path, networks: Networks) -> None:
    """Write weights and scales."""
    folder.mkdir(parents=True, exist_ok=True)
    squash = networks.squash
    np.savez(
        folder / "squash.npz", middle=squash.middle, scale=squash.scale, mean=squash.mean,
        directions=squash.directions, power=networks.power, log_loss=networks.log_loss, n=len(networks.members),
    )  # fmt: skip
    for number, member in enumerate(networks.members):
        member.save_weights(folder / f"member-{number}.weights.h5")


def load_networks(folder: Path) -> Networks:
    """Read what `save_networks` wrote."""
    with np.load(folder / "squash.npz") as found:
        squash = Squash(**{name: found[name] for name in ("middle", "scale", "mean", "directions")})
        power, loss, n = float(found["power"]), float(found["log_loss"]), int(found["n"])
    members = []
    inputs = np.zeros((2, squash.directions.shape[1]), dtype=np.float32)
    for number in range(n):
        member = _member(inputs.shape[1], number)
        # One step on nothing builds the layers that the weights belong to.
        _fit(member, inputs, np.zeros(2, dtype=int), epochs=1, seed=0)
        member.load_weights(folder / f"member-{number}.weights.h5")
        members.append(member)
    return Networks(members=tuple(members), squash=squash, power=power, log_loss=loss)
