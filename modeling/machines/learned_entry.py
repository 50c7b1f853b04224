"""The entry `learned` of an `[effects]` table: a learned term with its nodes and values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from sawbench.bench.errors import ConfigError
from sawbench.bench.plain_digits import rounded
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import (
    LEAST_NODES,
    MOST_QUANTITIES,
    QUANTITIES,
    SITES,
    LearnedTerm,
    learned_effect,
)

_REQUIRED: Final = ("equation", "quantities", "nodes", "values", "stds")
_KEYS: Final = (*_REQUIRED, "cutting_only", "scale", "std")
_REMEDY: Final = "copy the entry unchanged from improved_model.toml of `sawbench diagnose`"
# Of the spacing: nodes are evenly spaced to the digits that are written.
_EVEN: Final = 1e-3


def learned_entry(known: KnownEffect) -> dict[str, Any]:
    """Write a learned term as its entry, which `read_learned` reads back."""
    term = known.effect.signature
    assert isinstance(term, LearnedTerm)
    return {
        "equation": term.site,
        "quantities": list(term.quantities),
        "cutting_only": term.is_cutting_only,
        "scale": known.value,
        "std": known.std,
        "nodes": [[float(f"{v:.8g}") for v in nodes] for nodes in term.nodes],
        "values": _rounded(term.values),
        "stds": _rounded(term.stds),
    }


def read_learned(entry: Mapping[str, Any], where: str) -> KnownEffect:
    """Read the entry.

    Parameters
    ----------
    entry : mapping
        "equation" (a site), "quantities", "nodes" (a list each), "values" and "stds" (nested lists, one level a
        quantity); "cutting_only", "scale" and "std" (of the scale) may be absent.
    where : str
        File and entry, for the error.

    Raises
    ------
    ConfigError
        If a key is missing, unknown, or does not fit the others.
    """
    _check_keys(entry, where)
    names = _quantities(entry["quantities"], where)
    nodes = entry["nodes"]
    if not isinstance(nodes, list) or len(nodes) != len(names):
        raise ConfigError(f"nodes must hold a list for each of {', '.join(names)}, got {nodes!r}", where=where)
    places = [_nodes(values, name, where) for name, values in zip(names, nodes, strict=True)]
    shape = tuple(len(place) for place in places)
    values, stds = (_array(entry[key], key, where) for key in ("values", "stds"))
    if values.shape != shape or stds.shape != shape or np.any(stds < 0.0):
        raise ConfigError(
            f"values and stds (not negative) need the shape {shape} of the nodes, got {values.shape} and {stds.shape}",
            where=where,
            remedy=_REMEDY,
        )
    cutting_only = entry.get("cutting_only", False)
    if not isinstance(cutting_only, bool):
        raise ConfigError(f"cutting_only must be true or false, got {cutting_only!r}", where=where)
    scale, std = (_array(entry.get(key, default), key, where) for key, default in (("scale", 1.0), ("std", 0.0)))
    if scale.ndim or std.ndim or float(std) < 0.0:
        raise ConfigError("scale and std must be numbers, std not negative", where=where)
    term = LearnedTerm(
        site=entry["equation"],
        quantities=names,
        nodes=tuple(tuple(place.tolist()) for place in places),
        values=values,
        stds=stds,
        is_cutting_only=cutting_only,
    )
    return KnownEffect(effect=learned_effect(term), value=float(scale), std=float(std))


def _check_keys(entry: Mapping[str, Any], where: str) -> None:
    for key in entry:
        if key not in _KEYS:
            raise ConfigError(f"unknown key {key!r}", where=where, remedy=f"allowed here: {', '.join(_KEYS)}")
    for key in _REQUIRED:
        if key not in entry:
            raise ConfigError(f"missing key {key!r}", where=where, remedy=_REMEDY)
    if entry["equation"] not in list(SITES):
        raise ConfigError(
            f"equation must be one of {', '.join(SITES)}, got {entry['equation']!r}", where=where, remedy=_REMEDY
        )


def _quantities(stated: Any, where: str) -> tuple[str, ...]:
    names = [str(name) for name in stated] if isinstance(stated, list) else []
    is_right = 1 <= len(names) <= MOST_QUANTITIES and len(set(names)) == len(names) and set(names) <= set(QUANTITIES)
    if not is_right:
        raise ConfigError(
            f"quantities must be one to {MOST_QUANTITIES} different ones of {', '.join(QUANTITIES)}, got {stated!r}",
            where=where,
        )
    return tuple(names)


def _nodes(stated: Any, name: str, where: str) -> Floats:
    place = _array(stated, "nodes", where)
    if place.ndim != 1 or len(place) < LEAST_NODES or np.any(np.diff(place) <= 0.0):
        raise ConfigError(f"nodes of {name} must be {LEAST_NODES} or more increasing numbers", where=where)
    if QUANTITIES[name].is_periodic:
        turn = np.arange(len(place)) * 2.0 * np.pi / len(place)
        if np.abs(place - turn).max() > _EVEN * turn[1]:
            raise ConfigError(
                f"nodes of {name} must divide one turn evenly, starting at 0", where=where, remedy=_REMEDY
            )
        return turn
    return place


def _array(stated: Any, key: str, where: str) -> Floats:
    try:
        found = np.array(stated, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if not np.isfinite(found).all():
        raise ConfigError(f"{key} must hold finite numbers, lists of equal length", where=where, remedy=_REMEDY)
    return found


def _rounded(values: Floats) -> Any:
    return np.vectorize(rounded, otypes=[float])(values).tolist()
