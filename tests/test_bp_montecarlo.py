"""Paper B's synthetic experiment from a scenario: the same as the named cases, the same for any number of workers."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from dopslam.cli import main
from dopslam.config.scenario import load, shipped_scenes
from dopslam.errors import ConfigError, FilterError
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.experiment import Experiment
from dopslam.slam.belief.rao_blackwell import RaoBlackwell
from dopslam.slam.belief.stacked.stacked import Stacked
from dopslam.studies.bp import case_of
from dopslam.studies.bp_cases import CASES, Case, run_case
from dopslam.studies.bp_study import summary

PEDESTRIAN = shipped_scenes()["pedestrian"]


def assert_same(first, second):
    for field in fields(first):
        x, y = getattr(first, field.name), getattr(second, field.name)
        assert np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y, field.name


@pytest.mark.parametrize(
    ("scene", "settings", "name"),
    [
        (PEDESTRIAN, [], "paper"),
        (PEDESTRIAN, ["belief.types=aod_for_va"], "aod"),
        (PEDESTRIAN, ["experiment.false_alarms=5"], "cluttered"),
        (PEDESTRIAN, ["experiment.false_alarms=5", "experiment.amplitudes=[15, 6, 5, 5]"], "weak"),
        (PEDESTRIAN, ["experiment.false_alarms=5", "experiment.blocked=[90, 130]"], "blocked"),
        (PEDESTRIAN, ["experiment.false_alarms=1e-3", "experiment.spurious=3"], "spurious"),
        (PEDESTRIAN, ["belief.start=uniform"], "uniform"),
        (PEDESTRIAN, ["belief.types=va_only"], "va_only"),
        (PEDESTRIAN / "spatial.toml", [], "spatial"),
    ],
)
def test_scenarios_are_the_named_cases(scene, settings, name):
    case, named = case_of(load(scene, settings)), CASES[name]
    assert_same(case.experiment, named.experiment)
    assert_same(case.filter.parameters, named.filter.parameters)
    assert case.filter.motion == named.filter.motion
    assert (case.informed, case.skip) == (named.informed, named.skip)


def test_settings_reach_the_filter():
    case = case_of(load("pedestrian", ["belief.false_alarm_tail=0.3", "belief.birth_rate=0.2", "belief.skip=7"]))
    assert case.filter.parameters.amplitude.tail_weight == 0.3
    assert case.filter.parameters.birth_rate == 0.2
    assert case.skip == 7
    assert isinstance(case.filter, Conditional)
    assert case_of(load("pedestrian", ["belief.agent=gaussian"])).filter.parameters.agent == "gaussian"
    assert isinstance(case_of(load("pedestrian", ["belief.features=independent"])).filter, RaoBlackwell)
    settings = ["belief.engine=stacked", "belief.backend=numba"]
    assert isinstance(case_of(load("pedestrian", settings)).filter, Stacked)


@pytest.mark.parametrize(
    ("scene", "settings", "words"),
    [
        ("ring_road", [], "experiment"),
        ("pedestrian", ["experiment.amplitudes=[30, 15]", "experiment.reference_distances=[10, 20]"], "one per path"),
        ("pedestrian", ["experiment.amplitudes=[30, 15]"], "reference_distances"),
        ("pedestrian", ["experiment.blocked=[30, 15]"], "blocked"),
        ("pedestrian", ["belief.typs=paper"], "types"),
        ("pedestrian", ["belief.skip=200"], "200 steps"),
        (PEDESTRIAN / "spatial.toml", ["belief.engine=stacked"], "planar"),
    ],
)
def test_mistakes_are_named(scene, settings, words):
    with pytest.raises(ConfigError, match=words):
        case_of(load(scene, settings))


def test_command_writes_the_same_numbers_for_any_number_of_workers(tmp_path, capsys):
    written = []
    for jobs in (1, 2):
        file = tmp_path / f"{jobs}.json"
        arguments = ["--filter", "bp", "--runs", "2", "--particles", "60", "--seed", "3", "--jobs", str(jobs)]
        main(["montecarlo", str(PEDESTRIAN), *arguments, "--set", "track.steps=12", "--json", str(file)])
        written.append(json.loads(Path(file).read_text()))
    times = {"seconds_per_step", "microseconds_per_step"}
    first, second = ({k: v for k, v in result.items() if k not in times} for result in written)
    assert first == second
    assert first["runs"] == 2 and first["steps"] == 12 and first["particles"] == 60
    expected = {"rmse_over_bound", "rmse_over_bound_interval", "nees_mean", "gospa_va_m", "gospa_sp_m", "diverged"}
    assert expected | {"orientation_rmse_deg", "type_belief_true", "per_step"} <= set(first)
    assert len(first["type_belief_true"]) == 3
    assert len(first["per_step"]["rmse_position"]) == 12
    assert "orientation" in capsys.readouterr().out


def test_summary_counts_from_the_first_counted_step():
    case = Case(Experiment(steps=8), particles=50, skip=5)
    results = run_case(case, 2)
    table = summary(results)
    squares = np.array([r.score.position_error[5:] ** 2 for r in results])
    assert table["position_rmse_m"] == pytest.approx(np.sqrt(squares.mean()))
    limits = np.array([r.position_bound[5:] ** 2 for r in results]).mean(axis=0)
    assert table["rmse_over_bound"]["position"] == pytest.approx(np.mean(np.sqrt(squares.mean(axis=0) / limits)))
    assert results[0].score.nees.min() > 0
    with pytest.raises(FilterError, match="runs"):
        run_case(case, 0)
