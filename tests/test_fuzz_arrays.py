"""Arrays drawn at random into the Python functions: a result of finite numbers, or one DopslamError that says what."""

from dataclasses import fields, replace

import numpy as np
import pytest

import dopslam as ds
from dopslam.errors import DopslamError
from estimation.errors import EstimationError

VALUES = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 1e-300, 1e12, 1e-12, 180.0]
FILTERS = ("joint", "marginal", "smoother")


@pytest.fixture(scope="module")
def case():
    scenario = ds.load("ring_road", set=["source.kind=model", "track.steps=4"])
    truth, detections = ds.simulate(scenario, seed=4)
    return truth, detections, ds.problem(scenario)


def spoilt(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An array with values or a shape that it should not have."""
    array = np.array(array)
    kind = rng.integers(6)
    if kind == 0 and array.ndim:
        return array[: rng.integers(0, len(array) + 1)]
    if kind == 1:
        return array[..., None] if rng.integers(2) else array.reshape(-1)
    if kind == 2:
        return array.astype(rng.choice(["complex128", "int8", "float16"]))
    if not array.size:
        return array
    value = VALUES[rng.integers(len(VALUES))]
    if kind == 3:
        return np.full(array.shape, value)
    array = array.astype(float) if array.dtype.kind in "iu" and not np.isfinite(value) else array
    with np.errstate(all="ignore"):
        array.reshape(-1)[rng.integers(array.size)] = np.array(value).astype(array.dtype)
    return array


def arrays(record) -> list[str]:
    return [f.name for f in fields(record) if isinstance(getattr(record, f.name), np.ndarray)]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(60))
def test_spoilt_arrays_give_numbers_or_one_sentence(seed, case):
    rng = np.random.default_rng(seed)
    truth, detections, problem = case
    try:
        if rng.integers(4):
            name = str(rng.choice(arrays(detections)))
            detections = replace(detections, **{name: spoilt(getattr(detections, name), rng)})
        else:
            name = str(rng.choice(["mean", "covariance"]))
            problem = replace(problem, **{name: spoilt(getattr(problem, name), rng)})
        history = ds.slam(problem, detections, FILTERS[rng.integers(len(FILTERS))])
        assert np.isfinite(history.mean).all() and np.isfinite(history.covariance).all()
        bound = ds.bound(problem, truth, detections)
        assert str(ds.evaluate(truth, bound, joint=history))
    except (DopslamError, EstimationError) as error:
        assert str(error).strip() and "\n" not in str(error).strip()
