"""From a converged fit to :class:`~estimation.Detections`: covariances, statistics and flags."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ..detections import Detections, Flag
from ..fisher import path_covariances
from ..signal.arrays import to_front
from ..signal.model import SignalModel
from ..signal.paths import Geometry, tangent_jacobian
from .detect import fitted_excess
from .projector import Projector
from .refine import Linearization, information, linearize

if TYPE_CHECKING:
    from .nomp import Nomp


def empty(estimator: Nomp, noise_variance: float) -> Detections:
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


def canonical(model: SignalModel, geometry: Geometry) -> Geometry:
    """The same paths within the unambiguous delays, and in front of arrays that cannot tell front from back."""
    return replace(
        geometry.wrapped(model.waveform.max_delay or np.inf),
        arrival=to_front(model.receiver, geometry.arrival),
        departure=to_front(model.transmitter, geometry.departure),
    )


def detections(estimator: Nomp, data: Projector, lin: Linearization, noise_variance: float) -> Detections:
    """Sorted by rho, in canonical form (and the gains solved for there)."""
    model = data.model
    order = np.argsort(lin.drop)[::-1]
    geometry = lin.geometry.take(order)
    plain = canonical(model, geometry)
    changed = any(np.any(getattr(plain, f.name) != getattr(geometry, f.name)) for f in fields(geometry))
    geometry, lin = plain, linearize(data, plain) if changed else lin.sorted(order)
    snr = lin.drop / noise_variance
    tangent = path_covariances(
        information(unbiased(lin, snr, estimator.level, model.active), model.active) * 2 / noise_variance, model.active
    )
    scale = tangent_jacobian(geometry)
    with np.errstate(invalid="ignore"):
        covariance = tangent * scale[:, :, None] * scale[:, None]
    table = geometry.table(lin.gain)
    flags = np.zeros(len(snr), np.uint8)
    overlap = lin.coherence - np.eye(len(snr))
    flags[overlap.max(axis=1) > 0.3] |= np.uint8(Flag.CLOSE_PAIR)
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
    )
