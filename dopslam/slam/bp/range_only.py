"""Distance-only BP-SLAM with several anchors in the plane: the setting of Leitinger et al. (2019), paper B
[1].

Every anchor has its own map of virtual anchors; a measurement is a distance of standard deviation 0.10 m, detected with
p_D = 0.95 among one false alarm per anchor. Features are born from an intensity of undetected anchors along the ring
of every unexplained distance. Stacked particles coupled by index and resampled in order; data association on Gaussian
moments; a likelihood deviation larger than the true one (0.15 m) keeps the particle sets from collapsing. The constants
are those published with that paper; room and track of :func:`office` are ours.

Limitation: in this room the map locks to the agent's first errors, because separate marginals forget that all features
share them: in most runs the agent stays 0.08–0.2 m off, and some runs lose it. The published 0.05 m are not reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.compiled import compiled
from dopslam.slam.bp.belief import effective_size, normalized, systematic
from dopslam.slam.loopy import loopy_association


@dataclass(frozen=True, slots=True)
class RangeParameters:
    """Parameters, SI.

    deviation, filter_deviation : of the distances, true and assumed [m]; detection : p_D; clutter : false
        alarms per
    anchor and step; distance_end : they are uniform up to there [m]; acceleration : driving noise per axis
    [m/s²];
    interval : T [s]; survival; undetected : mean number of undetected anchors, births : new ones per step,
        both
    uniform over ``area`` [m²]; position_walk : of the features per step [m]; detection_threshold,
    pruning_threshold
    """

    deviation: float = 0.10
    filter_deviation: float = 0.15
    detection: float = 0.95
    clutter: float = 1.0
    distance_end: float = 30.0
    acceleration: float = 0.01
    interval: float = 1.0
    survival: float = 0.999
    undetected: float = 6.0
    births: float = 1e-4
    area: float = 60.0**2
    position_walk: float = 1e-4
    detection_threshold: float = 0.5
    pruning_threshold: float = 1e-4


@dataclass(frozen=True, slots=True)
class RangeMap:
    """Features of one anchor: particles (2, K, N) [m], existence (K,), intensity of undetected ones [1/m²]."""

    particles: np.ndarray
    existence: np.ndarray
    undetected: float


@dataclass(frozen=True, slots=True)
class RangeState:
    """Agent particles (4, N) = x, y, v_x, v_y, and one map per anchor."""

    agent: np.ndarray
    maps: tuple[RangeMap, ...]


@dataclass(frozen=True, slots=True)
class RangeInfo:
    """Diagnostics: position (2,) m, declared features of every anchor (D, 2) m, effective sample size."""

    position: np.ndarray
    features: tuple[np.ndarray, ...]
    effective: float


@dataclass(frozen=True)
class RangeOnly:
    """The filter: parameters only; ``init`` and ``step`` are pure."""

    parameters: RangeParameters

    def init(
        self, rng: np.random.Generator, anchors: np.ndarray, center: np.ndarray, size: int, radius=0.5, speed=0.05
    ) -> RangeState:
        """Agent uniform in a disc [m] with velocities in ±speed [m/s]; anchors (J, 2) known to 1 mm."""
        p = self.parameters
        angle, r = rng.uniform(0, 2 * np.pi, size), radius * np.sqrt(rng.random(size))
        agent = np.stack(
            [center[0] + r * np.cos(angle), center[1] + r * np.sin(angle), *rng.uniform(-speed, speed, (2, size))]
        )
        maps = tuple(
            RangeMap(
                (np.asarray(a, float)[:, None] + 1e-3 * rng.standard_normal((2, size)))[:, None],
                np.ones(1), p.undetected / p.area,
            )
            for a in anchors
        )  # fmt: skip
        return RangeState(agent, maps)

    def step(
        self, rng: np.random.Generator, state: RangeState, z: Sequence[np.ndarray]
    ) -> tuple[RangeState, RangeInfo]:
        """One step with the distances of every anchor, each (M,) m."""
        p, size = self.parameters, state.agent.shape[1]
        w = p.acceleration * rng.standard_normal((2, size))
        agent = np.concatenate(
            [state.agent[:2] + p.interval * state.agent[2:] + 0.5 * p.interval**2 * w, state.agent[2:] + p.interval * w]
        )
        log_weight, updated = np.zeros(size), []
        for old, distances in zip(state.maps, z, strict=True):
            updated.append(self._update_map(rng, agent, old, np.asarray(distances, float), log_weight))
        normal = normalized(log_weight)
        maps = tuple(self._with_births(rng, agent, *entry) for entry in updated)
        agent = agent[:, systematic(rng, normal, size)]
        features = tuple(m.particles[:, m.existence > p.detection_threshold].mean(axis=2).T for m in maps)
        return RangeState(agent, maps), RangeInfo(agent[:2].mean(axis=1), features, effective_size(normal))

    def _update_map(self, rng, agent, old: RangeMap, z, log_weight):
        """Associate and update one anchor's features; adds their messages to the agent's log weights."""
        p, size = self.parameters, agent.shape[1]
        walk = np.concatenate([rng.standard_normal(4 * size)] * 2)
        particles = _walked(old.particles, walk, rng.integers(0, 4 * size, (2, len(old.existence))), p.position_walk)
        existence = p.survival * old.existence
        intensity = p.survival * old.undetected + p.births / p.area
        distance, mean, variance = _distances(agent, particles)
        spread = variance[:, None] + p.filter_deviation**2
        density = np.exp(-0.5 * (z - mean[:, None]) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
        false_alarm = p.clutter / p.distance_end
        # ∫ N(z; ‖q − p‖) dq over the plane is the ring's circumference 2πz.
        birth = p.detection * intensity * 2 * np.pi * z
        with np.errstate(divide="ignore"):
            association = loopy_association(
                np.log(1 - existence * p.detection),
                np.log(existence[:, None] * p.detection * density),
                np.log(false_alarm + birth),
            )
        nu = np.where(association.marginal[:, 1:] > 1e-6, np.exp(association.log_nu), 0.0)
        lam = _messages(distance, z, nu * p.detection, 1 - p.detection, p.filter_deviation, existence, log_weight)
        average = lam.mean(axis=1)
        existence = existence * average / (existence * average + 1 - existence)
        keep = np.flatnonzero(existence > p.pruning_threshold)
        kept = _resampled(particles, lam, keep, rng.random(keep.size))
        new = association.new * birth / (false_alarm + birth)
        return RangeMap(kept, existence[keep], (1 - p.detection) * intensity), z, new

    def _with_births(self, rng, agent, current: RangeMap, z, new) -> RangeMap:
        """Adds a ring of particles for every distance that is likely new."""
        likely = np.flatnonzero(new > self.parameters.pruning_threshold)
        if likely.size == 0:
            return current
        size = agent.shape[1]
        angle = rng.uniform(0, 2 * np.pi, (likely.size, size))
        radius = z[likely, None] + self.parameters.filter_deviation * rng.standard_normal((likely.size, size))
        rings = agent[:2, None] + radius * np.stack([np.cos(angle), np.sin(angle)])
        return RangeMap(
            np.concatenate([current.particles, rings], axis=1),
            np.concatenate([current.existence, new[likely]]),
            current.undetected,
        )


@compiled
def _walked(particles, pool, offsets, deviation):
    out = np.empty_like(particles)
    _, features, size = particles.shape
    for a in range(2):
        for k in range(features):
            start = offsets[a, k]
            for i in range(size):
                out[a, k, i] = particles[a, k, i] + deviation * pool[start + i]
    return out


@compiled
def _distances(agent, particles):
    """Distances (K, N) of index-coupled particles, their means and variances (K,)."""
    _, features, size = particles.shape
    distance, mean, variance = np.empty((features, size)), np.empty(features), np.empty(features)
    for k in range(features):
        first = 0.0
        s1, s2 = 0.0, 0.0
        for i in range(size):
            dx, dy = particles[0, k, i] - agent[0, i], particles[1, k, i] - agent[1, i]
            d = np.sqrt(dx * dx + dy * dy)
            distance[k, i] = d
            if i == 0:
                first = d
            s1 += d - first
            s2 += (d - first) ** 2
        mean[k] = first + s1 / size
        variance[k] = s2 / size - (s1 / size) ** 2
    return distance, mean, variance


@compiled
def _messages(distance, z, coefficient, missed, deviation, existence, log_weight):
    """λ (K, N), and ln of r λ + 1 − r added to the agent's log weights in place."""
    features, size = distance.shape
    lam = np.empty((features, size))
    norm = 1.0 / (np.sqrt(2 * np.pi) * deviation)
    for k in range(features):
        for i in range(size):
            total = missed
            for m in range(z.size):
                if coefficient[k, m] > 0.0:
                    e = (z[m] - distance[k, i]) / deviation
                    if abs(e) < 9.0:
                        total += coefficient[k, m] * norm * np.exp(-0.5 * e * e)
            lam[k, i] = total
            log_weight[i] += np.log(existence[k] * total + 1.0 - existence[k])
    return lam


