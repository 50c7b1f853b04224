"""What a trial's instruments write down."""

from __future__ import annotations

from dataclasses import dataclass

from sawbench.blindcheck.plant import Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class Readings:
    """One trial as written down: `time_s` shape (n,), `values` of shape (n,) per channel, in its unit."""

    time_s: Floats
    values: dict[str, Floats]
