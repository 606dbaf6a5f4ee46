"""Faults of a configuration as sentences."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError


def _fields_at(loc: tuple, model: Any) -> list[str]:
    """Names of the keys allowed beside the last part of an error's location."""
    for part in loc[:-1]:
        if isinstance(model, type) and issubclass(model, BaseModel) and part in model.model_fields:
            model = _inner_model(model.model_fields[part].annotation, loc)
    return list(model.model_fields) if isinstance(model, type) and issubclass(model, BaseModel) else []


def _inner_model(annotation: Any, loc: tuple) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    candidates = [m for arg in getattr(annotation, "__args__", ()) if (m := _inner_model(arg, loc)) is not None]
    tagged = [m for m in candidates if "kind" in m.model_fields and m.model_fields["kind"].default in loc]
    return (tagged or candidates or [None])[0]


_TAGS = {"cylinder", "planar", "custom", "motion", "line", "circle", "drive"}  # of unions


def sentence(error: ValidationError, model: type[BaseModel]) -> str:
    """The first fault of a validation: the key with its path, the value, and for a misspelt key the nearest right one."""
    first = error.errors()[0]
    loc = tuple(first["loc"])
    key = ".".join(str(part) for part in loc if part not in _TAGS or part == loc[-1])
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        allowed = _fields_at(loc, model)
        near = difflib.get_close_matches(str(loc[-1]), allowed, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys here: {', '.join(allowed)}"
        return f"unknown key {key!r}; {hint}{more}"
    if first["type"] == "missing":
        return f"key {key!r} is missing{more}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key or 'scenario'} = {first['input']!r}: {message}{more}" if key else f"{message}{more}"
