"""Results as JSON and back, whole: dataclasses, tuples, mappings, arrays, times, numbers that are not finite."""

from __future__ import annotations

import dataclasses
import json
import types
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")


def as_json(value: Any) -> str:
    """Return a result as JSON that `from_json` restores.

    Examples
    --------
    >>> from sawbench.bench.processed import Phase
    >>> from_json(Phase, as_json(Phase(kind="rest", start_s=0.0, end_s=1.5)))
    Phase(kind='rest', start_s=0.0, end_s=1.5)
    """
    return json.dumps(_stored(value), separators=(",", ":"))


def from_json(kind: type[T], text: str) -> T:
    """Restore a result of the class `kind` from what `as_json` returned.

    Raises
    ------
    ValueError, TypeError, KeyError
        If the text is of another class, or of another version of it.
    """
    return _restored(kind, json.loads(text))


def _stored(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {field.name: _stored(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _stored(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_stored(item) for item in value]
    if isinstance(value, datetime):
        return value.isoformat()
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


_hints = cache(get_type_hints)


def _restored(kind: Any, value: Any) -> Any:  # noqa: PLR0911 (one a kind of annotation)
    """Follow the annotations of the class; what JSON holds as it is needs nothing done."""
    if value is None:
        return None
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        (kind,) = (one for one in arguments if one is not types.NoneType)
        return _restored(kind, value)
    if dataclasses.is_dataclass(kind):
        hints = _hints(kind)
        return kind(**{name: _restored(hints[name], item) for name, item in value.items()})  # pyright: ignore[reportCallIssue]
    if origin is tuple:
        return tuple(_restored(arguments[0], item) for item in value)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: _restored(arguments[1], item) for key, item in value.items()}
    if origin is np.ndarray:
        return np.asarray(value, dtype=get_args(arguments[1])[0])
    return datetime.fromisoformat(value) if kind is datetime else value
