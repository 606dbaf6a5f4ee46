"""``dopslam doctor``: what the ray tracer and the compilers find on this machine."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

PACKAGES = (
    "dopslam", "sionna-rt", "mitsuba", "drjit", "numpy", "scipy", "numba", "h5py", "pydantic", "cyclopts",
    "rich", "matplotlib", "joblib", "karellen-llvm-core",
)  # fmt: skip
OPTIONAL = ("karellen-llvm-core",)
_KERNEL = (
    "import drjit, {0} as backend; x = backend.Float([1.0, 2.0, 3.0]);assert drjit.sum(x * x)[0] == 14.0; print('ok')"
)


def doctor() -> None:
    """Say what was found: Python, packages, LLVM, GPU, threads, caches. Exit code 1 if nothing can trace."""
    from rich.console import Console
    from rich.text import Text

    from dopslam.compute import llvm

    console = Console(highlight=False, soft_wrap=True, markup=False)
    for title, rows in (
        ("System", _system()),
        ("Packages", _packages()),
        ("LLVM", _llvm()),
        ("Caches", _caches()),
    ):
        console.print(title, style="bold")
        for name, value, good in rows:
            mark, style = {True: ("✓", "green"), False: ("✗", "red"), None: ("·", "dim")}[good]
            console.print(Text.assemble("  ", (mark, style), f" {name:<22} {value}"))  # paths are no markup
    able, sentence = _verdict()
    console.print(sentence, style="bold green" if able else "bold red")
    if not able:
        console.print(f"Remedy: {llvm.remedy()}")
        sys.exit(1)


def _system() -> Iterator[tuple[str, str, bool | None]]:
    from dopslam.compute import llvm

    version = platform.python_version()
    yield "python", f"{version} ({sys.executable})", sys.version_info >= (3, 11)
    yield "platform", platform.platform(), None
    yield (
        "cores",
        f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()}",
        None,
    )
    threads = [f"{name}={os.environ[name]}" for name in sorted(os.environ) if name.endswith("_NUM_THREADS")]
    yield "threads set", ", ".join(threads) or "no limits set", None
    gpus = llvm.cuda_devices()
    yield (
        "CUDA devices",
        str(gpus) if gpus else "none (the ray tracer runs on the CPU)",
        True if gpus else None,
    )


def _packages() -> Iterator[tuple[str, str, bool | None]]:
    from importlib.metadata import PackageNotFoundError, version

    for name in PACKAGES:
        try:
            yield name, version(name), True
        except PackageNotFoundError:
            yield name, "not installed", None if name in OPTIONAL else False


def _llvm() -> Iterator[tuple[str, str, bool | None]]:
    from dopslam.compute import llvm

    found = llvm.candidates()
    chosen = next((candidate for candidate in found if candidate.works), None)
    if not found:
        yield "libLLVM", "none found", False
    for candidate in found:
        version = ".".join(map(str, candidate.version)) or "below 16 or broken"
        if candidate is chosen:
            yield version, f"{candidate.path} ({candidate.origin}), used", True
        else:
            note = "not needed" if candidate.works else "would fail or abort, not used"
            yield version, f"{candidate.path} ({candidate.origin}), {note}", None


def _caches() -> Iterator[tuple[str, str, bool | None]]:
    home = os.environ.get("HOME")
    drjit = os.environ.get("DRJIT_CACHE_DIR") or (str(Path(home) / ".drjit") if home else None)
    from estimation.jit import cache_folder

    chosen = cache_folder()
    numba = str(chosen) if chosen else None
    for name, folder in (("Dr.Jit kernels", drjit), ("numba kernels", numba)):
        if folder is None:
            yield name, "no home folder: compiled again by every process, slower but not broken", None
        elif _writable(Path(folder)):
            yield name, f"{folder}, writable", True
        else:
            yield (
                name,
                f"{folder}, not writable: compiled again by every process, slower but not broken",
                None,
            )


def _writable(folder: Path) -> bool:
    """Whether files can be created in a folder, or in the nearest existing one above it."""
    try:
        while not folder.exists():
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _verdict() -> tuple[bool, str]:
    """Whether a kernel compiles and runs, tried in a process of its own: a bad library may abort it."""
    from dopslam.compute import llvm
    from dopslam.errors import LLVMError

    try:
        library = llvm.prepare()
    except LLVMError as error:
        return False, f"Tracing is not possible. {error}."
    backend = "drjit.cuda" if llvm.cuda_devices() else "drjit.llvm"
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _KERNEL.format(backend)], capture_output=True, text=True, timeout=120
        )
    except OSError as error:
        return True, f"{library or 'CUDA'} should work; no process could be started to try it ({error})."
    except subprocess.SubprocessError as error:
        return False, f"Tracing is not possible: the trial kernel did not finish ({error})."
    if trial.returncode == 0 and trial.stdout.strip().endswith("ok"):
        return True, f"Ready to trace with {'CUDA' if backend == 'drjit.cuda' else library}."
    lines = trial.stderr.strip().splitlines() or [f"exit code {trial.returncode}"]
    return False, f"Tracing is not possible: the trial kernel failed ({lines[-1]})."
