"""Estimators by name, and one's own in their place."""

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import ConfigError
from dopslam.pipeline import stages
from dopslam.pipeline.link import signal_model
from estimation import Detections, EstimationError, ModelError, PathTable, SignalModel, comb, digital, ura
from estimation.estimators import ESTIMATORS, estimated, find, make

OWN = '''
import numpy as np
from estimation import Detections, PathTable

class Strongest:
    """One path at the strongest delay."""

    def __init__(self, model, max_speed=1.0, cells=64):
        self.model, self.max_speed, self.cells = model, max_speed, cells

    def run(self, signal):
        profile = np.abs(np.fft.ifft(signal, self.cells, axis=0)).sum(axis=tuple(range(1, signal.ndim)))
        delay = np.argmax(profile) / self.cells / self.model.waveform.spacing
        paths = PathTable([delay], [[0.1, 0.2]], [[0.3, 0.4]], [0.0], [1.0])
        return Detections.of(paths, np.eye(6)[None], snr=50.0, threshold=25.0)

class Wrong:
    def __init__(self, model):
        pass

    def run(self, signal):
        return [1.0]

class Negative(Strongest):
    def run(self, signal):
        paths = PathTable([1e-7], [[0.1, 0.2]], [[0.3, 0.4]], [0.0], [1.0])
        return Detections.of(paths, -np.eye(6)[None], snr=50.0, threshold=25.0)

class Faulty(Strongest):
    def run(self, signal):
        return {}["peak"]

class Unmade:
    def __init__(self):
        pass

    def run(self, signal):
        pass

class Deaf:
    pass
'''


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    return str(path)


@pytest.fixture
def model() -> SignalModel:
    return SignalModel(comb(28e9, 6.25e6, 32), digital(4, 125e-6), ura(2, 2), ura(2, 2))


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_every_name_of_the_table_is_an_estimator(kind, model):
    estimator = make(kind, model, threshold=25.0, max_speed=10.0, colour="red")
    assert estimator.max_speed == 10.0
    assert isinstance(estimated(estimator, np.ones(model.shape, complex)), Detections)


def test_one_s_own_takes_the_options_that_it_names(own, model, monkeypatch, tmp_path):
    estimator = make(f"{own}:Strongest", model, {"cells": 128}, max_speed=7.0, max_paths=3)
    assert (estimator.max_speed, estimator.cells) == (7.0, 128)
    monkeypatch.syspath_prepend(tmp_path)
    assert make("mine:Strongest", model).cells == 64


@pytest.mark.parametrize(
    ("kind", "own_options", "message"),
    [
        ("nmop", {}, "did you mean 'nomp'"),
        ("nowhere.at_all:Class", {}, "cannot be imported"),
        ("nowhere.py:Class", {}, "no file nowhere.py"),
        ("numpy:Class", {}, "no class 'Class'"),
        ("{own}:Deaf", {}, "no method run"),
        ("{own}:Unmade", {}, "cannot be made: TypeError"),
        ("{own}:Strongest", {"cell": 3}, "did you mean 'cells'"),
        ("nomp", {"resolved": True}, "did you mean 'resolve'"),
    ],
)
def test_what_is_no_estimator_is_said_in_one_sentence(own, model, kind, own_options, message):
    with pytest.raises(ModelError, match=message):
        make(kind.format(own=own), model, own_options)


def test_detections_are_asked_for(own, model):
    with pytest.raises(EstimationError, match=r"must return estimation\.Detections, got list"):
        estimated(make(f"{own}:Wrong", model), np.ones(model.shape))
    with pytest.raises(EstimationError, match=r"estimator Faulty: run\(signal\): KeyError: 'peak'"):
        estimated(make(f"{own}:Faulty", model), np.ones(model.shape))
    with pytest.raises(EstimationError, match="Negative: a covariance of its detections has no positive variance"):
        estimated(make(f"{own}:Negative", model), np.ones(model.shape))
    with pytest.raises(EstimationError, match=r"covariance must be of shape \(1, 6, 6\)"):
        Detections.of(PathTable([0.0], [[0, 0]], [[0, 0]], [0.0], [1.0]), np.eye(6))


def test_entry_points_are_names(monkeypatch, own):
    from importlib import metadata

    point = metadata.EntryPoint("mine", f"{own}:Strongest", "dopslam.estimators")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point] if group == "dopslam.estimators" else [])
    assert ESTIMATORS.checked("mine") == "mine" and find("mine").__name__ == "Strongest"


class Snapshots:
    """Two noise-free bursts of one path."""

    steps, time = 2, None

    def __init__(self, scenario):
        self.model = signal_model(scenario)

    def snapshot(self, step):
        from estimation import synthesize

        return synthesize(self.model, PathTable([5e-7], [[0.1, 0.0]], [[0.2, 0.0]], [0.0], [1.0]))


def test_the_pipeline_runs_it(own):
    scenario = load("ring_road", [f"estimator.kind={own}:Strongest", "estimator.options.cells=1024"])
    found = stages.estimate(scenario, Snapshots(scenario))
    assert found.steps == 2 and len(found.delay) == 2 and found.threshold == 25.0
    np.testing.assert_allclose(found.delay, 5e-7, atol=2e-9)


def test_a_scenario_with_a_misspelt_kind_names_the_nearest():
    with pytest.raises(ConfigError, match=r"estimator.kind.*did you mean 'sage'"):
        load("ring_road", ["estimator.kind=saeg"])
