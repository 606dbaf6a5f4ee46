"""The suite: what is written is told, what is hidden is apart, and scores are what hand computation says."""

import csv
import io
import json

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import DatasetError
from dopslam.models.measurement import measure, residual
from dopslam.pipeline import file as stages
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries
from dopslam.store import file as dataset
from dopslam.studies.challenge import answer as answers
from dopslam.studies.challenge import board, cases, filtered, make, score


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """A suite of two cases drawn from the model, so that nothing is traced."""
    root = tmp_path_factory.mktemp("suite")
    entries = []
    for seed, split in ((0, cases.DEVELOP), (1, cases.TEST)):
        scenario = load("ring_road", ["source.kind=model", "track.steps=6"])
        track, landmarks, detections = pipeline.simulate(scenario, seed)
        label = pipeline.landmark_of_detections(scenario, track, landmarks, None, detections)
        case = cases.Case("ring", 7, seed, "rough", split)
        (root / "suite" / split).mkdir(parents=True)
        (root / "suite-truth").mkdir(exist_ok=True)
        found = cases.Drawn(case, scenario, track, landmarks, detections, label)
        entries.append(make.write_case(found, root / "suite" / split, root / "suite-truth"))
    (root / "suite" / "suite.json").write_text(json.dumps({"format": 1, "cases": entries}))
    return root


def scored(suite, path, **options):
    return score.score(path, suite / "suite", suite / "suite-truth", **options)


def test_the_files_say_what_the_records_say(suite):
    entry = score.manifest_of(suite / "suite")["cases"][0]
    base = suite / "suite" / entry["split"] / entry["name"]
    series = dataset.read_record(base.with_suffix(".h5"), "detections", DetectionSeries)
    rows = list(csv.DictReader(io.StringIO(base.with_suffix(".csv").read_text())))
    assert len(rows) == len(series.delay) == entry["detections"]
    assert [float(r["delay_s"]) for r in rows] == series.delay.tolist()
    assert [float(r["cov_26"]) for r in rows] == series.covariance[:, 1, 5].tolist()
    assert [int(r["step"]) - 1 for r in rows] == series.step_of_row.tolist()
    told = json.loads(base.with_suffix(".json").read_text())
    assert told["base_station"]["position_m"] == [0, 0, 40] and len(told["time_s"]) == 6
    assert set(dataset.groups(base.with_suffix(".h5"))) == {"base_stations", "detections"}


HALF = """
import numpy as np
import dopslam as ds

class Half:
    "Gives up where a path is shorter than in the other case."
    capabilities = ds.Capabilities(doppler=False)
    def init(self, problem, rng):
        return problem
    def step(self, state, scan, rng):
        if scan.z[:, 0].min() < LIMIT:
            raise ZeroDivisionError("no more")
        return state, ds.Info(ds.Estimate(state.mean, state.covariance))
"""


def test_a_case_that_fails_is_named_and_the_others_are_answered(suite, tmp_path, call, capsys):
    entries = score.manifest_of(suite / "suite")["cases"]
    first = {}
    for entry in entries:
        path = suite / "suite" / entry["split"] / f"{entry['name']}.h5"
        first[entry["name"]] = SPEED_OF_LIGHT * dataset.read_record(path, "detections", DetectionSeries).delay.min()
    (tmp_path / "half.py").write_text(f"LIMIT = {float(np.mean(list(first.values())))!r}\n{HALF}")
    assert call("benchmark", "run", suite / "suite", "--filter", f"{tmp_path / 'half.py'}:Half", "--out", tmp_path) == 1
    said = capsys.readouterr().out
    poor, good = sorted(first, key=lambda name: first[name])
    assert f"failed: {poor}, " in said and "no more" in said
    assert set(scored(suite, tmp_path / "Half.csv")["cases"]) == {good}


def test_a_filter_answers_and_its_file_scores_as_its_table(suite, tmp_path):
    text, failed = filtered.answers(suite / "suite", "joint")
    assert not failed
    (tmp_path / "joint.csv").write_text(text)
    (tmp_path / "files").mkdir()
    for entry in score.manifest_of(suite / "suite")["cases"]:
        copy = tmp_path / "files" / f"{entry['name']}.h5"
        copy.write_bytes((suite / "suite" / entry["split"] / f"{entry['name']}.h5").read_bytes())
        stages.slam(copy)
    table, files = scored(suite, tmp_path / "joint.csv"), scored(suite, tmp_path / "files")
    assert table["method"] == "joint" and table["splits"]["test"]["answered"] == 1
    for name, figures in table["cases"].items():
        for key, value in figures.items():
            assert files["cases"][name][key] == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)
    assert not any(c["lost"] for c in table["cases"].values())
    assert all(c["position_rmse_m"] < 1.0 and c["nees"] < 30 for c in table["cases"].values())


