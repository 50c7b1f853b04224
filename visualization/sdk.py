"""The one place that imports rerun, after the settings it reads at import.

Rerun reads `RUST_LOG` when its library is loaded. Only errors may reach the terminal: a viewer that is slow
or gone is reported through `LiveView.is_dead`, not by log lines that tear up the live counters.
"""

from __future__ import annotations

import os

os.environ.setdefault("RUST_LOG", "error")

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn

__all__ = ["TimelineColumn", "rr", "rrb"]
