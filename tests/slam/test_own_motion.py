"""A motion model of one's own, that of docs/extending.md: one file outside the package, through filters, bound and
refusals."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import ConfigError
from dopslam.evaluate.bounds import detection_mask, pcrb
from dopslam.filters import FILTERS
from dopslam.models.motion import Motion, MotionModel, Told, differences, motion_of
from dopslam.models.pose import VELOCITY
from dopslam.pipeline import problem as build
from dopslam.simulate.world import noise_of, simulate
from dopslam.slam.filter import run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
OWN = next(code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if "class Accelerating" in code)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "mine.py"
    path.write_text(OWN)
    return path


@pytest.fixture(scope="module")
def kind(own):
    spec = importlib.util.spec_from_file_location("mine", own)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Accelerating


TOLD = Told(
    interval=0.5, pose_noise=np.diag([0.2, 0.2, 0.001, 0.2]) ** 2, speed=22.22, turn_rate=0.3, speed_std=2.0,
    turn_rate_std=0.03, speed_walk=0.1, turn_rate_walk=0.002, position_walk=None, heading_walk=0.5,
)  # fmt: skip


@pytest.mark.parametrize("name", ["known", "unknown", "walk", "own"])
def test_every_model_keeps_the_contract(name, own):
    motion = motion_of(f"{own}:Accelerating" if name == "own" else name, TOLD, {})
    assert isinstance(motion, MotionModel) and len(motion.names) == motion.dimension
    mean, covariance = motion.prior(np.array([70.0, 1.0, 1.5, 300.0]), 0.1 * np.eye(4))
    n = motion.dimension
    assert mean.shape == (n,) and covariance.shape == motion.process_noise.shape == (n, n)
    states = mean + np.random.default_rng(3).normal(size=(5, n))
    np.testing.assert_allclose(motion.jacobian(states), differences(motion.step, states), atol=1e-6)
    np.testing.assert_allclose(motion.step(states)[3], motion.step(states[3]))
    pose, slope = motion.pose(states, 1.5), motion.pose_jacobian(states)
    np.testing.assert_allclose(slope[:, VELOCITY], differences(lambda s: motion.pose(s).velocity, states), atol=1e-6)
    np.testing.assert_array_equal(pose.position[:, 2], 1.5)
    np.testing.assert_array_equal(slope[:, 6:], np.broadcast_to(np.eye(n)[2:4], (5, 2, n)))
    assert motion.paced(2.0).interval == pytest.approx(2 * motion.interval)


@pytest.mark.mc  # what is compiled is compiled once more for foreign models
def test_what_is_compiled_and_what_is_called_agree(world, prior):
    """A known turn through the door of foreign models is the compiled turn; with Doppler up to what its velocity, linearized
    where the step was predicted, leaves out."""
    _, scans = simulate(replace(world, steps=5), 2, 0)
    problem = build.told(world)

    class Turn(Motion):
        names, interval, process_noise = world.motion.names, world.motion.interval, world.motion.process_noise
        step, jacobian, velocity = world.motion.step, world.motion.jacobian, world.motion.velocity
        pose_jacobian = world.motion.pose_jacobian

    for doppler in (False, True):
        chosen = FILTERS["joint"](iterations=1, doppler=doppler)
        (inside, _), (outside, _) = run(problem, scans, chosen), run(replace(problem, motion=Turn()), scans, chosen)
        off, deviation = outside.mean - inside.mean, np.sqrt(np.diagonal(inside.covariance, axis1=1, axis2=2))
        assert np.abs(off / deviation).max() < (0.02 if doppler else 1e-8)
        np.testing.assert_array_equal(outside.track, inside.track)


@pytest.mark.mc
def test_it_follows_its_bound(kind, world):
    """Joint filter with a model that knows neither speed nor turn rate, beside the bound of that model."""
    motion = kind(interval=0.5, pose_noise=world.motion.process_noise, speed=world.motion.speed)
    mean, covariance = motion.prior(world.prior_mean, np.asarray(world.prior_covariance))
    problem = replace(build.told(world), motion=motion, mean=mean, covariance=covariance)
    square, lowest = [], []
    for seed in range(4):
        states, scans = simulate(world, seed, 0)
        history, _ = run(problem, scans, FILTERS["joint"]())
        v = world.motion.pose(states).velocity[:, :2]
        full = np.column_stack([states, v, world.motion.turn_rate * v @ [[0, 1], [-1, 0]]])
        start = np.concatenate([world.prior_mean, full[0, 4:]])
        mask = detection_mask(scans.label, scans.offsets, len(world.kind))
        noise = noise_of(world, states)[0]
        bound = pcrb(full, start, covariance, motion, world.position, world.kind, noise, mask, world.bs)
        assert set(bound.squared(motion.names)) == {"position", "heading", "clock", "vx", "vy", "ax", "ay"}
        square.append(np.sum((history.mean[:, :2] - states[:, :2]) ** 2, axis=1))
        lowest.append(bound.peb**2)
    ratio = np.sqrt(np.mean(square, axis=0) / np.mean(lowest, axis=0))
    assert 0.7 < ratio[5:].mean() < 1.5, ratio


@pytest.mark.mc
def test_one_file_outside_the_package(own, call, tmp_path, capsys):
    """slam with joint and marginal, its bound beside; filters that cannot refuse by name."""
    data = tmp_path / "a.h5"
    assert call("simulate", "ring_road", "--out", data, "--seed", "1", "--set", "track.steps=12") == 0
    choice = ["--set", f"filter.motion={own}:Accelerating"]
    assert call("slam", data, "--filter", "joint,marginal", *choice) in (0, 3)
    assert call("bound", data, *choice) == 0
    assert call("slam", data, "--filter", "batch", *choice) == 2
    assert "coordinated turns only" in capsys.readouterr().err
    assert call("slam", data, "--filter", "joint", *choice, "--set", "filter.motion_options.jrek=1") == 2
    assert "has no such option; it has jerk" in capsys.readouterr().err
    assert call("slam", data, "--set", "filter.motion=knwon") == 2
    assert "did you mean 'known'" in capsys.readouterr().err


STILL = """
import numpy as np
from dopslam.models.motion import Motion

