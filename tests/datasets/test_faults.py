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
