"""Histories moved onto a truth in a frame of its own: what a rigid motion changes, and what it leaves."""

import numpy as np
import pytest

from dopslam.errors import DopslamError
from dopslam.evaluate import metrics
from dopslam.evaluate.alignment import aligned
from dopslam.records import Track
from dopslam.slam.history import History


def drawn(seed, steps=20):
    """A true track, and a history beside it with errors of its own and a map of three landmarks."""
    rng = np.random.default_rng(seed)
    place = np.column_stack([np.cumsum(rng.normal(1, 0.3, (steps, 2)), axis=0), np.full(steps, 1.5)])
    heading = rng.uniform(-3, 3, steps)
    nothing = np.zeros((steps, 3))
    track = Track(np.arange(1.0, steps + 1), place, heading, nothing, np.zeros(steps), np.zeros(4))
    mean = np.column_stack([place[:, :2], heading, np.zeros(steps)]) + rng.normal(0, 0.1, (steps, 4))
    root = rng.normal(size=(steps, 4, 4))
    spread = rng.normal(size=(3, 3, 3))
    history = History(
        mean,
        root @ root.swapaxes(1, 2) + 0.1 * np.eye(4),
        np.append(np.zeros(steps), 3).astype(np.int64),
        position=rng.normal(0, 10, (3, 3)),
        position_covariance=spread @ spread.swapaxes(1, 2) + np.eye(3),
        existence=np.ones(3),
        type_probability=np.ones(3),
        kind=np.array([1, 2, 1]),
        track=np.arange(3),
    )
    return track, history


def turned(track, angle, shift):
    """The same truth in another frame."""
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return Track(
        track.time, track.position @ rotation.T + shift, track.heading + angle, track.velocity, track.bias, track.start
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_truths_frame_makes_no_difference(seed):
    track, history = drawn(seed)
    one, how = aligned(history, track)
    other, far = aligned(history, turned(track, 2.0, np.array([300.0, -40.0, 0.0])))
    errors = [
        metrics.state_errors(h.mean, t.state)
        for h, t in ((one, track), (other, turned(track, 2.0, np.array([300.0, -40.0, 0.0]))))
    ]
    np.testing.assert_allclose(
        np.linalg.norm(errors[0][:, :2], axis=1), np.linalg.norm(errors[1][:, :2], axis=1), atol=1e-9
    )
    np.testing.assert_allclose(errors[0][:, 2:], errors[1][:, 2:], atol=1e-9)
    nees = [metrics.nees(e, h.covariance) for e, h in zip(errors, (one, other), strict=True)]
    np.testing.assert_allclose(*nees, rtol=1e-7)
    assert abs(how["turned_deg"]) < 10 and how["moved_m"] < 1
    assert far["turned_deg"] == pytest.approx(np.degrees(2.0) + how["turned_deg"]) and far["moved_m"] > 100
    before, after = (np.linalg.norm(h.position[:, None] - h.position[None], axis=2) for h in (history, other))
    np.testing.assert_allclose(before, after, atol=1e-9)
    np.testing.assert_allclose(*(np.linalg.eigvalsh(h.position_covariance) for h in (history, other)), rtol=1e-7)


def test_a_straight_line_is_refused():
    track, history = drawn(4)
    history.mean[:, 1] = 2 * history.mean[:, 0]
    line = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    straight = Track(track.time, line, track.heading, track.velocity, track.bias, track.start)
    with pytest.raises(DopslamError, match="--align: .*one line"):
        aligned(history, straight)
