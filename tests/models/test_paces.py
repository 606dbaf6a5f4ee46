"""Steps of different lengths at once are the paced motion's, one by one."""

import numpy as np

from dopslam.models.motion import CoordinatedTurn
from dopslam.models.paces import noises, propagate, transition_jacobian


def test_states_over_their_own_times():
    rng = np.random.default_rng(0)
    motion, pace = CoordinatedTurn(0.5, np.diag([0.1, 0.2, 0.3, 0.4]), 3.0, 0.2), np.array([1, 0.5, 2, 1, 0.5, 1.7])
    state = rng.normal(size=(6, 4))
    pairs = list(zip(pace, state, strict=True))
    assert np.array_equal(propagate(state, motion, pace), [motion.paced(p).step(s) for p, s in pairs])
    assert np.array_equal(transition_jacobian(state, motion, pace), [motion.paced(p).jacobian(s) for p, s in pairs])
    assert np.allclose(noises(motion, pace), pace[:, None, None] * motion.process_noise)
    assert propagate(state[0], motion).shape == (4,)
