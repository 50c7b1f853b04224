"""What kind of bench a sealed case is from, by its label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sawbench.blindcheck.nuisances import NUISANCES, SENSOR_FAULTS

_RATES_KHZ = (1.0, 2.5, 7.0, 20.0)
_NOISES = (0.3, 0.7, 1.5, 4.0)
_TRIALS = (6, 13, 25, 41)


def shifts_of(truth: Mapping[str, Any]) -> dict[str, str]:
    """Sort a label into kinds of benches; labels that say nothing of the bench are of the paper's.

    Examples
    --------
    >>> shifts_of({"rate_hz": 5000.0})["sample rate"]
    '2.5 to 7 kHz'
    """
    nuisances = truth.get("nuisances", {})
    n = len(set(nuisances) & SENSOR_FAULTS)
    found = {
        "machine": "another jigsaw" if _is_another_machine(truth) else "the paper's jigsaw",
        "mechanism": str(truth.get("mechanism", "scotch_yoke")).replace("_", " "),
        "sample rate": _bin(_RATES_KHZ, float(truth.get("rate_hz") or 5000.0) / 1e3) + " kHz",
        "noise": _bin(_NOISES, float(truth.get("bench", {}).get("noise_factor", 1.0))),
        "trials": _bin(_TRIALS, len(truth.get("trials", [None] * 18)), last=-1),
        "faults of sensors": "none" if n == 0 else "1 or 2" if n <= 2 else "3 or more",
    }
    return found | {name.replace("_", " "): "with" if name in nuisances else "without" for name in NUISANCES}


def _is_another_machine(truth: Mapping[str, Any]) -> bool:
    return truth.get("benches", "own") == "foreign" and "machine" not in truth.get("without", ())


def _bin(edges: Sequence[float], value: float, *, last: int = 0) -> str:
    """Name the bin of a value; `last` is added to the upper edge that is shown."""
    k = int(np.clip(np.searchsorted(edges, value, side="right"), 1, len(edges) - 1))
    return f"{edges[k - 1]:g} to {edges[k] + last:g}"
