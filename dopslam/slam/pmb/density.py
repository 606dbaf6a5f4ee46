"""The Poisson multi-Bernoulli density of UE and map, and the parameters the recursion needs.

Records that cross into compiled code are named tuples. One Gaussian over `[s; x_1; …; x_H]` holds the UE and
every landmark hypothesis; cross-covariances are kept (`joint`) or dropped after each step (`marginal`, the
paper's (31)-(32)). A *block* is one type hypothesis (VA or SP) of a *track* (a Bernoulli component):
siblings share a track number and lie side by side. Block 0 is the base station: known, always existing,
without state.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, take
from dopslam.errors import FilterError
from dopslam.models.detection import (
    TABLE_START_DB,
    TABLE_STEP_DB,
    ConstantDetection,
    DetectionModel,
    SnrDetection,
    detection_table,
)
from dopslam.models.motion import CoordinatedTurn, MotionModel
from dopslam.models.pose import POSE, VELOCITY
from dopslam.records import Kind

Array = NDArray[np.float64]

BS_TRACK = -1  # track number of the base station
NO_TRACK = -2  # a measurement taken as new or clutter
INERT = -1  # kind of a block that is kept for what hangs on it (`sleeping`)
BIRTHS = len(Kind) - 1  # kinds of landmarks that can be born, all but the BS, in the order of their numbers


class PMB(NamedTuple):
    """Posterior or prior density.

    Attributes
    ----------
    mean : (n + 3H,) array; UE first, then the landmark blocks
    covariance : (n + 3H, n + 3H) array
    kind : (H + 1,) int array; entry 0 is the BS
    weight : (H + 1,) array; existence times type probability of each block
    track : (H + 1,) int array; track number, siblings share it
    reference : (H + 1,) array; log of ρ times spreading loss, learnt from detections
    detections : (H + 1,) array; number of detections that `reference` rests on
    visible : (H + 1,) array; P(in sight | existing) of each block
    unseen : (H + 1,) array; detections that were due, were it in sight, since its last one
    idle : (H + 1,) array; scans since a detection was last within reach of it
    origin : (H + 1,) int array; number of the block in the snapshot that sleepers hang on (`sleeping`), 0 if it has none
    trail : (k, 2) array; past UE positions, for the thinning of the undetected intensity
    """

    mean: Array
    covariance: Array
    kind: NDArray[np.int64]
    weight: Array
    track: NDArray[np.int64]
    reference: Array
    detections: Array
    visible: Array
    unseen: Array
    idle: Array
    origin: NDArray[np.int64]
    trail: Array


class Scan(NamedTuple):
    """Measurements of one step as the recursion reads them: m = 6 rows, or 5 without Doppler.

    Attributes
    ----------
    z : (M, m) array
    covariance : (M, m, m) array
    log_snr : (M,) array; natural log of ρ, zeros where unknown, -∞ where a measurement is passed over (`splinters`)
    first : int; number of the first measurement in the whole run; a track is named by the measurement that bore it
    clutter : float; clutter intensity c(z)
    pace : float; time since the scan before, in periods of the motion model
    """

    z: Array
    covariance: Array
    log_snr: Array
    first: int
    clutter: float
    pace: float


class Model(NamedTuple):
    """`FilterParameters` and motion in the form compiled code reads; made by `compile_model`."""

    site: tuple[Any, ...]
    interval: float
    turn_rate: float
    process_noise: Array
    joint: bool
    iterations: int
    cubature: bool
    reweight: bool
    gamma: int
    gate: float
    survival: float
    intensity: Array
    birth_intensity: Array
    thinning: bool
    prune: float
    existence_limit: float
    unconfirmed: float
    beside: float
    merge: bool
    curvature: bool
    negligible: float
    hide: float
    reappear: float
    robust: float
    outlier: float
    inform: bool
    lazy: bool
    planar: bool
    pieces: bool
    sp_range: float
    use_snr: bool
    table: Array
    memory: float


OUTLIER = 20.0  # times as likely as a birth is a distorted detection of a landmark within a resolution cell


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Choices of the EK-PMB recursion; defaults follow the reference figures of paper A's scenario.

    Attributes
    ----------
    joint : bool
        Keep UE-landmark cross-covariances through time (default); False is the paper's filter, (31)-(32).
    doppler : bool
        Use the Doppler row.
    iterations : int
        Linearizations per update; 1 is the plain EKF.
    cubature : bool
        Statistical linearization with cubature points instead of Jacobians in the update.
    reweight : bool
        Weight the γ associations by the evidence of the joint update instead of products of single
        likelihoods.
    associations : int
        γ, the data associations kept per step (and per prior hypothesis).
    gate : float
        Squared Mahalanobis distance beyond which a measurement cannot belong to a track.
    survival : float
        p_S per step.
    intensity : (VA, SP, SR)
        Initial intensity of undetected landmarks [m⁻³]; two entries, or an SR of 0: no second reflections. The paper's
        filter (`joint=False`) knows none.
    birth_intensity : (VA, SP)
        λ_B added every step [m⁻³].
    thinning : bool
        λ ← (1 - p_D) λ inside the field of view after each scan; False keeps it constant, the convention of
        the reference figures.
    prune : float
        Blocks below this weight are dropped.
    existence_limit : float
        Ceiling of a track's existence, so that misses can still end it.
    unconfirmed : float
        Ceiling of the existence of what was detected once, at most `existence_limit`: an estimator's mistakes are not spread
        evenly over the search region, and a single detection cannot tell.
    beside : float
        Likelihood of a miss of a landmark beside a detection in its cell that it does not explain, over that of none.
    curvature : bool
        Whether the association allows for what the linearization leaves out (`curvature`); never in the paper's filter.
    merge : bool
        Whether tracks of one path are merged (`merging`); never in the paper's filter.
    hide : float
        Probability per step that a landmark in sight goes out of sight; 0, and always in the paper's filter: never.
    reappear : float
        Probability that one just out of sight comes back at the next step. It falls with the time out of sight,
        b/(1 + b·t), so that P(still hidden) = 1/(1 + b·t): what is behind a house may be so for long.
    robust : float
        Degrees of freedom ν of the Student-t noise that the update of tracks assumes: after each linearization a
        measurement's R grows by (ν + d)/(ν + m), d its squared Mahalanobis distance to what the scan as a whole says.
        Infinite: Gaussian, as in the paper's filter.
    outlier : float
        How many times likelier a detection within a resolution cell of an unseen landmark is a distorted detection of
        that landmark than a new one beside it; it then moves nothing. 0: no such hypothesis.
    lazy : bool
        Whether landmarks out of reach sleep (`sleeping`) once there are many, in a whole run with `joint`.
    inform : bool
        Whether the redundant rows of a birth's only measurement move the receiver.
    planar : bool
        No elevation is measured at all: landmarks are held at the height of the base station, or the receiver's (scatter
        points).
    pieces : bool
        Whether pieces of one path are passed over (`splinters`); of no use where R does not fall with ρ.
    negligible : float
        Associations below this weight relative to the best are not updated.
    detection : ConstantDetection or SnrDetection
    memory : float
        Detections over which a track's SNR reference is averaged.
    """

    joint: bool = True
    doppler: bool = True
    iterations: int = 2
    cubature: bool = False
    reweight: bool = False
    associations: int = 10
    gate: float = 40.0
    survival: float = 1.0
    intensity: tuple[float, ...] = (1e-7, 4e-6, 1e-9)
    birth_intensity: tuple[float, float] = (0.0, 0.0)
    thinning: bool = False
    prune: float = 1e-3
    existence_limit: float = 0.999
    unconfirmed: float = 0.45
    beside: float = 0.5
    merge: bool = True
    curvature: bool = True
    hide: float = 0.05
    reappear: float = 0.1
    robust: float = 10.0
    outlier: float = OUTLIER
    inform: bool = True
    lazy: bool = True
    planar: bool = False
    pieces: bool = True
    negligible: float = 1e-4
    detection: DetectionModel = field(default_factory=ConstantDetection)
    memory: float = 5.0

    def __post_init__(self) -> None:
        if self.associations < 1 or self.iterations < 1:
            raise FilterError(
                f"FilterParameters: associations ({self.associations}) and iterations ({self.iterations}) must be ≥ 1"
            )
        if not 0 < self.survival <= 1:
            raise FilterError(f"FilterParameters.survival is {self.survival}; it must lie in (0, 1]")
        if not (self.gate > 0 and min(self.intensity[:2]) > 0 and min(*self.birth_intensity, *self.intensity) >= 0):
            raise FilterError("FilterParameters: gate and intensity must be positive, birth_intensity not negative")
        if not (0 <= self.hide < 1 and 0 <= self.reappear <= 1):
            raise FilterError(f"FilterParameters: hide ({self.hide}) and reappear ({self.reappear}) are probabilities")