def table_of(suite, change=lambda row: row):
    """The truth of the first case as a MATLAB user answers it: no covariances."""
    entry = score.manifest_of(suite / "suite")["cases"][0]
    track, landmarks, *_ = stages.read_truth(suite / "suite-truth" / f"{entry['name']}.h5")
    empty = dict.fromkeys(answers.COLUMNS, "") | {"case": entry["name"]}
    rows = [
        empty | {"what": "state", "time_s": t, "x_m": s[0], "y_m": s[1], "heading_rad": s[2], "bias_m": s[3]}
        for t, s in zip(track.time.tolist(), track.state.tolist(), strict=True)
    ]
    rows += [
        empty | {"what": name.split()[0][:2], "x_m": p[0], "y_m": p[1], "z_m": p[2]}
        for name, p in zip(landmarks.name[1:], landmarks.position[1:].tolist(), strict=True)
    ]
    out = io.StringIO()
    lines = csv.DictWriter(out, answers.COLUMNS, lineterminator="\n")
    lines.writeheader()
    lines.writerows(change(row) for row in rows)
    return out.getvalue()


def test_errors_are_those_that_were_put_in(suite, tmp_path):
    path = tmp_path / "a.csv"

    def moved(row):
        if row["what"] == "state":
            turned = row["heading_rad"] + 2 * np.pi
            return row | {"x_m": row["x_m"] + 0.3, "y_m": row["y_m"] - 0.4, "heading_rad": turned}
        return row | ({"z_m": row["z_m"] + 0.5} if row["what"] == "SP" else {})

    path.write_text(table_of(suite, moved))
    result = scored(suite, path)
    (found,) = result["cases"].values()
    assert found["position_rmse_m"] == pytest.approx(0.5) and found["ate_m"] == pytest.approx(0.5)
    assert found["heading_rmse_deg"] == pytest.approx(0, abs=1e-6) and found["rpe_m"] == pytest.approx(0, abs=1e-9)
    assert found["nees"] is None and not found["lost"]
    assert found["landmarks_found"] == found["landmarks_counted"] > 3 and found["landmarks_false"] == 0
    assert found["wall_distance_m"] == pytest.approx(0, abs=1e-6)
    splits = result["splits"]
    assert splits["test"]["answered"] == 0 and splits["develop"]["position_rmse_m"]["value"] == pytest.approx(0.5)


def test_a_huge_covariance_buys_no_landmark(suite, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(table_of(suite, lambda row: row | ({"x_m": row["x_m"] + 5} if row["what"] == "VA" else {})))
    (plain,) = scored(suite, path)["cases"].values()
    head, *lines = path.read_text().splitlines()
    wide = [f"{line},1e6,0,0,1e6,0,1e6" if ",VA," in line else f"{line},,,,,," for line in lines]
    path.write_text("\n".join([f"{head},cov_11,cov_12,cov_13,cov_22,cov_23,cov_33", *wide]) + "\n")
    (found,) = scored(suite, path)["cases"].values()
    assert found["landmarks_found"] == plain["landmarks_found"] and found["landmarks_false"] == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lambda t: t.replace("x_m", "X"), "no column 'x_m'"),
        (lambda t: t.replace("ring-7", "ring-8"), "line 2: 'ring-8-0-rough' is no case"),
        (lambda t: t.replace(",SP,", ",tree,", 1), "what is 'tree'; write state, VA or SP"),
        (lambda t: t.replace(",state,1.0,", ",state,nan,"), "line 3: time_s is 'nan', no finite number"),
        (lambda t: t.replace(",state,1.0,", ",state,1.1,"), "state at 1.1 s, the snapshot is at 1 s"),
        (lambda t: "\n".join(x for x in t.splitlines() if ",state,1.0," not in x), "5 states for 6 snapshots"),
    ],
)
def test_a_wrong_table_is_one_sentence(suite, tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text(table_of(suite)))
    with pytest.raises(DatasetError, match=message):
        scored(suite, path)


