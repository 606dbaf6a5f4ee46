"""The stages over a dataset file: composition, entering anywhere, and what a user sees when something is missing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.datasets.checks import check
from dopslam.errors import ConfigError, DatasetError, FilterError
from dopslam.evaluate.walls import Walls, walls
from dopslam.pipeline import file as stages
from dopslam.records import BaseStations, DetectionSeries, Track, same
from dopslam.slam.snapshot.start import locate
from dopslam.store import file as dataset

VARIANTS = stages.variants_of(load("ring_road"), ["joint", "marginal", "smoother", "mixture", "bp"])


@pytest.fixture
def simulated(tmp_path):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=8"]), seed=3)
    return path


def finish(path):
    for name, doppler in VARIANTS:
        stages.slam(path, (), name, doppler)
    for doppler in (True, False):
        stages.bound(path, (), doppler)


def test_a_simulated_run_ends_with_a_summary_a_table_and_figures(simulated, tmp_path):
    finish(simulated)
    summary, evaluations = stages.evaluate(simulated)
    stages.report(simulated, tmp_path, summary, evaluations)
    written = json.loads((tmp_path / "summary.json").read_text())
    keys = {"position_rmse_m", "heading_rmse_deg", "clock_bias_rmse_m", "peb_m", "heb_deg", "ceb_m", "rmse_over_bound"}
    assert keys | {"gospa_va_m", "gospa_sp_m", "va_found", "va_total", "sp_found", "nees", "seed"} <= set(written)
    assert set(written["variants"]) == {stages.variant_name(*variant) for variant in VARIANTS}
    assert written["ate_m"] == pytest.approx(written["position_rmse_m"]) and written["rpe_m"] > 0
    assert 0.5 < written["nis_per_row"] < 2.0 and "NIS" in (tmp_path / "table.txt").read_text()
    assert written["t_gospa_va_m"] > written["gospa_va_m"] and written["ospa_va_m"] < 20
    for name in ("plan", "errors", "gospa"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert "joint" in (tmp_path / "table.txt").read_text()


def test_slam_writes_the_walls_of_its_final_map(simulated):
    stages.slam(simulated)
    found = dataset.read_record(simulated, "walls_joint", Walls)
    history, scenario = stages.histories(simulated)["joint"], stages.scenario_of(simulated)[0]
    assert same(found, walls(history, np.array(scenario.base_station.position), scenario.receiver.height))
    assert len(found) and not check(simulated)


def test_the_bound_without_doppler_is_never_below_the_one_with_it(simulated):
    finish(simulated)
    _, evaluations = stages.evaluate(simulated)
    with_doppler, without = evaluations["joint"], evaluations["joint, no Doppler"]
    assert np.all(without.peb >= with_doppler.peb)
    assert np.all(without.heb > with_doppler.heb)


def test_the_same_seed_gives_the_same_content(tmp_path):
    scenario = load("ring_road", ["source.kind=model", "track.steps=4"])
    for name in "ab":
        stages.simulate(tmp_path / f"{name}.h5", scenario, seed=5)
    for group, kind in (("track", Track), ("detections", DetectionSeries)):
        first, second = (dataset.read_record(tmp_path / f"{name}.h5", group, kind) for name in "ab")
        assert same(first, second)
    stages.simulate(tmp_path / "c.h5", scenario, seed=6)
    assert not same(first, dataset.read_record(tmp_path / "c.h5", "detections", DetectionSeries))


def test_a_stage_says_what_is_missing_and_changes_nothing(simulated):
    before = simulated.read_bytes()
    with pytest.raises(DatasetError, match="no filter history"):
        stages.evaluate(simulated)
    with pytest.raises(DatasetError, match="'paths'"):
        stages.synthesize(simulated)
    with pytest.raises(DatasetError, match="exists already"):
        stages.simulate(simulated, load("ring_road", ["source.kind=model"]), seed=0)
    assert simulated.read_bytes() == before


def test_the_command_line_runs_a_model_scenario_and_links_the_latest(call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call("run", "ring_road", "--source", "model", "--set", "track.steps=4", "--seed", 2) == 0
    latest = tmp_path / "runs" / "latest"
    assert {p.name for p in latest.iterdir()} >= {
        "dataset.h5",
        "summary.json",
        "table.txt",
        "scenario.toml",
        "plan.png",
    }
    assert json.loads((latest / "summary.json").read_text())["seed"] == 2
    assert "joint" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (["run", "ring_rod"], ["ring_road"]),
        (["run", "ring_road", "--set", "filter.gamma=3"], ["filter.gamma"]),
        (["run", "ring_road", "--doppler-std", "-1"], ["-1"]),
        (["slam", "nothing.h5"], ["nothing.h5"]),
        (["trace", "ring_road"], ["out"]),
        (["rnu"], ["run"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(call, tokens, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(*tokens) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_data_leaves_no_folder(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(stages, "simulate", lambda *_: (_ for _ in ()).throw(DatasetError("broken")))
    assert call("run", "ring_road", "--source", "model", "--set", "track.steps=3") == 2
    assert list(tmp_path.iterdir()) == []


def test_a_run_keeps_its_dataset_when_the_filters_fail(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(stages, "slam", lambda *_: (_ for _ in ()).throw(DatasetError("broken")))
    assert call("run", "ring_road", "--source", "model", "--set", "track.steps=3") == 1
    assert (tmp_path / "runs" / "latest" / "dataset.h5").exists()
    assert "broken" in (tmp_path / "runs" / "latest" / "failed.json").read_text()


def test_a_start_from_the_scans_alone_does_not_look_at_the_scenarios(simulated):
    """Told a start 50 m off, a filter with filter.start="snapshot" gives what it gives without being told."""
    withheld = ["filter.start=snapshot"]
    stages.slam(simulated, [*withheld, "track.start=[50.0, 50.0, 0.0, 250.0]"], "joint")
    astray = stages.histories(simulated)["joint"]
    stages.slam(simulated, withheld, "joint")
    found = stages.histories(simulated)["joint"]
    assert same(astray, found)
    track = dataset.read_record(simulated, "track", Track)
    assert np.hypot(*(found.mean[:, :2] - track.position[:, :2]).T).max() < 3.0
    with pytest.raises(ConfigError, match=r'filter.start="snapshot"'):
        load("ring_road", ["track.start=snapshot"])


def test_locate_finds_the_receiver_from_one_scan_of_a_file(simulated):
    track, detections = (
        dataset.read_record(simulated, *r) for r in (("track", Track), ("detections", DetectionSeries))
    )
    stations = BaseStations(np.array([[0.0, 0.0, 40.0]]), np.zeros(1))
    modes = locate(detections, stations, step=2)
    error = modes.pose[0] - track.state[2]
    error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
    assert error @ np.linalg.solve(modes.covariance[0], error) < 25
    assert modes.probability.sum() == pytest.approx(1)
    turned = replace(stations, yaw=np.array([0.3]))
    moved = replace(detections, aod=detections.aod - [0.3, 0.0])
    np.testing.assert_allclose(locate(moved, turned, step=2).pose[0], modes.pose[0], atol=1e-6)
    with pytest.raises(FilterError, match="names base station 1"):
        locate(replace(detections, anchor=np.ones(len(detections.delay), int)), stations)