def compile_model(parameters: FilterParameters, motion: MotionModel, bs: Array, height: float = 0.0) -> Model:
    """The parameters as compiled code reads them.

    Parameters
    ----------
    parameters : FilterParameters
    motion : MotionModel; one that is no coordinated turn is added step by step, by :func:`predicted`
    bs : (3,) array, position of the base station [m]
    height : float, height of the UE's plane [m]
    """
    bs = np.asarray(bs, dtype=float)
    detection = parameters.detection
    intensity, birth_intensity = np.zeros(BIRTHS), np.zeros(BIRTHS)
    birth_intensity[: len(parameters.birth_intensity)] = parameters.birth_intensity
    intensity[: len(parameters.intensity)] = parameters.intensity
    if not parameters.joint:
        intensity[2:] = 0.0
    turn = motion if isinstance(motion, CoordinatedTurn) else None
    limit = detection.sp_range if isinstance(detection, ConstantDetection) else None
    return Model(
        site=(float(bs[0]), float(bs[1]), float(bs[2]), float(height), float(turn.speed) if turn else 0.0),
        interval=float(motion.interval),
        turn_rate=float(turn.turn_rate) if turn else 0.0,
        process_noise=np.array(motion.process_noise, dtype=float, order="C"),
        joint=bool(parameters.joint),
        iterations=int(parameters.iterations),
        cubature=bool(parameters.cubature),
        reweight=bool(parameters.reweight),
        gamma=int(parameters.associations),
        gate=float(parameters.gate),
        survival=float(parameters.survival),
        intensity=intensity,
        birth_intensity=birth_intensity,
        thinning=bool(parameters.thinning),
        prune=float(parameters.prune),
        existence_limit=float(parameters.existence_limit),
        unconfirmed=float(parameters.unconfirmed if parameters.joint else parameters.existence_limit),
        beside=float(parameters.beside),
        merge=bool(parameters.merge and parameters.joint),
        curvature=bool(parameters.curvature and parameters.joint),
        negligible=float(parameters.negligible),
        hide=float(parameters.hide) if parameters.joint else 0.0,
        reappear=float(parameters.reappear),
        robust=float(parameters.robust) if parameters.joint else np.inf,
        outlier=float(parameters.outlier) if parameters.joint else 0.0,
        inform=bool(parameters.inform and parameters.joint),
        lazy=bool(parameters.lazy and parameters.joint),
        planar=bool(parameters.planar),
        pieces=bool(parameters.pieces),
        sp_range=np.inf if limit is None else float(limit),
        use_snr=isinstance(detection, SnrDetection),
        table=detection_table(detection),
        memory=float(parameters.memory),
    )


