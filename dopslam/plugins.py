"""Tables of what is chosen by name: filters, formats. A name is spelled in one table and nowhere else.

An entry is written ``"module:object"`` and imported when it is asked for, so that listing names costs nothing. A package
installed beside adds its own by an entry point of the table's group; one's own class needs no name: ``module:Class``.
"""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import Any

from dopslam.errors import ConfigError


class Table(Mapping[str, Any]):
    """Names and what they stand for.

    Parameters
    ----------
    what : what an entry is, for messages, e.g. ``"filter"``
    group : entry-point group of plug-ins, e.g. ``"dopslam.filters"``
    entries : name → ``"module:object"``
    """

    def __init__(self, what: str, group: str, entries: Mapping[str, str]) -> None:
        self._what, self._group, self._entries = what, group, dict(entries)

    def _all(self) -> dict[str, str]:
        found = {point.name: point.value for point in entry_points(group=self._group)}
        return self._entries | {name: value for name, value in found.items() if name not in self._entries}

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self._all() or ":" in name)

    def __getitem__(self, name: str) -> Any:
        """What a name, or ``module:object``, stands for.

        Raises
        ------
        ConfigError
            With the nearest right name, or why the module gives no such object.
        """
        where = name if ":" in name else self._all().get(name)
        if where is None:
            near = difflib.get_close_matches(name, self, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(self)}"
            raise ConfigError(f"no {self._what} named {name!r}; {hint} (one of your own: 'module:Class')")
        module, _, attribute = where.partition(":")
        try:
            found: Any = _imported(module)
            for part in attribute.split("."):
                found = getattr(found, part)
        except Exception as error:  # a plug-in can fail at import in any way
            raise ConfigError(
                f"{self._what} {name!r}: {where} cannot be loaded ({type(error).__name__}: {error}); "
                "the module must be importable from here (current folder or PYTHONPATH)"
            ) from error
        return found


def _imported(module: str) -> Any:
    """A module, also from the folder that the command was given in."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0] or "" in sys.path:
            raise
    sys.path.insert(0, "")
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove("")
