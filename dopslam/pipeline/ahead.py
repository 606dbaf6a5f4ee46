"""Filters on a machine that never compiled them: nobody waits for machine code.

Compilation takes a minute and more, once; the machine code is kept on disk (:mod:`estimation.jit`), and a mark in the same
folder, named by everything that it is made from, says that it is there. Until then the kernels are what they are written
in, Python over NumPy: some hundred times slower a step, and yet far sooner done with a run of ordinary length. So a
process interprets the filter while another compiles it, and what is ready first answers (:func:`sooner`). The numbers are
the same to rounding. Both processes import what this one imports, and end with it. A filter of one's own is run here: it
may print, draw on what only this process holds, or not be ours to run twice.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import config

from dopslam.config.scenario import load
from dopslam.errors import DopslamError
from dopslam.filters import FILTERS
from dopslam.pipeline import stages
from estimation import jit

PATIENCE = 0.05  # s between two looks at what is ready
GO_ON = b"go on"
STEPS = 4  # of the drive that every kernel is compiled on
_PACKAGE = Path(__file__).resolve().parents[1]
_COMPILED = ("slam", "models", "compute")  # rooms with kernels


def compile_filters(names: Sequence[str]) -> None:
    """Run filters over a few steps drawn from the model, with Doppler and without, and leave a mark for each.

    One process at a time does so; a second one leaves it to the first.
    """
    folder = jit.writable(jit.cache_folder())
    with contextlib.nullcontext(True) if folder is None else jit.locked(folder / "compiling", wait=False) as mine:
        if not mine:
            return
        scenario = load("ring_road", ["source.kind=model", f"track.steps={STEPS}"])
        _, _, detections = stages.simulate(scenario, 0)
        for name in missing(names):
            for doppler in (True, False):
                with contextlib.suppress(DopslamError):  # few steps may be too few for it; it is compiled by then
                    stages.slam(scenario, detections, name, doppler)
            mark = _mark(name)
            if mark is not None:
                with contextlib.suppress(OSError):
                    mark.touch()


def missing(names: Sequence[str]) -> list[str]:
    """Those of the house's filters that were never compiled here; none where nothing can be kept or is compiled."""
    if getattr(config, "DISABLE_JIT", 0):  # numba sets its names from the environment
        return []
    marks = {name: _mark(name) for name in names if name in FILTERS.shipped}
    return [name for name, mark in marks.items() if mark is not None and not mark.exists()]


def sooner(names: Sequence[str], function: Callable[..., Any], *arguments: Any) -> Any:
    """``function(*arguments)``, interpreted by another process as long as the filters it needs are not compiled.

    Parameters
    ----------
    names : of the filters
    function : of a module, so that another process finds it by its name
    arguments : records of ours
    """
    if not missing(names):
        return function(*arguments)
    with compiling(names) as compiler:
        found = _interpreted(names, function, arguments)
        if found is not None:
            go_on(compiler)
            result, error = found
            if error is not None:
                raise error
            return result
        while compiler is not None and compiler.poll() is None and missing(names):
            time.sleep(PATIENCE)
    return function(*arguments)


def _interpreted(
    names: Sequence[str], function: Callable[..., Any], arguments: Sequence[Any]
) -> tuple[Any, DopslamError | None] | None:
    """What another process found, or the error that it refused with; None if it has not, or machine code came first."""
    try:
        job = pickle.dumps((function, arguments))
    except (pickle.PicklingError, AttributeError, TypeError):  # a part that only this process has
        return None
    with contextlib.suppress(OSError), tempfile.TemporaryDirectory(prefix="dopslam-") as folder:
        given, answer = Path(folder) / "job", Path(folder) / "answer"
        given.write_bytes(job)
        with _child(f"interpret({str(given)!r}, {str(answer)!r})", NUMBA_DISABLE_JIT="1") as reader:
            while reader is not None and reader.poll() is None and missing(names):
                time.sleep(PATIENCE)
        return pickle.loads(answer.read_bytes()) if answer.exists() else None
    return None  # no place for files


@contextlib.contextmanager
def compiling(names: Sequence[str]) -> Iterator[subprocess.Popen | None]:
    """A process that compiles what is :func:`missing` while the body runs, None if nothing is; it ends with the body.

    It is soon done where another one is at it already.
    """
    cold = missing(names)
    with _child(f"compile_filters({cold!r})") if cold else contextlib.nullcontext() as child:
        yield child


def go_on(compiler: subprocess.Popen | None) -> None:
    """Let a process of :func:`compiling` finish after its parent has gone, so that the next run finds machine code."""
    if compiler is None:
        return
    assert compiler.stdin is not None
    with contextlib.suppress(OSError), compiler.stdin:
        compiler.stdin.write(GO_ON)
    threading.Thread(target=compiler.wait, daemon=True).start()  # it is taken note of if it ends first


def interpret(job: str, answer: str) -> None:
    """What the interpreting process of :func:`sooner` does; without an answer it has failed.

    Where Python raises and machine code goes on with inf and nan (a division of floats by zero), nothing is answered: not
    an error that came of another one, and not a run that was started anew, perhaps for such an error.
    """
    function, arguments = pickle.loads(Path(job).read_bytes())
    result, refused = None, None
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = function(*arguments)
        except DopslamError as error:
            if error.__cause__ is not None or error.__context__ is not None:
                raise
            refused = error
    if any(getattr(part, "restarted", "") for part in (result if isinstance(result, tuple) else (result,))):
        return
    part = Path(answer + "-part")
    part.write_bytes(pickle.dumps((result, refused)))
    part.rename(answer)


def follow() -> None:
    """Make this process end when its standard input does, that is with its parent, unless it was told to go on."""

    def wait() -> None:
        if GO_ON not in sys.stdin.buffer.read():
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextlib.contextmanager
def _child(work: str, **environment: str) -> Iterator[subprocess.Popen | None]:
    """A process that does one thing of this module; it ends with the body, unless :func:`go_on` let it go.

    It finds its modules where this one does, not in the folder that it happens to run in. None where no process can be
    started.
    """
    command = [sys.executable, "-P", "-c", f"from dopslam.pipeline import ahead; ahead.follow(); ahead.{work}"]
    silent: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    try:
        child = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, **silent)
    except (OSError, TypeError, ValueError):  # an embedded interpreter has no program of its own; no more processes
        yield None
        return
    assert child.stdin is not None
    try:
        yield child
    finally:
        if not child.stdin.closed:
            child.kill()
            child.stdin.close()
            child.wait()


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
