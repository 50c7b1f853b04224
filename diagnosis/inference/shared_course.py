"""A course of the hardness that starts again with every trial: no wood has one, and no blade wears so.

Pieces of wood differ, and each may be harder at one end of the cut. Where the hardness of every trial rises or falls by
the same share from its start on, and starts at the old value in the next trial, it is the tool or the bench that
changes: chips that fill the gullets, a blade that heats up, a feed that settles. No effect of the catalogue does that.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.stroke_trend import Blocks, noise_roots
from sawbench.diagnosis.log_mean import log_mean_exp

# Where the course levels off, as a share of the longest trial: from early in it to hardly.
_LEVELS = np.geomspace(0.05, 2.0, 6)


def shared_course(blocks: Blocks | None) -> float:
    """Weigh a course of the hardness that levels off and is the same in all trials.

    Parameters
    ----------
    blocks : Blocks or None
        Of `stroke_trend.blocks_of`.

    Returns
    -------
    float
        Log evidence against wood that only scatters, in the same model of the wood that a worn blade is weighed in; no
        more than 0 where the course changes the hardness by no more than pieces of wood differ, and 0 without blocks
        or where nothing says how far each was cut.
    """
    from scipy.linalg import solve_triangular

    if blocks is None or not blocks.into_cut.any():
        return 0.0
    courses, free_std, prior = _courses(blocks), SETTINGS.strokes.free_std, SETTINGS.strokes.course_std**-2
    with_course, without, sizes = [], [], []
    for root in noise_roots(blocks, speed_std=free_std, feed_std=free_std):
        half = solve_triangular(root, np.column_stack([blocks.log_k, courses]), lower=True)
        data, columns = half[:, 0], half[:, 1:]
        none = -0.5 * float(data @ data) - float(np.sum(np.log(np.diag(root))))
        precision, moment = np.sum(columns**2, axis=0) + prior, columns.T @ data
        without.append(none)
        with_course.append(none + 0.5 * moment**2 / precision - 0.5 * np.log(precision / prior))
        sizes.append(moment / precision)
    logs = np.array(with_course)
    weights = np.exp(logs - logs.max())
    reach = float(np.sum(weights * np.array(sizes)) / np.sum(weights))
    log = log_mean_exp(logs.ravel().tolist()) - log_mean_exp(without)
    return log if abs(reach) > np.sqrt(2.0) * SETTINGS.workpieces.piece_std else min(log, 0.0)


def _courses(blocks: Blocks) -> Floats:
    """Courses along the cut of the blade and along the feed, shape (n, 2 levels), 1 at the end of the longest trial."""
    cut = blocks.into_cut
    found = []
    for path in (cut, cut * np.exp(blocks.log_feed - blocks.log_speed)):
        share = path[:, None] / path.max()
        found.append(np.expm1(-share / _LEVELS) / np.expm1(-1.0 / _LEVELS))
    return np.hstack(found)
