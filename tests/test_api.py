"""``import dopslam as ds``: the names, that they cost nothing, and the lines of the README as printed."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dopslam as ds

ROOT = Path(__file__).resolve().parent.parent


def test_every_public_name_is_there():
    for name in ds.__all__:
        assert getattr(ds, name) is not None


def test_importing_costs_nothing_heavy():
    code = "import sys, dopslam; print({'numpy', 'numba', 'h5py', 'sionna', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_rooms_that_are_verbs_can_be_called_and_imported_from():
    code = (
        "from dopslam.slam import history; import dopslam as ds; assert callable(ds.slam) and ds.slam.history is history\n"
        "from dopslam.pipeline import problem; assert problem.motion and callable(ds.problem)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_simulated_run_in_memory():
    scenario = ds.load("ring_road", set=["source.kind=model", "track.steps=5"])
    truth, detections = ds.simulate(scenario, seed=2)
    problem = ds.problem(scenario)
    joint = ds.slam(problem, detections, "joint")
    result = ds.evaluate(truth, ds.bound(problem, truth, detections), detections, joint=joint)
    assert "position RMSE" in str(result) and "joint" in str(result)
    assert result.summary["position_rmse_m"] < 1.0
    assert np.all(result.evaluations["joint"].peb > 0)
    with pytest.raises(ds.DopslamError, match="name at least one history"):
        ds.evaluate(truth, ds.bound(problem, truth, detections))
    with pytest.raises(ds.DopslamError, match="has no paths"):
        ds.synthesize(scenario, truth)


@pytest.mark.rt
def test_the_lines_of_the_readme_run_as_printed(capsys):
    """As printed but shorter: a track of four steps, two runs."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = text.partition("```python\n")[2].partition("```")[0]
    assert len(lines.split("\n\n")[-1].splitlines()) <= 12
    lines = lines.replace('max_depth=2"]', 'max_depth=2", "track.steps=4"]').replace("runs=100", "runs=2")
    exec(lines, {})
    assert "belief" in capsys.readouterr().out


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 850


def test_links_of_the_documentation_lead_somewhere():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    for page in pages:
        for target in re.findall(r"\]\((?!http|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
