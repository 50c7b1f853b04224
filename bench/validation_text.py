"""Errors of pydantic in words: a line per offending key, with what is allowed there."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError

# What the command line calls otherwise.
_SYNONYMS = {"material": "workpiece", "thickness": "thickness_mm", "feed": "feed_mm_s"}


def describe_validation(error: ValidationError, model: type[BaseModel]) -> str:
    """Turn a pydantic error into one line per offending key, with the nearest allowed key.

    Parameters
    ----------
    error : ValidationError
    model : type of BaseModel
        The model that was validated, for the suggestions.
    """
    lines = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        got = item.get("input")
        if item["type"] == "extra_forbidden":
            allowed = _allowed_keys(model, item["loc"][:-1])
            last = str(item["loc"][-1])
            close = difflib.get_close_matches(_SYNONYMS.get(last, last), allowed, n=1, cutoff=0.5)
            hint = f"did you mean {close[0]!r}?" if close else f"allowed here: {', '.join(allowed) or 'nothing'}"
            lines.append(f"unknown key {key!r}; {hint}")
        elif item["type"] == "missing":
            lines.append(f"missing key {key!r}")
        else:
            message = item["msg"].removeprefix("Value error, ")
            shown = f" (got {got!r})" if isinstance(got, str | int | float | bool) else ""
            is_quoted = item["type"] in ("float_type", "int_type") and isinstance(got, str) and _is_number(got)
            shown += "; write numbers without quotes" if is_quoted else ""
            lines.append(f"{key}: {message}{shown}" if key else f"{message}{shown}")
    return lines[0] if len(lines) == 1 else f"{len(lines)} problems:\n  " + "\n  ".join(lines)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _allowed_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    for part in location:
        field = model.model_fields.get(str(part))
        # What is no field is a name of the user's own in a mapping: the model stays that of the mapping's values.
        nested = model if field is None else _nested_model(field.annotation)
        if nested is None:
            return []
        model = nested
    return list(model.model_fields)


def _nested_model(annotation: Any) -> type[BaseModel] | None:
    """Return the model that an annotation is, holds as an option, or maps to."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = (_nested_model(part) for part in getattr(annotation, "__args__", ()))
    return next((found for found in inner if found is not None), None)