def test_foreign_detections_and_changed_files_are_refused(suite, tmp_path):
    other = tmp_path / "d.h5"
    stages.simulate(other, load("ring_road", ["source.kind=model", "track.steps=6"]), seed=9)
    stages.slam(other)
    with pytest.raises(DatasetError, match="of no case of this suite"):
        scored(suite, other)
    with pytest.raises(DatasetError, match="no suite"):
        score.manifest_of(tmp_path)
    entry = score.manifest_of(suite / "suite")["cases"][0]
    changed = entry | {"truth": dict.fromkeys(entry["truth"], "0" * 64)}
    with pytest.raises(DatasetError, match="checksum differs"):
        score.verify(suite / "suite", suite / "suite-truth", [changed])
    with pytest.raises(DatasetError, match="has no split 'tset'; it has develop, test"):
        filtered.answers(suite / "suite", "joint", "tset")


def test_the_board_ranks_answers_to_one_suite(suite, tmp_path):
    found = []
    for name in ("joint", "dopslam.slam.baselines:LineOfSight", "dopslam.slam.baselines:DeadReckoning"):
        path = tmp_path / f"{name.rpartition(':')[2]}.csv"
        path.write_text(filtered.answers(suite / "suite", name)[0])
        found.append(scored(suite, path))
    text = board.board(found[::-1])
    test = text[text.index("## test") :]
    best_first = sorted(found, key=lambda r: r["splits"]["test"]["position_rmse_m"]["value"])
    places = [test.index(f"| {result['method']} |") for result in best_first]
    assert places == sorted(places)
    errors = {r["method"]: r["splits"]["develop"]["position_rmse_m"]["value"] for r in found}
    assert max(errors, key=errors.get) == "DeadReckoning"
    with pytest.raises(DatasetError, match="2 different suites"):
        board.board([found[0], found[1] | {"suite_sha256": "x"}])


def test_the_halves_of_a_suite_share_no_scene():
    plan = cases.plan(scenes=3)
    halves = [{(c.kind, c.scene) for c in plan if c.split == s} for s in (cases.DEVELOP, cases.TEST)]
    assert not halves[0] & halves[1] and len({c.name for c in plan}) == len(plan) == 5 * 2 * 3 * 2 * 2


def test_what_is_told_does_not_hold_the_scene():
    case = cases.Case("room", 100, 0, "sharp", cases.DEVELOP)
    scenario = cases.scenario_of(case)
    told = cases.told(scenario, case.name)
    assert scenario.scatter_point and not told.scatter_point and told.scene.generator is None
    assert (
        told.base_station == scenario.base_station and told.filter == scenario.filter and told.track == scenario.track
    )


@pytest.mark.rt
def test_a_made_suite_is_the_same_again_and_its_detections_are_consistent(tmp_path):
    plan = [cases.Case("room", 100, 0, level, cases.DEVELOP) for level in cases.LEVELS]
    manifests = [make.make(tmp_path / n, tmp_path / f"{n}-truth", plan, steps=3) for n in "ab"]
    assert manifests[0] == manifests[1]
    with pytest.raises(DatasetError, match="exists already"):
        make.make(tmp_path / "a", tmp_path / "c", plan)
    scenario = cases.scenario_of(plan[0], 6)
    traced = pipeline.trace(scenario, 0)
    for case in plan:
        drawn = cases.drawn(case, scenario, traced.track, traced.landmarks, traced.paths)
        scans = build.scans(drawn.scenario, drawn.detections)
        real = (drawn.label >= 0) & (traced.landmarks.order[drawn.label] <= 1)  # departures of others are unexplained
        step, mark = np.repeat(np.arange(6), np.diff(scans.offsets))[real], drawn.label[real]
        exact = measure(
            traced.track.state[step], traced.landmarks.position[mark], traced.landmarks.kind[mark],
            np.array(scenario.base_station.position), speed=scenario.track.speed, height=scenario.receiver.height,
        )  # fmt: skip
        away = residual(scans.z[real], exact)
        nees = np.einsum("ni,nij,nj->n", away, np.linalg.inv(scans.covariance[real]), away)
        assert real.sum() > 30
        assert 0.75 < np.median(nees) / 5.35 < 1.3  # median of χ² of six
