"""Finds an LLVM library that works, before anything imports Dr.Jit, Mitsuba or Sionna.

Dr.Jit compiles its CPU kernels with a shared libLLVM that it looks for at run time: ``DRJIT_LIBLLVM_PATH``,
then ``libLLVM.so``, then the highest version in the system's library folder; never in a virtual environment.
LLVM 14 is rejected with a misleading message, 15 and 16 abort the process at the first traced path.
:func:`prepare` therefore looks by itself, asks each candidate for its version in a process of its own
(loading a wrong libLLVM here could make Dr.Jit use it, or bring this process down), and sets the variable.
"""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import re
import site
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dopslam.errors import LLVMError

MINIMUM_VERSION = 17
VARIABLE = "DRJIT_LIBLLVM_PATH"
_PATTERNS = ("libLLVM.so*", "libLLVM-*.so*", "libLLVM*.dylib")
_ASK_VERSION = (
    "import ctypes, sys; v = [ctypes.c_uint() for _ in range(3)];"
    "ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, v)); print(*(x.value for x in v))"
)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One libLLVM on this machine: where it is, why it was looked at, and its version (empty if it cannot
    tell).
    """

    path: Path
    origin: str
    version: tuple[int, ...]

    @property
    def works(self) -> bool:
        """Whether Dr.Jit can trace with it."""
        return bool(self.version) and self.version[0] >= MINIMUM_VERSION


def _folders() -> list[tuple[str, Path]]:
    machine = platform.machine()
    folders = [("environment", Path(sys.prefix) / "lib"), ("user site", Path(site.getuserbase()) / "lib")]
    if "CONDA_PREFIX" in os.environ:
        folders.append(("conda", Path(os.environ["CONDA_PREFIX"]) / "lib"))
    folders.append(("base python", Path(sys.base_prefix) / "lib"))
    folders += [
        ("system", Path(text))
        for text in (
            f"/usr/lib/{machine}-linux-gnu",
            "/usr/lib64",
            "/usr/lib",
            "/usr/local/lib",
            "/opt/homebrew/opt/llvm/lib",
        )
    ]
    return folders + [("system", path) for path in sorted(Path("/usr/lib").glob("llvm-*/lib"), reverse=True)]


def _number(path: Path) -> float:
    """Version in a file name, for trying the newest first; the library itself has the last word."""
    match = re.search(r"(?:-|so\.)(\d+(?:\.\d+)?)", path.name)
    return float(match.group(1)) if match else 0.0


def _located() -> list[tuple[str, Path]]:
    """Candidate files in the order of trust, one entry per real file."""
    found = [("variable " + VARIABLE, Path(os.environ[VARIABLE]))] if os.environ.get(VARIABLE) else []
    for origin, folder in _folders():
        files = {path for pattern in _PATTERNS for path in folder.glob(pattern)}
        found += [(origin, path) for path in sorted(files, key=lambda path: (-_number(path), path.name))]
    unique: dict[Path, tuple[str, Path]] = {}
    for origin, path in found:
        unique.setdefault(path.resolve(), (origin, path))
    return list(unique.values())


@cache
def version_of(path: Path) -> tuple[int, ...]:
    """(major, minor, patch) of a libLLVM, asked in a subprocess; () if it is missing, damaged or older than
    16.
    """
    command = [sys.executable, "-I", "-S", "-c", _ASK_VERSION, str(path)]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        return tuple(int(word) for word in answer.stdout.split())
    except (OSError, TypeError):  # no interpreter to start: embedded Python, or it may not be executed
        return () if 0 < _number(path) < MINIMUM_VERSION else _ask_here(path)
    except (subprocess.SubprocessError, ValueError):
        return ()


def _ask_here(path: Path) -> tuple[int, ...]:
    try:
        numbers = [ctypes.c_uint() for _ in range(3)]
        ctypes.CDLL(str(path)).LLVMGetVersion(*map(ctypes.byref, numbers))
        return tuple(number.value for number in numbers)
    except (OSError, AttributeError):
        return ()


def candidates() -> list[Candidate]:
    """Every libLLVM that was found, in the order in which :func:`prepare` would take it."""
    return [Candidate(path, origin, version_of(path)) for origin, path in _located()]


def cuda_devices() -> int:
    """Number of CUDA devices the driver reports; 0 without a driver."""
    try:
        driver = ctypes.CDLL("libcuda.so.1" if sys.platform != "win32" else "nvcuda.dll")
        count = ctypes.c_int()
        return count.value if driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0 else 0
    except (OSError, AttributeError):
        return 0


def remedy() -> str:
    """What to install on this machine."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return "install the wheel `pip install karellen-llvm-core==19.1.7` or the Debian package libllvm19"
    if sys.platform == "linux":
        return "install LLVM 17 or newer (Debian: `apt install libllvm19`)"
    return "install LLVM 17 or newer (macOS: `brew install llvm`)"


def prepare() -> Path | None:
    """Point Dr.Jit to a libLLVM that works; call before anything imports drjit, mitsuba or sionna.

    Returns
    -------
    The library chosen, or None if there is none and a CUDA device makes one unnecessary.

    Raises
    ------
    LLVMError
        If nothing works; says what was found and what to install.
    """
    seen = []
    for origin, path in _located():
        candidate = Candidate(path, origin, version_of(path))
        if candidate.works:
            if seen and seen[0].origin.startswith("variable"):
                _log.warning("%s=%s does not work, using %s", VARIABLE, seen[0].path, path)
            os.environ[VARIABLE] = str(path)
            return path
        seen.append(candidate)
    if cuda_devices():
        return None
    found = "; ".join(
        f"{c.path} is " + (f"version {'.'.join(map(str, c.version))}" if c.version else "not loadable or older than 16")
        for c in seen
    )
    raise LLVMError(
        f"The ray tracer needs LLVM {MINIMUM_VERSION} or newer, or a CUDA device, and found "
        f"{found or 'no libLLVM at all'}: {remedy()}, or set {VARIABLE} to a newer libLLVM"
    )
