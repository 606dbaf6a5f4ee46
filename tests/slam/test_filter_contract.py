"""The contract of a filter, for every filter of the table; filters of one's own."""

import json
import textwrap
from importlib import metadata

import numpy as np
import pytest

import dopslam as ds
from dopslam.errors import ConfigError, FilterError
from dopslam.filters import FILTERS
from dopslam.models.scans import Scans
from dopslam.pipeline import problem as build
from dopslam.simulate.world import section_v, simulate, unknown_motion
from dopslam.slam.filter import Capabilities, Estimate, Info, run, run_steps
from dopslam.slam.history import TYPES

OWN = """
    from dataclasses import dataclass
    from typing import ClassVar

    import numpy as np

    import dopslam as ds
    from dopslam.models.motion import propagate


    @dataclass(frozen=True)
    class DeadReckoning:
        capabilities = ds.Capabilities(doppler=False)
        growth: float = 1.0

        def init(self, problem, rng):
            return problem, problem.mean, problem.covariance

        def step(self, state, scan, rng):
            problem, mean, covariance = state
            mean, covariance = propagate(mean, problem.motion), covariance + self.growth * problem.motion.process_noise
            return (problem, mean, covariance), ds.Info(ds.Estimate(mean, covariance))
"""


@pytest.fixture(scope="module")
def case():
    world = section_v(steps=6)
    states, scans = simulate(world, 3, 0)
    return build.told(world), states, scans


def small(name):
    return FILTERS[name](particles=200) if name == "bp" else FILTERS[name]()


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_tracks_and_maps(name, case):
    problem, states, scans = case
    history, diagnostics = run(problem, scans, small(name), seed=1)
    assert history.steps == scans.steps and len(diagnostics.nis) == scans.steps
    assert np.hypot(*(history.mean - states)[:, :2].T).max() < 1.5
    assert len(history.existence) > 0 and np.all(history.existence <= 1 + 1e-9)
    again, _ = run(problem, scans, small(name), seed=1)
    np.testing.assert_array_equal(history.mean, again.mean)


@pytest.mark.parametrize("name", ["joint", "marginal", "mixture"])
def test_step_by_step_is_the_run(name, case):
    """The compiled loop and the online recursion are one filter."""
    problem, _, scans = case
    chosen = FILTERS[name]()
    whole, told = chosen.run(problem, scans, np.random.default_rng(0))
    steps, info = run_steps(chosen, problem, scans, np.random.default_rng(0))
    np.testing.assert_allclose(steps.mean, whole.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(steps.covariance, whole.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(steps.track, whole.track)
    np.testing.assert_allclose(steps.existence, whole.existence, rtol=1e-9)
    np.testing.assert_allclose(info.nis, told.nis, rtol=1e-9)


def test_capabilities_decide_what_is_refused(case):
    problem, _, scans = case
    world = unknown_motion(section_v(steps=6))
    with pytest.raises(FilterError, match=r"Belief carries 4 states, the motion model has 6.*filter\.motion"):
        run(build.told(world), scans, FILTERS["bp"]())
    second = Scans(**{f: getattr(scans, f) for f in Scans.__slots__} | {"anchor": np.ones(len(scans.z), int)})
    with pytest.raises(FilterError, match="knows 1 base station"):
        run(problem, second, FILTERS["joint"]())
    with pytest.raises(FilterError, match="is not a filter"):
        run(problem, scans, object())


def test_a_filter_that_fails_names_its_step(case):
    class Broken:
        capabilities = Capabilities()

        def init(self, problem, rng):
            return 0

        def step(self, state, scan, rng):
            if state == 2:
                raise ValueError("no more")
            return state + 1, Info(Estimate(np.zeros(4), np.eye(4)))

    with pytest.raises(FilterError, match="step 2: Broken: no more"):
        run(case[0], case[2], Broken())


class Answers:
    """A filter of one's own that answers whatever it was made with."""

    capabilities = Capabilities(doppler=False)

    def __init__(self, answer):
        self.answer = answer

    def init(self, problem, rng):
        return problem.mean, problem.covariance

    def step(self, state, scan, rng):
        return self.answer(*state)


POINT = {"position": [[1.0, 2.0, 3.0]], "position_covariance": [np.eye(3)], "existence": [0.9]}
ODD = {
    "must return": lambda mean, covariance: Info(Estimate(mean, covariance)),
    r"must return \(state, dopslam.Info.*got \(int, Estimate\)": lambda mean, covariance: (
        0,
        Estimate(mean, covariance),
    ),
    "must be a dopslam.Estimate, got tuple": lambda mean, covariance: (0, Info((mean, covariance))),
    r"step 0: Answers: Estimate.mean has the shape \(2,\)": lambda mean, covariance: (
        0,
        Info(Estimate(mean[:2], covariance)),
    ),
    r"Estimate.mean has the shape \(4, 1\)": lambda mean, covariance: (0, Info(Estimate(mean[:, None], covariance))),
    r"covariance has the shape \(4,\), it must be \(4, 4\)": lambda mean, covariance: (0, Info(Estimate(mean, mean))),
    r"type_probability has the shape \(0, \d\), it must be \(1,": lambda m, c: (0, Info(Estimate(m, c, **POINT))),
    "step 0: Answers: KeyError: 'speed'": lambda mean, covariance: {}["speed"],
    "is not made of numbers": lambda mean, covariance: (0, Info(Estimate("abcd", covariance))),
    "Estimate.mean is not finite": lambda mean, covariance: (0, Info(Estimate(mean * np.nan, covariance))),
    "covariance has a negative variance": lambda mean, covariance: (0, Info(Estimate(mean, -covariance))),
    "existence is no probability": lambda m, c: (
        0,
        Info(Estimate(m, c, POINT["position"], [np.eye(3)], [5.0], np.eye(TYPES)[1:2], [0])),
    ),
    "step 0: Answers: TypeError": lambda mean, covariance: (0, Info(Estimate(mean, covariance), nis=np.ones(2))),
    "step 1: Answers: TypeError": lambda mean, covariance: (None, Info(Estimate(mean, covariance))),
}


@pytest.mark.parametrize("said", ODD)
def test_what_a_filter_of_one_s_own_answers_is_looked_at(said, case):
    with pytest.raises(FilterError, match=said):
        run(case[0], case[2], Answers(ODD[said]))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("pass", "Mine is no filter: it needs 'capabilities'"),
        ("capabilities = {'doppler': True}; init = step = lambda *_: 0", "Mine is no filter"),
        ("__init__ = lambda self, gain: None", "cannot be made: TypeError: .*'gain'"),
        (
            "capabilities = property(lambda self: 1 / 0); init = step = lambda *_: 0",
            "cannot be made: ZeroDivisionError",
        ),
    ],
)
def test_what_is_no_filter_is_said_before_anything_runs(body, said, tmp_path):
    (tmp_path / "mine.py").write_text(f"class Mine:\n    {body}\n")
    with pytest.raises(ConfigError, match=said):
        build.chosen_filter(ds.load("ring_road"), f"{tmp_path}/mine.py:Mine")


