"""Every key of a scenario with what it may be, read from the models that validate it."""

from __future__ import annotations

from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from dopslam.config.scenario import Scenario
from dopslam.config.sentences import models_in, shown


@dataclass(frozen=True)
class Key:
    """A key with its path, what it may be (ranges included), and its default as written in TOML; empty if required."""

    name: str
    allowed: str
    default: str


def listed(prefix: str = "", model: type[BaseModel] = Scenario) -> list[Key]:
    """Keys of a model and of those below it, in their order, tables of a union one after the other."""
    found: list[Key] = []
    for name, field in model.model_fields.items():
        inner = models_in(field.annotation)
        path = f"{prefix}{name}"
        if inner:
            for part in inner:
                found += [key for key in listed(f"{path}.", part) if key not in found]
            continue
        default = "" if field.is_required() or field.get_default(call_default_factory=True) is None else _toml(field)
        found.append(Key(path, said(field.annotation, list(field.metadata)), default))
    return found


def _toml(field: Any) -> str:
    value = field.get_default(call_default_factory=True)
    return str(value).lower() if isinstance(value, bool) else shown(list(value) if isinstance(value, tuple) else value)


def said(annotation: Any, metadata: list | None = None) -> str:
    """What a value of this annotation may be, in words."""
    origin, args = get_origin(annotation), get_args(annotation)
    limits = metadata or []
    if origin is Annotated:
        return said(args[0], [*args[1:], *limits])
    if origin in (Union, UnionType):
        return " or ".join(said(part, limits) for part in args if part is not type(None))
    if origin is Literal:
        return " | ".join(map(str, args))
    if origin is tuple:
        return f"list of {said(args[0])}" if args[-1] is Ellipsis else f"{len(args)} × {said(args[0])}"
    name = {int: "whole number", float: "number", str: "text", bool: "true | false"}.get(annotation, "table")
    return f"{name} {span(limits)}".strip()


def span(limits: list) -> str:
    """A range in words, from the constraints of a number; empty without one."""
    bounds: dict[str, Any] = {}
    for item in (part for limit in limits for part in (getattr(limit, "metadata", None) or [limit])):
        bounds |= {
            kind: getattr(item, kind) for kind in ("ge", "gt", "le", "lt") if getattr(item, kind, None) is not None
        }
    low = f"from {bounds['ge']:g}" if "ge" in bounds else f"above {bounds['gt']:g}" if "gt" in bounds else ""
    high = f"to {bounds['le']:g}" if "le" in bounds else f"below {bounds['lt']:g}" if "lt" in bounds else ""
    return f"{low} {high}".strip()