@compiled
def _resampled(particles, lam, keep, points):
    """Systematic resampling of the kept features by λ, in order: index i keeps its place relative to the agent's."""
    size = particles.shape[2]
    out = np.empty((2, keep.size, size))
    for j in range(keep.size):
        k = keep[j]
        step = lam[k].sum() / size
        threshold, source = points[j] * step, 0
        cumulative = lam[k, 0]
        for place in range(size):
            while cumulative < threshold and source < size - 1:
                source += 1
                cumulative += lam[k, source]
            out[0, j, place] = particles[0, k, source]
            out[1, j, place] = particles[1, k, source]
            threshold += step
    return out


@dataclass(frozen=True)
class RangeScenario:
    """Track (K, 2) m and per anchor the true features (L_j, 2) m, the anchor itself first."""

    track: np.ndarray
    features: tuple[np.ndarray, ...]

    @property
    def anchors(self) -> np.ndarray:
        """(J, 2) m."""
        return np.array([f[0] for f in self.features])

    def draw(self, rng: np.random.Generator, parameters: RangeParameters) -> list[list[np.ndarray]]:
        """Distances per step and anchor: detected paths with noise, and false alarms."""
        scans = []
        for place in self.track:
            step = []
            for features in self.features:
                true = np.linalg.norm(features - place, axis=1)
                seen = rng.random(true.size) < parameters.detection
                noisy = true[seen] + parameters.deviation * rng.standard_normal(seen.sum())
                false = rng.uniform(0, parameters.distance_end, rng.poisson(parameters.clutter))
                step.append(rng.permutation(np.concatenate([noisy, false])))
            scans.append(step)
        return scans


def office(steps: int = 900, length: float = 0.03) -> RangeScenario:
    """A 10 m × 8 m room with two anchors and eleven anchors in all: images in the four walls, one of second
    order.

    The track is a figure of eight, walked in steps of ``length`` [m].
    """
    width, depth = 10.0, 8.0

    def images(a):
        return [a, [-a[0], a[1]], [2 * width - a[0], a[1]], [a[0], -a[1]], [a[0], 2 * depth - a[1]]]

    # Both on one side: on the line between two anchors, distances alone cannot tell left from right.
    first, second = [1.6, 1.5], [8.3, 1.2]
    maps = (np.array([*images(first), [2 * width - first[0], -first[1]]]), np.array(images(second)))
    phase = np.linspace(0, 6 * np.pi, 60001)
    path = np.column_stack([5 + 3.2 * np.sin(phase), 5 + 1.6 * np.sin(2 * phase)])
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    reached = length * np.arange(1, steps + 1)
    return RangeScenario(np.column_stack([np.interp(reached, arc, path[:, a]) for a in range(2)]), maps)
