"""Lost receivers are recognized from the filter's history and the measurements alone; hidden ones are not taken for lost."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import FilterError
from dopslam.evaluate import metrics
from dopslam.evaluate.bounds import situation_bound
from dopslam.evaluate.run import LOST_NEES
from dopslam.models.detection import ConstantDetection
from dopslam.models.measurement import BS, SP, VA
from dopslam.models.motion import CoordinatedTurn
from dopslam.pipeline import file as stages
from dopslam.records import edges_of
from dopslam.simulate.world import FixedNoise, Situation, section_v, simulate
from dopslam.slam.health import divergence, explained
from dopslam.slam.history import History
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.density import FilterParameters
from dopslam.store import file as dataset


def world(rng):
    """Walls, scatter points, a start, a motion, accuracies and false alarms: all drawn."""
    bs = np.array([0, 0, rng.uniform(3, 40)])
    walls, points = rng.integers(2, 6), rng.integers(0, 6)
    bearing, distance = rng.uniform(0, 2 * np.pi, walls), rng.uniform(30, 120, walls)
    va = bs + 2 * distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(walls)])
    sp = rng.uniform([-80, -80, 1], [80, 80, 15], (points, 3))
    reach, place, course = rng.uniform(15, 60), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    angle = 10 ** rng.uniform(-2.3, -1.3)
    std = np.array([10 ** rng.uniform(-1.7, -0.5), *[angle] * 4, 10 ** rng.uniform(-1.3, -0.3)])
    noise = np.diag([0.1, 0.1, 0.003, 0.1]) ** 2 * rng.uniform(0.5, 2) ** 2
    return Situation(
        bs=bs,
        kind=np.array([BS] + [VA] * walls + [SP] * points),
        position=np.vstack([bs, va, sp]),
        motion=CoordinatedTurn(rng.uniform(0.1, 0.5), noise, rng.uniform(1, 20), rng.uniform(-0.4, 0.4)),
        prior_mean=np.array([reach * np.cos(place), reach * np.sin(place), course, rng.uniform(-300, 300)]),
        prior_covariance=np.diag([0.3, 0.3, 0.01, 0.3]) ** 2 * rng.uniform(0.3, 2) ** 2,
        steps=30,
        noise=FixedNoise(std, rng.uniform(0.7, 0.98)),
        clutter_count=rng.uniform(0.05, 3),
        clutter_range=400.0,
        doppler_limit=25.0,
        height=1.5,
    )


def wrong_start(rng):
    """An error of position, heading, clock, or all of them; from hardly any to a hundred metres and half a turn."""
    course, which = rng.uniform(-np.pi, np.pi), rng.integers(0, 4)
    error = np.zeros(4)
    if which in (0, 3):
        error[:2] = 10 ** rng.uniform(-0.5, 2) * np.array([np.cos(course), np.sin(course)])
    if which in (1, 3):
        error[2] = min(10 ** rng.uniform(-1.5, 0.5), np.pi) * rng.choice([-1, 1])
    if which in (2, 3):
        error[3] = 10 ** rng.uniform(-0.5, 2) * rng.choice([-1, 1])
    return error


def hidden(scans, rng):
    """The line of sight is blocked for a part of the run."""
    first = rng.integers(0, 20)
    step = scans.step_of_row
    keep = ~((scans.label == 0) & (step >= first) & (step < first + rng.integers(8, 25)))
    rows = {name: getattr(scans, name)[keep] for name in ("z", "covariance", "anchor", "label")}
    return replace(scans, **rows, offsets=edges_of(np.bincount(step[keep], minlength=scans.steps)))


def filtered(situation, scans, error=0.0):
    noise = situation.noise
    parameters = FilterParameters(detection=ConstantDetection(noise.detection_probability, noise.sp_range))
    prior = situation.prior_mean + error, situation.prior_covariance
    return ek_pmb.run(scans, prior, situation.motion, situation.bs, parameters, situation.height)[0]


def truly_lost(situation, states, history):
    """By the truth, as `Evaluation.diverged` has it."""
    error = metrics.state_errors(history.mean, states)
    far = np.hypot(*error[-1, :2]) > max(10.0, 30 * situation_bound(situation, states).peb[-1])
    return far or np.median(metrics.nees(error, history.covariance)) > LOST_NEES


@pytest.mark.mc
def test_nearly_all_lost_runs_are_recognized_and_no_good_one_is_suspected():
    """40 drawn worlds: each driven right, with a hidden line of sight, with twice the false alarms that the filter is told,
    and twice from a wrong start."""
    recognized, lost, suspected, good = 0, 0, [], 0
    for seed in range(1000, 1040):
        rng = np.random.default_rng(seed)
        situation = world(rng)
        states, scans = simulate(situation, seed, 0)
        noisy = simulate(replace(situation, clutter_count=2 * situation.clutter_count), seed, 0)[1]
        told = replace(noisy, clutter_count=scans.clutter_count)
        for name, right in (("right", scans), ("hidden", hidden(scans, rng)), ("clutter", told)):
            history = filtered(situation, right)
            if truly_lost(situation, states, history):
                continue
            good += 1
            suspected += [(seed, name)] if divergence(history, right, situation.bs, situation.height) else []
        for _ in range(2):
            try:
                history = filtered(situation, scans, wrong_start(rng))
            except FilterError:
                continue  # that is named as well
            if truly_lost(situation, states, history):
                lost += 1
                recognized += bool(divergence(history, scans, situation.bs, situation.height))
    assert lost > 30 and recognized / lost >= 0.95
    assert good > 110 and len(suspected) <= 0.02 * good, suspected


@pytest.fixture(scope="module")
def ring():
    situation = section_v(steps=20)
    states, scans = simulate(situation, 3, 0)
    return situation, states, scans, filtered(situation, scans)


def test_a_good_run_is_explained(ring):
    situation, _, scans, history = ring
    seen = explained(history, scans, situation.bs, situation.height)
    assert divergence(history, scans, situation.bs, situation.height) == ""
    assert seen.sighted.mean() > 0.7 and not seen.too_far.any()
    assert seen.distance.sum() < 1.3 * 5 * seen.explained.sum()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ([30.0, 30, 0, 0], "the base station is never where it should be"),
        ([0, 0, np.pi, 0], "nor is anything of the map"),
        ([0, 0, 0, 15.0], "right in direction, wrong in length"),
    ],
)
def test_a_wrong_start_is_named(ring, error, said):
    situation, states, scans, _ = ring
    history = filtered(situation, scans, np.array(error))
    assert truly_lost(situation, states, history)
    assert said in divergence(history, scans, situation.bs, situation.height)


def test_a_state_that_is_no_number_is_named(ring):
    situation, _, scans, history = ring
    mean = history.mean.copy()
    mean[7] = np.nan
    assert "no number from step 7" in divergence(replace(history, mean=mean), scans, situation.bs, situation.height)


def test_a_run_without_detections_says_nothing(ring):
    situation, _, scans, _ = ring
    empty = scans.take([0]).take(slice(0, 0))
    none = replace(empty, offsets=np.zeros(21, int))
    history = filtered(situation, none)
    assert divergence(history, none, situation.bs, situation.height) == ""


@pytest.mark.parametrize("density", ["joint", "smoother"])
def test_slam_alone_names_a_lost_receiver_and_leaves_with_3(tmp_path, call, capsys, density):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=12", "filter.particles=200"]), seed=2)
    told = ("--set", "track.start=[30, 40, 0.2, 300]", "--set", "filter.restart=false")
    assert call("slam", path, "--filter", density, *told) == 3
    shown = " ".join(capsys.readouterr().out.split())
    assert "diverged: " + density in shown and "do not use this track" in shown and "snapshot" in shown
    group = next(g for g in dataset.groups(path) if g.startswith("slam_"))
    assert dataset.read_record(path, group, History).lost in shown


def test_belief_propagation_from_a_wrong_start_names_it_or_its_own_end(tmp_path, call, capsys):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=12", "filter.particles=200"]), seed=2)
    told = ("--set", "track.start=[30, 40, 0.2, 300]", "--set", "filter.restart=false")
    status = call("slam", path, "--filter", "bp", *told)
    out, err = capsys.readouterr()
    assert status in (2, 3) and "snapshot" in out + err and "a fault of dopslam" not in err


def test_the_table_and_the_summary_name_it(tmp_path, call, capsys):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=12"]), seed=2)
    assert call("slam", path) == 0 and call("bound", path) == 0
    assert call("evaluate", path, "--out", tmp_path) == 0
    assert call("slam", path, "--set", "track.start=[30, 40, 0.2, 300]", "--set", "filter.restart=false") == 3
    capsys.readouterr()
    assert call("evaluate", path, "--out", tmp_path) == 3
    summary = (tmp_path / "summary.json").read_text()
    assert '"diverged": true' in summary and '"lost": "from step' in summary
    assert "diverged" in capsys.readouterr().out
