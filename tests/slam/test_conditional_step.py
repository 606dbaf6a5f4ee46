"""The compiled step of conditional belief propagation against the same lines in NumPy, and its motions against differences."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.slam.association.loopy import loopy_association
from dopslam.slam.belief.conditional import step
from dopslam.slam.belief.conditional.amplitude import amplitude_messages, log_losses
from dopslam.slam.belief.conditional.belief import Dynamics, Map
from dopslam.slam.belief.conditional.course import advance, course_of, place
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.conditional.linear import measured
from dopslam.slam.belief.conditional.update import linearized_rows, pair_densities, sequential_update
from dopslam.slam.belief.experiment import Experiment, draw
from dopslam.slam.belief.motion import ConstantVelocity, SpeedHeading
from dopslam.slam.belief.records import Form
from dopslam.slam.belief.start import Box, informed_start

MOTIONS = [
    ConstantVelocity(0.1, 0.3, 0.1, 0.05),
    SpeedHeading(0.5, 0.2, 0.05, 0.3, 0.1, 0.02),
    SpeedHeading(0.5, 0.2, 0.05),
]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("heading", [0.3, 3.1])
def test_a_motion_in_closed_form_is_that_of_the_particles(motion, heading):
    dynamics, course = Dynamics(motion), course_of(motion)
    mean = np.array([1.0, 2, 0.5, -2.0, 3.0, 0.2, 4.0] if not course.polar else [1.0, 2, 0.5, 5.0, heading, 4.0])
    size = len(mean)
    moved, transition, noise = np.empty(size), np.empty((size, size)), np.empty((size, size))
    advance(course, mean, moved, transition, noise)
    expected = dynamics.linearize(mean)
    np.testing.assert_allclose(moved, expected[0], atol=1e-12)
    np.testing.assert_allclose(transition, expected[1], atol=1e-8)
    np.testing.assert_allclose(noise, expected[2], atol=1e-12)
    active = np.array([0, 1, *range(3, size)])
    pose, slopes = np.empty(8), np.empty((8, len(active)))
    place(course, mean, active, pose, slopes)
    np.testing.assert_allclose(pose, dynamics.pose(mean)[0], atol=1e-14)
    np.testing.assert_allclose(slopes, dynamics.pose(mean)[1][:, active], atol=1e-14)


def predict(filter_, belief):
    """The prediction, with the smoother's gain by a pseudo-inverse."""
    p, old, active = filter_.parameters, belief.map, belief.active
    moved, transition, noise = filter_.dynamics.linearize(belief.mean)
    transition, noise = transition[np.ix_(active, active)], noise[np.ix_(active, active)]
    covariance = transition @ belief.covariance @ transition.T + noise
    scale = 1 / np.sqrt(np.diag(covariance))
    inverse = scale[:, None] * np.linalg.pinv(covariance * np.outer(scale, scale), hermitian=True) * scale
    smooth = belief.covariance @ transition.T @ inverse
    left = belief.covariance - smooth @ covariance @ smooth.T
    walk = np.zeros((len(old.form), 3))
    walk[1:, : 3 if p.spatial else 2] = p.position_walk**2
    weight = p.survival * old.weight
    weight[0] += p.return_probability * (1 - old.weight[0])
    counts = np.diff(old.first)
    share = np.where(counts > 1, p.type_switch / np.maximum(counts - 1, 1), 0.0)
    exists = np.repeat(np.add.reduceat(weight, old.first[:-1]), counts)
    weight = weight + np.repeat(share, counts) * (exists - np.repeat(counts, counts) * weight)
    spread = old.spread + old.gain @ left @ old.gain.T + np.diag(walk.ravel())
    chart = old._replace(weight=weight, gain=old.gain @ smooth, spread=spread)
    return moved, covariance, noise, chart, *filter_.dynamics.pose(moved)


def association(chart, log_density, log_amplitude, log_false, log_birth):
    log_weight = np.log(np.maximum(chart.weight, 1e-300))
    by_row = log_weight[:, None] + log_density + log_amplitude[:, 1:] - log_false
    log_detected = np.logaddexp.reduceat(by_row, chart.first[:-1], axis=0)
    missed = np.add.reduceat(chart.weight * np.exp(log_amplitude[:, 0]), chart.first[:-1])
    log_missed = np.log(missed + np.maximum(1 - chart.existence, 1e-12))
    log_born = np.logaddexp.reduce(log_birth - log_false[:, None], axis=1)
    return loopy_association(log_missed, log_detected, np.logaddexp(0.0, log_born)), log_born


