"""Signals of a suite: what is told is enough to estimate, and scores of detections are what they were made to be."""

import csv
import io
import json

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import DatasetError
from dopslam.models.measurement import measure
from dopslam.pipeline import link
from dopslam.pipeline import stages as pipeline
from dopslam.records import SPEED_OF_LIGHT, Paths
from dopslam.store import file as dataset
from dopslam.studies.challenge import cases, detected, make, score, signals
from estimation.fisher import crb

STEPS, FALSE = 6, 3
MINE = """
import numpy as np
from estimation import Detections, PathTable

class Fixed:
    "Whatever the signal says, one path."
    def __init__(self, model):
        self.model = model
    def run(self, signal, noise_variance=None):
        assert signal.shape == self.model.shape and np.abs(signal).max() > 0
        path = PathTable(delay=[3e-7], aoa=[[0.3, 0.5]], aod=[[-2.8, -0.5]], radial_velocity=[1.0], gain=[1.0])
        return Detections.of(path, np.diag([1e-18, 1e-4, 1e-4, 1e-4, 1e-4, 1e-2])[None], snr=100.0)
"""


@pytest.fixture(scope="module")
def scenario():
    small = ["radio.subcarriers=24", "radio.comb=60"]
    return load("ring_road", ["source.kind=model", f"track.steps={STEPS}", "estimator.max_radial_velocity=30", *small])


@pytest.fixture(scope="module")
def hidden(scenario):
    """Track, landmarks, and paths by the closed forms of the measurement model."""
    track, landmarks, _ = pipeline.simulate(scenario, 0)
    first = np.flatnonzero(landmarks.order <= 1)
    mark, step = np.tile(first, STEPS), np.repeat(np.arange(STEPS), len(first))
    z = measure(
        track.state[step], landmarks.position[mark], landmarks.kind[mark], np.array(scenario.base_station.position),
        speed=scenario.track.speed, height=scenario.receiver.height,
    )  # fmt: skip
    length = z[:, 0] - track.bias[step]
    wave = SPEED_OF_LIGHT / scenario.radio.carrier_frequency
    paths = Paths(
        offsets=np.arange(STEPS + 1) * len(first), landmark=mark, a=wave / (4 * np.pi * length) + 0j,
        tau=length / SPEED_OF_LIGHT, theta_t=np.pi / 2 - z[:, 4], phi_t=z[:, 3] + np.deg2rad(scenario.base_station.yaw_deg),
        theta_r=np.pi / 2 - z[:, 2], phi_r=z[:, 1] + track.heading[step], doppler=z[:, 5] / wave,
        vertex_offsets=np.zeros(len(mark) + 1, int), vertices=np.zeros((0, 3)),
    )  # fmt: skip
    return track, landmarks, paths


@pytest.fixture(scope="module")
def suite(tmp_path_factory, scenario, hidden):
    root = tmp_path_factory.mktemp("signals")
    track, landmarks, _ = hidden
    detections = pipeline.simulate(scenario, 0)[2]
    label = pipeline.landmark_of_detections(scenario, track, landmarks, None, detections)
    case = cases.Case("ring", 7, 0, "sharp", cases.TEST)
    folder, truth = root / "suite" / case.split, root / "suite-truth"
    folder.mkdir(parents=True), truth.mkdir()
    found = cases.Drawn(case, cases.told(scenario, case.name), track, landmarks, detections, label)
    entry = make.write_case(found, folder, truth)
    entry["signal"] = make.write_signal(case.name, case.split, found.scenario, 0, hidden, folder, truth)
    (root / "suite" / "suite.json").write_text(json.dumps({"format": 1, "cases": [entry]}))
    return root


def test_what_is_told_of_a_signal_is_its_link_and_not_its_paths(suite, scenario):
    path = suite / "suite" / "test" / "ring-7-0-sharp.signal.h5"
    assert set(dataset.groups(path)) == {"base_stations", "signal"}
    from dopslam.config.scenario import parse

    told = parse(dataset.read_root(path)[0])
    mine, theirs = link.signal_model(scenario), link.signal_model(told)
    assert mine.shape == theirs.shape == dataset.read_snapshot(path, 0).shape
    assert link.noise_variance(told) == link.noise_variance(scenario)
    table = signals_table(scenario, 1)
    np.testing.assert_array_equal(crb(mine, table, 1.0), crb(theirs, table, 1.0))  # beams alike


def signals_table(scenario, count):
    from estimation import PathTable

    rng = np.random.default_rng(count)
    return PathTable(
        delay=rng.uniform(1e-8, 3e-7, count), aoa=rng.uniform(-1, 1, (count, 2)), aod=rng.uniform(-1, 1, (count, 2)),
        radial_velocity=rng.uniform(-5, 5, count), gain=np.ones(count, complex),
    )  # fmt: skip