def predicted(model: Model, motion: MotionModel, state: Array) -> Model:
    """The model with the next step of any motion model from a state (n,): f(s), F and Q, and its velocity linearized at
    f(s); the recursion then steps by one period of `motion`, whatever that is."""
    moved = np.ascontiguousarray(motion.step(state), dtype=float)
    by_velocity = motion.pose_jacobian(moved)[VELOCITY]
    velocity = motion.pose(moved).velocity
    course = np.column_stack([by_velocity, velocity - by_velocity @ moved])
    transition = np.ascontiguousarray(motion.jacobian(state), dtype=float)
    return model._replace(
        site=(*model.site[:5], course, moved, transition),
        process_noise=np.array(motion.process_noise, dtype=float, order="C"),
    )


def initial_density(mean: Array, covariance: Array) -> PMB:
    """The density before the first step: UE prior N(mean, covariance), the BS, no landmark."""
    mean = np.array(mean, dtype=float, order="C")
    covariance = np.array(covariance, dtype=float, order="C")
    if covariance.shape != (mean.size, mean.size) or mean.size < len(POSE):
        raise FilterError(
            f"prior mean {mean.shape} and covariance {covariance.shape}: expected (n,), (n, n), n at least {len(POSE)}"
        )
    return PMB(
        mean=mean,
        covariance=covariance,
        kind=np.zeros(1, dtype=np.int64),
        weight=np.ones(1),
        track=np.full(1, BS_TRACK, dtype=np.int64),
        reference=np.zeros(1),
        detections=np.zeros(1),
        visible=np.ones(1),
        unseen=np.zeros(1),
        idle=np.zeros(1),
        origin=np.zeros(1, dtype=np.int64),
        trail=np.zeros((0, 2)),
    )


@compiled
def start_of(n, block):
    """First row of a landmark block in the state of a UE with n entries (the BS has none)."""
    return n + 3 * (block - 1)


_START_DB = TABLE_START_DB
_STEP_DB = TABLE_STEP_DB
_LOG_TO_DB = 10.0 / np.log(10.0)


@compiled
def look_up(table, log_snr):
    """p_D for the natural log of ρ, linear between the table's entries."""
    place = (_LOG_TO_DB * log_snr - _START_DB) / _STEP_DB
    last = table.shape[0] - 1
    if place <= 0.0:
        return table[0]
    if place >= last:
        return table[last]
    low = int(place)
    share = place - low
    return (1.0 - share) * table[low] + share * table[low + 1]


@compiled
def select(density, keep):
    """The density with only the blocks numbered in `keep` (ascending, 0 first)."""
    n = density.mean.shape[0] - 3 * (density.kind.shape[0] - 1)
    size = n + 3 * (keep.shape[0] - 1)
    rows = np.empty(size, dtype=np.int64)
    for i in range(n):
        rows[i] = i
    for j in range(1, keep.shape[0]):
        for i in range(3):
            rows[start_of(n, j) + i] = start_of(n, keep[j]) + i
    mean = np.empty(size)
    covariance = np.empty((size, size))
    for i in range(size):
        mean[i] = density.mean[rows[i]]
        for j in range(size):
            covariance[i, j] = density.covariance[rows[i], rows[j]]
    return PMB(
        mean,
        covariance,
        take(density.kind, keep),
        take(density.weight, keep),
        take(density.track, keep),
        take(density.reference, keep),
        take(density.detections, keep),
        take(density.visible, keep),
        take(density.unseen, keep),
        take(density.idle, keep),
        take(density.origin, keep),
        density.trail,
    )
