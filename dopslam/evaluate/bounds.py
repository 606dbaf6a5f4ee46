"""Posterior Cramér-Rao bounds of UE and landmarks, paper A eqs. (13)-(25), with all cross terms.

The state is `[s; x_1; …; x_L]` without the BS. Recursion (17) at given true states with the full J_data (the
paper's claim that it is block diagonal is wrong: A_iᵀR⁻¹B_i ≠ 0, and without it the PEB of the reference
case is 0.068 instead of 0.173 m). The recursion itself is `recursion.filtering`, and `recursion.smoothing` for the
bound of the whole run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dopslam.errors import FilterError
from dopslam.evaluate.recursion import LinearizedRun, filtering, smoothing
from dopslam.models.measurement import BS, jacobians
from dopslam.models.motion import TURN, MotionModel
from dopslam.models.pose import POSE
from dopslam.simulate.world import Situation, noise_of, nominal_track

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bound:
    """Bounds per step.

    Attributes
    ----------
    covariance : (K, n, n) array; UE block of J⁻¹
    landmark : (K, L, 3, 3) array; landmark blocks of J⁻¹, NaN before the first detection (and for the BS)
    """

    covariance: Array
    landmark: Array

    @property
    def peb(self) -> Array:
        """Position error bound (K,) [m]."""
        return np.sqrt(self.covariance[:, 0, 0] + self.covariance[:, 1, 1])

    @property
    def heb(self) -> Array:
        """Heading error bound (K,) [rad]."""
        return np.sqrt(self.covariance[:, 2, 2])

    @property
    def ceb(self) -> Array:
        """Clock bias error bound (K,) [m]."""
        return np.sqrt(self.covariance[:, 3, 3])

    @property
    def leb(self) -> Array:
        """Landmark error bounds (K, L) [m]; NaN before the first detection and for the BS."""
        return np.sqrt(np.trace(self.landmark, axis1=-2, axis2=-1))

    def squared(self, names: tuple[str, ...] = TURN) -> dict[str, Array]:
        """Squared bounds (K,) under the names of `metrics.squared_errors`."""
        parts = {"position": self.peb**2, "heading": self.heb**2, "clock": self.ceb**2}
        for i, name in list(enumerate(names))[len(POSE) : self.covariance.shape[1]]:
            parts[name] = self.covariance[:, i, i]
        return parts


def measurement_information(
    states: Array,
    position: Array,
    kind: NDArray[np.int64],
    covariance: Array,
    weight: Array,
    bs: Array,
    motion: MotionModel,
    *,
    height: float = 0.0,
    doppler: bool = True,
) -> tuple[Array, Array, Array]:
    """Blocks AᵀR⁻¹A (K, L, n, n), AᵀR⁻¹B (K, L, n, 3), BᵀR⁻¹B (K, L, 3, 3) of every step and landmark.

    `weight` (K, L) scales them: a detection mask, or p_D to weight the information.
    """
    rows = 6 if doppler else 5
    by_pose, by_landmark = jacobians(motion.pose(states[:, None], height), position, kind, bs)
    by_state = by_pose @ motion.pose_jacobian(states)[:, None]
    by_state, by_landmark = by_state[..., :rows, :], by_landmark[..., :rows, :]
    inverse = row_information(covariance[..., :rows, :rows], weight)
    left_state = np.swapaxes(by_state, -1, -2) @ inverse
    left_landmark = np.swapaxes(by_landmark, -1, -2) @ inverse
    return left_state @ by_state, left_state @ by_landmark, left_landmark @ by_landmark


def row_information(covariance: Array, weight: ArrayLike = 1.0, where: str = "(step, landmark)") -> Array:
    """`weight` times R⁻¹ (..., m, m); a row of infinite variance is a row that was not measured: no information.

    Where the weight is 0 the covariance is not read. `where` names the leading axes in the error's sentence.

    Raises
    ------
    FilterError
        If the covariance of a detection is singular or not a number.
    """
    covariance, weight = np.asarray(covariance, float), np.asarray(weight, float)
    measured = ~np.isposinf(np.diagonal(covariance, axis1=-2, axis2=-1)) & (weight > 0)[..., None]
    both = measured[..., :, None] & measured[..., None, :]
    matrix = np.where(both, covariance, np.eye(covariance.shape[-1]))
    with np.errstate(invalid="ignore"):
        scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    unit = scale[..., :, None] * scale[..., None, :]
    sound = np.asarray(np.isfinite(matrix).all(axis=(-1, -2)) & (scale > 0).all(axis=-1))
    correlation = np.where(sound[..., None, None], matrix / np.where(unit > 0, unit, 1.0), np.eye(matrix.shape[-1]))
    sound &= np.linalg.eigvalsh(correlation)[..., 0] > 1e-14
    if not sound.all():
        raise FilterError(
            f"the covariance R of the detection at {where} {np.argwhere(~sound)[0].tolist()} is singular, "
            "not positive definite or not a number; remove that detection or give it a variance in every row"
        )
    inverse = np.linalg.inv(correlation) / unit
    return np.where(both, inverse, 0.0) * weight[..., None, None]


def pcrb(
    states: Array,
    start: Array,
    prior_covariance: Array,
    motion: MotionModel,
    position: Array,
    kind: NDArray[np.int64],
    covariance: Array,
    detected: NDArray,
    bs: Array,
    *,
    height: float = 0.0,
    doppler: bool = True,
    smoothed: bool = False,
    lag: int | None = None,
    pace: Array | None = None,
) -> Bound:
    """Recursion (17) at given true states.

    Parameters
    ----------
    states : (K, n) array; true states at the measured steps
    start : (n,) array; state one interval before the first step, where the prior is
    prior_covariance : (n, n) array
    motion : MotionModel
    position, kind : (L, 3), (L,) true landmarks; those of kind BS are known
    covariance : (K, L, 6, 6) array; R of every step and landmark (anything invertible where not detected)
    detected : (K, L) array; detection mask, or weights in [0, 1]
    bs : (3,) array
    height : m, of the receiver's plane
    doppler : bool; False drops the Doppler row
    smoothed : bool; bound every step by the detections of the whole run instead of those up to it
    lag : with `smoothed`: only those up to so many steps later count
    pace : (K,) array; time since the step before, in periods of the motion model; default 1

    Returns
    -------
    Bound
    """
    states, start = np.array(states, dtype=float), np.array(start, dtype=float)
    steps, n = states.shape
    # A clock bias that nobody knows (NaN): no Jacobian depends on it.
    states[:, 3], start[3] = np.nan_to_num(states[:, 3]), np.nan_to_num(start[3])
    count = len(kind)
    covariance = np.broadcast_to(covariance, (steps, count, 6, 6))
    detected = np.broadcast_to(np.asarray(detected, dtype=float), (steps, count))
    if n != motion.dimension or np.shape(prior_covariance) != (n, n):
        raise FilterError(
            f"pcrb: states have {n} entries, the motion model {motion.dimension}, the prior "
            f"{np.shape(prior_covariance)}; they must agree"
        )
    aa, ab, bb = measurement_information(
        states, position, kind, covariance, detected, bs, motion, height=height, doppler=doppler
    )
    free = np.asarray(kind) != BS
    moves = [motion.paced(float(p)) for p in (np.ones(steps) if pace is None else pace)]
    previous = np.vstack([start, states[:-1]])
    run = LinearizedRun(
        prior=np.asarray(prior_covariance, dtype=float),
        transition=np.stack([m.jacobian(s) for s, m in zip(previous, moves, strict=True)]),
        noise=np.stack([m.process_noise for m in moves]),
        state=aa.sum(axis=1),
        cross=ab[:, free],
        landmark=bb[:, free],
        seen=detected[:, free] > 0,
    )
    landmark = np.full((steps, count, 3, 3), np.nan)
    ue, landmark[:, free] = smoothing(run, lag) if smoothed else filtering(run)
    return Bound(ue, landmark)


def situation_bound(
    situation: Situation,
    states: Array | None = None,
    start: Array | None = None,
    detected: NDArray | None = None,
    *,
    doppler: bool = True,
    visibility: float | None = None,
    weight_by_probability: bool = False,
    smoothed: bool = False,
    lag: int | None = None,
) -> Bound:
    """Bound of a simulated world.

    Parameters
    ----------
    situation : Situation
    states : (K, n) true track; default the nominal one
    start : (n,) true start; default the prior mean
    detected : (K, L) mask; default every visible landmark at every step (p_D = 1)
    doppler : bool
    visibility : float or None
        Range [m] within which SPs are visible when `detected` is not given; None: all visible.
    weight_by_probability : bool
        Scale the information by p_D instead of a mask (2 % optimistic).
    smoothed, lag : bool, int or None
        As of :func:`pcrb`.
    """
    states = nominal_track(situation) if states is None else states
    covariance, probability, _ = noise_of(situation, states)
    if detected is None:
        if weight_by_probability:
            detected = probability
        elif situation.noise.detection is not None:
            ue = np.column_stack([states[:, :2], np.full(len(states), situation.height)])
            near = np.linalg.norm(situation.position - ue[:, None], axis=-1) < (visibility or np.inf)
            detected = near | (situation.kind != 2)
        else:
            detected = np.ones(probability.shape)
    return pcrb(
        states,
        situation.prior_mean if start is None else start,
        situation.prior_covariance,
        situation.motion,
        situation.position,
        situation.kind,
        covariance,
        np.asarray(detected),
        situation.bs,
        height=situation.height,
        doppler=doppler,
        smoothed=smoothed,
        lag=lag,
    )


def detection_mask(labels: NDArray[np.int64], offsets: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """Which landmark was detected at which step (K, L), from the true labels of the measurements."""
    step = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    mask = np.zeros((len(offsets) - 1, count), dtype=bool)
    real = labels >= 0
    mask[step[real], labels[real]] = True
    return mask


@dataclass(frozen=True, slots=True)
class DopplerContribution:
    """The Doppler-related terms of (22) and (23) per step and landmark: what a single path's Doppler adds
    directly.

    Attributes
    ----------
    position : (K, L) array; trace of the x, y block of ã σ_d⁻² ãᵀ [1/m²]
    heading : (K, L) array [1/rad²]
    landmark : (K, L) array; trace of b̃ σ_d⁻² b̃ᵀ [1/m²]
    position_rest, heading_rest, landmark_rest : (K, L) arrays; the same of the other five rows
    """

    position: Array
    heading: Array
    landmark: Array
    position_rest: Array
    heading_rest: Array
    landmark_rest: Array


def doppler_contribution(situation: Situation, states: Array | None = None) -> DopplerContribution:
    """Decomposition of (22)-(25). These are diagonal blocks of J_data, not equivalent information: cross
    terms remain.
    """
    states = nominal_track(situation) if states is None else states
    covariance, probability, _ = noise_of(situation, states)
    parts = []
    for doppler in (True, False):
        aa, _, bb = measurement_information(
            states,
            situation.position,
            situation.kind,
            covariance,
            np.ones(probability.shape),
            situation.bs,
            situation.motion,
            height=situation.height,
            doppler=doppler,
        )
        parts.append((aa[..., 0, 0] + aa[..., 1, 1], aa[..., 2, 2], np.trace(bb, axis1=-2, axis2=-1)))
    full, rest = parts
    return DopplerContribution(*(f - r for f, r in zip(full, rest, strict=True)), *rest)
