"""Tracks drawn from eq. (1) and detections drawn from the measurement model: paper A, Section V, without
tracing.

`Situation` is the world as it is; what a filter knows is given to it separately, so that mismatch can be
studied. Two kinds of noise: the paper's fixed R with a range limit for scatter points, and noise that
follows a link budget (R falls with ρ, p_D follows ρ), as ray-traced detections have it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.detection import probability_from_snr, spreading_loss
from dopslam.models.measurement import BS, SP, VA, incidence, measure, positions, wrap
from dopslam.models.motion import CoordinatedTurn, propagate
from dopslam.models.scans import CLUTTER, Scans

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FixedNoise:
    """R and p_D the same for all: standard deviations (6,) [m, rad ×4, m/s], SPs seen within `sp_range`
    [m].
    """

    std: Array
    detection_probability: float = 0.9
    sp_range: float | None = 50.0


@dataclass(frozen=True, slots=True)
class SnrNoise:
    """R = diag(unit_std²)/ρ and p_D(ρ), ρ = reference/spreading loss.

    Attributes
    ----------
    unit_std : (6,) array; standard deviations at ρ = 1
    reference_db : (L,) array; ρ times spreading loss of each landmark [dB]
    threshold : float; detection threshold on ρ, linear
    """

    unit_std: Array
    reference_db: Array
    threshold: float = 14.0


@dataclass(frozen=True, slots=True)
class Situation:
    """The world detections are drawn from.

    Attributes
    ----------
    bs : (3,) array [m]
    kind : (L,) int array; entry 0 is the BS
    position : (L, 3) array [m]
    motion : CoordinatedTurn; of the true track
    prior_mean, prior_covariance : (n,), (n, n); the start is drawn from it
    steps : int
    noise : FixedNoise or SnrNoise
    clutter_count : float; expected false detections per scan
    clutter_range : float; clutter path lengths lie in [bias, bias + clutter_range] [m]
    doppler_limit : float; clutter Dopplers lie within ± this [m/s]
    height : float; of the UE's plane [m]
    """

    bs: Array
    kind: NDArray[np.int64]
    position: Array
    motion: CoordinatedTurn
    prior_mean: Array
    prior_covariance: Array
    steps: int
    noise: FixedNoise | SnrNoise
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
    motion = situation.motion
    noise, prior = np.zeros((6, 6)), np.zeros((6, 6))
    noise[:4, :4], prior[:4, :4] = motion.process_noise, situation.prior_covariance
    noise[4, 4], noise[5, 5] = speed_walk**2, rate_walk**2
    prior[4, 4], prior[5, 5] = speed_std**2, rate_std**2
    return replace(
        situation,
        motion=CoordinatedTurn(motion.interval, noise, motion.speed, motion.turn_rate),
        prior_mean=np.concatenate([situation.prior_mean, [motion.speed, motion.turn_rate]]),
        prior_covariance=prior,
    )


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


def noise_of(situation: Situation, states: Array) -> tuple[Array, Array, Array | None]:
    """Measurement covariance (K, L, 6, 6), detection probability (K, L) and ρ (K, L) or None along a
    track.
    """
    noise = situation.noise
    ue = positions(states, situation.height)[:, None]
    count = (len(states), len(situation.kind))
    if isinstance(noise, FixedNoise):
        covariance = np.broadcast_to(np.diag(noise.std**2), (*count, 6, 6))
        probability = np.full(count, noise.detection_probability)
        if noise.sp_range is not None:
            distance = np.linalg.norm(situation.position - ue, axis=-1)
            probability = np.where((situation.kind == SP) & (distance > noise.sp_range), 0.0, probability)
        snr = None
    else:
        loss = spreading_loss(situation.kind, situation.position, ue, situation.bs)
        snr = 10 ** (noise.reference_db / 10) / loss
        covariance = np.diag(noise.unit_std**2) / np.maximum(snr, 1e-3)[..., None, None]
        probability = probability_from_snr(snr, noise.threshold)
    # A virtual anchor whose wall does not lie between it and the UE reflects nothing.
    _, t, _ = incidence(
        ue, np.where((situation.kind == VA)[:, None], situation.position, situation.bs + 1), situation.bs
    )
    blocked = (situation.kind == VA) & ((t <= 0) | (t >= 1))
    return covariance, np.where(blocked, 0.0, probability), snr


def draw_scans(
    situation: Situation, states: Array, rng: np.random.Generator, clutter_rng: np.random.Generator
) -> Scans:
    """Detections along a track, with misses and clutter, in random order within each scan; labels tell the
    truth.
    """
    covariance, probability, snr = noise_of(situation, states)
    steps, count = probability.shape
    exact = measure(
        states[:, None],
        situation.position,
        situation.kind,
        situation.bs,
        speed=situation.motion.speed,
        height=situation.height,
    )
    errors = rng.standard_normal((steps, count, 6))
    detected = rng.random((steps, count)) < probability
    z = exact + np.einsum("klij,klj->kli", np.linalg.cholesky(covariance), errors)
    false_counts = clutter_rng.poisson(situation.clutter_count, steps)
    columns: list[tuple[NDArray, ...]] = []
    for k in range(steps):
        seen = np.flatnonzero(detected[k])
        false_z, false_covariance, false_snr = _draw_clutter(
            situation, states[k], int(false_counts[k]), clutter_rng, covariance[k]
        )
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
        threshold=None if isinstance(situation.noise, FixedNoise) else situation.noise.threshold,
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


def _draw_clutter(situation: Situation, state: Array, count: int, rng: np.random.Generator, covariance: Array):
    """False detections uniform over the search volume, with a covariance borrowed from the noise model."""
    low = np.array([state[3], -np.pi, -np.pi / 2, -np.pi, -np.pi / 2, -situation.doppler_limit])
    high = np.array([state[3] + situation.clutter_range, np.pi, np.pi / 2, np.pi, np.pi / 2, situation.doppler_limit])
    z = rng.uniform(low, high, (count, 6))
    noise = situation.noise
    if isinstance(noise, FixedNoise):
        return z, np.broadcast_to(covariance[0], (count, 6, 6)), np.ones(count)
    snr = noise.threshold * (1.0 + rng.exponential(1 / noise.threshold, count))  # just above the threshold
    return z, np.diag(noise.unit_std**2) / snr[:, None, None], snr


def simulate(situation: Situation, seed: int, run: int, scenario: int = 0) -> tuple[Array, Scans]:
    """True states (K, n) and scans of one run."""
    track_rng, detection_rng, clutter_rng = generators(seed, run, scenario)
    states = draw_track(situation, track_rng)
    return states, draw_scans(situation, states, detection_rng, clutter_rng)
