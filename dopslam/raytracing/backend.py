"""Imports Sionna RT once, with a working LLVM or a GPU behind it. Nothing else in the package does."""

from __future__ import annotations

import contextlib
import importlib
from functools import cache
from types import ModuleType
from typing import Any

from dopslam.compute import llvm
from dopslam.errors import LLVMError

resource: Any = None
with contextlib.suppress(ImportError):  # POSIX only
    resource = importlib.import_module("resource")


ROOM = 1_500_000_000  # bytes of address space; with 0.9e9 LLVM ends the process without a word, with 2e9 it works


def _refuse_little_room() -> None:
    if resource is None:
        return
    room, _ = resource.getrlimit(resource.RLIMIT_AS)
    if room != resource.RLIM_INFINITY and room < ROOM:
        raise LLVMError(
            f"The address space of this process is limited to {room / 1e9:.1f} GB (ulimit -v), the ray tracer needs "
            f"{ROOM / 1e9:.1f} GB: raise the limit"
        )


@cache
def backend() -> tuple[ModuleType, ModuleType]:
    """The modules ``(sionna.rt, mitsuba)``, ready to trace: on a CUDA device if there is one, else on the
    CPU.

    Raises
    ------
    LLVMError
        If there is neither a CUDA device nor an LLVM that works, or the ray tracer cannot be imported.
    """
    _refuse_little_room()
    llvm.prepare()
    try:
        mitsuba = importlib.import_module("mitsuba")
        if mitsuba.variant() is None:
            gpu = llvm.cuda_devices() > 0
            mitsuba.set_variant(*(["cuda_ad_mono_polarized"] if gpu else []), "llvm_ad_mono_polarized")
        return importlib.import_module("sionna.rt"), mitsuba
    except ImportError as error:
        raise LLVMError(
            f"The ray tracer cannot be imported ({error}): {llvm.remedy()}; see `dopslam doctor`"
        ) from error