class Still(Motion):
    def __init__(self, interval, pose_noise):
        self.interval, self.process_noise = interval, pose_noise
    def step(self, state):
        return np.array(state)
    def velocity(self, state):
        return np.zeros((*np.shape(state)[:-1], 3))

class Wrong(Still):
    BODY
"""


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def step(self, state): return np.zeros(3)", r"Wrong.step has the shape \(3,\), it must be \(3, 4\)"),
        ("def step(self, state): return {}['speed']", "Wrong.step: KeyError: 'speed'"),
        ("def velocity(self, state): return np.zeros(2)", r"Wrong.velocity has the shape \(2,\)"),
        ("def prior(self, mean, covariance): return mean, mean", r"prior \(covariance\) has the shape \(4,\)"),
        ("process_noise = property(lambda self: np.eye(3), lambda *_: 0)", r"process_noise has the shape \(3, 3\)"),
        ("process_noise = property(lambda self: -np.eye(4), lambda *_: 0)", "process_noise is no covariance"),
        ("names = ('x', 'y', 'heading', 'bias', 'vx', 'vx')", "names has one twice"),
        ("def __init__(self): raise KeyError('nothing')", "'nothing'"),
    ],
)
def test_its_answers_are_looked_at_before_anything_runs(body, said, tmp_path):
    (tmp_path / "mine.py").write_text(STILL.replace("BODY", body))
    assert build.motion(load("ring_road", [f"filter.motion={tmp_path}/mine.py:Still"])).dimension == 4
    with pytest.raises(ConfigError, match=said):
        build.motion(load("ring_road", [f"filter.motion={tmp_path}/mine.py:Wrong"]))
