"""Distance-only BP-SLAM with several anchors in the plane: the setting of Leitinger et al. (2019), paper B
[1].

Every anchor has its own map of virtual anchors; a measurement is a distance of standard deviation 0.10 m, detected with
p_D = 0.95 among one false alarm per anchor. A single distance leaves a feature anywhere on a ring. A feature's belief is
therefore a mixture of Gaussians, born around the ring and pruned and merged as the agent moves; given a particle of the
agent each Gaussian is updated in closed form.

Weights and means are those *given the particle's trajectory* and travel with it through the resampling; covariances and
existence are common to all particles, data association is loopy and uses Gaussian moments as the published code does.
With one mixture for all particles, or with stacked particles of agent and features that are resampled
apart, a feature's belief forgets that all features share the agent's past errors: the map then locks to the first of
them, and in this room the agent stays 0.08–0.2 m off, twice to four times the bound.

New features come from an intensity of undetected anchors along the ring of every unexplained distance. Improbable ones
wait as bare distances, without a say in the agent's position, until they are seen again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.slam.association.loopy import Association, loopy_association
from dopslam.slam.belief.belief import effective_size, normalized, systematic
from dopslam.slam.belief.distance_only import kernels
from dopslam.slam.belief.stacked.clouds import in_threads

_EVIDENCE = 250  # particles behind the Gaussian moments of data association
_PARTS = 2  # pieces that the particles are worked on in; fixed, so that sums do not depend on the machine
_WORTH_THREADS = 1_000_000  # components times particles
_ANCHOR_DEVIATION = 1e-3  # m


@dataclass(frozen=True, slots=True)
class RangeParameters:
    """Parameters, SI.

    deviation, filter_deviation : of the distances, true and assumed [m]; detection : p_D; clutter : false
        alarms per anchor and step; distance_end : they are uniform up to there [m]
    acceleration : driving noise per axis [m/s²]; interval : T [s]; survival
    undetected : mean number of undetected anchors, births : new ones per step, both uniform over ``area`` [m²]
    position_walk : of the features per step [m]; detection_threshold, pruning_threshold
    confirmation : existence from which a feature gets a ring and a say
    sagitta : by which the ring leaves a component's tangent at one standard deviation [m]
    component_floor, component_distance : components lighter than this are pruned, nearer ones (squared Mahalanobis
        distance) merged
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
    births: float = 1e-3
    area: float = 60.0**2
    position_walk: float = 1e-4
    detection_threshold: float = 0.5
    pruning_threshold: float = 1e-4
    confirmation: float = 0.1
    sagitta: float = 0.04
    component_floor: float = 1e-5
    component_distance: float = 0.3


@dataclass(frozen=True, slots=True)
class RangeMap:
    """Features of one anchor; feature 0 is the anchor itself, known.

    existence : (K,); first : (K + 1,) the features' first components
    weight (C, N), mean (C, 2, N) [m] per particle, covariance (C, 3) = xx, xy, yy [m²] of the components
    undetected : intensity of undetected features [1/m²]
    waiting : (Q, 3) distance [m], its variance and existence of features not confirmed yet
    """

    existence: np.ndarray
    first: np.ndarray
    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    undetected: float
    waiting: np.ndarray


@dataclass(frozen=True, slots=True)
class RangeState:
    """Agent particles (4, N) = x, y, v_x, v_y with log weights (N,), and one map per anchor."""

    agent: np.ndarray
    log_weight: np.ndarray
    maps: tuple[RangeMap, ...]


@dataclass(frozen=True, slots=True)
class RangeInfo:
    """Diagnostics: position (2,) m and its covariance, declared features of every anchor (D, 2) m, effective sample
    size, components in all."""

    position: np.ndarray
    covariance: np.ndarray
    features: tuple[np.ndarray, ...]
    effective: float
    components: int


@dataclass(frozen=True, slots=True)
class _Evaluated:
    """One anchor's step before the agent's new weights are known; rows of the association: features, waiting ones."""

    z: np.ndarray
    existence: np.ndarray
    covariance: np.ndarray
    undetected: float
    waiting: np.ndarray
    association: Association
    birth_share: np.ndarray
    lam: np.ndarray
    gamma: np.ndarray


