"""Mends five defects of Sionna RT 2.2 without touching its code; all private names that we rely on are in
this file.

1. ``Scene._endpoints`` writes every receiver's position into the kernel as a literal, so each new trajectory
compiles
   a new kernel: 0.6 s for 40 receivers, 8 s for 1000. :func:`mend_endpoints` gives one scene a version that
   passes the same numbers as data.
2. The hash table that tells specular candidates apart drops paths on collisions. A larger one does not.
3. The buffer of candidates drops what exceeds it, without a word. :class:`CountingSolver` notices and takes a
larger one.
4. A scene takes receivers one by one. :class:`Receivers` keeps those of every number that was needed.
5. A scene is born at 3.5 GHz, and a material that is not defined there (floorboard, clear acrylic) is refused for every
carrier. :func:`born_at` lets it be born at the carrier.

A version of Sionna that was not tested keeps its own behavior in 1, 3, 4 and 5, and whatever a mend does not cover
goes to the original.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import MethodType
from typing import Any

import numpy as np

from dopslam.raytracing.backend import backend
from dopslam.raytracing.objects import receiver_name

TESTED_VERSIONS = ("2.2.0",)
HASH_TABLE_SIZE = 7_999_993  # a prime; Sionna's 1e6 loses paths
FIRST_BUFFER = 1_000_000  # candidates


def _tested() -> bool:
    rt, _ = backend()
    return rt.__version__ in TESTED_VERSIONS


def _rows(devices, name: str) -> np.ndarray:
    """(3, N) values of a point-valued attribute of every device; raises if one is not a single point."""
    values = [[component[0] for component in getattr(device, name)] for device in devices]
    return np.array(values, dtype=np.float32).T


def _endpoints_as_data(scene, radio_devices, array, synthetic_array, return_velocities):
    """Drop-in for ``Scene._endpoints``, for synthetic arrays of one antenna at the device's own position."""
    _, mi = backend()
    devices = list(radio_devices)
    at_device = array is not None and array.array_size == 1 and not np.any(array.normalized_positions.numpy())
    if not (synthetic_array and at_device and devices):
        return type(scene)._endpoints(scene, devices, array, synthetic_array, return_velocities)
    positions, orientations = (mi.Point3f(_rows(devices, name)) for name in ("position", "orientation"))
    relative = mi.Point3f(np.zeros((3, len(devices)), dtype=np.float32))
    velocities = mi.Vector3f(_rows(devices, "velocity")) if return_velocities else None
    return positions, orientations, relative, velocities


def mend_endpoints(scene) -> None:
    """Give this Sionna scene endpoints that are data; does nothing for a version of Sionna that was not
    tested.
    """
    if _tested():
        scene._endpoints = MethodType(_endpoints_as_data, scene)


@contextmanager
def born_at(frequency: float) -> Iterator[None]:
    """Scenes loaded within have this frequency [Hz] from the start."""
    backend()
    module: Any = sys.modules["sionna.rt.scene"]
    before = module.DEFAULT_FREQUENCY
    if _tested():
        module.DEFAULT_FREQUENCY = frequency
    try:
        yield
    finally:
        module.DEFAULT_FREQUENCY = before


class Receivers:
    """The receivers of a scene; one set for every number of them, exchanged as a whole."""

    def __init__(self, scene):
        self._scene = scene
        self._kept: dict[int, dict] = {}

    def place(self, positions: np.ndarray) -> None:
        """Make (N, 3) positions [m] the scene's receivers."""
        rt, mi = backend()
        scene, count = self._scene, len(positions)
        if _tested() and count in self._kept:
            scene._receivers = self._kept[count]
        elif len(scene.receivers) != count:
            if _tested():
                scene._receivers = {}
            for name in scene.receivers:
                scene.remove(name)
            for i in range(count):
                scene.add(rt.Receiver(name=receiver_name(i), position=mi.Point3f(0.0, 0.0, 0.0)))
        if _tested():
            self._kept[count] = scene._receivers
        for device, position in zip(scene.receivers.values(), positions.tolist(), strict=True):
            device.position = mi.Point3f(*position)


class CountingSolver:
    """Sionna's ``PathSolver`` that runs again with a larger buffer when one was full."""

    def __init__(self, deterministic: bool):
        rt, _ = backend()
        # The constant is read when the solver runs; a larger one is right for everybody, so it stays.
        generator = rt.path_solvers.sb_candidate_generator.SBCandidateGenerator
        generator.MIN_SPEC_COUNT_SIZE = max(generator.MIN_SPEC_COUNT_SIZE, HASH_TABLE_SIZE)
        self._solver = rt.PathSolver(deterministic=deterministic)
        self._candidates = 0
        if _tested():
            generate = self._solver._candidate_generator

            def counted(**arguments):
                buffer = generate(**arguments)
                self._candidates = int(buffer.paths_counter[0])
                return buffer

            self._solver._candidate_generator = counted

    def __call__(self, scene, **arguments):
        """As ``PathSolver``, without ``max_num_paths_per_src``."""
        size = FIRST_BUFFER
        while True:
            self._candidates = 0
            paths = self._solver(scene, max_num_paths_per_src=size, **arguments)
            if self._candidates < size:
                return paths
            size *= 4