def test_no_name_is_no_filter(call, capsys):
    assert call("slam", "a.h5", "--filter", ",") == 2
    assert "names no filter; known are joint" in capsys.readouterr().err


def test_a_filter_may_write_into_what_it_handed_out(case):
    class InPlace(Answers):
        def step(self, state, scan, rng):
            mean, covariance = state
            mean += 1.0
            return state, Info(Estimate(mean, covariance))

        def init(self, problem, rng):
            return np.zeros(4), np.eye(4)

    history, _ = run(case[0], case[2], InPlace(None))
    np.testing.assert_array_equal(history.mean[:, 0], [1, 2, 3, 4, 5, 6])


def test_a_run_of_one_s_own_returns_a_history(case):
    class Whole(Answers):
        def run(self, problem, scans, rng):
            return self.answer

    history, told = run(case[0], case[2], FILTERS["joint"]())
    assert run(case[0], case[2], Whole((history, told)))[0] is history
    with pytest.raises(FilterError, match=r"Whole.run must return \(dopslam.History"):
        run(case[0], case[2], Whole(history))
    with pytest.raises(FilterError, match="5 steps for 6 scans"):
        run(case[0], case[2], Whole((history.take(slice(0, 5)), told)))


def test_a_filter_of_one_s_own_runs_everywhere(call, tmp_path, monkeypatch, capsys):
    """One file outside the package: in run, slam, montecarlo and the tables."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(textwrap.dedent(OWN))
    short = ["--set", "track.steps=4", "--source", "model"]
    assert call("run", "ring_road", "--filter", "joint,mine.py:DeadReckoning", *short) in (0, 3)
    table = capsys.readouterr().out
    assert "DeadReckoning" in table and "joint" in table
    summary = json.loads((tmp_path / "runs" / "latest" / "summary.json").read_text())
    assert set(summary["variants"]) == {"joint", "joint, no Doppler", "mine.py:DeadReckoning, no Doppler"}
    study = ["--filter", "mine.py:DeadReckoning", "--runs", "3", "--jobs", "1", "--json", "out.json"]
    assert call("montecarlo", "ring_road", *study, "--set", "filter.options.growth=2.0") == 0
    assert json.loads((tmp_path / "out.json").read_text())["filter"] == "mine.py:DeadReckoning"
    assert (
        call("slam", "runs/latest/dataset.h5", "--filter", "mine.py:DeadReckoning", "--set", "filter.options.grwth=1")
        == 2
    )
    assert "has no such option; it has" in capsys.readouterr().err


def test_a_filter_may_lie_in_another_folder(call, tmp_path, monkeypatch, capsys):
    """The slashes of its name leave the file, its copies and exports whole."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my 50%").mkdir()
    (tmp_path / "my 50%" / "mine.py").write_text(textwrap.dedent(OWN))
    name = f"{tmp_path}/my 50%/mine.py:DeadReckoning"
    assert call("simulate", "ring_road", "--out", "a.h5", "--set", "track.steps=3") == 0
    assert call("slam", "a.h5", "--filter", name) in (0, 3)
    assert call("slam", "a.h5", "--filter", "my 50%/mine.py:DeadReckoning") in (0, 3)
    assert call("bound", "a.h5", "--doppler-std", "none") == 0
    for words in (("info", "a.h5"), ("check", "a.h5"), ("export", "a.h5", "--to", "csv", "--out", "o")):
        assert call(*words) == 0, words
    assert call("evaluate", "a.h5", "--out", "e") in (0, 3)
    found = json.loads((tmp_path / "e" / "summary.json").read_text())["variants"]
    assert set(found) == {f"{name}, no Doppler", "my 50%/mine.py:DeadReckoning, no Doppler"}


