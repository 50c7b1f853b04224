"""Scotch yoke: the blade follows a pin on the crank in a straight slot.

    y(phi) = r_c (1 - cos phi),   dy/dphi = r_c sin phi

Assumptions: no play, a rigid yoke, the slot square to the stroke. Range: any angle, r_c > 0.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eqs. 1 and 3.
"""

from __future__ import annotations

from sawbench.modeling.compilation import kernel


@kernel()
def lever(sine, cosine, radius):
    """First and second derivative of the displacement with respect to the crank angle, m (Eqs. 1, 3).

    Parameters
    ----------
    sine, cosine : float
        Of the crank angle.
    radius : float
        Crank radius, m.

    Returns
    -------
    lever, slope : float
        dy/dphi and d2y/dphi2, m.

    Examples
    --------
    >>> lever(1.0, 0.0, 0.01)
    (0.01, 0.0)
    """
    return radius * sine, radius * cosine


@kernel()
def displacement(sine, cosine, radius):
    """Blade displacement above the lower dead centre, m (Eq. 1); arguments as in `lever`.

    Examples
    --------
    >>> displacement(0.0, -1.0, 0.01)
    0.02
    """
    return radius * (1.0 - cosine)