def update(filter_, active, predicted, scan, rows, log_false, log_birth):
    """Association and update."""
    p, anchor = filter_.parameters, np.asarray(filter_.parameters.anchor, float)
    whole, covariance, _, chart, pose, full = predicted
    by_coordinate, mean = np.ascontiguousarray(full[:, active]), whole[active]
    slopes = linearized_rows(chart.form, chart.center, pose, by_coordinate, anchor, rows)
    loss = log_losses(chart.form, pose, chart.center, anchor)
    u = chart.reference[:, 0] * np.exp(-0.5 * loss)
    variance = chart.reference[:, 1] * np.exp(-loss) + (p.amplitude_walk * u) ** 2
    log_amplitude, amplitudes = amplitude_messages(filter_._table, u, variance, scan.amplitude)
    hide = np.where(chart.seen >= step.ESTABLISHED, filter_.hide, 0.0)
    hidden = chart.hidden * (1 - filter_.unhide) + (1 - chart.hidden) * hide
    hidden[0] = 0.0
    seen_missed = np.log(hidden + (1 - hidden) * np.exp(log_amplitude[:, 0]))
    log_amplitude = log_amplitude + np.log1p(-hidden)[:, None]
    log_amplitude[:, 0] = seen_missed
    scale = np.ones(log_amplitude[:, 1:].shape)
    if p.rescale_covariance:
        scale = (scan.amplitude / amplitudes[:, 1:, 0]) ** 2
    log_density, cell = pair_densities(
        chart.form, mean, covariance, chart.center, chart.gain, chart.spread, pose, *slopes, anchor, rows, scale,
        filter_.pair_gate, np.square(scan.amplitude),
    )  # fmt: skip
    expected = 1 - p.amplitude.missed_probability(chart.reference[:, 2] * np.exp(-0.5 * loss))
    log_amplitude[1:, 0] += (np.log(1 - (1 - filter_.double) * expected) * cell.any(axis=1))[1:]
    found, log_born = association(chart, log_density, log_amplitude, log_false, log_birth)
    owner = chart.owner
    log_pair = found.log_nu[owner] + log_amplitude[:, 1:] - log_false
    log_pair[found.marginal[owner, 1:] < filter_.gate] = -np.inf
    log_pair[~np.isfinite(log_density)] = -np.inf
    order = np.concatenate([[0], 1 + np.argsort(-chart.existence[1:], kind="stable")])
    start, point = mean, chart.center
    for iteration in range(filter_.iterations):
        if iteration > 0:
            slopes = linearized_rows(chart.form, point, pose, by_coordinate, anchor, rows)
        updated = sequential_update(
            chart.form, chart.first, order, chart.weight, mean, covariance, chart.center, chart.gain, chart.spread, start,
            point, pose, *slopes, anchor, rows, scale, log_pair, np.ascontiguousarray(log_amplitude[:, 0]),
            filter_.prune_type * p.pruning_threshold,
        )  # fmt: skip
        moved = updated[0] - start
        start, point = updated[0], updated[2]
        whole = whole.copy()
        whole[active] = start
        if np.all(moved**2 < 1e-2 * np.diag(updated[1])) and iteration > 0:
            break
        pose, full = filter_.dynamics.pose(whole)
        by_coordinate = np.ascontiguousarray(full[:, active])
    _, covariance, center, gain, spread, share = updated[:6]
    weight = share.sum(axis=1)
    gone = share[:, 0] / np.maximum(weight, 1e-300)
    hidden = np.where(weight > 0, gone, 0.0) * hidden * np.exp(-seen_missed)
    part = np.where(weight[:, None] > 1e-280, share / np.maximum(weight, 1e-280)[:, None], np.eye(1, share.shape[1]))
    u = np.sum(part * amplitudes[:, :, 0], axis=1)
    variance = np.sum(part * (amplitudes[:, :, 1] + (amplitudes[:, :, 0] - u[:, None]) ** 2), axis=1)
    loss = np.exp(log_losses(chart.form, filter_.dynamics.pose(whole)[0], center, anchor))
    seen = np.sum(share[:, 1:] * amplitudes[:, 1:, 0], axis=1) / np.maximum(weight, 1e-300) * np.sqrt(loss)
    reference = np.column_stack([u * np.sqrt(loss), variance * loss, gone * chart.reference[:, 2] + seen])
    after = Map(
        chart.label, chart.first, chart.form, weight, hidden, chart.seen + 1 - gone, reference, center, gain, spread,
    )  # fmt: skip
    return whole, covariance, after, found.marginal, found.new, log_born


