"""From the tracer to the summary on real traced paths: composition of the stages, reproducibility, accuracy, bad
input."""

import json

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import SceneError
from dopslam.evaluate import detections as matching
from dopslam.pipeline import file as stages
from dopslam.pipeline.judge import match_series
from dopslam.records import DetectionSeries, Landmarks, same
from dopslam.report.tables import study_text
from dopslam.store import file as dataset
from dopslam.studies.traced import study

pytestmark = pytest.mark.rt
SHORT = ["track.steps=4"]


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Four steps of ring_road, traced and estimated without a stored signal."""
    path = tmp_path_factory.mktemp("ring") / "d.h5"
    stages.trace(path, load("ring_road", SHORT), seed=1)
    stages.estimate(path)
    return path


def test_stored_signal_and_two_workers_change_nothing(traced, tmp_path):
    path = tmp_path / "d.h5"
    stages.trace(path, load("ring_road", SHORT), seed=1)
    stages.synthesize(path)
    assert dataset.signal_steps(path) == 4
    stages.estimate(path, jobs=2)
    left, right = (dataset.read_record(p, "detections", DetectionSeries) for p in (traced, path))
    assert same(left, right)
    assert dataset.content_hash(left) == dataset.content_hash(right)


def test_line_of_sight_and_walls_are_detected_within_their_covariance(traced):
    track, paths, detections = _truth(traced)
    summary = matching.figures(match_series(load("ring_road", SHORT), track, paths, detections))
    strong = summary["found_by_rho_db"]["20-90"]
    assert strong["found"] == strong["of"] >= 16
    assert summary["false_per_snapshot"] <= 0.5
    assert 0.5 < summary["nees_over_6"] < 2.0


def _truth(path):
    track, _, paths, _ = stages.read_truth(path)
    return track, paths, stages.read_detections(path)


def test_the_command_line_composes_to_run(call, traced, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("run", "ring_road", "--seed", 1, "--set", *SHORT, "--jobs", 1) == 0
    whole = json.loads((tmp_path / "runs/latest/summary.json").read_text())
    assert call("trace", "ring_road", "--seed", 1, "--set", *SHORT, "--out", "d.h5") == 0
    assert call("estimate", "d.h5", "--jobs", 1) == 0
    for density in ("joint", "marginal"):
        for doppler in ((), ("--doppler-std", "none")):
            assert call("slam", "d.h5", "--filter", density, *doppler) == 0
    assert call("bound", "d.h5") == 0
    assert call("bound", "d.h5", "--doppler-std", "none") == 0
    assert call("evaluate", "d.h5", "--out", ".") == 0
    parts = json.loads((tmp_path / "summary.json").read_text())
    assert parts["variants"] == whole["variants"]
    assert set(whole["seconds"]) >= {"trace", "estimate", "slam", "bound", "evaluate"}
    assert (tmp_path / "runs/latest/detections.png").stat().st_size > 10_000


def test_two_bounces_report_second_order_anchors(tmp_path):
    path = tmp_path / "d.h5"
    stages.trace(path, load("ring_road", [*SHORT, "trace.max_depth=2"]), seed=1)
    landmarks = dataset.read_record(path, "landmarks", Landmarks)
    assert np.sum(landmarks.order == 2) >= 4
    assert any(">" in name for name in landmarks.name)
    stages.estimate(path)
    stages.slam(path)
    stages.bound(path)
    summary, _ = stages.evaluate(path)
    assert len(summary["higher_order_va_error_m"]) == np.sum(landmarks.order == 2)
    assert summary["va_total"] == 4


def test_a_track_through_a_wall_is_refused_before_anything_is_written(tmp_path):
    path = tmp_path / "d.h5"
    with pytest.raises(SceneError):
        stages.trace(path, load("ring_road", [*SHORT, "base_station.position=[100.0, 0.0, 20.0]"]), seed=1)
    assert not path.exists()


def test_a_study_pools_its_seeds_and_uses_complete_datasets_again(tmp_path):
    scenario = load("ring_road", ["track.steps=3"])
    first = study(scenario, range(2), tmp_path)
    stamps = [p.stat().st_mtime_ns for p in sorted(tmp_path.iterdir())]
    assert study(scenario, range(2), tmp_path) == first
    assert [p.stat().st_mtime_ns for p in sorted(tmp_path.iterdir())] == stamps
    errors = [run["joint"]["position_rmse_m"] for run in first["runs"]["estimator"]]
    assert first["estimator"]["joint"]["position_rmse_m"]["mean"] == pytest.approx(np.mean(errors))
    # Noise of paper A's R (0.1 m, 0.05 rad) makes everything coarser than the estimator's few centimeters.
    assert first["paper"]["joint"]["position_rmse_m"]["mean"] > first["estimator"]["joint"]["position_rmse_m"]["mean"]
    assert "| joint |" in study_text(first)
