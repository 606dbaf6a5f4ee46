"""From a converged fit to :class:`~estimation.Detections`: covariances, statistics and flags."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Protocol

import numpy as np

from ..detections import Detections, Flag
from ..fisher import path_covariances
from ..signal.arrays import Manifold, mirror_of
from ..signal.directions import Float, sphere
from ..signal.model import SignalModel
from ..signal.observability import cone_variance, confused, mirrored
from ..signal.paths import Geometry, tangent_jacobian
from .detect import fitted_excess
from .floor import Floor
from .grids import View
from .haze import Haze, raised
from .misfit import misfit
from .projector import Projector
from .refine import Linearization, information, linearize


class Settings(Protocol):
    """What the report reads of an estimator: its model, the region it searched, and how it decided."""

    @property
    def model(self) -> SignalModel: ...
    @property
    def false_alarm_rate(self) -> float: ...
    @property
    def level(self) -> float: ...
    @property
    def error_share(self) -> float: ...
    @property
    def max_delay(self) -> float | None: ...
    @property
    def max_speed(self) -> float: ...
    @property
    def arrival_view(self) -> View: ...
    @property
    def departure_view(self) -> View: ...


def empty(estimator: Settings, noise_variance: float) -> Detections:
    """No path."""
    pair, square = np.empty((0, 2)), np.empty((0, 6, 6))
    return Detections(
        np.empty(0),
        pair,
        pair,
        np.empty(0),
        np.empty(0, complex),
        square,
        square,
        np.empty(0),
        float(noise_variance),
        estimator.level,
        estimator.false_alarm_rate,
        np.empty(0, np.uint8),
        estimator.model.active,
    )


def seen(data: Projector, lin: Linearization) -> Linearization:
    """Without the paths that the fit took behind an array and of which nothing is left: one would spoil all covariances."""
    there = np.flatnonzero(lin.drop > 0)
    return lin if len(there) == len(lin.gain) else linearize(data, lin.geometry.take(there))


def unbiased(lin: Linearization, snr, threshold: float, active) -> Linearization:
    """With gains whose energies are right on average, for covariances that are.

    A fitted path explains its own energy and that of the noise in its dimensions, and one near the threshold was
    lucky: information at the fitted gain would be too large, by a sixth at 14 dB. Two steps of bias correction.
    """
    size = int(np.sum(active))
    own = snr - (1 + 0.5 * size)
    for _ in range(2):
        own = np.maximum(snr - fitted_excess(np.maximum(own, 1.0), threshold, size), 0.3 * snr)
    return replace(lin, gain=lin.gain * np.sqrt(np.minimum(own / snr, 1.0)))


def canonical(estimator: Settings, model: SignalModel, geometry: Geometry) -> Geometry:
    """The same paths within the unambiguous delays, and in the view, or else in front, of arrays that cannot tell front
    from back.
    """
    return replace(
        geometry.wrapped(model.max_delay or np.inf),
        arrival=turned(model.receiver, geometry.arrival, estimator.arrival_view)[0],
        departure=turned(model.transmitter, geometry.departure, estimator.departure_view)[0],
    )


def turned(array: Manifold, directions: Float, view: View) -> tuple[Float, np.ndarray]:
    """Directions (P, 3) or, of those that ``array`` takes for the same, the mirror images that are in the view or else in
    front; and which of them (P,) have an equal in the view.
    """
    normal = mirror_of(array)
    if normal is None or not len(directions):
        return directions, np.zeros(len(directions), bool)
    images = mirrored(directions, normal)
    same = confused(array, directions, images)
    inside, other = view.contains(directions), view.contains(images)
    behind = directions @ normal < 0
    swap = same & np.where(inside == other, behind, other)
    return np.where(swap[:, None], images, directions), same & inside & other & (np.abs(directions @ normal) > 1e-9)


def on_sphere(array: Manifold, view: View) -> Float:
    """Directions (n, 3) of the view, spread over the sphere, on the side that a line of elements faces."""
    points = sphere(6000)
    inside = points[view.contains(points)]
    front = inside @ array.sight.side > 0
    return inside[front] if front.any() else inside


def detections(
    estimator: Settings,
    data: Projector,
    lin: Linearization,
    noise_variance: float,
    spread: Float | None = None,
    limited: bool = False,
    hazes: tuple[Haze, ...] = (),
) -> Detections:
    """Sorted by rho, in canonical form (and the gains solved for there); ``spread`` (P, 6, 6) of pairs (:mod:`~.pairs`), and
    ``hazes`` that paths may be in.
    """
    model = data.model
    if not np.any(lin.drop > 0):
        return empty(estimator, noise_variance)
    spread = np.zeros((len(lin.gain), 6, 6)) if spread is None else spread
    spread = spread[lin.drop > 0]
    lin = seen(data, lin)
    order = np.argsort(lin.drop)[::-1]
    spread = spread[order]
    geometry = lin.geometry.take(order)
    plain = canonical(estimator, model, geometry)
    changed = any(np.any(getattr(plain, f.name) != getattr(geometry, f.name)) for f in fields(geometry))
    geometry, lin = plain, linearize(data, plain) if changed else lin.sorted(order)
    snr = lin.drop / noise_variance
    tangent = path_covariances(
        information(unbiased(lin, snr, estimator.level, model.active), model.active) * 2 / noise_variance, model.active
    )
    residue = misfit(lin, noise_variance, model.active)
    merged = residue.merged | np.any(spread, axis=(1, 2))
    tangent = residue.inflated(tangent) + spread
    tangent = tangent * raised(model, hazes, geometry, noise_variance)[:, None, None]
    # A path's model error moves it as noise of that share of its energy would, spread over the mode it is in.
    floor = Floor(data, lin, noise_variance)
    errors = floor.errors()
    root = np.sqrt(1 + estimator.error_share * snr[:, None] + floor.spread(errors) * snr[:, None])
    tangent = tangent * root[:, :, None] * root[:, None]
    flags = np.where(merged, np.uint8(Flag.MERGED), np.uint8(0))
    flags |= np.uint8(Flag.LIMITED if limited else 0)
    for number, (array, directions, view) in enumerate(
        (
            (model.receiver, geometry.arrival, estimator.arrival_view),
            (model.transmitter, geometry.departure, estimator.departure_view),
        )
    ):
        flags[turned(array, directions, view)[1]] |= np.uint8(Flag.AMBIGUOUS)
        if array.sight.axis is not None:
            flags |= np.uint8(Flag.AMBIGUOUS)
            if array.observable[0]:
                tangent[:, 1 + 2 * number, 1 + 2 * number] += cone_variance(array, directions, on_sphere(array, view))
    scale = tangent_jacobian(geometry)
    with np.errstate(invalid="ignore"):
        covariance = tangent * scale[:, :, None] * scale[:, None]
    table = geometry.table(lin.gain)
    flags[lin.overlap > 0.3] |= np.uint8(Flag.CLOSE_PAIR)
    flags[snr < 1.41 * estimator.level] |= np.uint8(Flag.WEAK)
    inside = estimator.arrival_view.contains(geometry.arrival) & estimator.departure_view.contains(geometry.departure)
    inside &= model.receiver.faces(geometry.arrival) & model.transmitter.faces(geometry.departure)
    inside &= (np.abs(geometry.speed) <= estimator.max_speed) & (geometry.delay <= estimator.max_delay)
    flags[~inside] |= np.uint8(Flag.EDGE_OF_VIEW)
    std = np.sqrt(np.diagonal(tangent, axis1=1, axis2=2))
    for column, vectors in ((1, geometry.arrival), (3, geometry.departure)):
        # Within three standard deviations of a pole azimuth means nothing; otherwise a radian is too much.
        distance = np.hypot(vectors[:, 0], vectors[:, 1])
        for angle in (column, column + 1):
            if model.active[angle]:
                flags[(distance < 3 * std[:, angle]) | ~(std[:, angle] < 1.0)] |= np.uint8(Flag.SINGULAR)
    return Detections(
        table.delay,
        table.aoa,
        table.aod,
        table.radial_velocity,
        table.gain,
        covariance,
        tangent,
        snr,
        float(noise_variance),
        estimator.level,
        estimator.false_alarm_rate,
        flags,
        model.active,
        float(errors.max(initial=0.0)),
    )
