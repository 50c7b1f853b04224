"""In-line slider-crank: the blade hangs on a connecting rod, as in most reciprocating saws.

    y(phi) = r (1 - cos phi) + l (1 - q),   q = sqrt(1 - (r/l)^2 sin^2 phi)
    dy/dphi = r sin phi (1 + (r/l) cos phi / q)

Assumptions: the stroke line passes through the crank axis (dead centres at 0 and pi), a massless rod (its
mass is shared out to yoke inertia and reciprocating mass). Range: l > r. As l grows this becomes the Scotch
yoke. Source: the loop-closure equation of a planar slider-crank, e.g. Norton, Design of Machinery, chapter 4.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.compilation import kernel


@kernel()
def lever(sine, cosine, radius, rod):
    """First and second derivative of the displacement with respect to the crank angle, m.

    Parameters
    ----------
    sine, cosine : float
        Of the crank angle.
    radius, rod : float
        Crank radius and rod length, m; rod > radius.

    Returns
    -------
    lever, slope : float
        dy/dphi and d2y/dphi2, m.

    Examples
    --------
    >>> lever(1.0, 0.0, 0.01, 0.05)[0]
    0.01
    """
    ratio = radius / rod
    root = np.sqrt(1.0 - (ratio * sine) ** 2)
    bend = (cosine * cosine - sine * sine) / root + (ratio * sine * cosine) ** 2 / (root * root * root)
    return radius * sine * (1.0 + ratio * cosine / root), radius * (cosine + ratio * bend)


@kernel()
def displacement(sine, cosine, radius, rod):
    """Blade displacement above the lower dead centre, m; arguments as in `lever`.

    Examples
    --------
    >>> displacement(0.0, -1.0, 0.01, 0.05)
    0.02
    """
    root = np.sqrt(1.0 - (radius / rod * sine) ** 2)
    return radius * (1.0 - cosine) + rod * (1.0 - root)
