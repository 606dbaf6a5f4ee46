"""Imports Sionna RT once, with a working LLVM or a GPU behind it. Nothing else in the package does."""

from __future__ import annotations

import importlib
from functools import cache
from types import ModuleType

from dopslam import llvm
from dopslam.errors import LLVMError


@cache
def backend() -> tuple[ModuleType, ModuleType]:
    """The modules ``(sionna.rt, mitsuba)``, ready to trace: on a CUDA device if there is one, else on the
    CPU.

    Raises
    ------
    LLVMError
        If there is neither a CUDA device nor an LLVM that works, or the ray tracer cannot be imported.
    """
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
