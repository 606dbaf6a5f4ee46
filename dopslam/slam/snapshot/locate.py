"""Position, heading and clock bias from one scan, from nothing but the base stations: several modes, best first.

Candidates are scored with noise widened by the coarseness of the heading grid; the best are refined together by robust
Gauss-Newton steps on probability-weighted equations while the widening fades; Laplace's method gives each its
evidence. Doppler adds the velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.measurement import wrap
from dopslam.slam.snapshot.candidates import Prior, from_bounces, from_sights, headings
from dopslam.slam.snapshot.rays import Rays, directions
from dopslam.slam.snapshot.score import Beliefs, explain

Array = NDArray[np.float64]

CHUNK = 4000  # poses scored at once
ROUNDING = 1e-12  # of an information, that its solution cannot tell from nothing


@dataclass(frozen=True, slots=True)
class Search:
    """How wide the search is.

    Attributes
    ----------
    heading_step : float
        Grid of headings [rad].
    most_paths : int
        Earliest paths that form sets.
    most_sights : int
        Earliest paths of a base station that are tried as its line of sight.
    refined : int
        Candidates that are refined.
    iterations : int
        Most Gauss-Newton steps.
    modes : int
        Most modes returned.
    beliefs : Beliefs
    """

    heading_step: float = np.deg2rad(2.0)
    most_paths: int = 10
    most_sights: int = 4
    refined: int = 200
    iterations: int = 14
    modes: int = 8
    beliefs: Beliefs = field(default_factory=Beliefs)

    def __post_init__(self) -> None:
        if not self.heading_step > 0 or min(self.refined, self.iterations, self.modes, self.most_paths) < 1:
            raise FilterError(f"Search: heading_step, refined, iterations, modes, most_paths must be positive: {self}")


@dataclass(frozen=True, slots=True)
class Modes:
    """Where the receiver may be, the best first.

    Attributes
    ----------
    pose : (M, 4) array
        [x m, y m, heading rad, bias m].
    covariance : (M, 4, 4) array
    evidence : (M,) array
        log of the scan's likelihood with the pose integrated out, over the uniform density.
    bounce, sight : (M, n) arrays
        Probability that each path is a single bounce, a line of sight; the rest is clutter.
    velocity, velocity_covariance : (M, 2), (M, 2, 2) arrays or None
        World frame [m/s]; None without Doppler.
    """

    pose: Array
    covariance: Array
    evidence: Array
    bounce: Array
    sight: Array
    velocity: Array | None = None
    velocity_covariance: Array | None = None

    def __len__(self) -> int:
        return len(self.evidence)

    @property
    def probability(self) -> Array:
        """(M,) shares of the evidence among the modes."""
        weight = np.exp(self.evidence - self.evidence.max(initial=-np.inf))
        return weight / weight.sum()


def no_modes(paths: int) -> Modes:
    """What a scan with too few paths has to say."""
    return Modes(np.empty((0, 4)), np.empty((0, 4, 4)), np.empty(0), np.empty((0, paths)), np.empty((0, paths)))


def find_modes(rays: Rays, prior: Prior | None = None, search: Search | None = None) -> Modes:
    """Modes of the pose's posterior given one scan; none if the scan has too few paths to say anything.

    Parameters
    ----------
    rays : Rays
    prior : Prior or None
        One more factor; without one every place, heading and bias is as likely as any other.
    search : Search or None
    """
    search = search or Search()
    if not len(rays.z):
        return no_modes(0)
    grid = headings(search.heading_step, prior)
    step = float(grid[1] - grid[0])
    poses = [from_bounces(rays, grid, search.most_paths, prior), from_sights(rays, search.most_sights)]
    if prior is not None:
        around = np.tile(np.asarray(prior.mean, float), (len(grid), 1))
        around[:, 2] = grid
        poses.append(around)
    pose = np.concatenate(poses)
    if not len(pose):
        return no_modes(len(rays.z))
    coarse = step / np.sqrt(12)
    sights = np.repeat([False, True], [len(poses[0]), len(pose) - len(poses[0])])
    score = _score(pose, rays, prior, search, coarse, sights)
    pose = pose[_spread(pose, score, search.refined, step, rays.extent)]
    pose, information, density, parts = _refine(pose, rays, prior, search, coarse)
    return _collect(pose, information, density, parts, rays, search)


def _prior_terms(pose: Array, prior: Prior | None) -> tuple[Array, Array, Array | float]:
    """log density (C,), gradient (C, 4) and information of the prior."""
    if prior is None:
        return np.zeros(len(pose)), np.zeros((len(pose), 4)), 0.0
    information = prior.information
    difference = prior.mean - pose
    difference[:, 2] = wrap(difference[:, 2])
    pull = difference @ information
    constant = 0.5 * np.linalg.slogdet(information)[1] - 2 * np.log(2 * np.pi)
    return constant - 0.5 * np.sum(pull * difference, axis=1), pull, information


def _score(pose: Array, rays: Rays, prior: Prior | None, search: Search, coarse: float, sights) -> Array:
    score = _prior_terms(pose, prior)[0]
    for flag in (False, True):
        rows = np.flatnonzero(sights == flag)
        for first in range(0, len(rows), CHUNK):
            part = rows[first : first + CHUNK]
            score[part] += explain(pose[part], rays, search.beliefs, coarse, flag).log_likelihood
    return score


def _spread(pose: Array, score: Array, count: int, step: float, extent: float) -> NDArray[np.int64]:
    """Best rows, one for each cell of headings, places and biases, so that one mode does not take all the room."""
    order = np.argsort(-score, kind="stable")[: 40 * count]
    cell = np.floor(pose[order] / np.array([extent / 30, extent / 30, 2.5 * step, extent / 30])).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    return order[np.sort(first)[:count]]


def _refine(pose: Array, rays: Rays, prior: Prior | None, search: Search, coarse: float):
    """Poses at the peaks, information, log density there, and what explains the paths."""
    # Without a prior the peak is bounded by a room some ten times as wide as what the delays span.
    floor = np.diag([0.1 / rays.extent, 0.1 / rays.extent, 0.1, 0.1 / rays.extent]) ** 2
    longest = np.array([0.2 * rays.extent, 0.2 * rays.extent, 0.2, 0.2 * rays.extent])
    for iteration in range(search.iterations):
        widened = coarse * 0.4**iteration if iteration < search.iterations - 3 else 0.0
        parts = explain(pose, rays, search.beliefs, widened)
        _, pull, information = _prior_terms(pose, prior)
        total = _regular(parts.information + information + floor)
        change = np.linalg.solve(total, (parts.gradient + pull)[..., None])[..., 0]
        change /= np.maximum(1.0, np.max(np.abs(change) / longest, axis=1, keepdims=True, initial=0.0))
        pose = pose + change
        pose[:, 2] = wrap(pose[:, 2])
    parts = explain(pose, rays, search.beliefs)
    log_prior, _, information = _prior_terms(pose, prior)
    return pose, _regular(parts.information + information + floor), parts.log_likelihood + log_prior, parts


def _regular(information: Array) -> Array:
    """Information that can be inverted: paths measured to micrometers drown a floor of meters in their rounding."""
    diagonal = np.einsum("mii->mi", information)
    return information + ROUNDING * diagonal[:, :, None] * np.eye(information.shape[-1])


def _collect(pose: Array, information: Array, density: Array, parts, rays: Rays, search: Search) -> Modes:
    """Distinct modes by falling evidence."""
    good = np.isfinite(density) & np.isfinite(pose).all(axis=1)
    evidence = np.where(good, density - 0.5 * np.linalg.slogdet(information)[1] + 2 * np.log(2 * np.pi), -np.inf)
    kept: list[int] = []
    for row in np.argsort(-evidence, kind="stable"):
        if len(kept) == search.modes or not np.isfinite(evidence[row]):
            break
        apart = pose[kept] - pose[row]
        apart[:, 2] = wrap(apart[:, 2])
        if not kept or np.einsum("mi,mij,mj->m", apart, information[kept], apart).min() > 25.0:
            kept.append(int(row))
    covariance = np.linalg.inv(information[kept]) if kept else np.empty((0, 4, 4))
    chosen = parts.bounce_probability[kept], parts.sight_probability[kept]
    velocity = _velocities(pose[kept], rays, *chosen) if rays.doppler and kept else (None, None)
    return Modes(pose[kept], 0.5 * (covariance + np.swapaxes(covariance, 1, 2)), evidence[kept], *chosen, *velocity)


def _velocities(pose: Array, rays: Rays, bounce: Array, sight: Array) -> tuple[Array, Array]:
    """Horizontal velocity from d = vᵀq over the explained paths, q the arrival direction; robust in two rounds."""
    angles = rays.angles
    q = directions(angles[:, 0] + pose[:, 2, None], angles[:, 1])[0][..., :2]
    variance = rays.covariance[:, 5, 5]
    weight = (bounce + sight) / variance
    floor = 1e-6 * np.eye(2)  # a receiver on foot or wheels: far below 1 km/s
    for _ in range(3):
        information = np.einsum("mn,mni,mnj->mij", weight, q, q) + floor
        velocity = np.linalg.solve(information, np.einsum("mn,mni,n->mi", weight, q, rays.z[:, 5])[..., None])[..., 0]
        error = rays.z[:, 5] - np.einsum("mni,mi->mn", q, velocity)
        weight = (bounce + sight) / variance * 5.0 / (4.0 + error**2 / variance)
    return velocity, np.linalg.inv(information)
