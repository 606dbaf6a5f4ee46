"""``import dopslam as ds``: the names, that they cost nothing, and the lines of the README as printed."""

import subprocess
import sys

import numpy as np
import pytest

import dopslam as ds

TWELVE = """
import dopslam as ds
scenario = ds.load("ring_road", set=["trace.max_depth=2"{short}])
truth = ds.trace(scenario, seed=0)
detections = ds.estimate(scenario, ds.synthesize(scenario, truth, seed=0))
problem = ds.problem(scenario)
joint = ds.slam(problem, detections, ds.filters.Joint(iterations=3))
belief = ds.slam(problem, detections, ds.filters.Belief(particles=1000), seed=0)
bound = ds.bound(problem, truth, detections)
print(ds.evaluate(truth, bound, joint=joint, belief=belief))
study = ds.montecarlo(ds.world(scenario), problem, {{"joint": ds.filters.Joint(), "bp": ds.filters.Belief()}}, runs={runs})
"""


def test_every_public_name_is_there():
    for name in ds.__all__:
        assert getattr(ds, name) is not None


def test_importing_costs_nothing_heavy():
    code = "import sys, dopslam; print({'numpy', 'numba', 'h5py', 'sionna', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_rooms_that_are_verbs_can_be_called_and_imported_from():
    code = (
        "from dopslam.slam import history; import dopslam as ds; assert callable(ds.slam) and ds.slam.history is history\n"
        "from dopslam import problem; assert problem.motion and callable(problem)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_simulated_run_in_memory():
    scenario = ds.load("ring_road", set=["source.kind=model", "track.steps=5"])
    truth, detections = ds.simulate(scenario, seed=2)
    problem = ds.problem(scenario)
    joint = ds.slam(problem, detections, "joint")
    result = ds.evaluate(truth, ds.bound(problem, truth, detections), detections, joint=joint)
    assert "position RMSE" in str(result) and "joint" in str(result)
    assert result.summary["position_rmse_m"] < 1.0
    assert np.all(result.evaluations["joint"].peb > 0)
    with pytest.raises(ds.DopslamError, match="name at least one history"):
        ds.evaluate(truth, ds.bound(problem, truth, detections))
    with pytest.raises(ds.DopslamError, match="has no paths"):
        ds.synthesize(scenario, truth)


@pytest.mark.rt
def test_the_twelve_lines_run_as_printed(capsys):
    exec(TWELVE.format(short=', "track.steps=4"', runs=2), {})
    assert "belief" in capsys.readouterr().out