def efficient(scenario, hidden, scale=1.0, told=True) -> str:
    """An answer with the bound's own errors times ``scale``, the last path of each step left out, some false ones added."""
    track, _, paths = hidden
    model, noise = link.signal_model(scenario), link.noise_variance(scenario)
    rng, rows = np.random.default_rng(5), [signals.header()]
    for step in range(STEPS):
        table = link.path_table(scenario, track, paths, step)
        bound = crb(model, table, noise)
        unit = np.sqrt(np.einsum("nii->ni", bound))
        root = np.linalg.cholesky(bound / unit[:, :, None] / unit[:, None])
        drawn = table.vector + scale * unit * np.einsum("nij,nj->ni", root, rng.standard_normal(unit.shape))
        for z, c in list(zip(drawn, bound, strict=True))[:-1]:
            cells = [repr(float(c[i, j])) if told else "" for i, j in make.PAIRS]
            rows.append(["ring-7-0-sharp", step + 1, track.time[step], *map(repr, map(float, z)), 100, *cells, 0.25])
    for number in range(FALSE):
        cells = [repr(float(np.diag([1e-18, 1e-4, 1e-4, 1e-4, 1e-4, 1e-2])[i, j])) for i, j in make.PAIRS]
        far = [9e-8, 2.9 - number, 1.4, 3.0, 1.4, 28.0]
        rows.append(["ring-7-0-sharp", 1, track.time[0], *far, 20, *cells, 0.25])
    out = io.StringIO()
    csv.writer(out).writerows(rows)
    return out.getvalue()


def test_detections_score_as_they_were_made(suite, scenario, hidden, tmp_path, call, capsys):
    split = {}
    for name, options in {"efficient": {}, "double": {"scale": 2.0}, "untold": {"told": False}}.items():
        path = tmp_path / f"{name}.csv"
        path.write_text(efficient(scenario, hidden, **options))
        assert detected.is_detections(path)
        split[name] = detected.score(path, suite / "suite", suite / "suite-truth")["splits"]["test"]
    good = split["efficient"]
    paths = len(hidden[2].tau) // STEPS
    assert good["snapshots"] == STEPS and good["false_per_snapshot"] == FALSE / STEPS
    assert good["strong_paths"] == paths * STEPS and good["found"]["value"] == pytest.approx((paths - 1) / paths)
    assert good["seconds_per_snapshot"] == 0.25
    assert all(0.7 < ratio["value"] < 1.35 for ratio in good["rmse_over_crb"].values())
    assert 0.7 < good["nees_over_6"] < 1.35 and good["gross"] == 0.0
    assert all(0.6 < ratio < 1.5 for ratio in good["median_over_crb"].values())
    doubled = [split["double"]["rmse_over_crb"][p]["value"] / r["value"] for p, r in good["rmse_over_crb"].items()]
    np.testing.assert_allclose(doubled, 2.0, rtol=0.15)
    assert split["untold"]["nees_over_6"] is None
    assert split["untold"]["rmse_over_crb"]["delay"]["value"] == pytest.approx(good["rmse_over_crb"]["delay"]["value"])
    (tmp_path / "wrong.csv").write_text(
        efficient(scenario, hidden).replace("ring-7-0-sharp,2,", "ring-7-0-sharp,2.5,", 1)
    )
    assert call("score", tmp_path / "wrong.csv", "--suite", suite / "suite") == 2
    assert "step is '2.5'" in " ".join(capsys.readouterr().err.split())


def test_an_own_estimator_and_filter_run_from_the_signal_to_the_board(suite, tmp_path, call, capsys):
    (tmp_path / "mine.py").write_text(MINE)
    filters = "dopslam.slam.baselines:DeadReckoning"
    done = call("benchmark", "run", suite / "suite", "--estimator", f"{tmp_path / 'mine.py'}:Fixed", "--filter", filters, "--out", tmp_path / "a")  # fmt: skip
    assert done == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "a" / "Fixed.csv").read_text())))
    assert [int(row["step"]) for row in rows] == list(range(1, STEPS + 1))
    assert all(float(row["delay_s"]) == 3e-7 and 0 < float(row["seconds"]) < 60 for row in rows)
    capsys.readouterr()
    for name in ("Fixed", "Fixed+DeadReckoning"):
        assert (
            call(
                "score", tmp_path / "a" / f"{name}.csv", "--suite", suite / "suite", "--json", tmp_path / f"{name}.json"
            )
            == 0
        )
    found = json.loads((tmp_path / "Fixed.json").read_text())
    assert found["track"] == "signal to detections" and found["splits"]["test"]["found"]["value"] < 0.2
    mapped = json.loads((tmp_path / "Fixed+DeadReckoning.json").read_text())
    assert mapped["track"] == "signal to map" and mapped["splits"]["test"]["answered"] == 1
    assert mapped["splits"]["test"]["position_over_bound"]["value"] > 1.0
    assert "| Fixed |" in detected.board([found])


def test_a_suite_without_signals_says_how_to_make_one(tmp_path):
    (tmp_path / "suite.json").write_text(json.dumps({"format": 1, "cases": [{"name": "a", "split": "test"}]}))
    with pytest.raises(DatasetError, match="benchmark make --signal"):
        signals.estimated(tmp_path, "nomp")


def test_answers_of_two_tracks_in_one_file_are_refused(suite, tmp_path):
    entry = score.manifest_of(suite / "suite")["cases"][0]
    from dopslam.studies.challenge import filtered

    text, _ = filtered.answers(suite / "suite", "dopslam.slam.baselines:DeadReckoning")
    both = text + "".join(
        line.replace(entry["name"], f"{entry['name']}.signal") + "\n" for line in text.splitlines()[1:]
    )
    (tmp_path / "both.csv").write_text(both)
    with pytest.raises(DatasetError, match="mixes cases"):
        score.score(tmp_path / "both.csv", suite / "suite", suite / "suite-truth")
