"""Just-in-time compilation with a disk cache that cannot go stale, and that no fault of the disk can break.

Numba's own cache looks at the file of the compiled function alone: where a callee in another module has changed, it
runs the old machine code. Here every folder of the cache is named by a hash of everything the machine code was made
from (:func:`fingerprint`), so that changed code finds no cache and compiles. Folders that were not used for a month are
deleted.

The cache lies in ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache folder (``XDG_CACHE_HOME`` or
``~/.cache``). Checkouts and installations with the same code share it, and so do processes at the same time: entries
are written under a lock. A folder that cannot be written is read all the same; where there is none or an entry cannot be
read, kernels compile anew: slower, never broken.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import pickle
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache

KEPT_DAYS = 30  # a folder of the cache that nothing used for so long is deleted
KEPT_FOLDERS = 200  # and at most so many stay
_SCALARS = (bool, int, float, complex, str, bytes, np.generic)
_ROOT = Path(__file__).resolve().parent


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """``numba.njit`` with an on-disk cache where one can be kept, without otherwise."""
    return cached(function, _ROOT, nogil=True, fastmath=True, error_model="numpy")


def cached(function: Callable[..., Any], root: Path, **options: Any) -> Any:
    """``numba.njit(**options)`` of a function, its machine code kept on disk if a folder can be written.

    Parameters
    ----------
    function : to be compiled at its first call
    root : folder of the package whose sources the machine code is made from
    options : of ``numba.njit``
    """
    dispatcher: Any = numba.njit(**options)(function)
    folder = cache_folder()
    if folder is not None and (writable(folder) or folder.is_dir()):  # what another one filled can be read
        with contextlib.suppress(OSError, AttributeError):  # the source cannot be read; a numba without this cache
            dispatcher._cache = _Cache(function, folder / fingerprint(function, root))
    return dispatcher


def cache_folder() -> Path | None:
    """The folder of all compiled kernels, whether or not it can be written; None without a home folder."""
    chosen = getattr(config, "CACHE_DIR", "")  # numba sets its names from the environment
    if chosen:
        return Path(chosen) / "dopslam"
    named = os.environ.get("XDG_CACHE_HOME")
    if named and os.path.isabs(named):
        return Path(named) / "dopslam" / "numba"
    try:
        return Path.home() / ".cache" / "dopslam" / "numba"
    except RuntimeError:
        return None


@lru_cache(maxsize=8)
def writable(folder: Path | None) -> Path | None:
    """The folder, made if need be, or None if nothing can be written there."""
    if folder is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    return folder


@cache
def machine() -> bytes:
    """Versions and processor: machine code of other ones is another's."""
    versions = (sys.version, numba.__version__, llvmlite.__version__, np.__version__, platform.machine())
    features = llvmlite.binding.get_host_cpu_features().flatten()
    return repr((versions, llvmlite.binding.get_host_cpu_name(), features)).encode()


@cache
def _sources(folder: Path) -> bytes:
    """Hash of the sources of one folder: kernels hand records to each other that only a neighbor defines."""
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.digest()


@cache
def fingerprint(function: Callable[..., Any], root: Path) -> str:
    """Hash of everything that the machine code of a function is made from.

    That is: versions and processor; the sources of the function's own folder; and of what its module uses from other
    folders of the package, the fingerprints of kernels, the fields of records and the values of constants, which a
    kernel freezes.
    """
    folder = Path(inspect.getfile(function)).resolve().parent
    digest = hashlib.sha256(machine() + _sources(folder))
    for name, value in sorted(function.__globals__.items()):
        if name.startswith("__"):
            continue
        for part in _ingredients(value, folder, root):
            digest.update(name.encode() + b"\0" + part)
    return f"{function.__module__.rpartition('.')[0]}-{digest.hexdigest()[:24]}"


def _ingredients(value: Any, folder: Path, root: Path) -> Iterator[bytes]:
    source = getattr(value, "py_func", None)
    if source is not None:
        where = Path(inspect.getfile(source)).resolve().parent
        if where != folder:  # a kernel from elsewhere
            yield (fingerprint(source, root) if root in (where, *where.parents) else str(source.__code__)).encode()
    elif isinstance(value, type) and hasattr(value, "_fields"):
        yield repr((value._fields, value.__annotations__)).encode()
    elif isinstance(value, _SCALARS) or (isinstance(value, tuple) and all(isinstance(v, _SCALARS) for v in value)):
        yield repr(value).encode()
    elif isinstance(value, np.ndarray):
        yield value.tobytes()
    elif isinstance(value, ModuleType) and getattr(value, "__file__", None):
        where = Path(str(value.__file__)).resolve().parent
        if where != folder and root in (where, *where.parents):
            yield _sources(where)


class _Locator:
    """Where the machine code of one function lies; what numba asks of a locator."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._py_file = inspect.getfile(function)
        self._line = function.__code__.co_firstlineno
        self._folder = folder

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Cache(FunctionCache):
    """Numba's cache of one function, in a folder of our choice, written under a lock, silent about a broken disk."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        class Implementation(CompileResultCacheImpl):
            _locator_classes = (
                type("Here", (), {"from_function": staticmethod(lambda *_: _Locator(function, folder))}),
            )

        self._impl_class = Implementation
        self._folder = folder
        super().__init__(function)
        _mark_used(folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # torn or foreign bytes: as good as no entry
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):  # a full or read-only disk costs the entry, not the result
            new = not self._folder.exists()
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if new:
                prune(self._folder.parent)
            with locked(self._folder / "lock"):
                try:
                    super().save_overload(sig, data)
                except (pickle.UnpicklingError, EOFError, ValueError):  # a torn index: begin a new one
                    self.flush()
                    super().save_overload(sig, data)


@contextlib.contextmanager
def locked(file: Path, wait: bool = True) -> Iterator[bool]:
    """Hold a lock between processes; says whether it is held, which without waiting it may not be.

    Two processes that add to one index at once would name their entries alike.
    """
    try:
        import fcntl
    except ImportError:  # not a POSIX system; numba guards against errors of its own there
        yield True
        return
    with open(file, "ab") as handle:
        held = True
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held = False
        except OSError:  # a network disk without locks
            pass
        yield held


@cache
def _mark_used(folder: Path) -> None:
    with contextlib.suppress(OSError):  # not there yet, or not ours to touch
        os.utime(folder)


def prune(root: Path, now: float | None = None) -> None:
    """Delete the folders of the cache that were not used for :data:`KEPT_DAYS`, and the oldest ones beyond
    :data:`KEPT_FOLDERS`."""
    now = time.time() if now is None else now
    with contextlib.suppress(OSError):
        ages = sorted((now - folder.stat().st_mtime, folder) for folder in root.iterdir() if folder.is_dir())
        for place, (age, folder) in enumerate(ages):
            if place >= KEPT_FOLDERS or age > KEPT_DAYS * 86400:
                shutil.rmtree(folder, ignore_errors=True)
