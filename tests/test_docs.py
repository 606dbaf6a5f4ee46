"""The documentation runs: every Python block, every tutorial, every message it quotes."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.proc

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "estimation" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
TRACED = ("ds.trace", "ds.synthesize")  # blocks that need the tracer; tests/test_api.py runs the README's


def blocks(page: Path) -> list[str]:
    """The Python code of a page."""
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda p: str(p.relative_to(ROOT)))
def test_python_of_a_page_runs(page, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "page"}
    for code in blocks(page):
        compiled = compile(code, f"{page.name}", "exec")
        if not any(word in code for word in TRACED):
            exec(compiled, names)


@pytest.mark.parametrize(
    "script",
    [pytest.param(t, marks=pytest.mark.rt) if t.stem.startswith("3") else t for t in TUTORIALS],
    ids=lambda t: t.stem,
)
def test_a_tutorial_runs(script, tmp_path):
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    said = {
        "1": "NEES",
        "2": "slam_joint.geojson",
        "3": "my room",
        "4": "mine",
        "5": "detections",
        "6": "image at x=16: 0.0",
    }[script.stem[0]]
    assert said in done.stdout


def test_there_are_six_tutorials_in_cells():
    assert [t.stem[0] for t in TUTORIALS] == list("123456")
    assert all(t.read_text(encoding="utf-8").count("\n# %% ") >= 2 for t in TUTORIALS)


def test_the_messages_that_are_explained_are_the_program_s_own():
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    source = "\n".join(
        p.read_text(encoding="utf-8") for room in ("dopslam", "estimation") for p in (ROOT / room).rglob("*.py")
    )
    joined = re.sub(r'"\s*\n\s*f?"', "", source)
    quoted = [line.split("|")[1].strip().strip("`") for line in text.splitlines() if line.startswith("| `")]
    assert len(quoted) > 10
    assert [message for message in quoted if message not in joined] == []


def test_the_documentation_builds(tmp_path):
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (pip install 'dopslam[docs]')")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-q", "-f", ROOT / "docs" / "site" / "mkdocs.yml", "-d", tmp_path / "site"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "site" / "docs" / "tutorials" / "1_a_run" / "index.html").exists()
