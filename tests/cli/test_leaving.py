"""However a command ends: one line, a number, and no traceback."""

import os
import signal
import subprocess
import sys
import time

import pytest

from dopslam.cli import failure, main

pytestmark = pytest.mark.proc


def leave(*tokens):
    with pytest.raises(SystemExit) as raised:
        main([str(token) for token in tokens])
    return raised.value.code


@pytest.mark.parametrize("seed", [-1, 2**63, 2**70])
def test_impossible_seeds_are_refused_by_name(seed, capsys):
    assert leave("run", "ring_road", "--seed", seed) == 2
    assert "--seed" in capsys.readouterr().err


@pytest.mark.parametrize("jobs", [-3, 10**9])
def test_impossible_numbers_of_workers_are_refused_by_name(jobs, capsys):
    assert leave("montecarlo", "ring_road", "--runs", 1, "--jobs", jobs) == 2
    assert "--jobs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value"),
    [("track.speed", 1e300), ("radio.subcarriers", 10**9), ("track.steps", 10**12), ("filter.motion", "sideways"),
     ("receiver.array.columns", 10**5), ("base_station.yaw_deg", -1e20)],
)  # fmt: skip
def test_absurd_keys_are_refused_by_name(key, value, capsys):
    assert leave("bound", "ring_road", "--set", f"{key}={value}") == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and (key.split(".")[-1] in message or "elements of receiver.array" in message)


def test_an_unforeseen_fault_is_one_line(monkeypatch, capsys):
    import dopslam.config.scenario as scenario

    monkeypatch.delenv("DOPSLAM_DEBUG", raising=False)
    monkeypatch.setattr(scenario, "load", lambda *_: 1 / 0)
    assert leave("bound", "ring_road") == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "DOPSLAM_DEBUG" in message
    assert "memory" in failure.sentence(MemoryError())


def test_a_terminal_of_few_characters_gets_the_output():
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(
        [sys.executable, "-c", "from dopslam.cli import main; main(['scenes'])"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "ring_road" in done.stdout


def test_names_are_no_markup(tmp_path, capsys):
    path = tmp_path / "d[bold].h5"
    main(["simulate", "ring_road", "--out", str(path), "--set", "track.steps=2", "--set", "name='ring [v2]'"])
    for verb in ("slam", "bound"):
        main([verb, str(path)])
    capsys.readouterr()
    main(["evaluate", str(path), "--out", str(tmp_path / "o[/o]")])
    assert "ring [v2]" in capsys.readouterr().out


def test_termination_is_one_line():
    code = "from dopslam.cli import main; main(['montecarlo', 'ring_road', '--runs', '100000', '--jobs', '1'])"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    time.sleep(6)
    process.send_signal(signal.SIGTERM)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 143 and "terminated" in message and "Traceback" not in message
