"""How well poses explain a scan: every path is a single bounce, a line of sight, or clutter.

Densities are compared in one measure, that of the detection. A bounce's place is free, so it spreads as clutter does
over all but its equations; there it has N(e; 0, S), with a second, wider term for errors beyond the stated noise,
against clutter's uniform density over the extent of the scan. A line of sight has N(z; h, R) against the uniform
density of delays and angles; each base station has at most one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.slam.snapshot.rays import Rays, bounce, sight

Array = NDArray[np.float64]

TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What is assumed of the paths of a scan before looking at it.

    Attributes
    ----------
    clutter : float
        Share of paths that are neither line of sight nor single bounce.
    sight : float
        Probability that a base station is seen.
    wide_share, wide_scale : float
        Share of detections with errors beyond the stated noise, and how many times larger these are.
    """

    clutter: float = 0.25
    sight: float = 0.6
    wide_share: float = 0.2
    wide_scale: float = 4.0

    @property
    def scales(self) -> tuple[tuple[float, float], ...]:
        """(share, factor on the covariance) of the two noise terms."""
        return (1 - self.wide_share, 1.0), (self.wide_share, self.wide_scale**2)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Likelihood of C poses, and what the n paths are under each.

    Attributes
    ----------
    log_likelihood : (C,) array; over the uniform density
    bounce, sight : (C, n) arrays; weights of the single-bounce and the line-of-sight equations: probability times
        1/factor of the noise term
    bounce_probability, sight_probability : (C, n) arrays
    gradient : (C, 4) array; normal equations' right side, of a change of [x, y, heading, bias]
    information : (C, 4, 4) array
    """

    log_likelihood: Array
    bounce: Array
    sight: Array
    bounce_probability: Array
    sight_probability: Array
    gradient: Array
    information: Array


def _mixture(square: Array, logdet: Array, size: int, beliefs: Beliefs) -> tuple[Array, Array]:
    """log density of a two-term normal mixture, and Σ posterior/factor of its terms."""
    terms = [
        np.log(share) - 0.5 * (square / factor + logdet + size * np.log(2 * np.pi * factor))
        for share, factor in beliefs.scales
    ]
    total = np.logaddexp(*terms)
    weight = sum(np.exp(term - total) / factor for term, (_, factor) in zip(terms, beliefs.scales, strict=True))
    return total, np.asarray(weight)


def _whiten(covariance: Array, columns: Array) -> tuple[Array, Array]:
    """L⁻¹ columns (..., m, k) for covariance = LLᵀ and log |covariance|; in closed form, as there are 10⁵ of them."""
    first = np.sqrt(np.maximum(covariance[..., 0, 0], TINY))
    top = columns[..., 0, :] / first[..., None]
    if covariance.shape[-1] == 1:
        return top[..., None, :], 2 * np.log(first)
    cross = covariance[..., 1, 0] / first
    second = np.sqrt(np.maximum(covariance[..., 1, 1] - cross**2, 1e-12 * covariance[..., 1, 1] + TINY))
    bottom = (columns[..., 1, :] - cross[..., None] * top) / second[..., None]
    return np.stack([top, bottom], axis=-2), 2 * np.log(first * second)


def explain(pose: Array, rays: Rays, beliefs: Beliefs, heading_std: float = 0.0, sights: bool = True) -> Explanation:
    """Likelihood of poses (C, 4) and the normal equations of the next step.

    `heading_std` [rad] widens the noise where headings are known no better; without `sights` no path is taken for a
    line of sight.
    """
    found = bounce(pose, rays, heading_std)
    m, (poses, n) = rays.equations, found.possible.shape
    white, logdet = _whiten(found.covariance, np.concatenate([found.error[..., None], found.jacobian], axis=-1))
    density, narrow = _mixture(np.einsum("cnm,cnm->cn", white[..., 0], white[..., 0]), logdet, m, beliefs)
    log_bounce = np.where(found.possible, np.log1p(-beliefs.clutter) + density + m * np.log(rays.extent), -np.inf)
    either = np.logaddexp(log_bounce, np.log(beliefs.clutter))
    probability = np.exp(log_bounce - either)
    total = either.sum(axis=1)
    gradient, information = np.zeros((poses, 4)), np.zeros((poses, 4, 4))
    seen, sight_weight = np.zeros((poses, n)), np.zeros((poses, n))
    if sights and n:
        residual, slope, density, wide = _sights(pose, rays, beliefs, heading_std)
        stations, which = np.unique(rays.anchor, axis=0, return_inverse=True)
        for station in range(len(stations)):
            paths = which.reshape(-1) == station
            odds = np.log(beliefs.sight / paths.sum()) + (density - either)[:, paths]
            every = np.logaddexp(np.log1p(-beliefs.sight), np.logaddexp.reduce(odds, axis=1))
            total = total + every
            seen[:, paths] = np.exp(odds - every[:, None])
        sight_weight = seen * wide
        weighted = slope * sight_weight[..., None, None]
        information += np.einsum("cnik,cnil->ckl", weighted, slope)
        gradient += np.einsum("cnik,cni->ck", weighted, residual)
    probability = probability * (1 - seen)
    bounce_weight = probability * narrow
    slope = white[..., 1:]
    weighted = slope * bounce_weight[..., None, None]
    information += np.einsum("cnmk,cnml->ckl", weighted, slope)
    gradient -= np.einsum("cnmk,cnm->ck", weighted, white[..., 0])
    return Explanation(total, bounce_weight, sight_weight, probability, seen, gradient, information)


def _sights(pose: Array, rays: Rays, beliefs: Beliefs, heading_std: float):
    """Whitened residuals and slopes of lines of sight, log density over the uniform one, and weight of the terms."""
    residual, slope = sight(pose, rays)
    rows = np.array([0, 1, 3]) if rays.planar else np.arange(5)
    noise = rays.noise[:, rows][:, :, rows].copy()
    noise[:, 1, 1] += heading_std**2
    root = np.linalg.cholesky(noise)
    white = np.linalg.solve(root, np.concatenate([residual[..., None], slope], axis=-1)[..., rows, :])
    logdet = 2 * np.log(np.einsum("nii->ni", root)).sum(axis=1)
    square = np.einsum("cni,cni->cn", white[..., 0], white[..., 0])
    density, weight = _mixture(square, logdet, len(rows), beliefs)
    volume = rays.extent * ((2 * np.pi) ** 2 if rays.planar else (2 * np.pi**2) ** 2)
    return white[..., 0], white[..., 1:], density + np.log(volume), weight
