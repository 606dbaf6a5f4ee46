"""Mends the recompilation per trajectory of Sionna RT 2.2.

``Scene._endpoints`` writes every receiver's position into the kernel as a literal, so each new trajectory compiles a new
kernel: 0.6 s for 40 receivers, 8 s for 1000. :func:`mend` gives one scene a version that passes the same numbers as data.
It is a private method, therefore the mend is bound to one scene only, refuses versions it was not tested with, and hands
back to the original whatever it does not cover.
"""

from __future__ import annotations

from types import MethodType

import numpy as np

from dopslam.raytracing.backend import backend

TESTED_VERSIONS = ("2.2.0",)


def _rows(devices, name: str) -> np.ndarray:
    """(3, N) values of a point-valued attribute of every device; raises if one is not a single point."""
    return np.array([[component[0] for component in getattr(device, name)] for device in devices], dtype=np.float32).T


def _endpoints_as_data(scene, radio_devices, array, synthetic_array, return_velocities):
    """Drop-in for ``Scene._endpoints``, for synthetic arrays of one antenna at the device's own position."""
    _, mi = backend()
    devices = list(radio_devices)
    single = synthetic_array and array is not None and array.array_size == 1
    if not single or np.any(array.normalized_positions.numpy()) or not devices:
        return type(scene)._endpoints(scene, devices, array, synthetic_array, return_velocities)
    positions, orientations = (mi.Point3f(_rows(devices, name)) for name in ("position", "orientation"))
    relative = mi.Point3f(np.zeros((3, len(devices)), dtype=np.float32))
    velocities = mi.Vector3f(_rows(devices, "velocity")) if return_velocities else None
    return positions, orientations, relative, velocities


def mend(scene) -> None:
    """Give this Sionna scene endpoints that are data; does nothing for a version of Sionna that was not tested."""
    rt, _ = backend()
    if rt.__version__ in TESTED_VERSIONS:
        scene._endpoints = MethodType(_endpoints_as_data, scene)
