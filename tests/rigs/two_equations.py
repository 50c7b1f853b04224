"""A whitened problem of two equations, cutting and electrical, without a campaign behind it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.plants.jigsaw import Jigsaw

from tests.rigs.jigsaw_in_time import BASELINE

N_BLOCKS, N_CUTTING, N_ELECTRICAL = 40, 6, 4
QUIET = 0.2
CAMPAIGN = SimpleNamespace(plant=Jigsaw(baseline=BASELINE))


def problem_of(cutting, electrical, n_start_up=0):
    """Features of both equations, shape (N_BLOCKS, size) each; the last blocks are those of a start."""
    both = np.hstack([cutting, electrical])
    layout = SimpleNamespace(
        size=N_CUTTING + N_ELECTRICAL,
        slices={"cutting": slice(0, N_CUTTING), "electrical": slice(N_CUTTING, N_CUTTING + N_ELECTRICAL)},
    )
    split = (N_BLOCKS - n_start_up) * layout.size
    parts = [SimpleNamespace(place=slice(0, split), layout=layout, state=SimpleNamespace(kind="running"))]
    if n_start_up:
        start_up = SimpleNamespace(kind="start_up")
        parts.append(SimpleNamespace(place=slice(split, both.size), layout=layout, state=start_up))
    return LinearProblem(
        campaign=CAMPAIGN, parts=tuple(parts), data=both.ravel(), known=np.zeros(both.size),
        nuisance=np.zeros((both.size, 0)), names=(), prior_std=np.zeros(0), quiet=QUIET,
    )  # fmt: skip


def noise(seed, size, std):
    return std * np.random.default_rng(seed).standard_normal((N_BLOCKS, size))
