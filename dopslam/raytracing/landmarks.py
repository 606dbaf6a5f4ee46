"""Which landmark every traced path belongs to: the base station, a virtual anchor by its walls, a scatter
point.

A virtual anchor is named by the planes in the order in which the path leaves the base station, ``VA a > b``.
Orders with the same composite reflection, as both ways around a right-angled corner, are the same anchor for
every receiver and share the alphabetically first name; so do names, order and positions not depend on which
paths happened to be found.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations

import numpy as np

from dopslam.raytracing.images import isometry, mirror_images
from dopslam.raytracing.surfaces import Surfaces
from dopslam.records import Kind, Landmarks

SAME_PLACE = 1e-6  # relative, between composite reflections of the same planes in another order


class Naming:
    """Canonical plane sequences and names of one scene."""

    def __init__(self, surfaces: Surfaces):
        self.surfaces = surfaces
        self.canonical = lru_cache(maxsize=None)(self._canonical)

    def _canonical(self, sequence: tuple[int, ...]) -> tuple[int, ...]:
        """Of all orders of the planes with the same composite reflection the one whose names come first."""
        normals, offsets = self.surfaces.plane_normal, self.surfaces.plane_offset
        matrix, translation = isometry(normals[list(sequence)], offsets[list(sequence)])
        scale = max(1.0, float(np.abs(translation).max()))

        def same(order: tuple[int, ...]) -> bool:
            other, shift = isometry(normals[list(order)], offsets[list(order)])
            return np.allclose(other, matrix, atol=SAME_PLACE) and np.allclose(
                shift, translation, atol=SAME_PLACE * scale
            )

        orders = {order for order in permutations(sequence) if order == sequence or same(order)}
        return min(orders, key=lambda order: [self.surfaces.plane_name[p] for p in order])

    def name(self, sequence: tuple[int, ...]) -> str:
        """``VA wall_east > wall_north``."""
        return "VA " + " > ".join(self.surfaces.plane_name[p] for p in sequence)


def landmarks_of(
    surfaces: Surfaces, bs_position: np.ndarray, sequences: set[tuple[int, ...]], naming: Naming,
    point_names: tuple[str, ...], points: np.ndarray,
) -> tuple[Landmarks, dict[tuple[int, ...], int]]:  # fmt: skip
    """Landmarks in their canonical order: BS, virtual anchors by order and name, scatter points as given.

    Returns
    -------
    the record, and the row of every (canonical) plane sequence
    """
    ordered = sorted(sequences - {()}, key=lambda sequence: (len(sequence), naming.name(sequence)))
    anchors = [
        mirror_images(bs_position, surfaces.plane_normal[list(s)], surfaces.plane_offset[list(s)])[-1] for s in ordered
    ]
    names = ["BS", *(naming.name(sequence) for sequence in ordered), *(f"SP {name}" for name in point_names)]
    kinds = [Kind.BS] + [Kind.VA] * len(ordered) + [Kind.SP] * len(points)
    record = Landmarks(
        name=np.array(names),
        kind=np.array(kinds, dtype=np.int8),
        position=np.array([bs_position, *anchors, *points], dtype=float).reshape(-1, 3),
        order=np.array([0, *map(len, ordered), *[1] * len(points)], dtype=np.int64),
    )
    rows = {sequence: i for i, sequence in enumerate([(), *ordered])}
    return record, rows
