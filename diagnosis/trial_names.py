"""Names of trials in a message."""

from __future__ import annotations

from collections.abc import Sequence


def some(names: Sequence[str]) -> str:
    """All of a few, the first of many and how many more there are.

    Examples
    --------
    >>> some(["a", "b"]), some(list("abcdef"))
    ('a, b', 'a, b, c and 3 more trials')
    """
    return ", ".join(names) if len(names) <= 4 else f"{', '.join(names[:3])} and {len(names) - 3} more trials"
