"""One scan as rays, and what single bounces and lines of sight say about the receiver's pose.

A path leaves base station t along v, turns once, and arrives at p from direction u after d = τ − b metres:
p − t = d₂ v − d₁ u with d₁ + d₂ = d. Hence p − t − d v = −d₁ (u + v), and for every n ⟂ (u + v)

    e = nᵀ(p − t) − nᵀv (τ − b) = 0,

linear in position and bias once the heading turns u into the world: one equation in the plane, two in space. It holds
for reflections and scatter points alike, since the place of the turn is eliminated; its information on the pose is
that of the five angles and delay with the landmark unknown (a test holds the two together). A pose is
[x m, y m, heading rad, bias m]; the height is known. World frame, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.measurement import wrap

Array = NDArray[np.float64]

ROWS = 5  # c·τ, AOA az, AOA el, AOD az, AOD el; the radial velocity says nothing about the pose
STEEPEST = 10.0  # length of a path over its length on the ground
NEAR_SIGHT = 6.0  # standard deviations of u + v below which a path cannot be told from a line of sight


@dataclass(frozen=True, slots=True)
class Rays:
    """Detections of one scan.

    Attributes
    ----------
    z : (n, 6) array
        As :class:`dopslam.models.scans.Scans`: c·τ + bias [m], AOA az, el (in the receiver's frame), AOD az, el (in the
        world) [rad], radial velocity [m/s].
    covariance : (n, 6, 6) array
    anchor : (n, 3) array
        Base station that each path left [m].
    height : float
        Of the receiver [m].
    planar : bool
        No elevations were measured: everything lies in the horizontal plane but for the heights of base station and
        receiver, which are known.
    doppler : bool
        Whether the radial velocities were measured.
    """

    z: Array
    covariance: Array
    anchor: Array
    height: float = 0.0
    planar: bool = False
    doppler: bool = True

    def __post_init__(self) -> None:
        n = len(self.z)
        if self.z.shape != (n, 6) or self.covariance.shape != (n, 6, 6) or self.anchor.shape != (n, 3):
            raise FilterError(
                f"Rays: z {self.z.shape}, covariance {self.covariance.shape}, anchor {self.anchor.shape}; "
                "expected (n, 6), (n, 6, 6), (n, 3)"
            )

    @property
    def base(self) -> Array:
        """Anchors (n, 3) as the equations see them: in the plane at the receiver's height."""
        return np.column_stack([self.anchor[:, :2], np.full(len(self.z), self.height)]) if self.planar else self.anchor

    def ground(self, path: Array) -> tuple[Array, Array]:
        """Paths (C, n) as the equations see them, and their derivatives by the true length: in the plane what the drop from
        the base station to the receiver leaves of it, as behind walls that stand upright."""
        if not self.planar:
            return path, np.ones_like(path)
        level = np.sqrt(np.maximum(path**2 - (self.anchor[:, 2] - self.height) ** 2, 0.0))
        return np.where(path > 0, level, path), np.clip(path / np.maximum(level, 1e-9), 1.0, STEEPEST)

    @property
    def angles(self) -> Array:
        """(n, 4) AOA az, el, AOD az, el; elevations zero in the plane."""
        return self.z[:, 1:5] * ([1.0, 0.0, 1.0, 0.0] if self.planar else [1.0] * 4)

    @property
    def noise(self) -> Array:
        """(n, 5, 5) covariance of delay and angles; elevations exact in the plane."""
        noise = np.array(self.covariance[:, :ROWS, :ROWS])
        if self.planar:
            noise[:, [2, 4]] = 0.0
            noise[:, :, [2, 4]] = 0.0
        return noise

    @property
    def equations(self) -> int:
        """Equations of a single bounce."""
        return 1 if self.planar else 2

    @property
    def extent(self) -> float:
        """Span of the delays [m], the size of what is seen; the yardstick of everything uniform."""
        spread = np.sqrt(self.covariance[:, 0, 0])
        return float(np.ptp(self.z[:, 0]) + 10.0 * spread.max()) if len(self.z) else 1.0


