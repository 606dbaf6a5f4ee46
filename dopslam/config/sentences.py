"""What is wrong with a configuration, in one sentence that names the key with its path, its value, and the remedy."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Models that a value of this annotation may be."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in models_in(part)]


def _walk(root: type[BaseModel], loc: tuple) -> tuple[list[str], list[str]]:
    """Names of an error's location, the tags of unions left out, and of the keys allowed beside the last of them."""
    annotation: Any = root
    names, beside = [], []
    for part in loc:
        models = models_in(annotation)
        tagged = [m for m in models if len(models) > 1 and part in _tags(m)]
        if tagged:
            annotation = tagged[0]
            continue
        names.append(str(part))
        if models and isinstance(part, str):
            beside = list(models[0].model_fields)
            annotation = models[0].model_fields[part].annotation if part in beside else None
    return names, beside


def _tags(model: type[BaseModel]) -> tuple:
    """Values of ``kind`` by which a union knows this model."""
    kind = model.model_fields.get("kind")
    return getattr(kind.annotation, "__args__", ()) if kind is not None else ()


def shown(value: Any) -> str:
    """A value as it may stand in one line."""
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:80]}… ({len(text)} characters)"


def sentence(error: ValidationError, root: type[BaseModel]) -> str:
    """What is wrong with the first wrong key of a tree that should be a ``root``: key, value, what is allowed."""
    first = error.errors()[0]
    names, allowed = _walk(root, tuple(first["loc"]))
    key = ".".join(names)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        begun = [name for name in allowed if len(names[-1]) > 3 and name.startswith(names[-1])]  # carrier(_frequency)
        near = begun or difflib.get_close_matches(names[-1], allowed, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys here: {', '.join(allowed)}"
        return f"unknown key {shown(key)}; {hint}{more}"
    if first["type"] == "missing":
        gone = [".".join(_walk(root, tuple(e["loc"]))[0]) for e in error.errors() if e["type"] == "missing"]
        if len(gone) > 1:
            return f"keys {', '.join(gone)} are missing"
        return f"key {key!r} is missing{more}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key} = {shown(first['input'])}: {message}{more}" if key else f"{message}{more}"
