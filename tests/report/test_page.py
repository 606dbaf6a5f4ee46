"""report.html: whole without a network, and its replay moves. Looked at in headless Chromium where there is one."""

import json
import re
import shutil
import subprocess

import pytest

from dopslam.pipeline import file as stages

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
    "--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=6000",
)  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The report of a short run of the model source."""
    from dopslam.config.scenario import load

    folder = tmp_path_factory.mktemp("report")
    data = folder / "dataset.h5"
    stages.simulate(data, load("ring_road", ["source.kind=model", "track.steps=6"]), 3)
    stages.slam(data)
    stages.bound(data)
    stages.report(data, folder, *stages.evaluate(data))
    return folder / "report.html"


def test_the_page_needs_no_network_and_stays_small(page):
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|#)[^"']+""", text)
    assert "@import" not in text and len(text) < 5_000_000
    tree = json.loads(re.search(r'id="replay-data">(.*?)</script>', text, re.S).group(1))
    assert len(tree["truth"]["position"]) == 6 and list(tree["filters"]) == ["joint"]
    assert "times the posterior Cramér–Rao bound" in text


def test_names_cannot_break_the_page():
    from dopslam.report.page import _embedded

    assert "</script" not in _embedded({"name": "</script><script>alert(1)</script>"})


@pytest.mark.rt
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian's package chromium)")
@pytest.mark.parametrize("step", [1, 4, 6])
def test_the_replay_shows_a_step_without_errors(page, step, tmp_path):
    done = subprocess.run(
        [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path}", "--enable-logging=stderr", "--dump-dom",
         f"{page.as_uri()}#step={step}"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert 'data-ready="yes"' in done.stdout, done.stderr[-2000:]
    assert f"step {step} of 6" in done.stdout
    assert "data-error" not in done.stdout and ":CONSOLE" not in done.stderr
