"""The modes of successive scans joined by the receiver's motion: which of them belong to one track (Viterbi).

A mode's evidence is its scan's likelihood integrated over the pose; between the modes of two scans stands the density of
one prediction from the other, N(s'; f(s), F C Fᵀ + Q + C'). A scan without a mode that fits is passed over, at the price
of calling all its paths clutter. A smoother over the chosen modes gives the track and what the first step starts from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.measurement import wrap
from dopslam.slam.snapshot.locate import Modes

Array = NDArray[np.float64]
Step = Callable[[Array], tuple[Array, Array]]

REACH = 6  # scans that may be passed over at once


@dataclass(frozen=True, slots=True)
class Walk:
    """How poses move from scan to scan.

    Attributes
    ----------
    step : function
        Poses (M, 4) → predicted poses (M, 4) and Jacobians (M, 4, 4).
    noise : (4, 4) array
        Covariance of one step.
    """

    step: Step
    noise: Array


@dataclass(frozen=True, slots=True)
class Chain:
    """The likeliest sequence of modes.

    Attributes
    ----------
    chosen : (K,) int array
        Mode of every scan, -1 where it was passed over.
    evidence : float
        log density of the scans along it.
    margin : (K,) array
        How much evidence a track through any other mode of the scan loses; inf where it has no other.
    mean, covariance : (K, 4), (K, 4, 4) arrays
        Pose at every scan, smoothed over the chosen modes.
    """

    chosen: NDArray[np.int64]
    evidence: float
    margin: Array
    mean: Array
    covariance: Array


def _log_normal(difference: Array, covariance: Array) -> Array:
    difference = difference.copy()
    difference[..., 2] = wrap(difference[..., 2])
    solved = np.linalg.solve(covariance, difference[..., None])[..., 0]
    return -0.5 * (np.sum(solved * difference, axis=-1) + np.linalg.slogdet(covariance)[1] + 4 * np.log(2 * np.pi))


def _predictions(modes: Modes, walks: Sequence[Walk]):
    """Means (M, 4) and covariances (M, 4, 4) of the modes after each of the walks to the scans that follow."""
    mean, covariance = modes.pose, modes.covariance
    for walk in walks:
        mean, jacobian = walk.step(mean)
        covariance = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2) + walk.noise
        yield mean, covariance


def chain(found: list[Modes], passing: Array, walks: Sequence[Walk]) -> Chain:
    """Join the modes of K scans.

    Parameters
    ----------
    found : K records of modes, perhaps empty
    passing : (K,) array
        log likelihood of each scan if all its paths are clutter.
    walks : K of them; k leads to scan k from the one before

    Raises
    ------
    FilterError
        If no scan has a mode.
    """
    steps = len(found)
    if not any(len(m) for m in found):
        raise FilterError(
            "snapshot start: no scan has enough paths (two in space, three in the plane) to tell where the receiver is; "
            "give a prior instead"
        )
    passed = np.concatenate([[0.0], np.cumsum(passing)])
    links = {}
    for k in range(steps):
        for gap, prediction in enumerate(_predictions(found[k], walks[k + 1 : k + 2 + REACH]), start=1):
            later = found[k + gap]
            if len(found[k]) and len(later):
                mean, covariance = prediction
                jump = _log_normal(later.pose[None] - mean[:, None], covariance[:, None] + later.covariance[None])
                links[k, k + gap] = jump + passed[k + gap] - passed[k + 1]
    forward = [m.evidence + passed[k] for k, m in enumerate(found)]
    origin = [np.full((len(m), 2), -1) for m in found]
    for (early, late), jump in sorted(links.items(), key=lambda item: item[0][1]):
        score = forward[early][:, None] + jump
        best = np.argmax(score, axis=0)
        value = score[best, np.arange(len(best))] + found[late].evidence
        better = value > forward[late]
        forward[late] = np.where(better, value, forward[late])
        origin[late][better] = np.column_stack([np.full(better.sum(), early), best[better]])
    backward = [np.full(len(m), passed[-1] - passed[k + 1]) for k, m in enumerate(found)]
    for (early, late), jump in sorted(links.items(), key=lambda item: -item[0][0]):
        value = np.max(jump + found[late].evidence + backward[late], axis=1)
        backward[early] = np.maximum(backward[early], value)
    after = passed[-1] - passed[1:]
    total = [f + b for f, b in zip(forward, backward, strict=True)]
    ends = [f.max(initial=-np.inf) + rest for f, rest in zip(forward, after, strict=True)]
    last = int(np.argmax(ends))
    evidence, mode = float(ends[last]), int(np.argmax(forward[last]))
    chosen = np.full(steps, -1)
    while last >= 0:
        chosen[last] = mode
        last, mode = (int(x) for x in origin[last][mode])
    margin = np.array([
        evidence - np.delete(t, c if c >= 0 else []).max(initial=-np.inf) for t, c in zip(total, chosen, strict=True)
    ])  # fmt: skip
    return Chain(chosen, evidence, margin, *smooth(found, chosen, walks))


def before(mean: Array, covariance: Array, walk: Walk) -> tuple[Array, Array]:
    """The pose one step earlier, from that of a step alone."""
    earlier = mean.copy()
    for _ in range(5):
        predicted, jacobian = (part[0] for part in walk.step(earlier[None]))
        earlier = earlier + np.linalg.solve(jacobian, mean - predicted)
    back = np.linalg.inv(jacobian)
    return earlier, back @ (covariance + walk.noise) @ back.T


def smooth(found: list[Modes], chosen: NDArray[np.int64], walks: Sequence[Walk]) -> tuple[Array, Array]:
    """Means (K, 4) and covariances (K, 4, 4) of the pose at every scan given all chosen modes (Rauch-Tung-Striebel)."""
    steps, used = len(found), np.flatnonzero(chosen >= 0)
    mean, covariance = np.empty((steps, 4)), np.empty((steps, 4, 4))
    predicted_mean, predicted, moved = mean.copy(), covariance.copy(), covariance.copy()
    first = int(used[0])
    for k in range(first, steps):
        if k > first:
            step, jacobian = walks[k].step(mean[k - 1][None])
            predicted_mean[k], moved[k] = step[0], jacobian[0] @ covariance[k - 1]
            predicted[k] = moved[k] @ jacobian[0].T + walks[k].noise
            mean[k], covariance[k] = predicted_mean[k], predicted[k]
        if chosen[k] < 0:
            continue
        own, spread = found[k].pose[chosen[k]], found[k].covariance[chosen[k]]
        if k == first:
            mean[k], covariance[k] = own, spread
            continue
        gain = np.linalg.solve(predicted[k] + spread, predicted[k]).T
        innovation = own - predicted_mean[k]
        innovation[2] = wrap(innovation[2])
        mean[k] = predicted_mean[k] + gain @ innovation
        covariance[k] = gain @ spread
    for k in range(steps - 1, first, -1):
        gain = np.linalg.solve(predicted[k], moved[k]).T
        change = mean[k] - predicted_mean[k]
        change[2] = wrap(change[2])
        mean[k - 1] = mean[k - 1] + gain @ change
        covariance[k - 1] += gain @ (covariance[k] - predicted[k]) @ gain.T
    for k in range(first, 0, -1):
        mean[k - 1], covariance[k - 1] = before(mean[k], covariance[k], walks[k])
    return mean, 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
