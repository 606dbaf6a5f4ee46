"""Tracks drawn from eq. (1) and detections drawn from the measurement model: paper A, Section V, without
tracing.

`Situation` is the world as it is; what a filter knows is given to it separately, so that mismatch can be
studied. Its noise is one of the kinds of :mod:`dopslam.simulate.noise`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.measurement import BS, SP, VA, measure, wrap
from dopslam.models.motion import CoordinatedTurn, MotionModel, propagate, unknown
from dopslam.models.paths import paths
from dopslam.models.pose import positions
from dopslam.models.scans import CLUTTER, Scans
from dopslam.simulate.noise import AmplitudeNoise, FixedNoise, Noise, SnrNoise, Told

Array = NDArray[np.float64]

__all__ = ["AmplitudeNoise", "FixedNoise", "Situation", "SnrNoise"]  # what a world is made of


@dataclass(frozen=True, slots=True)
class Situation:
    """The world detections are drawn from.

    Attributes
    ----------
    bs : (3,) array [m]
    kind : (L,) int array; entry 0 is the BS
    position : (L, 3) array [m]
    motion : MotionModel; of the true track
    prior_mean, prior_covariance : (n,), (n, n); the start is drawn from it
    steps : int
    noise : Noise; fixed, by link budget or by amplitude
    clutter_count : float; expected false detections per scan
    clutter_range : float; clutter path lengths lie in [bias, bias + clutter_range] [m]
    doppler_limit : float; clutter Dopplers lie within ± this [m/s]
    height : float; of the UE's plane [m]
    """

    bs: Array
    kind: NDArray[np.int64]
    position: Array
    motion: MotionModel
    prior_mean: Array
    prior_covariance: Array
    steps: int
    noise: Noise
    clutter_count: float = 1.0
    clutter_range: float = 300.0
    doppler_limit: float = 22.22
    height: float = 0.0

    def __post_init__(self) -> None:
        if len(self.kind) != len(self.position) or self.kind[0] != BS:
            raise FilterError("Situation: kind and position must have one row per landmark, the BS first")
        if self.prior_mean.size != self.motion.dimension:
            raise FilterError(
                f"Situation: prior_mean has {self.prior_mean.size} entries, the motion model {self.motion.dimension}"
            )

    def landmarks(self, kind: int) -> Array:
        """True positions (·, 3) of one kind."""
        return self.position[self.kind == kind]


def section_v(doppler_std: float = 0.1, prior: str = "std", steps: int = 40) -> Situation:
    """Paper A, Section V. `prior` reads the printed diag[0.3, 0.3, 0.0052, 0.3] as 'std' or 'var'."""
    if prior not in ("std", "var"):
        raise FilterError(f"prior is {prior!r}; it must be 'std' or 'var'")
    printed = np.array([0.3, 0.3, 0.0052, 0.3])
    position = [[0, 0, 40], [200, 0, 40], [-200, 0, 40], [0, 200, 40], [0, -200, 40]]
    position += [[99, 0, 10], [-99, 0, 10], [0, 99, 10], [0, -99, 10]]
    return Situation(
        bs=np.array([0.0, 0.0, 40.0]),
        kind=np.array([BS] + 4 * [VA] + 4 * [SP], dtype=np.int64),
        position=np.array(position, dtype=float),
        motion=CoordinatedTurn(0.5, np.diag([0.2, 0.2, 0.001, 0.2]) ** 2, 22.22, np.pi / 10),
        prior_mean=np.array([70.7285, 0.0, np.pi / 2, 300.0]),
        prior_covariance=np.diag(printed**2 if prior == "std" else printed),
        steps=steps,
        noise=FixedNoise(np.array([0.1, 0.05, 0.05, 0.05, 0.05, doppler_std])),
    )


def unknown_motion(
    situation: Situation,
    speed_std: float = 2.0,
    rate_std: float = 0.03,
    speed_walk: float = 0.1,
    rate_walk: float = 0.002,
) -> Situation:
    """The same world with speed and turn rate unknown and walking (per step): a six-state UE."""
    known: Any = situation.motion  # a coordinated turn, whose speed and turn rate become states
    motion = unknown(
        known.interval, known.process_noise, known.speed, known.turn_rate, speed_std, rate_std, speed_walk, rate_walk
    )
    mean, covariance = motion.prior(situation.prior_mean, situation.prior_covariance)
    return replace(situation, motion=motion, prior_mean=mean, prior_covariance=covariance)


def generators(seed: int, run: int, scenario: int = 0) -> tuple[np.random.Generator, ...]:
    """Generators of track, detections and clutter of one run: independent of workers and order."""
    return tuple(
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scenario, run, component)))
        for component in range(3)
    )


def draw_track(situation: Situation, rng: np.random.Generator) -> Array:
    """States (K, n) of one realization of eq. (1), start drawn from the prior."""
    n = situation.motion.dimension
    noise = rng.standard_normal((situation.steps + 1, n))
    state = situation.prior_mean + _root(situation.prior_covariance) @ noise[0]
    root = _root(situation.motion.process_noise)
    states = np.empty((situation.steps, n))
    for k in range(situation.steps):
        state = propagate(state, situation.motion) + root @ noise[k + 1]
        states[k] = state
    return states


def nominal_track(situation: Situation) -> Array:
    """States (K, n) without any noise: the circle."""
    states = np.empty((situation.steps, situation.motion.dimension))
    state = situation.prior_mean
    for k in range(situation.steps):
        state = propagate(state, situation.motion)
        states[k] = state
    return states


def _root(covariance: Array) -> Array:
    """Symmetric square root; semidefinite is fine."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def noise_of(situation: Situation, states: Array) -> Told:
    """Measurement covariance (K, L, 6, 6), detection probability (K, L) and ρ (K, L) or None along a
    track.
    """
    ue = positions(states, situation.height)[:, None]
    told = situation.noise.of(ue, situation.bs, situation.position, situation.kind)
    exists = paths(ue, situation.bs, situation.position, situation.kind).exists
    return told._replace(probability=np.where(exists, told.probability, 0.0))


