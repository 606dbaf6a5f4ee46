"""The plain NumPy filter of paper A, Section IV, is the compiled one: step by step, to nine digits."""

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.models.detection import SnrDetection
from dopslam.simulate.world import simulate
from dopslam.slam.pmb import reference
from dopslam.slam.pmb.density import FilterParameters, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import scan_of, single_step

STEPS = 9


@pytest.mark.parametrize(
    ("options", "seed"),
    [
        ({"joint": False, "iterations": 1}, 3),  # the paper's filter
        ({"joint": True, "iterations": 3}, 4),
        ({"joint": True, "doppler": False, "survival": 0.98, "birth_intensity": (1e-8, 1e-7)}, 5),
    ],
    ids=["marginal", "joint", "no Doppler, births"],
)
def test_the_compiled_filter_is_the_papers(world, prior, options, seed):
    parameters = reference.paper(FilterParameters(**options))
    _, scans = simulate(world, seed, 0)
    setting = reference.Setting(parameters, world.motion, world.bs, world.height)
    plain = reference.run(scans.take(range(STEPS)), prior, setting)
    model = compile_model(parameters, world.motion, world.bs, world.height)
    compiled, born, several, missed = initial_density(*prior), 0, 0, 0
    for k, (density, weight) in enumerate(plain):
        scan = scan_of(scans, k, parameters.doppler, world.motion.interval)
        before = set(compiled.track)
        compiled, info = single_step(compiled, scan, model)
        np.testing.assert_array_equal(density.kind, compiled.kind)
        np.testing.assert_array_equal(density.track, compiled.track)
        np.testing.assert_allclose(density.weight, compiled.weight, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(density.mean, compiled.mean, rtol=1e-9, atol=1e-9)
        deviation = np.sqrt(np.diag(compiled.covariance))
        unit = deviation[:, None] * deviation
        np.testing.assert_allclose(density.covariance / unit, compiled.covariance / unit, rtol=1e-9, atol=1e-9)
        told = np.sort(info.weight)[::-1][: len(weight)]
        np.testing.assert_allclose(np.sort(weight)[::-1], told / told.sum(), rtol=1e-8)
        born += len(set(compiled.track) - before)
        several += len(weight) > 1
        missed += len(before - set(info.track[0]))
    assert born > 5 and several > 2 and missed > 5  # the run has births, doubtful associations, misses


def test_beyond_the_paper_is_refused(world, prior):
    _, scans = simulate(world, 0, 0)
    for parameters in (FilterParameters(cubature=True), FilterParameters(detection=SnrDetection(14.0))):
        with pytest.raises(FilterError, match="reference filter"):
            reference.run(scans, prior, reference.Setting(parameters, world.motion, world.bs))
