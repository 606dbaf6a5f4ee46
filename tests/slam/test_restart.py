"""A filter that lost its receiver is started anew from the scans, says so, and no other one is touched."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.evaluate import metrics
from dopslam.filters import FILTERS
from dopslam.models.scans import Scans
from dopslam.pipeline import file as stages
from dopslam.pipeline.problem import told
from dopslam.records import Kind
from dopslam.simulate.world import section_v, simulate
from dopslam.slam import restart
from dopslam.slam.filter import run
from dopslam.slam.health import Verdict
from dopslam.slam.restart import joined
from dopslam.store import file as dataset

STEPS, MOVED = 24, 12


@pytest.fixture(scope="module")
def ring():
    situation = section_v(steps=STEPS)
    states, scans = simulate(situation, 3, 0)
    return situation, states, scans, replace(told(situation), restart=True)


def errors(history, states):
    return np.hypot(*metrics.state_errors(history.mean[:, :4], states)[:, :2].T)


@pytest.mark.mc
@pytest.mark.parametrize("name", ["joint", "smoother", "marginal", "mixture", "bp", "interval"])
def test_a_wrong_start_is_mended_whichever_filter_had_it(ring, name):
    _, states, scans, problem = ring
    wrong = replace(problem, mean=np.add(problem.mean, [30.0, 30, 0.3, 0]))
    chosen = FILTERS[name]()
    history, told_ = run(wrong, scans, chosen)
    assert history.restarted.startswith("from step 0: ")
    assert errors(history, states)[12:].max() < (3.0 if name == "marginal" else 2.0) and history.steps == STEPS == len(
        told_.nis
    )


def test_a_good_run_is_bit_for_bit_what_it_was(ring):
    _, _, scans, problem = ring
    watched, plain = (run(replace(problem, restart=on), scans, FILTERS["joint"]())[0] for on in (True, False))
    assert watched.restarted == "" and np.array_equal(watched.mean, plain.mean)


def test_who_leaves_the_track_of_the_first_scans_is_started_anew_on_it(ring, monkeypatch):
    """A filter that strays from step 8 on, and whose history alone shows nothing."""
    _, states, scans, problem = ring
    monkeypatch.setattr(restart, "judge", lambda *_: Verdict())
    calls, known = [], replace(problem, snapshot=True, restart=False)

    def go(told_, read):
        calls.append(read.steps)
        history, diagnostics = FILTERS["joint"]().run(told_, read, np.random.default_rng(0))
        mean = history.mean.copy()
        if len(calls) == 1:
            mean[8:, :2] += 6.0
        return replace(history, mean=mean), diagnostics

    history, _ = restart.watched(known, scans, go, whole=False, doppler=True, intervals=True)
    assert history.restarted.startswith("from step 8: ") and "first scans together" in history.restarted
    assert calls == [STEPS, STEPS - 8] and history.lost == "" and errors(history, states)[8:].max() < 1.0


@pytest.mark.parametrize("name", ["joint", "marginal", "lagged"])
def test_who_keeps_to_it_is_left_alone(ring, name):
    _, states, scans, problem = ring
    history, _ = run(replace(problem, snapshot=True), scans, FILTERS[name]())
    assert history.restarted == "" == history.lost and errors(history, states).max() < 2.0


@pytest.fixture(scope="module")
def kidnapped(ring):
    """Half way the receiver is carried off and driven on from another place."""
    situation, states, scans, problem = ring
    elsewhere = replace(situation, prior_mean=np.add(situation.prior_mean, [-90.0, 60, 2.0, 0]))
    other_states, other = simulate(elsewhere, 8, 0)
    both = Scans.join([scans.take(slice(0, MOVED)), other.take(slice(MOVED, None))])
    return np.vstack([states[:MOVED], other_states[MOVED:]]), both, problem


def test_a_kidnapped_receiver_is_found_again_and_the_map_stays(kidnapped):
    states, scans, problem = kidnapped
    plain, _ = run(replace(problem, restart=False), scans, FILTERS["joint"]())
    history, told_ = run(problem, scans, FILTERS["joint"]())
    assert errors(plain, states)[MOVED:].min() > 20.0
    assert f"from step {MOVED}: " in history.restarted
    assert errors(history, states)[MOVED + 6 :].max() < 2.0
    assert np.array_equal(history.mean[:MOVED], plain.mean[:MOVED])
    # What was mapped before is in the map at every later step, and of one landmark there is one entry.
    before = set(history.track[history.rows(MOVED - 1)][history.existence[history.rows(MOVED - 1)] > 0.5].tolist())
    for k in range(MOVED, STEPS):
        tracks = history.track[history.rows(k)]
        assert len(set(tracks.tolist())) == len(tracks) and before <= set(tracks.tolist())
    anchors = history.reported(STEPS - 1, Kind.VA)
    apart = np.linalg.norm(anchors[:, None] - anchors[None], axis=-1) + 1e9 * np.eye(len(anchors))
    assert len(anchors) >= 4 and apart.min() > 5.0
    named = np.concatenate([a[0] for a in told_.associations])
    assert len(named) == len(scans.z) and named.max() < len(scans.z)


def test_joining_at_a_step_that_was_never_lost_changes_no_landmark(ring):
    """The old run and the same run from its middle on are one run: every landmark has its old number."""
    _, _, scans, problem = ring
    chosen = FILTERS["joint"]()
    old = run(replace(problem, restart=False), scans, chosen)
    middle = replace(problem, restart=False, mean=old[0].mean[MOVED - 1], covariance=old[0].covariance[MOVED - 1])
    new = run(middle, scans.take(slice(MOVED, None)), chosen)
    history, _ = joined(old, new, scans, MOVED)
    sure = history.existence > 0.9
    assert set(history.track[sure].tolist()) <= set(old[0].track.tolist())


def test_a_run_that_nothing_mends_stays_lost(ring):
    _, _, scans, problem = ring
    rng = np.random.default_rng(0)
    nonsense = replace(
        scans, z=np.column_stack([rng.uniform(300, 700, len(scans.z)), rng.uniform(-1.5, 1.5, (len(scans.z), 5))])
    )
    history, _ = run(problem, nonsense, FILTERS["joint"]())
    plain, _ = run(replace(problem, restart=False), nonsense, FILTERS["joint"]())
    assert history.restarted == "" and np.array_equal(history.mean, plain.mean)


def test_the_command_line_says_so_and_the_summary_keeps_it(tmp_path, call, capsys):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=12"]), seed=2)
    assert call("slam", path, "--set", "track.start=[30, 40, 0.2, 300]") == 0
    assert "restarted: joint: from step 0: " in " ".join(capsys.readouterr().out.split())
    group = next(g for g in dataset.groups(path) if g.startswith("slam_"))
    assert stages.mishaps(path, "joint") == ("", dataset.read_record(path, group, stages.History).restarted)
    assert call("bound", path) == 0 and call("evaluate", path, "--out", tmp_path) == 0
    shown = capsys.readouterr().out
    assert "restarted" in shown and "diverged" not in shown
    assert '"restarted": "from step 0' in (tmp_path / "summary.json").read_text()
