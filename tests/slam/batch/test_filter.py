"""The whole-run smoother as a filter of the table: from a file, from nothing, step by step, and beside its own bound."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.filters import FILTERS
from dopslam.pipeline import file as stages
from dopslam.pipeline.problem import problem
from dopslam.records import Track, same
from dopslam.slam.filter import run, run_steps
from dopslam.store import file as dataset


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("batch") / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=10"]), seed=3)
    return path


def test_it_is_judged_by_the_bound_of_the_whole_run(simulated):
    for name in ("joint", "batch"):
        stages.slam(simulated, (), name)
    stages.bound(simulated)
    summary, evaluations = stages.evaluate(simulated)
    assert summary["variants"]["batch"]["bound"] == "smoothing"
    assert summary["variants"]["joint"]["bound"] == "filtering"
    assert np.all(evaluations["batch"].peb <= evaluations["joint"].peb * (1 + 1e-9))
    assert evaluations["batch"].peb[0] < 0.9 * evaluations["joint"].peb[0]
    assert evaluations["batch"].nees.mean() < 12
    assert summary["variants"]["batch"]["va_found"] >= 3


def test_without_a_start_it_does_not_look_at_the_scenarios(simulated):
    found = []
    for start in ("[50.0, 50.0, 0.0, 250.0]", "[70.0, 1.0, 1.0, 300.0]"):
        stages.slam(simulated, ["filter.start=snapshot", f"track.start={start}"], "batch")
        found.append(stages.histories(simulated)["batch"])
    assert same(*found)
    track = dataset.read_record(simulated, "track", Track)
    assert np.hypot(*(found[0].mean[:, :2] - track.position[:, :2]).T).max() < 3.0


def test_a_wide_prior_that_is_off_does_not_lose_it(simulated):
    """Told 40 m around a place 39 m off, whatever the filter that it starts from makes of it."""
    told = problem(load("ring_road", ["source.kind=model", "track.steps=10"]))
    spread = np.diag([40.0, 40.0, 1.0, 20.0]) ** 2
    wide = replace(told, mean=told.mean + np.array([30.0, 25.0, 0.5, 5.0]), covariance=spread)
    track = dataset.read_record(simulated, "track", Track)
    history, _ = run(wide, stages.read_detections(simulated), FILTERS["batch"]())
    assert np.hypot(*(history.mean[:, :2] - track.position[:, :2]).T).max() < 3.0


def test_its_steps_are_its_runs_over_what_was_read(simulated):
    scenario = load("ring_road", ["source.kind=model", "track.steps=10"])
    told, chosen = problem(scenario), FILTERS["batch"](rounds=3)
    scans = told.scans(stages.read_detections(simulated)).take(slice(0, 4))
    rng = np.random.default_rng(0)
    stepped, _ = run_steps(chosen, told, scans, rng)
    whole, diagnostics = run(told, scans, chosen)
    np.testing.assert_allclose(stepped.mean[-1], whole.mean[-1])
    np.testing.assert_allclose(stepped.covariance[-1], whole.covariance[-1])
    assert len(diagnostics.associations) == 4
    assert [a.shape[1] for a in diagnostics.associations] == np.diff(scans.offsets).tolist()


def test_learned_scales_undo_a_covariance_wrong_by_a_factor(simulated):
    """Detections that claim half of their deviations: overconfident as given, consistent as scaled."""
    told = problem(load("ring_road", ["source.kind=model", "track.steps=10"]))
    scans = told.scans(stages.read_detections(simulated))
    bold = replace(scans, covariance=scans.covariance / 4)
    truth = dataset.read_record(simulated, "track", Track).state

    def nees(noise):
        history, _ = run(told, bold, FILTERS["batch"](noise=noise))
        error = history.mean - truth
        error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
        return np.einsum("ki,kij,kj->k", error, np.linalg.inv(history.covariance), error).mean()

    given, scaled = nees("given"), nees("scaled")
    assert scaled < 0.6 * given


def test_the_joint_filter_smoothed_over_the_whole_run_is_nearer_than_itself(simulated):
    """The same associations, looked back over: below the filter's error, consistent, and its bound is the smoothing one."""
    for name in ("joint", "interval"):
        stages.slam(simulated, (), name)
    stages.bound(simulated)
    summary, evaluations = stages.evaluate(simulated)
    assert summary["variants"]["interval"]["bound"] == "smoothing"
    errors = {name: np.sqrt(np.mean(evaluations[name].position_error ** 2)) for name in ("joint", "interval")}
    assert errors["interval"] < errors["joint"]
    assert evaluations["interval"].nees.mean() < 12


def test_a_walk_and_a_free_clock_are_what_the_filter_believes(simulated):
    """Nothing is told of speed and turn rate, nor of the clock: the positions are found all the same, less sharply."""
    free = ["filter.motion=walk", "filter.clock=free", "filter.start=snapshot"]
    told = problem(load("ring_road", ["source.kind=model", "track.steps=10", *free]))
    assert told.motion.speed == 0
    np.testing.assert_allclose(np.sqrt(np.diag(told.motion.process_noise))[:3], [11.11, 11.11, 0.5])
    assert told.motion.process_noise[3, 3] >= 1e4
    variant = stages.slam(simulated, free, "batch")
    assert variant == "batch, no Doppler"
    history = stages.histories(simulated)[variant]
    track = dataset.read_record(simulated, "track", Track)
    error = np.hypot(*(history.mean[:, :2] - track.position[:, :2]).T)
    assert np.sqrt(np.mean(error**2)) < 4.0
