"""Which grid points lie in the same lobe of the ambiguity function.

Two points share a lobe if they are close in the metric of the normalized information (a uniform aperture has
its first null at 1.8). Mere coherence would let one grid point hide a different lobe, and the higher peak may
be in that one: arrays of two rings, for instance, nearly confuse steep elevations above and below.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..signal.algebra import gram_diagonal
from ..signal.directions import Float, tangents
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .refine import metric

RADIUS = 1.6
"""Points closer than this in the metric share a lobe."""


@dataclass(frozen=True, eq=False)
class LobeMap:
    """Squared metric distances between grid points, the coupling between delay, AOA, AOD and speed neglected.

    Attributes
    ----------
    delays, speeds : (L,), (V,) grids in metric units
    scales : (2,) metric units per second of delay and per m/s
    arrivals, departures : (A, A), (D, D) squared distances between direction cells
    arrival_metric, departure_metric : (A, 2, 2), (D, 2, 2) normalized information on the tangents at each cell
    arrival_roots, departure_roots : (A, 3, 2), (D, 3, 2) their roots: from differences of unit vectors to metric units
    """

    delays: Float
    speeds: Float
    scales: Float
    arrivals: Float
    departures: Float
    arrival_metric: Float
    departure_metric: Float
    arrival_roots: Float
    departure_roots: Float

    @staticmethod
    def build(model: SignalModel, delays: Float, arrivals: Float, departures: Float, speeds: Float) -> LobeMap:
        """Distances for the cells of a search."""

        def distances(grid: Float, part: slice, end: str) -> Float:
            count = len(grid)
            geometry = Geometry(
                np.full(count, delays[len(delays) // 2]),
                grid if end == "arrival" else np.repeat(arrivals[:1], count, axis=0),
                grid if end == "departure" else np.repeat(departures[:1], count, axis=0),
                np.zeros(count),
            )
            matrices = metric(gram_diagonal(model, model.evaluate(geometry)), model.active)
            step = great_circle(grid[:, None], grid[None])
            scales.append(matrices[0])
            local = matrices[:, part, part]
            metrics.append(local)
            return np.einsum("ijb,ijb->ij", np.matmul(step, local), step)

        scales: list[Float] = []
        metrics: list[Float] = []
        arrival = distances(arrivals, slice(1, 3), "arrival")
        departure = distances(departures, slice(3, 5), "departure")
        scale = np.sqrt(np.maximum(np.diag(scales[0]), 0))
        return LobeMap(
            delays * scale[0],
            speeds * scale[5],
            scale[[0, 5]],
            arrival,
            departure,
            *metrics,
            *(roots(m, grid) for m, grid in zip(metrics, (arrivals, departures), strict=True)),
        )

    def first_of_each(self, delay, arrival, departure, speed, count: int):
        """Positions of up to ``count`` points, in the given order, each in a lobe of its own; arguments are
        grid indices (P,).
        """
        tau, rate = self.delays[delay], self.speeds[speed]

        def squared(first: int):
            line = (tau - tau[first]) ** 2 + (rate - rate[first]) ** 2
            return line + self.arrivals[arrival[first], arrival] + self.departures[departure[first], departure]

        return _first_of_each(squared, len(tau), count)

    def first_of_points(self, points: Geometry, arrival, departure, count: int):
        """The same for ``points`` (P,) between the grid's, given the direction cells they are next to."""
        tau, rate = points.delay * self.scales[0], points.speed * self.scales[1]
        ends = (points.arrival, self.arrival_roots[arrival]), (points.departure, self.departure_roots[departure])

        def squared(first: int):
            total = (tau - tau[first]) ** 2 + (rate - rate[first]) ** 2
            for vectors, root in ends:
                offset = (vectors - vectors[first]) @ root[first]
                # Seen along the tangents the far side of the sphere would seem near.
                total += np.where(vectors @ vectors[first] < 0, np.inf, np.sum(offset**2, axis=1))
            return total

        return _first_of_each(squared, len(tau), count)


def _first_of_each(squared: Callable[[int], Float], points: int, count: int):
    """Positions of up to ``count`` of so many points, each farther than a lobe from those before."""
    left = np.ones(points, bool)
    kept: list[int] = []
    while len(kept) < count and left.any():
        first = int(np.argmax(left))
        kept.append(first)
        left &= squared(first) > RADIUS**2
        left[first] = False
    return np.array(kept, int)


def roots(metrics: Float, grid: Float) -> Float:
    """Roots (C, 3, 2) of metrics (C, 2, 2) on the tangents at unit vectors (C, 3)."""
    values, axes = np.linalg.eigh(metrics)
    return np.einsum("cbi,cbk,ck->cik", tangents(grid), axes, np.sqrt(np.maximum(values, 0)))


def great_circle(start: Float, end: Float) -> Float:
    """Tangent steps (..., 2) [rad] from unit vectors ``start`` to ``end`` along great circles (broadcast)."""
    along = np.sum(tangents(start) * end[..., None, :], axis=-1)
    angle = np.arctan2(np.linalg.norm(along, axis=-1), np.sum(start * end, axis=-1))
    # The antipode has no direction of its own; any will do, at its full distance.
    along = np.where((angle > np.pi - 1e-9)[..., None], [1.0, 0.0], along)
    sine = np.linalg.norm(along, axis=-1)
    return along * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 1.0)[..., None]
