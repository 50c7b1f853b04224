"""When a blade is changed: the rule of section 2 of the paper, for plans and for reports."""

from __future__ import annotations

from typing import Final

BLADE_GROWTH_LIMIT: Final = 0.20
"""Growth of the specific force from which a blade is changed."""


def is_worn(growth: float, limit: float = BLADE_GROWTH_LIMIT) -> bool:
    """Whether a blade is to be changed.

    Parameters
    ----------
    growth : float
        Specific force over that with the blade when it was new, less 1.
    limit : float
        A growth that reaches it is too much.
    """
    return growth >= limit
