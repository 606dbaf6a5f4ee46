"""Tables of what is chosen by name: estimators, filters, formats. A name is spelled in one table and nowhere else.

An entry is written ``"module:object"`` and imported when it is asked for, so that listing names costs nothing. A package
installed beside adds its own by an entry point of the table's group; one's own class needs no name: ``"module:Class"``,
or ``"path/to/file.py:Class"`` for a module that is not installed.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any


class Table(Mapping[str, Any]):
    """Names and what they stand for.

    Parameters
    ----------
    what : what an entry is, for messages, e.g. ``"filter"``
    group : entry-point group of plug-ins, e.g. ``"dopslam.filters"``
    entries : name → ``"module:object"``
    error : raised for what cannot be found
    """

    def __init__(self, what: str, group: str, entries: Mapping[str, str], error: type[Exception]) -> None:
        self._what, self._group, self._own, self._error = what, group, dict(entries), error

    @property
    def shipped(self) -> Mapping[str, str]:
        """The names of this package alone, with where they lie; nothing is imported."""
        return self._own

    def _all(self) -> dict[str, str]:
        announced = _announced(self._group, tuple(sys.path), importlib.metadata.entry_points)
        return self._own | {name: where for name, where in announced.items() if name not in self._own}

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self._all() or ":" in name)

    def sound(self) -> dict[str, Any]:
        """What all names stand for, but those of plug-ins that cannot be imported: for messages that look at all."""
        found = {}
        for name in self:
            with contextlib.suppress(self._error):
                found[name] = self[name]
        return found

    def checked(self, name: str) -> str:
        """The name if it is known or can be a ``module:Class``; nothing is imported.

        Raises
        ------
        error
            With the nearest known name.
        """
        module, colon, attribute = name.partition(":")
        known = self._all()
        if name in known or (colon and module and attribute.isidentifier()):
            return name
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}."
        raise self._error(
            f"no such {self._what} as {name!r}; {hint} One of your own is 'module:Class' or 'path/to/file.py:Class'"
        )

    def __getitem__(self, name: str) -> Any:
        """What a name, ``module:Class`` or ``file.py:Class`` stands for.

        Raises
        ------
        error
            With the nearest known name, or why the module gives no such object.
        """
        where = self._all().get(self.checked(name), name)
        module, _, attribute = where.partition(":")
        try:
            found = getattr(_imported(module), attribute, None)
        except Exception as error:  # a plug-in can fail at import in any way
            raise self._error(
                f"{self._what} {name!r}: module {module!r} cannot be imported ({type(error).__name__}: {error}); install "
                "it, put its folder on PYTHONPATH, or give its file, 'path/to/file.py:Class'"
            ) from error
        if not callable(found):
            raise self._error(f"{self._what} {name!r}: module {module!r} has no class {attribute!r}")
        return found


@lru_cache
def _announced(group: str, path: tuple[str, ...], entry_points: Callable[..., Any]) -> Mapping[str, str]:
    """Entry points of a group, name → where; all metadata on the path are read for it, which takes many milliseconds."""
    return {point.name: point.value for point in entry_points(group=group)}


def _imported(module: str) -> Any:
    if not module.endswith(".py"):
        return importlib.import_module(module)
    path = Path(module).resolve()
    name = f"dopslam_own_{path.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None) == str(path):
        return loaded
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError(f"no file {module}")
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded  # dataclasses look their module up
    try:
        spec.loader.exec_module(loaded)
    except BaseException:
        del sys.modules[name]
        raise
    return loaded


def of_the_house(thing: Any) -> bool:
    """Whether an object, class or error comes from these packages, and not from a plug-in or from Python."""
    return str(getattr(thing, "__module__", "")).partition(".")[0] in ("dopslam", "estimation")


@contextlib.contextmanager
def blamed(thing: Any, where: str, error: type[Exception]) -> Iterator[None]:
    """What fails in a plug-in is a fault of the plug-in, and said to be.

    Parameters
    ----------
    thing : the plug-in or its class; faults of what is of this house, and its errors, are let through
    where : what it was doing, for the message
    error : raised instead
    """
    try:
        yield
    except Exception as fault:
        if of_the_house(thing) or of_the_house(fault):
            raise
        raise error(f"{where}: {type(fault).__name__}: {fault} (DOPSLAM_DEBUG=1 shows where)") from fault
