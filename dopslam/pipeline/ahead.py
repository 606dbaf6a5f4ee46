"""Filters compiled ahead of their first use on a machine, by a process beside the stages before them.

Their machine code is kept on disk (:mod:`estimation.jit`), so that only the first run with a new version ever waits.
Whether it is there already says a mark in the same folder, named by everything that it is made from.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from dopslam.config.scenario import load
from dopslam.errors import DopslamError
from dopslam.pipeline import stages
from estimation import jit

STEPS = 4  # of the drive that every kernel is compiled on
_PACKAGE = Path(__file__).resolve().parents[1]
_COMPILED = ("slam", "models", "compute")  # rooms with kernels


def compile_filters(names: Sequence[str]) -> None:
    """Run filters over a few steps drawn from the model, with Doppler and without, and leave a mark for each."""
    scenario = load("ring_road", ["source.kind=model", f"track.steps={STEPS}"])
    _, _, detections = stages.simulate(scenario, 0)
    for name in names:
        for doppler in (True, False):
            with contextlib.suppress(DopslamError):  # few steps may be too few for it; it is compiled by then
                stages.slam(scenario, detections, name, doppler)
        remember([name])


def missing(names: Sequence[str]) -> list[str]:
    """Those of the filters that were never compiled here; none where nothing can be kept."""
    marks = {name: _mark(name) for name in names if ":" not in name}
    return [name for name, mark in marks.items() if mark is not None and not mark.exists()]


def remember(names: Sequence[str]) -> None:
    """Leave a mark that filters were compiled here."""
    for name in missing(names):
        mark = _mark(name)
        if mark is not None:
            with contextlib.suppress(OSError):
                mark.touch()


@contextlib.contextmanager
def compiling(names: Sequence[str]) -> Iterator[subprocess.Popen | None]:
    """A process that compiles what is :func:`missing` while the body runs, None if nothing is; it ends with the body."""
    cold = missing(names)
    if not cold:
        yield None
        return
    code = f"from dopslam.pipeline import ahead; ahead.work({cold!r})"
    with contextlib.ExitStack() as opened:
        child = opened.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )
        )  # fmt: skip
        opened.callback(child.kill)
        yield child


def work(names: Sequence[str]) -> None:
    """What the process of :func:`compiling` does: it ends with the process that started it, however that ends."""

    def follow() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=follow, daemon=True).start()
    compile_filters(names)


def _mark(name: str) -> Path | None:
    folder = jit.writable(jit.cache_folder())
    return None if folder is None else folder / f"compiled-{name}-{_sources()}"


@cache
def _sources() -> str:
    digest = hashlib.sha256(jit.machine())
    for room in _COMPILED:
        for file in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(str(file.relative_to(_PACKAGE)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:24]
