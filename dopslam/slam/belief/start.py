"""Initial particles of the agent: uniform, informed by the first line of sight, or Gaussian about a known start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.slam.belief import geometry
from dopslam.slam.belief.motion import particles
from dopslam.slam.belief.records import Parameters, Scan


@dataclass(frozen=True)
class Box:
    """Uniform prior of paper B, Section VI-A.

    Parameters
    ----------
    center : (3,) m, half_width : m in x and y
    half_speed : m/s, velocities in x and y are uniform in ±half_speed
    half_height, half_climb : the same for z [m] and its velocity [m/s]; 0 if the height is known
    """

    center: np.ndarray
    half_width: float = 0.5
    half_speed: float = 1.0
    half_height: float = 0.0
    half_climb: float = 0.0

    def contains(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """(N,) whether particles are inside."""
        inside = np.abs(position[:, :2] - self.center[:2]).max(axis=1) <= self.half_width
        inside &= np.abs(velocity[:, :2]).max(axis=1) <= self.half_speed
        return inside & (np.abs(position[:, 2] - self.center[2]) <= self.half_height + 1e-9)


def uniform_start(rng: np.random.Generator, box: Box, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles (N, 8) from the box and log weights (N,), before the first step."""
    position = np.tile(box.center, (size, 1))
    position[:, :2] += rng.uniform(-box.half_width, box.half_width, (size, 2))
    velocity = np.zeros((size, 3))
    velocity[:, :2] = rng.uniform(-box.half_speed, box.half_speed, (size, 2))
    position[:, 2] += rng.uniform(-box.half_height, box.half_height, size)
    velocity[:, 2] = rng.uniform(-box.half_climb, box.half_climb, size)
    return particles(position, velocity), np.zeros(size)


def informed_start(
    rng: np.random.Generator, box: Box, scan: Scan, parameters: Parameters, interval: float, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Importance sample of the box prior where the first line of sight points.

    The strongest measurement whose distance and AOD point into the box proposes position and heading (widened
    1.5 times); the speed is uniform. The log weights are prior over proposal, so the measurement itself is
    not used up and the first ``step`` applies it once. Without such a measurement the start is uniform.
    """
    widen = 1.5
    place = parameters.anchor + scan.distance[:, None] * scan.aod
    near = np.abs(place[:, :2] - box.center[:2]).max(axis=1, initial=0.0) <= 1.2 * box.half_width
    if not near.any():
        return uniform_start(rng, box, size)
    m = int(np.argmax(np.where(near, scan.amplitude, -np.inf)))
    count = scan.tangents
    deviation = widen * np.sqrt(np.diag(scan.covariance[m]))[[0, 1, 1 + count, -1]]
    offset = deviation * rng.standard_normal((size, 4))  # distance, AOA azimuth, AOD azimuth, AOD elevation
    if box.half_height == 0.0:
        offset[:, 3] = 0.0
    length = scan.distance[m] + offset[:, 0]
    azimuth, elevation = np.arctan2(scan.aod[m, 1], scan.aod[m, 0]), np.arcsin(scan.aod[m, 2])
    if box.half_height > 0.0:
        rise = length * np.sin(elevation + offset[:, 3])
    else:  # the height is known: distance and AOD azimuth fix the horizontal position
        rise = np.full(size, box.center[2] - parameters.anchor[2])
    flat = np.sqrt(np.maximum(length**2 - rise**2, 1e-6))
    stretch = scan.distance[m] / flat  # tangent angle to azimuth
    position = parameters.anchor + flat[:, None] * geometry.unit_vector(azimuth + offset[:, 2] * stretch)
    position[:, 2] += rise
    arrival = np.arctan2(parameters.anchor[1] - position[:, 1], parameters.anchor[0] - position[:, 0])
    heading = arrival - np.arctan2(scan.aoa[m, 1], scan.aoa[m, 0]) + offset[:, 1] * stretch
    speed = rng.uniform(0, np.sqrt(2) * box.half_speed, size)
    velocity = speed[:, None] * geometry.unit_vector(heading)
    velocity[:, 2] = rng.uniform(-box.half_climb, box.half_climb, size)
    before = position - interval * velocity
    # Densities: the prior is constant in (p, v); the proposal's Jacobians are flat (polar position) and
    # speed. (Those of height and azimuth stretch vary by less than a percent over the proposal.)
    log_weight = 0.5 * np.sum((offset / deviation) ** 2, axis=1) + np.log(flat) + np.log(np.maximum(speed, 1e-9))
    return particles(before, velocity), np.where(box.contains(before, velocity), log_weight, -np.inf)


def gaussian_start(
    rng: np.random.Generator, position, velocity, bias: float, heading: float, deviations, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Particles about a known start.

    deviations : standard deviations of position (x and y) [m], speed [m/s], bias [m], heading [rad]
    """
    noise = rng.standard_normal((size, 5)) * np.array([deviations[0], *deviations])
    place = np.tile(np.asarray(position, float), (size, 1))
    place[:, :2] += noise[:, :2]
    angle = heading + noise[:, 4]
    speed = np.hypot(velocity[0], velocity[1]) + noise[:, 2]
    return particles(place, speed[:, None] * geometry.unit_vector(angle), bias + noise[:, 3], angle), np.zeros(size)
