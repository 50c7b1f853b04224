"""Random numbers for one thing that is drawn, and how sizes are drawn."""

from __future__ import annotations

import zlib

import numpy as np


def stream_of(seed: int, name: str, *more: int) -> np.random.Generator:
    """Return random numbers for one thing, the same whatever else is drawn or left out."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *more])


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw log-uniformly."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
