"""The results folder of a run: made under a hidden name, moved into place when complete, with a ``latest`` link."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import math
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from dopslam.errors import DatasetError

PACKAGES = ("dopslam", "sionna-rt", "mitsuba", "drjit", "numpy", "scipy", "numba", "h5py", "pydantic", "matplotlib")


def versions() -> dict[str, str]:
    """Versions of the interpreter and of the packages that decide results."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


@contextlib.contextmanager
def results_folder(root: str | Path, name: str) -> Iterator[tuple[Path, Path]]:
    """Yield (working folder, final folder) for ``<root>/<name>-<time>``.

    If the run fails or is interrupted, a dataset that was finished until then is kept in ``<final>-unfinished``, which a
    note on the error names; without one nothing is left behind.

    Raises
    ------
    DatasetError
        If the folder cannot be made.
    """
    root = Path(root)
    made = not root.exists()
    final = root / f"{safe_name(name)}-{datetime.now():%Y%m%d-%H%M%S}"
    suffix = 0
    while final.exists():
        suffix += 1
        final = final.with_name(f"{final.name.split('+')[0]}+{suffix}")
    working = root / f".{final.name}.part"
    try:
        working.mkdir(parents=True)
    except OSError as error:
        raise DatasetError(
            f"{root}: cannot make a results folder ({error.strerror}); name another with --out"
        ) from error
    try:
        yield working, final
        os.replace(working, final)
    except BaseException as error:
        if (working / "dataset.h5").exists():
            kept = final.with_name(f"{final.name}-unfinished")
            with contextlib.suppress(OSError):
                os.replace(working, kept)
                error.add_note(f"what was finished is in {kept}")
        raise
    finally:
        shutil.rmtree(working, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # not empty after a run that went well
                root.rmdir()
    _link_latest(root, final)


def safe_name(name: str) -> str:
    """A name as it may stand in a file name anywhere: no separators or control characters, at most 100 bytes."""
    plain = "".join("_" if c in '/\\:*?"<>|' or not c.isprintable() else c for c in name).strip(". ") or "run"
    return plain.encode()[:100].decode(errors="ignore")


def _link_latest(root: Path, final: Path) -> None:
    link = root / f".latest-{os.getpid()}"
    # A file system without links, or a folder called "latest", is no reason to fail after all the work.
    with contextlib.suppress(OSError):
        link.symlink_to(final.name)
        os.replace(link, root / "latest")
    link.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole or not at all; makes its folder if that is missing.

    Raises
    ------
    DatasetError
        If it cannot be written.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    text = text.encode(errors="surrogatepass").decode(errors="replace")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(part, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        kept = _kept_elsewhere(path, text)
        raise DatasetError(f"{path}: cannot be written ({error.strerror}); name another place{kept}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _kept_elsewhere(path: Path, text: str) -> str:
    """Save what cannot go where it should in the folder for temporary files; says where, or nothing if that fails too."""
    with contextlib.suppress(OSError):
        place = Path(tempfile.mkdtemp(prefix="dopslam-")) / path.name
        place.write_text(text, encoding="utf-8")
        return f"; the content is kept in {place}"
    return ""


def write_json(path: str | Path, content: dict) -> None:
    """Write JSON whole or not at all; no NaN, so that every reader takes it."""
    write_text(path, json.dumps(_finite(content), indent=2, allow_nan=False) + "\n")


def _finite(content: Any) -> Any:
    """The same with null for what is no finite number, which JSON cannot say."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
