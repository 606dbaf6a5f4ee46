"""report.html: whole without a network, and its replay moves. Looked at in headless Chromium where there is one."""

import json
import re
import shutil
import subprocess

import pytest

from dopslam.pipeline import file as stages
from dopslam.report.page import length_text

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


def test_a_stranger_is_told_where_it_went_what_was_found_and_how_good_it_is(page):
    text = page.read_text(encoding="utf-8")
    summary = json.loads(page.with_name("summary.json").read_text(encoding="utf-8"))
    cards = re.findall(r"<div><b>([^<]*)</b><span>([^<]*)</span><i>([^<]*)</i></div>", text)
    told = {what: (figure, more) for figure, what, more in cards}
    assert told["walls found"][0] == f"{summary['walls_found']} of {summary['walls_total']}"
    assert told["position error"][0] == length_text(summary["position_rmse_m"])
    assert "4 expected" in told["its own error bars"][1]
    assert re.search(r"A receiver moved 5[0-9]\.\d\d m in 2\.5 s", text)  # 22.22 m/s
    assert text.count("<figcaption>") == 3
    true = [wall for wall in summary["walls"] if wall["name"]]
    assert len(true) == summary["walls_found"] > 0
    for wall in true:
        row = (
            f"<td>{wall['name']}</td><td>{length_text(wall['width_m'])}</td><td>{length_text(wall['distance_m'])}</td>"
        )
        assert row in text


@pytest.fixture(scope="module")
def bare(page, tmp_path_factory):
    """The same detections and history in a file that holds no truth, and the report of it."""
    from dopslam.cli import main
    from dopslam.records import DetectionSeries
    from dopslam.slam.history import History
    from dopslam.store import file as dataset

    whole, path = page.with_name("dataset.h5"), tmp_path_factory.mktemp("bare") / "own.h5"
    records = {"detections": DetectionSeries, "slam_joint": History}
    dataset.write_records(
        path, {n: dataset.read_record(whole, n, k) for n, k in records.items()}, dataset.read_root(whole)[0], 0
    )
    main(["view", "--no-open", str(path)])
    return path.with_name("report.html")


def test_without_a_truth_the_report_says_what_was_found_and_nothing_of_errors(page, bare):
    text = bare.read_text(encoding="utf-8")
    tree = json.loads(re.search(r'id="replay-data">(.*?)</script>', text, re.S).group(1))
    whole = json.loads(re.search(r'id="replay-data">(.*?)</script>', page.read_text(encoding="utf-8"), re.S).group(1))
    assert tree["truth"] is None and not tree["rays"] and len(tree["landmarks"]) == 1
    assert tree["time"] == whole["time"] and tree["filters"]["joint"]["map"] == whole["filters"]["joint"]["map"]
    walls = tree["filters"]["joint"]["walls"][-1]
    assert len(walls) > 0 and all(name.startswith("wall ") for *_, name in walls)
    assert f"<b>{len(walls)}</b><span>walls found</span>" in text and "No true track is beside this run" in text
    assert "error" not in re.sub(r"<(script|style|svg)\b.*?</\1>|<pre>.*?</pre>", "", text, flags=re.S)


def test_a_file_without_filter_or_truth_says_what_to_run(page, tmp_path, call, capsys):
    from dopslam.records import DetectionSeries
    from dopslam.store import file as dataset

    whole, path = page.with_name("dataset.h5"), tmp_path / "own.h5"
    dataset.write_records(path, {"detections": dataset.read_record(whole, "detections", DetectionSeries)}, dataset.read_root(whole)[0], 0)  # fmt: skip
    assert call("view", "--no-open", path) == 2
    assert "run 'dopslam slam" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("meters", "text"), [(0.0044, "4.4 mm"), (0.044, "4.4 cm"), (0.44, "44.0 cm"), (4.4, "4.40 m"), (4400, "4.40 km")]
)
def test_lengths_are_said_as_people_say_them(meters, text):
    assert length_text(meters) == text


def test_a_scene_too_large_for_a_page_says_so(page, monkeypatch):
    import numpy as np

    from dopslam.report import replay
    from dopslam.report.page import replay_section

    track, landmarks, *_ = stages.read_truth(page.with_name("dataset.h5"))
    monkeypatch.setattr(replay, "LARGEST_MESH", 3)
    small, large = (replay.replay(track, landmarks, None, None, {}, np.zeros((n, 3, 3))) for n in (3, 4))
    assert small["mesh"] and not small["note"] and large["mesh"] is None
    assert "4 triangles, too many" in replay_section(large, (), ()) and "triangles" not in replay_section(small, (), ())


def test_names_cannot_break_the_page():
    from dopslam.report.page import _embedded

    assert "</script" not in _embedded({"name": "</script><script>alert(1)</script>"})


@pytest.mark.rt
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian's package chromium)")
@pytest.mark.parametrize(("which", "step"), [("page", 1), ("page", 4), ("page", 6), ("bare", 3)])
def test_the_replay_shows_a_step_without_errors(which, step, tmp_path, request):
    page = request.getfixturevalue(which)
    done = subprocess.run(
        [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path}", "--enable-logging=stderr", "--dump-dom",
         f"{page.as_uri()}#step={step}"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert 'data-ready="yes"' in done.stdout, done.stderr[-2000:]
    assert f"step {step} of 6" in done.stdout
    assert "data-error" not in done.stdout and ":CONSOLE" not in done.stderr
    tags = re.findall(r'<div class="tag"[^>]*>([^<]*)</div>', done.stdout)
    assert {"base station", "receiver, at the end" if step == 6 else "receiver"} <= set(tags)


@pytest.mark.rt
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian's package chromium)")
def test_the_receiver_is_in_the_picture_wherever_its_world_lies(tmp_path):
    from dopslam.config.scenario import load

    data, seen = tmp_path / "dataset.h5", {}
    away = ["base_station.position=[500,300,40]", "track.start=[570.7,300,1.5708,300]"]
    stages.simulate(data, load("ring_road", ["source.kind=model", "track.steps=30", *away]), 3)
    stages.slam(data)
    stages.bound(data)
    stages.report(data, tmp_path, *stages.evaluate(data))
    for step in (1, 20):
        done = subprocess.run(
            [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / str(step)}", "--dump-dom",
             f"{(tmp_path / 'report.html').as_uri()}#step={step}"],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        seen[step] = [float(v) for v in re.search(r'data-receiver="([-.0-9]+) ([-.0-9]+)"', done.stdout).groups()]
        assert max(map(abs, seen[step])) < 1
    assert seen[1] != seen[20]  # it moves
