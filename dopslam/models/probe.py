"""A motion model of one's own is asked once for everything that filters and bounds will ask, before anything runs."""

from __future__ import annotations

import numpy as np

from dopslam.errors import ConfigError
from dopslam.models.motion import MotionModel
from dopslam.models.pose import COLUMNS
from estimation.plugins import blamed, of_the_house

ANYWHERE = np.array([3.0, -2.0, 0.7, 5.0])  # a pose [m, m, rad, m]
STATES = 3  # asked for at once


def probed(motion: MotionModel, name: str) -> MotionModel:
    """The model, if its answers have the shapes that its names promise; a model of this house is not asked.

    Parameters
    ----------
    motion : the model
    name : as the scenario has it, for messages

    Raises
    ------
    ConfigError
        Naming the method that fails, or the shape of its answer and the one wanted.
    """
    if of_the_house(motion):
        return motion
    n, who = len(motion.names), f"filter.motion = {name!r}: {type(motion).__name__}"
    if len(set(motion.names)) != n:
        raise ConfigError(f"{who}.names has one twice: {', '.join(motion.names)}")
    with blamed(motion, f"{who}.prior", ConfigError):
        mean, covariance = motion.prior(ANYWHERE, np.eye(4))
    one = np.asarray(mean, float)
    many = np.tile(one, (STATES, 1)) if one.shape == (n,) else one
    wanted = {
        "prior (mean)": ((n,), lambda: mean),
        "prior (covariance)": ((n, n), lambda: covariance),
        "process_noise": ((n, n), lambda: motion.process_noise),
        "step": ((STATES, n), lambda: motion.step(many)),
        "step of one state": ((n,), lambda: motion.step(one)),
        "jacobian": ((STATES, n, n), lambda: motion.jacobian(many)),
        "velocity": ((STATES, 3), lambda: motion.pose(many).velocity),
        "pose_jacobian": ((STATES, COLUMNS, n), lambda: motion.pose_jacobian(many)),
    }
    for what, (shape, ask) in wanted.items():
        with blamed(motion, f"{who}.{what}", ConfigError):
            answer = np.array(ask(), dtype=float)
        if answer.shape != shape:
            raise ConfigError(f"{who}.{what} has the shape {answer.shape}, it must be {shape}")
    noise = np.asarray(motion.process_noise)
    if not np.allclose(noise, noise.T) or np.linalg.eigvalsh(noise)[0] < -1e-9 * np.trace(np.abs(noise)):
        raise ConfigError(f"{who}.process_noise is no covariance: it must be symmetric, without negative variances")
    return motion