def draw_scans(
    situation: Situation, states: Array, rng: np.random.Generator, clutter_rng: np.random.Generator
) -> Scans:
    """Detections along a track, with misses and clutter, in random order within each scan; labels tell the
    truth.
    """
    told = noise_of(situation, states)
    steps, count = told.probability.shape
    pose = situation.motion.pose(states[:, None], situation.height)
    exact = measure(pose, situation.position, situation.kind, situation.bs)
    errors = rng.standard_normal((steps, count, 6))
    covariance, detected, snr = situation.noise.detect(rng, told)
    z = exact + np.einsum("klij,klj->kli", np.linalg.cholesky(told.covariance), errors)
    false_counts = clutter_rng.poisson(situation.clutter_count, steps)
    columns: list[tuple[NDArray, ...]] = []
    for k in range(steps):
        seen, false = np.flatnonzero(detected[k]), int(false_counts[k])
        false_z = _draw_clutter(situation, states[k], false, clutter_rng)
        false_covariance, false_snr = situation.noise.false(clutter_rng, false, covariance[k, 0])
        order = clutter_rng.permutation(len(seen) + len(false_z))
        labels = np.concatenate([seen, np.full(len(false_z), CLUTTER)])[order]
        scan_snr = np.concatenate([snr[k, seen] if snr is not None else np.ones(len(seen)), false_snr])[order]
        columns.append(
            (
                np.concatenate([z[k, seen], false_z])[order],
                np.concatenate([covariance[k, seen], false_covariance])[order],
                labels,
                scan_snr,
            )
        )
    flat = [np.concatenate([c[i] for c in columns]) for i in range(4)]
    for azimuth in (1, 3):
        flat[0][:, azimuth : azimuth + 2] = _direction(flat[0][:, azimuth : azimuth + 2])
    span = 2 * situation.doppler_limit
    return Scans(
        z=flat[0],
        covariance=flat[1],
        offsets=np.concatenate([[0], np.cumsum([len(c[0]) for c in columns])]).astype(np.int64),
        clutter_count=max(situation.clutter_count, 1e-6),
        search_volume=situation.clutter_range * (2 * np.pi * np.pi) ** 2 * span,
        doppler_span=span,
        snr=None if snr is None else flat[3],
        threshold=situation.noise.threshold,
        label=flat[2].astype(np.int64),
    )


def _direction(angles: Array) -> Array:
    """Azimuth and elevation (N, 2) of the same direction in their ranges: noise may carry an elevation over the pole."""
    azimuth, drawn = angles.T
    elevation = np.where(np.abs(drawn) > np.pi / 2, wrap(drawn), drawn)
    over = np.abs(elevation) > np.pi / 2
    return np.column_stack([
        wrap(np.where(over, azimuth + np.pi, azimuth)),
        np.where(over, np.copysign(np.pi, elevation) - elevation, elevation),
    ])  # fmt: skip


def _draw_clutter(situation: Situation, state: Array, count: int, rng: np.random.Generator) -> Array:
    """False detections (count, 6) uniform over the search volume."""
    low = np.array([state[3], -np.pi, -np.pi / 2, -np.pi, -np.pi / 2, -situation.doppler_limit])
    high = np.array([state[3] + situation.clutter_range, np.pi, np.pi / 2, np.pi, np.pi / 2, situation.doppler_limit])
    return rng.uniform(low, high, (count, 6))


def simulate(situation: Situation, seed: int, run: int, scenario: int = 0) -> tuple[Array, Scans]:
    """True states (K, n) and scans of one run."""
    track_rng, detection_rng, clutter_rng = generators(seed, run, scenario)
    states = draw_track(situation, track_rng)
    return states, draw_scans(situation, states, detection_rng, clutter_rng)
