"""Damaged files, foreign values, absurd scenarios: one documented error, never a hang or a silent change."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dopslam.config.scenario import Scenario, load, parse
from dopslam.datasets import check, make_plan
from dopslam.errors import ConfigError, DatasetError, DopslamError
from dopslam.pipeline import file as stages
from dopslam.records import DetectionSeries
from dopslam.store import file as dataset

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "fault_study.py"


def test_mutated_files_give_the_one_error_or_the_old_content():
    done = subprocess.run(
        [sys.executable, SCRIPT, "mutate", "--files", "60"], capture_output=True, text=True, check=False, timeout=300
    )
    result = json.loads(done.stdout)
    assert result["wrong"] == [] and done.returncode == 0
    assert result["error"] + result["same"] == 60
    assert result["error"] > 30


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulated") / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=4"]), seed=1)
    return path


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("column", ["delay", "aoa", "radial_velocity", "covariance", "snr", "gain"])
def test_non_finite_detections_never_reach_a_filter(simulated, tmp_path, column, value):
    detections = dataset.read_record(simulated, "detections", DetectionSeries)
    wrong = np.array(getattr(detections, column))
    wrong[1] = value
    with pytest.raises(DopslamError, match=f"{column} holds non-finite"):
        replace(detections, **{column: wrong})
    path = tmp_path / "d.h5"
    path.write_bytes(simulated.read_bytes())
    with h5py.File(path, "r+") as file:  # as another program would write it, without a hash
        file[f"detections/{column}"][1] = value
        del file["detections"].attrs["sha256"]
    with pytest.raises(DatasetError, match=f"{column} holds non-finite"):
        stages.slam(path)


TEXT = load("ring_road").to_toml()
KEYS = sorted(
    f"{section}.{name}"
    for section, field in Scenario.model_fields.items()
    if hasattr(field.annotation, "model_fields")
    for name in field.annotation.model_fields
)
VALUES = st.one_of(
    st.integers(), st.floats().map(lambda x: repr(x).replace("e", "E")), st.booleans().map(lambda b: str(b).lower()),
    st.text(max_size=20), st.lists(st.integers(-9, 9), max_size=5), st.just("{}"), st.just("{kind = 'drive'}"),
)  # fmt: skip


@given(key=st.one_of(st.sampled_from(KEYS), st.text(max_size=12)), value=VALUES)
@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_any_override_is_taken_or_refused_in_one_sentence(key, value):
    try:
        scenario = parse(TEXT, [f"{key}={value}"])
    except ConfigError as error:
        assert str(error)
    else:
        assert parse(scenario.to_toml()) == scenario


@given(st.integers(0, len(TEXT) - 1), st.text(alphabet="[]{}=\"'.,#\n0eE-ntf", min_size=1, max_size=4))
@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_any_broken_scenario_file_is_taken_or_refused_in_one_sentence(at, text):
    try:
        parse(TEXT[:at] + text + TEXT[at + len(text) :])
    except ConfigError as error:
        assert str(error)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A dataset file with a history and a bound."""
    path = tmp_path_factory.mktemp("whole") / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=4"]), seed=1)
    stages.slam(path)
    stages.bound(path)
    return path


def spoiled(path, folder, where, change):
    """A copy in which one array was changed by another program, which knows of no hash."""
    copy = folder / "d.h5"
    copy.write_bytes(path.read_bytes())
    group, _, name = where.partition("/")
    with h5py.File(copy, "r+") as file:
        node = file[group]
        node.attrs.pop("sha256", None)
        if name in node.attrs:
            node.attrs[name] = change
            return copy
        value = change(np.array(node[name][()]))
        units = dict(node[name].attrs)
        del node[name]
        node[name] = value
        if "units" in units:
            node[name].attrs["units"] = units["units"]
    return copy


def at(row, value):
    """Set one row."""

    def change(array):
        array[row] = value
        return array

    return change


def skewed(array):
    array[0, 0, 1] += 0.5 * np.sqrt(array[0, 0, 0] * array[0, 1, 1])
    return array


