"""Poses worth a closer look: a grid of headings times small sets of single bounces, and lines of sight.

Given the heading a bounce is one (plane) or two (space) linear equations in x, y and the bias, so three paths, or two,
fix them. Nothing is known of which paths are single bounces: all sets are tried. A path taken for the line of sight
gives the heading from its two azimuths, and then every other path the bias. Power decides nothing: a weak late path
can pass as a line of sight, and a weak line of sight exists.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import wrap
from dopslam.slam.snapshot.rays import Rays, bounce, directions

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prior:
    """Gaussian knowledge of a pose: mean (4,) and covariance (4, 4) of [x m, y m, heading rad, bias m]."""

    mean: Array
    covariance: Array

    @property
    def information(self) -> Array:
        """Inverse covariance."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=float)


def headings(step: float, prior: Prior | None) -> Array:
    """Grid [rad] over the circle, or over four standard deviations of a prior that is narrower."""
    if prior is None or 4 * np.sqrt(prior.covariance[2, 2]) >= np.pi:
        return np.arange(-np.pi, np.pi, step)
    reach = 4 * float(np.sqrt(prior.covariance[2, 2]))
    return prior.mean[2] + np.linspace(-reach, reach, max(int(np.ceil(2 * reach / step)) + 1, 3))


def from_bounces(rays: Rays, grid: Array, most_paths: int, prior: Prior | None = None) -> Array:
    """Poses (C, 4) that solve the equations of every set of paths at every heading of the grid.

    At most `most_paths` of the earliest paths form sets: what bounced once is rarely late.
    """
    chosen = np.argsort(rays.z[:, 0], kind="stable")[:most_paths]
    size = 3 if rays.planar else 2
    if prior is None and len(chosen) < size:
        return np.empty((0, 4))
    start = np.zeros((len(grid), 4))
    start[:, 2], start[:, 3] = grid, rays.z[:, 0].min() - rays.extent
    found = bounce(start, rays)  # linear in x, y and the bias: any point gives the equations
    rows = found.jacobian[..., [0, 1, 3]]
    right = np.einsum("cnmk,ck->cnm", rows, start[:, [0, 1, 3]]) - found.error
    normal = np.einsum("cnmk,cnml->cnkl", rows, rows)
    vector = np.einsum("cnmk,cnm->cnk", rows, right)
    sets = [np.array(list(combinations(chosen, size)), dtype=int).reshape(-1, size)]
    information, offset = 1e-9 * np.eye(3), np.zeros(3)
    if prior is not None:
        # A typical error of one equation in metres brings the unit weights of the paths to the prior's scale.
        typical = float(np.mean(np.einsum("cnmm->cn", found.covariance)[found.possible])) if found.possible.any() else 1
        place = [0, 1, 3]
        information = max(typical, 1e-6) * np.linalg.inv(prior.covariance[np.ix_(place, place)])
        offset = information @ prior.mean[place]
        sets += [np.array(list(combinations(chosen, few)), dtype=int).reshape(-1, few) for few in range(1, size)]
    poses = []
    for members in sets:
        if not len(members):
            continue
        left = normal[:, members].sum(axis=2) + information
        solved = np.linalg.solve(left, (vector[:, members].sum(axis=2) + offset)[..., None])[..., 0]
        pose = np.concatenate([solved[..., :2], np.broadcast_to(grid[:, None, None], (*solved.shape[:2], 1)),
                               solved[..., 2:]], axis=-1)  # fmt: skip
        poses.append(pose[_reachable(pose, members, rays)])
    return np.concatenate(poses)


def _reachable(pose: Array, members: NDArray[np.int64], rays: Rays) -> NDArray[np.bool_]:
    """Whether every path of the set is at least as long as the straight way, as it must be."""
    length = rays.z[members, 0] - pose[..., 3, None]
    way = pose[..., None, :2] - rays.base[members][..., :2]
    height = rays.height - rays.base[members][..., 2]
    return np.all(length**2 > 0.98 * (np.sum(way**2, axis=-1) + height**2), axis=-1) & np.all(length > 0, axis=-1)


def from_sights(rays: Rays, most_sights: int) -> Array:
    """Poses (C, 4) for each of the earliest paths of every base station as its line of sight, and every other path as a
    bounce that gives the bias.
    """
    poses = []
    angles = rays.angles
    arrival = directions(angles[:, 0], angles[:, 1])[0]
    departure = directions(angles[:, 2], angles[:, 3])[0]
    for station in np.unique(rays.anchor, axis=0):
        own = np.flatnonzero(np.all(rays.anchor == station, axis=1))
        for path in own[np.argsort(rays.z[own, 0], kind="stable")][:most_sights]:
            heading = wrap(angles[path, 2] + np.pi - angles[path, 0])
            v = departure[path]
            turned = np.array(
                [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]]
            )
            # e_j = nᵀ(t_i + (τ_i − b) v_i − t_j) − nᵀv_j (τ_j − b), linear in b; least squares over its equations
            both = arrival @ turned.T + departure
            axis = both / np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-9)

            def across(vector, axis=axis):
                return vector - axis * np.sum(axis * vector, axis=-1, keepdims=True)

            fixed = across(rays.base[path] - rays.base + rays.z[path, 0] * v - rays.z[:, :1] * departure)
            slope = across(departure - v)
            weight = np.sum(slope * slope, axis=1)
            good = weight > 1e-4
            bias = -np.sum(slope * fixed, axis=1)[good] / weight[good]
            drop = rays.height - rays.base[path, 2]
            if not rays.planar and drop * v[2] > 0:  # how far down the ray meets the receiver's plane
                bias = np.append(bias, rays.z[path, 0] - drop / v[2])
            place = rays.base[path, :2] + (rays.z[path, 0] - bias)[:, None] * v[:2]
            pose = np.column_stack([place, np.full(len(bias), heading), bias])
            poses.append(pose[rays.z[path, 0] - bias > 0])
    return np.concatenate(poses) if poses else np.empty((0, 4))