def test_plug_ins_announce_themselves(monkeypatch, tmp_path):
    (tmp_path / "mine.py").write_text(textwrap.dedent(OWN))
    point = metadata.EntryPoint("reckoning", f"{tmp_path}/mine.py:DeadReckoning", "dopslam.filters")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point] if group == "dopslam.filters" else [])
    assert "reckoning" in FILTERS and FILTERS["reckoning"].__name__ == "DeadReckoning"
    assert ds.load("ring_road", set=["filter.density=reckoning"]).filter.density == "reckoning"
    with pytest.raises(ConfigError, match="did you mean 'reckoning'"):
        FILTERS["rekoning"]


def test_a_plug_in_that_cannot_be_imported_is_in_nobody_s_way(monkeypatch, case):
    point = metadata.EntryPoint("broken", "there.is_none:Filter", "dopslam.filters")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point] if group == "dopslam.filters" else [])
    assert "broken" in FILTERS and "broken" not in FILTERS.sound() and "broken" not in FILTERS.shipped
    with pytest.raises(ConfigError, match="'broken': module 'there.is_none' cannot be imported"):
        FILTERS["broken"]
    with pytest.raises(ConfigError, match=r"filter.options.nois: .*it has"):
        build.chosen_filter(ds.load("ring_road", set=["filter.options.nois=1"]), "joint")
    detections = ds.simulate(ds.load("ring_road", set=["track.steps=3"]))[1]
    assert ds.slam(ds.problem(ds.load("ring_road", set=["source.kind=model"])), detections, "joint").steps == 3


def test_several_filters_run_on_the_same_draws(call, tmp_path):
    target = tmp_path / "out.json"
    options = ["--runs", "3", "--jobs", "1", "--set", "track.steps=5", "--particles", "200", "--json", str(target)]
    assert call("montecarlo", "ring_road", "--filter", "joint,smoother", "--filter", "bp", *options) == 0
    found = json.loads(target.read_text())["filters"]
    assert list(found) == ["joint", "smoother", "bp"]
    bounds = [found[name]["per_step"]["bound_position"] for name in found]
    assert bounds[0] == bounds[1]  # the same tracks and detections
    assert found["bp"]["diverged"] == 0


def test_an_option_can_be_for_one_of_several_filters_alone():
    scenario = ds.load("ring_road", set=["filter.options.batch.noise=scaled"])
    assert build.chosen_filter(scenario, "batch").noise == "scaled"
    assert build.chosen_filter(scenario, "joint") == build.chosen_filter(ds.load("ring_road"), "joint")
    with pytest.raises(ds.DopslamError, match=r"filter.options.nois: the filter 'batch' has no such option"):
        build.chosen_filter(ds.load("ring_road", set=["filter.options.batch.nois=scaled"]), "batch")
    with pytest.raises(ds.DopslamError, match=r"for batch alone it is filter.options.batch.noise"):
        build.chosen_filter(ds.load("ring_road", set=["filter.options.noise=scaled"]), "joint")
