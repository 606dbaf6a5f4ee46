"""What a linearization leaves out, against samples; and a start that it must not spoil."""

import numpy as np
import pytest

from dopslam.models.kernels import BS, SP, VA, linearize
from dopslam.models.measurement import measure, residual
from dopslam.models.motion import propagate
from dopslam.slam.pmb.curvature import add_curvature
from dopslam.slam.pmb.density import FilterParameters, Scan, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import single_step
from dopslam.slam.pmb.hypotheses import vector_spread

N = 4


@pytest.mark.parametrize(("kind", "spread"), [(BS, 0.0), (VA, 1.0), (SP, 1.0)])
def test_second_order_terms_have_the_spread_of_samples(world, kind, spread):
    """The rest of 4000 samples after their linear part, for every row, within a factor of two and a half."""
    rng, motion = np.random.default_rng(3), world.motion
    start = initial_density(world.prior_mean, np.diag([4.0, 4.0, 1e-4, 1.0]))
    landmark = world.bs if kind == BS else world.landmarks(kind)[1]
    covariance = np.zeros((7, 7))
    covariance[:N, :N], covariance[N:, N:] = start.covariance, spread**2 * np.eye(3)
    density = start._replace(
        mean=np.append(start.mean, landmark), covariance=covariance, kind=np.array([BS, kind], dtype=np.int64)
    )
    model = compile_model(FilterParameters(), motion, world.bs)
    block = 0 if kind == BS else 1
    noise = np.zeros((6, 6))
    add_curvature(density, N, block, vector_spread(covariance, N, block), model, noise)
    z, by_state, by_landmark = np.empty(6), np.zeros((6, N)), np.zeros((6, 3))
    linearize(density.mean[:N], landmark.astype(float), kind, model.site, z, by_state, by_landmark)
    states = rng.multivariate_normal(density.mean[:N], start.covariance, 4000)
    points = landmark + spread * rng.standard_normal((4000, 3))
    rest = np.array([
        residual(measure(s, x[None], np.array([kind]), world.bs, speed=motion.speed)[0], z)
        - by_state @ (s - density.mean[:N]) - by_landmark @ (x - landmark)
        for s, x in zip(states, points, strict=True)
    ])  # fmt: skip
    ratio = np.sqrt(np.diag(noise)) / np.sqrt(np.mean(rest**2, axis=0))
    assert ratio.min() > 0.5 and ratio.max() < 6.0, ratio


def test_a_sharp_base_station_passes_the_gate_of_a_wide_start(world):
    """Detections of hundredths of a millimetre before decimetres: without the second-order terms it is somebody else's."""
    rng = np.random.default_rng(0)
    noise = np.diag(np.square([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5]))
    near = world.bs + np.array([5.0, 3.0, 0.0])
    mean = np.array([near[0], near[1], 1.5, 300.0])
    deviation = np.array([0.3, 0.3, 0.005, 0.3])
    passed = {True: 0, False: 0}
    for _ in range(5):
        truth = mean + deviation * rng.standard_normal(4)
        after = propagate(truth, world.motion)
        for curvature in passed:
            model = compile_model(FilterParameters(iterations=4, curvature=curvature), world.motion, world.bs)
            z = measure(after, world.bs[None], np.array([BS]), world.bs, speed=world.motion.speed)
            start = initial_density(mean, np.diag(deviation**2))
            posterior, info = single_step(start, Scan(z, noise[None], np.full(1, 12.0), 0, 1e-9, 1.0), model)
            if info.track[0][0] == -1:
                passed[curvature] += 1
                assert np.abs(posterior.mean[:2] - after[:2]).max() < 1e-3
    assert passed[True] == 5 and passed[False] < 4
