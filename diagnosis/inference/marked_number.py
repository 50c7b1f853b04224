"""A number that no equation gives, marked with where it comes from."""

from __future__ import annotations

from dataclasses import field
from types import MappingProxyType
from typing import Any, Final, Literal

Mark = Literal["fitted", "measured", "convention"]
BY_HAND: Final = "answers to development campaigns, seeds 1 to 999, by hand"
INTACT: Final = "what development campaigns without an effect, seeds 1 to 999, leave"
CLASS: Final = "usual class of such instruments, one standard deviation"


def marked(value: Any, mark: Mark, source: str) -> Any:
    """Field of a dataclass with a number as its default, and where that comes from as its metadata.

    Parameters
    ----------
    value : number, tuple or dict
        A dict becomes a read-only mapping.
    mark : Mark
        "fitted" was chosen for what it does to answers, "measured" was read off data, "convention" is a choice.
    source : str
    """
    said = {"mark": mark, "source": source}
    if isinstance(value, dict):
        return field(default_factory=lambda: MappingProxyType(value), metadata=said)
    return field(default=value, metadata=said)
