"""Sweeps: one table whatever the workers, a figure, and refusal before anything runs."""

import csv
import json

import pytest

from dopslam.errors import ConfigError
from dopslam.studies import sweep

TEXT = """
scenario = "ring_road"
runs = 3
set = ["track.steps=6"]
[vary]
"source.model.doppler_std" = [0.1, 1.0]
"filter.density" = ["joint"]
"""


def write(folder, text=TEXT):
    path = folder / "s.toml"
    path.write_text(text)
    return path


def test_a_sweep_leaves_a_table_and_a_figure(tmp_path, call):
    assert call("sweep", write(tmp_path), "--out", tmp_path / "o", "--jobs", "1") == 0
    with open(tmp_path / "o" / "table.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["source.model.doppler_std"]) for row in rows] == [0.1, 1.0]
    for row in rows:
        assert float(row["position_ratio_low"]) <= float(row["position_ratio"]) <= float(row["position_ratio_high"])
    assert (tmp_path / "o" / "sweep.png").stat().st_size > 10_000
    assert len(json.loads((tmp_path / "o" / "sweep.json").read_text())["results"]) == 2
    assert call("sweep", write(tmp_path), "--out", tmp_path / "o") == 2


def test_the_numbers_do_not_depend_on_the_workers(tmp_path):
    plan = sweep.read_sweep(write(tmp_path))
    assert sweep.run_sweep(plan, tmp_path, jobs=1) == sweep.run_sweep(plan, tmp_path, jobs=2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("runs = 3", "run = 3", "unknown key 'run'"),
        ("runs = 3", "runs = 0", "at least 1 run"),
        ("doppler_std", "dopler_std", "did you mean 'doppler_std'"),
        ("[0.1, 1.0]", "[0.1, -1.0]", "greater than"),
        ("[0.1, 1.0]", "0.1", "give a list"),
        ("[vary]", "[varied]", "unknown key"),
        ('"ring_road"', '"ringroad"', "did you mean 'ring_road'"),
        ("runs = 3", 'filter = "best"', "known are joint"),
        ("[vary]", "[vary", "not a readable sweep"),
    ],
)
def test_a_wrong_sweep_is_refused_before_anything_runs(tmp_path, old, new, message):
    with pytest.raises(ConfigError, match=message):
        sweep.read_sweep(write(tmp_path, TEXT.replace(old, new, 1)))


@pytest.mark.parametrize(("key", "other"), [("filter.density", "bp"), ("source.kind", "traced")])
def test_a_sweep_never_labels_rows_with_what_did_not_run(tmp_path, key, other):
    text = TEXT.replace('"filter.density" = ["joint"]', f'"{key}" = ["{other}"]')
    with pytest.raises(ConfigError, match="one sweep for each"):
        sweep.read_sweep(write(tmp_path, text))