@dataclass(frozen=True)
class RangeOnly:
    """The filter: parameters only. ``step`` overwrites the arrays of the old state's maps, its largest ones."""

    parameters: RangeParameters

    def init(
        self, rng: np.random.Generator, anchors: np.ndarray, center: np.ndarray, size: int, radius=0.5, speed=0.05
    ) -> RangeState:
        """Agent uniform in a disc [m] with velocities in ±speed [m/s]; anchors (J, 2) known to 1 mm."""
        angle, r = rng.uniform(0, 2 * np.pi, size), radius * np.sqrt(rng.random(size))
        agent = np.stack(
            [center[0] + r * np.cos(angle), center[1] + r * np.sin(angle), *rng.uniform(-speed, speed, (2, size))]
        )
        known = np.array([[1.0, 0.0, 1.0]]) * _ANCHOR_DEVIATION**2
        maps = tuple(
            RangeMap(
                np.ones(1), np.array([0, 1]), np.ones((1, size), np.float32), np.repeat(np.asarray(a, np.float32)[None, :, None], size, axis=2), known,
                self.parameters.undetected / self.parameters.area, np.zeros((0, 3)),
            )
            for a in np.asarray(anchors)
        )  # fmt: skip
        return RangeState(agent, np.zeros(size), maps)

    def step(
        self, rng: np.random.Generator, state: RangeState, z: Sequence[np.ndarray]
    ) -> tuple[RangeState, RangeInfo]:
        """One step with the distances of every anchor, each (M,) m; ``state`` is used up."""
        p, size = self.parameters, state.agent.shape[1]
        w = p.acceleration * rng.standard_normal((2, size))
        agent = np.concatenate(
            [state.agent[:2] + p.interval * state.agent[2:] + 0.5 * p.interval**2 * w, state.agent[2:] + p.interval * w]
        )
        prior = normalized(state.log_weight)
        evaluated = [
            self._evaluate(agent, prior, old, np.asarray(distances, float))
            for old, distances in zip(state.maps, z, strict=True)
        ]
        log_weight = state.log_weight + sum(np.log(e.gamma.prod(axis=0)) for e in evaluated)
        weight = normalized(log_weight)
        effective = effective_size(weight)
        position = agent[:2] @ weight
        offset = agent[:2] - position[:, None]
        ancestors = np.arange(size)
        if effective < 0.5 * size:
            ancestors, log_weight = systematic(rng, weight, size), np.zeros(size)
        maps, features = zip(
            *(self._update(agent, weight, ancestors, *pair) for pair in zip(state.maps, evaluated, strict=True)),
            strict=True,
        )
        components = sum(len(m.weight) for m in maps)
        info = RangeInfo(position, (weight * offset) @ offset.T, features, effective, components)
        return RangeState(agent[:, ancestors], log_weight, maps), info

    def _evaluate(self, agent, prior, old: RangeMap, z) -> _Evaluated:
        """Associate one anchor's distances; messages and conditional updates of its features."""
        p, size = self.parameters, agent.shape[1]
        covariance = old.covariance.copy()
        covariance[1:, [0, 2]] += p.position_walk**2
        existence = np.r_[old.existence[:1], p.survival * old.existence[1:]]
        undetected = p.survival * old.undetected + p.births / p.area
        waiting = old.waiting.copy()
        waiting[:, 2] *= p.survival
        # A waiting distance may change by as much as the agent moves.
        waiting[:, 1] += p.interval**2 * (agent[2:] ** 2).sum(axis=0).mean()
        chosen = np.arange(0, size, max(1, size // _EVIDENCE))
        share = prior[chosen] / prior[chosen].sum()
        mass, center, spread = kernels.predicted(agent[:2], share, chosen, old.weight, old.mean, covariance)
        single = mass[:, None] * _normal(z, center, spread + p.filter_deviation**2)
        density = np.vstack(
            [
                np.add.reduceat(single, old.first[:-1], axis=0) if z.size else np.zeros((len(existence), 0)),
                _normal(z, waiting[:, 0], waiting[:, 1] + p.filter_deviation**2),
            ]
        )
        false_alarm = p.clutter / p.distance_end
        # ∫ N(z; ‖q − p‖) dq over the plane is the ring's circumference 2πz.
        birth = p.detection * undetected * 2 * np.pi * z
        exists = np.r_[existence, waiting[:, 2]]
        with np.errstate(divide="ignore"):
            association = loopy_association(
                np.log(1 - exists * p.detection),
                np.log(exists[:, None] * p.detection * density),
                np.log(false_alarm + birth),
            )
        nu = np.where(association.marginal[:, 1:] > 1e-4, np.exp(association.log_nu), 0.0)[: len(existence)]
        lam = np.empty((len(existence), size), np.float32)
        places, own = np.float32(agent[:2]), np.float32(prior)
        bounds = np.linspace(0, size, _PARTS + 1).astype(int)
        sums = np.zeros((_PARTS, len(old.weight), 4))
        _threaded(len(old.weight) * size, kernels.condition, [
            (
                places, old.first, old.weight, old.mean, covariance, 1, z, nu * p.detection,
                np.float32(1 - p.detection), np.float32(p.filter_deviation**2), own, *bounds[j : j + 2], lam,
                sums[j],
            )
            for j in range(_PARTS)
        ])  # fmt: skip
        change = sums.sum(axis=0)
        covariance += np.divide(change[:, 1:], change[:, :1], out=np.zeros_like(covariance), where=change[:, :1] > 0)
        gamma = existence[:, None] * lam + 1 - existence[:, None]
        return _Evaluated(
            z, existence, covariance, undetected, waiting, association, birth / (false_alarm + birth), lam, gamma,
        )  # fmt: skip

    def _update(self, agent, weight, ancestors, old: RangeMap, new: _Evaluated) -> tuple[RangeMap, np.ndarray]:
        """The anchor's map with the agent's new weights; its declared features (D, 2), likeliest components."""
        p, size = self.parameters, agent.shape[1]
        extrinsic = 1 / new.gamma  # without the feature's own message
        evidence = (extrinsic * new.lam) @ weight / (extrinsic @ weight)
        existence = new.existence * evidence / (new.existence * evidence + 1 - new.existence)
        existence[0] = 1.0
        keep = np.flatnonzero(existence > p.pruning_threshold)
        grouped, single = [], np.float32(weight)
        for k in keep:
            rows = slice(old.first[k], old.first[k + 1])
            mass, center = kernels.averages(old.weight[rows], old.mean[rows], new.lam[k], single)
            groups = kernels.groups(mass, center, new.covariance[rows], p.component_floor, p.component_distance)
            grouped.append((mass, center, rows, *groups))
        rings, waiting = self._births(new)
        counts = np.array([count for *_, count in grouped] + [_ring_size(z, p.sagitta) for z, _ in rings], int)
        first = np.concatenate([[0], np.cumsum(counts)])
        mean, share = np.empty((first[-1], 2, size), np.float32), np.empty((first[-1], size), np.float32)
        covariance = _threaded(len(old.weight) * size, kernels.merged, [
            (
                mass, center, new.covariance[rows], group, count, old.weight[rows], old.mean[rows], new.lam[k], ancestors,
                share[first[j] : first[j + 1]], mean[first[j] : first[j + 1]],
            )
            for j, (k, (mass, center, rows, group, count)) in enumerate(zip(keep, grouped, strict=True))
        ])  # fmt: skip
        declared = []
        for j in np.flatnonzero(existence[keep] > p.detection_threshold):
            rows = slice(first[j], first[j + 1])
            best = first[j] + share[rows].mean(axis=1).argmax()
            declared.append(mean[best] @ share[best] / share[best].sum())
        for j, (z, _) in enumerate(rings, start=len(keep)):
            rows = slice(first[j], first[j + 1])
            share[rows] = 1 / counts[j]
            covariance.append(_ring(agent[:2, ancestors], z, counts[j], p.filter_deviation**2, mean[rows]))
        updated = RangeMap(
            np.r_[existence[keep], [r for _, r in rings]],
            first,
            share,
            mean,
            np.concatenate(covariance),
            (1 - p.detection) * new.undetected,
            waiting,
        )
        return updated, np.array(declared)

    def _births(self, new: _Evaluated) -> tuple[list[tuple[float, float]], np.ndarray]:
        """Confirmed features as (distance, existence), and those that wait on, (Q', 3)."""
        p = self.parameters
        waiting = [
            (z, p.filter_deviation**2, r) for z, r in zip(new.z, new.association.new * new.birth_share, strict=True)
        ]
        for (d, variance, r), marginal in zip(new.waiting, new.association.marginal[len(new.existence) :], strict=True):
            seen = marginal[1:].sum()
            r = seen + marginal[0] * r * (1 - p.detection) / (1 - r * p.detection)
            if seen > 0.5:  # a moment-matched distance would lag behind the agent: the likeliest measurement is as good
                d, variance = new.z[marginal[1:].argmax()], p.filter_deviation**2
            waiting.append((d, variance, r))
        rings = [(z, r) for z, _, r in waiting if r > p.confirmation]
        rest = [w for w in waiting if p.pruning_threshold < w[2] <= p.confirmation]
        return rings, np.array(rest).reshape(-1, 3)


def _threaded(work: int, function, tasks: list[tuple]) -> list:
    """:func:`in_threads` where the work, components times particles, is worth starting threads."""
    return in_threads(function, tasks) if work > _WORTH_THREADS else [function(*task) for task in tasks]


def _normal(z: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Densities N(z_m; mean_k, variance_k), (K, M)."""
    offset = (z - mean[:, None]) ** 2 / variance[:, None]
    return np.exp(-0.5 * offset) / np.sqrt(2 * np.pi * variance[:, None])


def _ring_size(z: float, sagitta: float) -> int:
    """Components of a ring of radius z, one standard deviation apart."""
    return max(int(np.ceil(2 * np.pi * z / np.sqrt(2 * z * sagitta))), 8)


def _ring(places: np.ndarray, z: float, count: int, variance: float, out: np.ndarray) -> np.ndarray:
    """Covariances of a ring around every particle's place (2, N), whose means go into ``out``."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    e = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    out[:] = places + z * e[:, :, None]
    along = (2 * np.pi * z / count) ** 2
    c, s = e.T
    return np.stack(
        [variance * c**2 + along * s**2, (variance - along) * c * s, variance * s**2 + along * c**2], axis=1
    )