def prune(chart, threshold, share):
    exists = np.repeat(chart.existence, np.diff(chart.first))
    keep = (exists > threshold) & (chart.weight > share * exists)
    keep[0] = True
    rows = np.flatnonzero(keep)
    owner, wide = chart.owner[rows], (3 * rows[:, None] + np.arange(3)).ravel()
    kept, counts = np.unique(owner, return_counts=True)
    return Map(
        chart.label[kept], np.concatenate([[0], np.cumsum(counts)]), *(part[rows] for part in chart[2:8]), chart.gain[wide],
        chart.spread[np.ix_(wide, wide)],
    )  # fmt: skip


def agree(have, expected):
    for one, other in zip(have, expected, strict=True):
        if isinstance(other, tuple):
            agree(one, other)
        else:
            np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("motion", [ConstantVelocity(0.1, 0.02), SpeedHeading(0.1, 0.02, 0.01, position_walk=0.005)])
@pytest.mark.parametrize("rescale", [True, False])
def test_the_compiled_step_is_that_in_numpy(motion, rescale):
    """Every step of a run: prediction, update and pruning from the belief that the filter had; features are born, hidden,
    missed and given up, and one scan is empty."""
    experiment = Experiment(steps=30)
    _, scans, sources = draw(experiment, np.random.default_rng(3))
    parameters = replace(experiment.parameters, agent="gaussian", types=(Form.VA_AOD, Form.PS, Form.VA))
    filter_ = Conditional(replace(parameters, rescale_covariance=rescale), motion, particles=300)
    rng = np.random.default_rng(5)
    belief = filter_.init(*informed_start(rng, Box(experiment.start), scans[0], filter_.parameters, 0.1, 400), 30.0)
    features = []
    for k, (scan, source) in enumerate(zip(scans, sources, strict=True)):
        scan = scan.select((source != 1) if 15 < k < 22 else np.zeros(0, int) if k == 25 else np.arange(len(scan)))
        if k > 0:
            rows, active = measured(scan, True), belief.active
            predicted = predict(filter_, belief)
            course, choices = filter_._course, filter_._choices
            have = step.predict(course, choices, belief.mean, belief.covariance, active, belief.map)
            agree(have[:5], predicted[:5])
            agree(have[5:], (predicted[5][:, active],))
            log_false = filter_._log_false(scan, rows)
            log_birth = filter_._log_births(have[4], have[5], have[1], rows)[0]
            updated = update(filter_, active, predicted, scan, rows, log_false, log_birth)
            have = step.update(
                course, choices, *have[:2], active, have[3], *have[4:], rows, scan.amplitude, log_false, log_birth
            )
            agree(have[:6], updated)
            agree(step.pruned(have[2], 1e-3, 1e-5), prune(updated[2], 1e-3, 1e-5))
        belief, info = filter_.step(rng, belief, scan)
        features.append(info.features)
    assert max(features) > 3 and min(features[5:]) >= 3


def test_what_is_left_of_an_agent_that_moves_as_one_is_nothing():
    """A prior known up to one direction and a motion without noise: P' is singular, and the map keeps what it knew."""
    filter_ = Conditional(replace(Experiment().parameters, agent="gaussian"), ConstantVelocity(0.1, 0.0), particles=10)
    root = np.array([0.3, -0.2, 0.1, 0.4])
    covariance = np.outer(root, root)
    chart = Map(
        np.array([-1, 4]), np.array([0, 1, 2]), np.array([0, 2]), np.array([0.9, 0.8]), np.zeros(2), np.ones(2), np.ones((2, 3)),
        np.zeros((2, 3)), np.concatenate([np.zeros((3, 4)), np.arange(12.0).reshape(3, 4)]), np.diag([0.0, 0, 0, 1, 2, 3]),
    )  # fmt: skip
    active, mean = np.array([0, 1, 3, 4]), np.arange(7.0)
    _, after, _, later, _, _ = step.predict(filter_._course, filter_._choices, mean, covariance, active, chart)
    own = slice(3, 6)
    walk = np.diag([1.0, 1, 0]) * filter_.parameters.position_walk**2
    expected = chart.spread[own, own] + chart.gain[own] @ covariance @ chart.gain[own].T + walk
    have = later.spread[own, own] + later.gain[own] @ after @ later.gain[own].T
    np.testing.assert_allclose(have, expected, atol=1e-9)
