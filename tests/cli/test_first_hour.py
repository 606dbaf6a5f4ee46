"""What a newcomer meets: five commands, completion, bars with the time left, red where a filter is lost, the report's path."""

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dopslam.cli import FIRST_HOUR, VERBS, app
from dopslam.report import tables


def test_nothing_said_prints_five_commands_that_exist(call, capsys):
    assert call() == 0
    told = capsys.readouterr().out
    commands = [line.split()[1] for line in told.splitlines() if line.startswith("  dopslam")]
    assert len(commands) == 5 and set(commands) <= set(VERBS) and told.strip() == FIRST_HOUR


def test_completion_knows_the_verbs():
    script = app.generate_completion(prog_name="dopslam", shell="bash")
    assert all(verb in script for verb in VERBS)
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


def test_the_last_line_of_a_run_is_the_path_of_its_report(call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call("run", "ring_road", "--source", "model", "--set", "track.steps=3", "--filter", "joint") in (0, 3)
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("report: ") and Path(last.removeprefix("report: ")).is_file()


def test_bars_tell_the_time_left_and_compiling_has_one_of_its_own(monkeypatch):
    import numba

    from dopslam.cli import bars

    shown = []

    def progress(stage, done, total):
        shown.append((stage, done, total))

    with bars.compiling(progress):
        numba.njit(lambda x: x + 1)(1.0)
        numba.njit(lambda x: x + 2)(1.0)
    stages = {stage for stage, *_ in shown}
    assert stages == {"compile"} and shown[-1][1] == shown[-1][2] >= 2
    assert all(done < total for _, done, total in shown[:-1])
    shown.clear()
    with bars.compiling(progress):
        np.zeros(3).sum()
    assert not shown
    for forced in ("", "1"):
        monkeypatch.setenv("FORCE_COLOR", forced)
        monkeypatch.setattr(sys, "stderr", io.StringIO())
        _report(bars)
        assert bool(sys.stderr.getvalue()) == bool(forced)  # no bars in a log
    assert "left" in sys.stderr.getvalue() and "3/3" in sys.stderr.getvalue()


def _report(bars):
    with bars.timed_bars() as report:
        for done in range(4):
            report("runs", done, 3)


def test_a_lost_filter_is_red_in_the_table():
    from rich.console import Console

    figures = dict.fromkeys(
        ("position_rmse_m", "heading_rmse_deg", "clock_bias_rmse_m", "nees", "gospa_va_m", "gospa_sp_m"), 1.0
    )
    figures |= dict.fromkeys(("va_found", "va_total", "sp_found", "sp_total"), 0)
    figures |= {"rmse_over_bound": dict.fromkeys(("position", "heading", "clock"), 1.0), "diverged": True}
    summary = {"scenario": "x", "seed": 0, "found_within_m": 1.0, "variants": {"joint": figures}}
    out = io.StringIO()
    Console(file=out, force_terminal=True, color_system="standard", width=80).print(tables.run_table(summary))
    assert any("\x1b[1;31m" in line and "YES" in line for line in out.getvalue().splitlines())


@pytest.mark.skipif(os.name == "nt", reason="a POSIX terminal")
def test_help_of_every_verb_is_there(call, capsys):
    assert call("--help") == 0
    text = capsys.readouterr().out
    assert all(verb in text for verb in VERBS)


def test_the_page_is_served_to_this_machine_and_nothing_else_is(tmp_path):
    import threading
    import urllib.error
    import urllib.request

    from dopslam.cli.view import server_of

    page = tmp_path / "report.html"
    page.write_text("<p>ready</p>", encoding="utf-8")
    (tmp_path / "secret").write_text("no")
    with server_of(page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}"
        assert server.server_address[0] == "127.0.0.1"
        with urllib.request.urlopen(f"{address}/") as answer:
            assert answer.read() == b"<p>ready</p>"
        for path in ("secret", "../secret", "report.html/../secret"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"{address}/{path}")
        server.shutdown()
