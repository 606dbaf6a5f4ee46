"""Landmarks that sleep: the recursion with them against the dense one."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.models.detection import ConstantDetection
from dopslam.models.measurement import BS, SP, VA, measure
from dopslam.simulate.world import nominal_track, simulate
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.density import PMB, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import FilterParameters, filter_scans
from dopslam.studies.benchmark import crowded

pytestmark = pytest.mark.mc


def known_map(world, blocks, rng):
    """A density of many landmarks that exist, all errors correlated with one another and with the receiver."""
    size = 4 + 3 * blocks
    root = rng.normal(size=(size, size)) * 0.05 / np.sqrt(size)
    covariance = root @ root.T + 1e-4 * np.eye(size)
    covariance[:4, :4] += world.prior_covariance
    start = initial_density(world.prior_mean, world.prior_covariance)
    return PMB(
        mean=np.concatenate([world.prior_mean, world.position[1:].ravel() + 0.02 * rng.normal(size=3 * blocks)]),
        covariance=covariance,
        kind=world.kind.copy(),
        weight=np.array([1.0, *[0.99] * blocks]),
        track=np.arange(-1, blocks),
        reference=np.zeros(blocks + 1),
        detections=np.full(blocks + 1, 5.0),
        visible=np.ones(blocks + 1),
        unseen=np.zeros(blocks + 1),
        idle=np.zeros(blocks + 1),
        origin=np.zeros(blocks + 1, dtype=np.int64),
        trail=start.trail,
    )


def detections_in_turn(world, states, rng, at_once=8, turn=5):
    """Scans that detect the base station and `at_once` landmarks, others every `turn` steps, and come back to the first."""
    blocks = len(world.kind) - 1
    std = world.noise.std * 0.05
    rows, offsets = [], [0]
    for k, state in enumerate(states):
        group = (k // turn) % (blocks // at_once)
        seen = np.concatenate([[0], 1 + group * at_once + np.arange(at_once)])
        z = measure(state, world.position[seen], world.kind[seen], world.bs, speed=world.motion.speed)
        rows.append(z + rng.normal(size=z.shape) * std)
        offsets.append(offsets[-1] + len(seen))
    z = np.concatenate(rows)
    return z, np.tile(np.diag(std**2), (len(z), 1, 1)), np.array(offsets)


@pytest.mark.parametrize("kind", [SP, VA])
def test_sleeping_changes_nothing(world, kind):
    """Forty steps over eighty landmarks, eight in view: states, existence and the final map of the dense recursion."""
    rng = np.random.default_rng(3)
    wide = crowded(80, seed=4)
    position = wide.position.copy()
    if kind == VA:
        bearing = rng.uniform(0, 2 * np.pi, 80)
        position[1:] = wide.bs + rng.uniform(220, 400, 80)[:, None] * np.column_stack(
            [np.cos(bearing), np.sin(bearing), 0 * bearing]
        )
    wide = replace(wide, kind=np.array([BS] + [kind] * 80), position=position)
    states = nominal_track(wide)
    z, noise, offsets = detections_in_turn(wide, states, rng)
    density = known_map(wide, 80, rng)
    results = []
    for lazy in (False, True):
        parameters = FilterParameters(
            lazy=lazy, intensity=(1e-30, 1e-30), detection=ConstantDetection(0.3, None), robust=np.inf, iterations=1
        )
        model = compile_model(parameters, wide.motion, wide.bs)
        results.append(
            filter_scans(
                z,
                noise,
                np.zeros(len(z)),
                offsets,
                1e-30,
                np.ones(len(offsets) - 1),
                density,
                model,
                np.zeros(1, np.int64),
            )
        )
    dense, lazy = results
    np.testing.assert_allclose(lazy[1], dense[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(lazy[2], dense[2], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(lazy[3], dense[3])
    for k in range(len(offsets) - 1):  # the map of every step, in the order of the tracks
        one, other = (r[4][r[3][k] : r[3][k + 1]] for r in results)
        one, other = one[np.argsort(one[:, 14])], other[np.argsort(other[:, 14])]
        np.testing.assert_allclose(other[:, [0, 1, 2, 12]], one[:, [0, 1, 2, 12]], rtol=0, atol=1e-8)
        assert (
            np.trace(other[:, 3:12].reshape(-1, 3, 3), axis1=1, axis2=2)
            > np.trace(one[:, 3:12].reshape(-1, 3, 3), axis1=1, axis2=2) - 1e-9
        ).all()
    np.testing.assert_allclose(other, one, rtol=0, atol=1e-8)  # and at the end with all covariances
    a, b = dense[0], lazy[0]
    order = [[4 + 3 * (i - 1) + j for i in 1 + np.argsort(d.track[1:]) for j in range(3)] for d in (a, b)]
    blocks = [np.r_[0:4, o] for o in order]
    np.testing.assert_allclose(
        b.covariance[np.ix_(blocks[1], blocks[1])], a.covariance[np.ix_(blocks[0], blocks[0])], rtol=0, atol=1e-9
    )


def test_sleeping_in_doubt_is_as_good_as_waking():
    """A crowded road from an empty map, with clutter, births and rival associations: there a sleeper follows the mixture by
    its weights alone, not by those of its own existence. Other choices follow from that, but no worse ones.
    """
    busy = crowded(90, 12, seed=2)
    squared = {True: [], False: []}
    for run in range(3):
        states, scans = simulate(busy, 4, run)
        for lazy in squared:
            parameters = FilterParameters(lazy=lazy, detection=ConstantDetection(0.13, None), iterations=2)
            history, _ = ek_pmb.run(scans, (busy.prior_mean, busy.prior_covariance), busy.motion, busy.bs, parameters)
            squared[lazy].append(np.square(history.mean - states).sum(axis=0))
    ratio = np.sqrt(np.sum(squared[True], axis=0) / np.sum(squared[False], axis=0))
    assert (ratio < 1.25).all() and (ratio > 0.8).all()
