"""The backends of the stacked particles' likelihoods by name; only the one that is asked for is imported."""

from __future__ import annotations

from dopslam.errors import FilterError
from dopslam.slam.belief.stacked.likelihood import Backend, NumbaBackend, NumpyBackend


def backend(name: str) -> Backend:
    """Backend by name: ``numpy``, ``numba`` or ``drjit``."""
    if name == "numpy":
        return NumpyBackend()
    if name == "numba":
        return NumbaBackend()
    if name == "drjit":
        from dopslam.slam.belief.stacked.likelihood_drjit import DrJitBackend

        return DrJitBackend()
    raise FilterError(f"likelihood backend {name!r} is unknown; use numpy, numba or drjit")
