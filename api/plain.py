"""Results as plain values, for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any


def plain(value: Any) -> Any:  # noqa: PLR0911
    """Turn a result into what JSON can say; a number that is not finite becomes null.

    Examples
    --------
    >>> plain({"a": float("nan"), "b": Path("x")})
    {'a': None, 'b': 'x'}
    """
    if isinstance(value, type):
        raise TypeError(f"cannot write the class {value.__name__} as JSON")
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, datetime):
        return value.isoformat()
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
