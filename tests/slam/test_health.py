"""Lost receivers are recognized from the filter's history and the measurements alone; hidden ones are not taken for lost."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.filters import FILTERS
from dopslam.models.detection import ConstantDetection
from dopslam.pipeline import file as stages
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.health import divergence, explained
from dopslam.slam.history import History
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.density import FilterParameters
from dopslam.store import file as dataset
from dopslam.studies.lost import shares, truly_lost, verdicts


def filtered(situation, scans, error=0.0):
    noise = situation.noise
    parameters = FilterParameters(detection=ConstantDetection(noise.detection_probability, noise.sp_range))
    prior = situation.prior_mean + error, situation.prior_covariance
    return ek_pmb.run(scans, prior, situation.motion, situation.bs, parameters, situation.height)[0]


@pytest.mark.mc
def test_nearly_all_lost_runs_are_recognized_and_no_good_one_is_suspected():
    """40 drawn worlds: each driven right, with a hidden line of sight, with twice the false alarms that the filter is told,
    and twice from a wrong start."""
    found = [verdict for seed in range(1000, 1040) for verdict in verdicts(seed, FILTERS["joint"]())]
    told = shares(found)
    assert told["lost"] > 30 and told["recognized"] / told["lost"] >= 0.95
    wrong = [v for v in found if v.said and not v.lost and not v.wrong]
    assert told["good"] > 110 and told["suspected"] <= 0.02 * told["good"], wrong


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


def test_false_detections_alone_say_nothing():
    """A receiver that sees nothing but three false detections in ten snapshots goes by its motion, and is not lost."""
    situation = section_v(steps=40)
    dark = replace(situation, clutter_count=0.3, noise=replace(situation.noise, detection_probability=1e-6))
    for seed in range(1000, 1006):
        _, scans = simulate(dark, seed, 0)
        assert scans.clutter_count == pytest.approx(0.3) and len(scans.z) > 5
        assert divergence(filtered(dark, scans), scans, dark.bs, dark.height) == ""


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
