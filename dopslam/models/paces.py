"""A motion model over steps of different lengths: irregular times of scans."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dopslam.models.motion import MotionModel

Array = NDArray[np.float64]


def propagate(state: Array, motion: MotionModel, pace: Array | float = 1.0) -> Array:
    """:meth:`MotionModel.step` over ``pace`` periods, one number or one for every state (K, n)."""
    return _over(state, motion, pace, lambda model, states: model.step(states))


def transition_jacobian(state: Array, motion: MotionModel, pace: Array | float = 1.0) -> Array:
    """:meth:`MotionModel.jacobian` over ``pace`` periods, likewise."""
    return _over(state, motion, pace, lambda model, states: model.jacobian(states))


def noises(motion: MotionModel, pace: Array) -> Array:
    """(K, n, n) process noises of steps over ``pace`` (K,) periods."""
    values, which = np.unique(pace, return_inverse=True)
    return np.array([motion.paced(float(value)).process_noise for value in values])[which]


def _over(state: Array, motion: MotionModel, pace: Array | float, law: Callable[[MotionModel, Array], Array]) -> Array:
    """What a law gives states under the motion over their own times."""
    pace = np.asarray(pace, float)
    if pace.ndim == 0:
        return law(motion.paced(float(pace)), state)
    result = None
    for one in np.unique(pace):
        rows = pace == one
        part = law(motion.paced(float(one)), state[rows])
        if result is None:
            result = np.empty((len(state), *part.shape[1:]))
        result[rows] = part
    return law(motion, state) if result is None else result