@pytest.mark.parametrize(
    ("where", "change", "words"),
    [
        ("detections/covariance", at(2, 0.0), ["not positive", "row 2"]),
        ("detections/covariance", lambda c: -c, ["not positive"]),
        ("detections/covariance", skewed, ["not symmetric", "row 0"]),
        ("detections/covariance", lambda c: c[:, :5, :5], ["(detection, 6, 6)", "5, 5"]),
        ("detections/covariance", at(1, np.ones((6, 6)) - 2 * np.eye(6) + 2.5 * np.eye(6)[::-1]), ["covariance"]),
        ("detections/threshold", np.nan, ["threshold", "nan"]),
        ("detections/snr", at(0, -1.0), ["snr", "row 0"]),
        ("detections/aoa", at(0, [0.0, 30.0]), ["aoa", "elevation"]),
        ("detections/delay", at(0, 1e291), ["delay"]),
        ("detections/anchor", at(0, 7), ["anchor", "7"]),
        ("landmarks/kind", at(0, 9), ["kind"]),
        ("track/time", lambda t: t[:2], ["time", "(step, 3)", "position"]),
        ("slam_joint/existence", at(0, 1.7), ["existence"]),
        ("slam_joint/covariance", lambda c: -c, ["not positive"]),
        ("slam_joint/mean", at(0, np.nan), ["mean", "non-finite"]),
        ("bound_doppler/covariance", skewed, ["not symmetric"]),
        ("base_stations/position", lambda p: p[:, :2], ["position"]),
        ("base_stations/yaw", at(0, np.inf), ["yaw"]),
    ],
)  # fmt: skip
def test_check_sees_the_physics_and_not_the_hash_alone(whole, tmp_path, where, change, words):
    copy = spoiled(whole, tmp_path, where, change)
    findings = check(copy)
    group = where.partition("/")[0]
    said = [f"{finding.where} {finding.what}" for finding in findings]
    assert any(group in text and all(word in text for word in words) for text in said), said


def test_check_says_well_of_what_is_and_knows_foreign_units(whole, tmp_path):
    assert check(whole) == []
    copy = tmp_path / "d.h5"
    copy.write_bytes(whole.read_bytes())
    with h5py.File(copy, "r+") as file:
        file["detections/delay"].attrs["units"] = "ns"
    (finding,) = check(copy)
    assert finding.where.endswith("detections/delay") and "'ns'" in finding.what


@pytest.mark.parametrize(
    ("verb", "where", "change", "words"),
    [
        ("slam", "detections/covariance", lambda c: c[:, :5, :5], ["detections/covariance"]),
        ("bound", "track/time", lambda t: t[:2], ["track"]),
        ("evaluate", "slam_joint/map_offsets", lambda o: o + 5, ["slam_joint", "offsets"]),
        ("evaluate", "slam_joint/mean", at(0, np.inf), ["slam_joint/mean", "row 0"]),
        ("bound", "landmarks/order", at(0, -1), ["landmarks/order"]),
        ("slam", "detections/false_alarm_rate", "x", ["false_alarm_rate"]),
        ("evaluate", "landmarks/name", lambda n: np.zeros(len(n)), ["landmarks/name", "text"]),
    ],
)  # fmt: skip
def test_foreign_records_are_refused_by_name(whole, tmp_path, verb, where, change, words):
    copy = spoiled(whole, tmp_path, where, change)
    with pytest.raises(DatasetError) as raised:
        getattr(stages, verb)(copy)
    for word in words:
        assert word in str(raised.value)


def test_a_root_that_is_an_array_is_no_record(whole, tmp_path):
    copy = tmp_path / "d.h5"
    copy.write_bytes(whole.read_bytes())
    with h5py.File(copy, "r+") as file:
        del file["detections"]
        file["detections"] = np.zeros(3)
    with pytest.raises(DatasetError, match=r"d\.h5"):
        stages.slam(copy)
    assert check(copy)


@pytest.mark.parametrize(
    ("change", "word"),
    [({"positions": 10**12}, "shards"), ({"positions": 0}, "positions"), ({"seed": "x"}, "seed"), (None, "Plan")],
)
def test_a_manifest_that_promises_too_much_is_refused_at_once(tmp_path, change, word):
    plan = {"name": "x", "scenario": "", "seed": 0, "positions": 5, "shard_positions": 3, "signal": False,
            "detections": False, "tracks_sha256": ""}  # fmt: skip
    tree = {"schema": "dopslam-dataset", "version": 1, "complete": False, "shards": [], "landmarks": [], "sha256": ""}
    tree["plan"] = None if change is None else plan | change
    (tmp_path / "manifest.json").write_text(json.dumps(tree))
    (finding,) = check(tmp_path)
    assert word in finding.what
    tree["plan"], tree["landmarks"] = plan, [{"name": "BS"}]
    (tmp_path / "manifest.json").write_text(json.dumps(tree))
    assert "landmark" in check(tmp_path)[0].what


def test_more_positions_than_shards_can_hold_are_refused_with_the_limit():
    with pytest.raises(ConfigError, match=r"--positions 1000000000000: .* at most 100000 .*dataset\.shard_positions"):
        make_plan(load("ring_road"), 10**12, 0)
