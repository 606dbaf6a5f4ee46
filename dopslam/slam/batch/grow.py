"""From the surest part of a run outwards: for tracks that the snapshots alone do not join.

Short windows are smoothed by themselves, each with a map of its own. From the windows with most evidence the track grows
at both ends: the next scan is located with the motion as its prior, its modes are judged by what the map so far explains
of them, and the whole is smoothed again now and then. So a place where single scans say nothing is passed with the map
of what lies around it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.paces import propagate, transition_jacobian
from dopslam.slam.batch.landmarks import Belief, explain
from dopslam.slam.batch.noise import GIVEN
from dopslam.slam.batch.rows import Rows, part
from dopslam.slam.batch.smoother import Choices, Smoothed, smooth
from dopslam.slam.batch.track import Chain

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WINDOW = 8  # steps smoothed by themselves at first
TRIED = 2  # windows that are grown
AGAIN = 4  # steps after which the whole is smoothed anew

Locate = Callable[[int, Array, Array], tuple[Array, Array]]
"""Modes (M, n) and covariances (M, n, n) of a scan, given the mean (n,) and covariance (n, n) of its state."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A smoothed part of a run: scans low … high − 1."""

    low: int
    high: int
    result: Smoothed


def grow(data: Rows, chain: Chain, state: Array, covariance: Array, choices: Choices, locate: Locate) -> Smoothed:
    """The whole run from its surest windows.

    Parameters
    ----------
    data : Rows
    chain : Chain
        Without information on the pose: nothing is told of the start.
    state, covariance : (K + 1, n), (K + 1, n, n)
        The chain of snapshots.
    choices : Choices
    locate : function

    Raises
    ------
    FilterError
        If no window can be smoothed.
    """
    windows = []
    for low in range(0, max(data.steps - WINDOW // 2, 1), WINDOW // 2):
        high = min(low + WINDOW, data.steps)
        try:
            found = _smoothed(data, chain, low, high, state[low : high + 1], covariance[low : high + 1], choices)
            windows.append(Stretch(low, high, found))
        except (FilterError, np.linalg.LinAlgError):
            continue
    if not windows:
        raise FilterError("batch: no part of the run can be smoothed by itself; give a start")
    windows.sort(key=lambda w: -w.result.score)
    results = []
    for window in windows[:TRIED]:
        stretch = window
        while stretch.low > 0 or stretch.high < data.steps:
            stretch = _longer(data, chain, stretch, choices, locate)
        results.append(stretch.result)
    return max(results, key=lambda r: r.score)


def _smoothed(
    data: Rows, chain: Chain, low: int, high: int, state: Array, covariance: Array, choices: Choices, found=None
):
    """Scans low … high − 1 smoothed from states (high − low + 1, n), the first one step before."""
    own = replace(chain, pace=chain.pace[low:high])
    own = own if low == 0 else replace(own, mean=state[0], information=_extra(chain))
    return smooth(part(data, low, high), own, state, covariance, choices, found)


def _extra(chain: Chain) -> Array:
    """What is known of the states beyond the pose at any step."""
    information = np.zeros_like(chain.information)
    information[4:, 4:] = chain.information[4:, 4:]
    return information


def _longer(data: Rows, chain: Chain, stretch: Stretch, choices: Choices, locate: Locate) -> Stretch:
    """A stretch with some scans more at both ends, smoothed anew."""
    estimate = stretch.result.estimate
    state, covariance = list(estimate.state), list(estimate.covariance)
    base = len(data.stations)
    low, high = stretch.low, stretch.high
    for _ in range(AGAIN):
        if high < data.steps:
            pace = chain.pace[high]
            jacobian = transition_jacobian(state[-1], chain.motion, pace)
            mean = propagate(state[-1], chain.motion, pace)
            spread = jacobian @ covariance[-1] @ jacobian.T + chain.motion.paced(pace).process_noise
            mean, spread = _best(data, stretch, high, *locate(high, mean, spread), mean, spread)
            state.append(mean)
            covariance.append(spread)
            high += 1
        if low > 0:  # the state before the first scan belongs to scan low − 1
            mean, spread = _best(
                data, stretch, low - 1, *locate(low - 1, state[0], covariance[0]), state[0], covariance[0]
            )
            pace = chain.pace[low - 1]
            back = np.linalg.inv(transition_jacobian(mean, chain.motion, pace))
            earlier = mean - (propagate(mean, chain.motion, pace) - mean)
            state[0], covariance[0] = mean, spread
            state.insert(0, earlier)
            covariance.insert(0, back @ (spread + chain.motion.paced(pace).process_noise) @ back.T)
            low -= 1
    rounds = choices.rounds if (low, high) == (0, data.steps) else min(3, choices.rounds)
    found = estimate.found.take(slice(base, None))
    own = replace(choices, rounds=rounds)
    return Stretch(low, high, _smoothed(data, chain, low, high, np.array(state), np.array(covariance), own, found))


def _best(data: Rows, stretch: Stretch, step: int, modes: Array, spreads: Array, mean: Array, spread: Array):
    """The mode of a scan that the map explains best, the prediction being one of them."""
    modes, spreads = np.concatenate([mean[None], modes]), np.concatenate([spread[None], spreads])
    found = stretch.result.estimate.found
    rows = np.arange(data.offsets[step], data.offsets[step + 1])
    pairs, owner = np.repeat(rows, len(found)), np.tile(np.arange(len(found)), len(rows))
    one = replace(data, step=np.zeros(len(data.step), dtype=np.int64))
    score = np.empty(len(modes))
    for m in range(len(modes)):
        belief = Belief(modes[m][None], spreads[m][None], GIVEN, 1.0)
        density = explain(one, belief, pairs, owner, found.kind, found.position, found.covariance)[0]
        gain = np.maximum((density - data.false[pairs]).reshape(len(rows), len(found)), 0.0)
        apart = modes[m] - mean
        apart[2] = (apart[2] + np.pi) % (2 * np.pi) - np.pi
        score[m] = gain.max(axis=1, initial=0.0).sum() - 0.5 * apart @ np.linalg.solve(spread, apart)
    best = int(np.argmax(score))
    return modes[best], spreads[best]
