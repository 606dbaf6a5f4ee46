"""Runs beside each other: what pairs, what does not, what is refused."""

import json

import numpy as np
import pytest

from dopslam.errors import DatasetError
from dopslam.evaluate.statistics import over_runs
from dopslam.studies import compare, compared
from dopslam.studies.montecarlo import run_study, summarize
from dopslam.studies.summary import study


def folder(root, seed, errors, scenario="road", configuration="[filter]\nlag = 1\n"):
    """A results folder as a run leaves it, as far as it is read here."""
    root.mkdir(parents=True)
    figures = {
        name: {"position_rmse_m": float(np.sqrt(np.mean(np.square(e)))), "nees": 4.0} for name, e in errors.items()
    }
    (root / "summary.json").write_text(json.dumps({"scenario": scenario, "seed": seed, "variants": figures}))
    (root / "scenario.toml").write_text(configuration)
    lines = ["filter,step,time_s,position_error_m,heading_error_deg,clock_bias_error_m"]
    lines += [f"{n},{k},{k},{e},0,0" for n, column in errors.items() for k, e in enumerate(column)]
    (root / "errors.csv").write_text("\n".join(lines) + "\n")
    return root


def test_runs_pair_by_seed_whatever_their_order(tmp_path):
    rng = np.random.default_rng(0)
    level = dict(zip(range(6), rng.uniform(1, 9, 6), strict=True))
    gain = dict(zip(range(6), rng.uniform(0.1, 0.2, 6), strict=True))
    for seed in (3, 1, 2):
        folder(tmp_path / "a" / f"r{seed}", seed, {"joint": [level[seed]]})
    for seed in (5, 2, 1, 3):
        folder(tmp_path / "b" / f"q{9 - seed}", seed, {"joint": [level[seed] + gain[seed]]})
    found = compare.read([tmp_path / "a", tmp_path / "b"])
    first, second = found.entries
    assert found.shared(second) == 3
    expected = over_runs([gain[seed] for seed in (1, 2, 3)])
    np.testing.assert_allclose(second.difference(first, "position_rmse_m"), expected, rtol=1e-9)
    assert second.interval("position_rmse_m").value == pytest.approx(
        np.mean([level[s] + gain[s] for s in (1, 2, 3, 5)])
    )


def test_other_seeds_or_scenarios_have_no_difference(tmp_path):
    a = folder(tmp_path / "a", 1, {"joint": [1.0]})
    b = folder(tmp_path / "b", 2, {"joint": [2.0]})
    c = folder(tmp_path / "c", 1, {"joint": [2.0]}, scenario="other")
    found = compare.read([a, b, c])
    assert all(e.difference(found.entries[0], "position_rmse_m") is None for e in found.entries[1:])
    assert "No seed in common" in compared.words(found)


def test_single_runs_are_compared_over_their_steps_and_say_so(tmp_path):
    rng = np.random.default_rng(1)
    errors = rng.uniform(1, 2, 50)
    a = folder(tmp_path / "a", 1, {"joint": errors, "bp": errors + 0.5}, configuration="[filter]\nlag = 1\n")
    b = folder(tmp_path / "b", 1, {"joint": errors - 0.25}, configuration="[filter]\nlag = 5\n")
    found = compare.read([a, b])
    gap = found.entries[2].difference(found.entries[0], "position_rmse_m")
    assert gap.low < gap.value < gap.high < 0 and gap.value == pytest.approx(-0.25, abs=0.01)
    words = compared.words(found)
    assert "not independent" in words and "filter.lag = 1 | 5" in words
    assert found.tree()["differing_keys"] == {"filter.lag": [1, 1, 5]}
    assert compare.read([a], ["joint", "bp"]).entries[0].name == "joint"


def test_studies_of_the_same_seed_are_paired_by_run():
    from dopslam.config.scenario import load

    scenario = load("ring_road", ["source.kind=model", "track.steps=6"])
    plans = {name: study(scenario, name) for name in ("joint", "marginal")}
    results = {n: summarize(run_study(p, 3, 7), p) | {"scene": "ring_road", "seed": 7} for n, p in plans.items()}
    entries = compare._of_montecarlo("mc.json", {"filters": results})
    runs = run_study(plans["joint"], 3, 7), run_study(plans["marginal"], 3, 7)
    each = [[float(np.sqrt(r.squared["position"].mean())) for r in some] for some in runs]
    gap = entries["marginal"].difference(entries["joint"], "position_rmse_m")
    np.testing.assert_allclose(gap, over_runs(np.subtract(each[1], each[0])))


def test_what_holds_no_runs_is_refused_by_name(tmp_path):
    a = folder(tmp_path / "a", 1, {"joint": [1.0]})
    other = tmp_path / "o.json"
    cases = {
        "no such file": [a, tmp_path / "none"],
        "one entry alone": [a],
        "neither a results folder": [a, tmp_path / "empty"],
        "no figures of single runs": [a, other],
    }
    (tmp_path / "empty").mkdir()
    other.write_text("{}")
    for message, paths in cases.items():
        with pytest.raises(DatasetError, match=message):
            compare.read(paths)
    other.write_text("[")
    with pytest.raises(DatasetError, match=r"o\.json: no readable JSON"):
        compare.read([a, other])
    with pytest.raises(DatasetError, match="no filter bp; it has joint"):
        compare.read([a, a], ["bp"])
    folder(tmp_path / "two" / "x", 1, {"joint": [1.0]})
    folder(tmp_path / "two" / "y", 1, {"joint": [2.0]})
    with pytest.raises(DatasetError, match="there twice"):
        compare.read([a, tmp_path / "two"])


def test_the_command_leaves_table_figure_and_numbers(call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    for name in "ab":
        folder(tmp_path / name, 1, {"joint": rng.uniform(1, 2, 40)})
    assert call("compare", "a", "b") == 0
    assert capsys.readouterr().out.strip().splitlines()[-1] == "written: comparison/comparison.png"
    assert (tmp_path / "comparison" / "comparison.png").stat().st_size > 10_000
    tree = json.loads((tmp_path / "comparison" / "comparison.json").read_text())
    assert tree["entries"][1]["difference"]["position_rmse_m"]["low"] is not None
    assert "less the first" in (tmp_path / "comparison" / "comparison.txt").read_text()