def directions(azimuth: Array, elevation: Array) -> tuple[Array, Array, Array]:
    """Unit vectors (..., 3) and their derivatives by azimuth and elevation."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    zero = np.zeros(np.broadcast(ca, ce).shape)
    unit = np.stack([ce * ca, ce * sa, se + zero], axis=-1)
    by_azimuth = np.stack([-ce * sa, ce * ca, zero], axis=-1)
    by_elevation = np.stack([-se * ca, -se * sa, ce + zero], axis=-1)
    return unit, by_azimuth, by_elevation


@dataclass(frozen=True, slots=True)
class Bounce:
    """Single-bounce equations of C poses and n paths, m equations each.

    Attributes
    ----------
    error : (C, n, m) array [m]
    jacobian : (C, n, m, 4) array; by [x, y, heading, bias]
    covariance : (C, n, m, m) array; propagated from delay and angles
    possible : (C, n) bool; both legs and the whole are positive, and u + v is no mere noise
    arrival, departure : (C, n) arrays; legs d₁ and d₂ [m]
    """

    error: Array
    jacobian: Array
    covariance: Array
    possible: NDArray[np.bool_]
    arrival: Array
    departure: Array


def _normals(axis: Array, planar: bool) -> Array:
    """(..., m, 3) orthonormal vectors ⟂ `axis` (unit); in the plane the horizontal one alone."""
    helper = np.where(np.abs(axis[..., 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    first = np.asarray(np.cross(helper, axis), dtype=float)
    first /= np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
    if planar:
        return first[..., None, :]
    return np.stack([first, np.asarray(np.cross(axis, first), dtype=float)], axis=-2)


def bounce(pose: Array, rays: Rays, heading_std: float = 0.0) -> Bounce:
    """Equations of poses (C, 4); `heading_std` [rad] adds the doubt of a coarse heading to the noise."""
    angles, noise = rays.angles, rays.noise
    u, u_az, u_el = directions(angles[:, 0] + pose[:, 2, None], angles[:, 1])
    v, v_az, v_el = directions(angles[:, 2], angles[:, 3])
    both = u + v
    size = np.linalg.norm(both, axis=-1)
    axis = both / np.maximum(size, 1e-9)[..., None]
    normal = _normals(axis, rays.planar)
    position = np.column_stack([pose[:, :2], np.full(len(pose), rays.height)])
    path, slope = rays.ground(rays.z[:, 0] - pose[:, 3, None])
    rest = position[:, None] - rays.base - path[..., None] * v
    arrival = -np.einsum("cni,cni->cn", rest, axis) / np.maximum(size, 1e-9)
    departure = path - arrival
    along = {
        name: np.einsum("cnmi,cni->cnm", normal, np.broadcast_to(vector, u.shape))
        for name, vector in (("v", v), ("u_az", u_az), ("u_el", u_el), ("v_az", v_az), ("v_el", v_el))
    }
    error = np.einsum("cnmi,cni->cnm", normal, rest)
    near, far = np.maximum(arrival, 0.0)[..., None], np.maximum(departure, 0.0)[..., None]
    jacobian = np.stack([normal[..., 0], normal[..., 1], near * along["u_az"], slope[..., None] * along["v"]], axis=-1)
    by_noise = np.stack(
        [
            -slope[..., None] * along["v"],
            near * along["u_az"],
            near * along["u_el"],
            -far * along["v_az"],
            -far * along["v_el"],
        ],
        axis=-1,
    )
    covariance = np.einsum("cnmi,nij,cnlj->cnml", by_noise, noise, by_noise)
    if heading_std > 0:
        turn = heading_std * near * along["u_az"]
        covariance += turn[..., :, None] * turn[..., None, :]
    doubt = np.sqrt(np.einsum("nii->n", noise[:, 1:, 1:]))
    possible = (arrival > 0) & (departure > 0) & (path > 0) & (size > NEAR_SIGHT * doubt)
    return Bounce(error, jacobian, covariance, possible, arrival, departure)


def sight(pose: Array, rays: Rays) -> tuple[Array, Array]:
    """Residual (C, n, 5) of every path taken for the line of sight of its base station, and −∂/∂pose (C, n, 5, 4)."""
    position = np.column_stack([pose[:, :2], np.full(len(pose), rays.height)])
    way = position[:, None] - rays.anchor  # from base station to receiver
    flat = np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-9)
    length = np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
    azimuth, elevation = np.arctan2(way[..., 1], way[..., 0]), np.arctan2(way[..., 2], flat)
    angles, heading = rays.angles, pose[:, 2, None]
    residual = np.stack(
        [
            rays.z[:, 0] - pose[:, 3, None] - length,
            wrap(angles[:, 0] - (azimuth + np.pi - heading)),
            angles[:, 1] + elevation,
            wrap(angles[:, 2] - azimuth),
            angles[:, 3] - elevation,
        ],
        axis=-1,
    )
    jacobian = np.zeros((*residual.shape, 4))
    jacobian[..., 0, 0], jacobian[..., 0, 1], jacobian[..., 0, 3] = way[..., 0] / length, way[..., 1] / length, 1.0
    by_azimuth = np.stack([-way[..., 1], way[..., 0]], axis=-1) / flat[..., None] ** 2
    by_elevation = -way[..., :2] * (way[..., 2] / (flat * length**2))[..., None]
    jacobian[..., 1, :2] = jacobian[..., 3, :2] = by_azimuth
    jacobian[..., 1, 2] = -1.0
    jacobian[..., 2, :2], jacobian[..., 4, :2] = -by_elevation, by_elevation
    return residual, jacobian
