"""Every remedy that a message names is tried: provoke the message, do what it says, the message is gone."""

import re
import shutil

import h5py
import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.pipeline import file as stages
from dopslam.store import file as dataset

SETTINGS = ["source.kind=model", "track.steps=6"]
TABLE = "t,toa,phi\n" + "".join(
    f"{0.5 * (k + 1)},{1250 + 10 * k},{80 - k}\n{0.5 * (k + 1)},{1500 + 9 * k},{-90 - k}\n" for k in range(6)
)
MAP = """[columns]
time = "t"
delay = "toa"
aoa_azimuth = "phi"
[units]
delay = "ns"
aoa_azimuth = "deg"
[std]
delay = 0.5
aoa_azimuth = 2.0
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    path = tmp_path_factory.mktemp("drawn") / "d.h5"
    stages.simulate(path, load("ring_road", SETTINGS), seed=2)
    return path


@pytest.fixture
def say(call, capsys):
    """Status and message of a command."""

    def run(*command):
        capsys.readouterr()
        status = call(*command)
        return status, " ".join(capsys.readouterr().err.split())

    return run


def named(message):
    """The command that a message names in quotes, as words."""
    return re.search(r"'dopslam ([^']*)'", message).group(1).split()


@pytest.mark.parametrize("slam", [(), ("--doppler-std", "none"), ("--filter", "smoother")])
def test_evaluate_names_the_commands_that_it_waits_for(tmp_path, drawn, say, slam):
    path = tmp_path / "d.h5"
    shutil.copy(drawn, path)
    status, message = say("evaluate", path, "--out", tmp_path)
    assert status == 2 and named(message)[0] == "slam"
    assert say(*named(message), *slam)[0] == 0
    status, message = say("evaluate", path, "--out", tmp_path)
    assert status == 2 and named(message)[0] == "bound"
    assert say(*named(message))[0] == 0
    assert say("evaluate", path, "--out", tmp_path)[0] == 0


def test_imported_data_without_a_track_name_the_option_that_brings_it(tmp_path, say):
    (tmp_path / "t.csv").write_text(TABLE)
    (tmp_path / "m.toml").write_text(MAP)
    (tmp_path / "track.csv").write_text("time,x,y\n" + "".join(f"{0.5 * (k + 1)},{60 - k},{5 * k}\n" for k in range(6)))
    command = ["import", tmp_path / "t.csv", "--map", tmp_path / "m.toml", "--scene", "ring_road", "--out"]
    assert say(*command, tmp_path / "a.h5")[0] == 0
    for verb in ("bound", "evaluate", "estimate"):
        status, message = say(verb, tmp_path / "a.h5")
        assert status == 2 and "--track TRACK.csv" in message
    assert say(*command, tmp_path / "b.h5", "--track", tmp_path / "track.csv")[0] == 0
    assert say("bound", tmp_path / "b.h5")[0] == 0
    status, message = say("estimate", tmp_path / "b.h5")  # from a table there is nothing to estimate from
    assert status == 2 and "only a traced scene has it" in message


@pytest.mark.parametrize(
    ("mapping", "table", "said", "cure"),
    [
        (MAP.replace("[columns]", '[columns]\npower = "p"'), TABLE, "without noise_floor_db = … (dB)",
         (("[columns]", "noise_floor_db = -90.0\n[columns]"), ("[units]", '[units]\npower = "dB"'), ("t,toa,phi\n", "t,toa,phi,p\n"), (r"(?m)^([-\d.,]+)$", r"\1,-60"))),
        (MAP.replace("delay = 0.5\n", ""), TABLE, "Give std.delay", (("[std]", "[std]\ndelay = 0.5"),)),
        (MAP.replace('"toa"', '"tau"'), TABLE, "has no column 'tau'; it has t, toa, phi", (('"tau"', '"toa"'),)),
        (MAP.replace('"deg"', '"degrees"'), TABLE, "known are rad, deg", (('"degrees"', '"deg"'),)),
        (MAP.replace('aoa_azimuth = "deg"\n', ""), TABLE, "degrees taken for radians", (('delay = "ns"', 'delay = "ns"\naoa_azimuth = "deg"'),)),
        (MAP, TABLE.replace("t,toa,phi", "t,toa,phi,phi").replace("\n", ",0\n").replace("phi,0", "phi", 1),
         "rename or remove one", (("t,toa,phi,phi", "t,toa,phi,psi"),)),
    ],
)  # fmt: skip
def test_what_a_mapping_or_a_table_lacks_is_named_as_it_must_be_written(tmp_path, say, mapping, table, said, cure):
    def bring():
        (tmp_path / "t.csv").write_text(table)
        (tmp_path / "m.toml").write_text(mapping)
        return say(
            "import",
            tmp_path / "t.csv",
            "--map",
            tmp_path / "m.toml",
            "--scene",
            "ring_road",
            "--out",
            tmp_path / "d.h5",
        )

    status, message = bring()
    assert status == 2 and said in message
    for old, new in cure:
        mapping = mapping.replace(old, new, 1)
        table = re.sub(old, new, table) if old.startswith("(?m)") else table.replace(old, new, 1)
    assert bring() == (0, "")


def test_a_file_without_a_scenario_says_where_to_write_it(tmp_path, drawn, say):
    path = tmp_path / "d.h5"
    shutil.copy(drawn, path)
    with h5py.File(path, "r+") as file:
        text = file.attrs["scenario"]
        for name in ("scenario", "root_sha256"):
            del file.attrs[name]
    status, message = say("slam", path)
    assert status == 2 and "attribute 'scenario' of the file's root" in message
    with h5py.File(path, "r+") as file:
        file.attrs["scenario"] = text
    assert say("slam", path)[0] == 0


def test_detections_that_are_missing_name_what_makes_them(tmp_path, drawn, say):
    path = tmp_path / "d.h5"
    shutil.copy(drawn, path)
    with h5py.File(path, "r+") as file:
        del file["detections"]
    status, message = say("slam", path)
    assert status == 2 and "dopslam import" in message and "dopslam simulate" in message
    with h5py.File(path, "r+") as file:
        file.create_group("paths")
    assert named(say("slam", path)[1]) == ["estimate", str(path)]


def test_a_place_that_is_taken_or_missing_is_named(tmp_path, say):
    command = ("simulate", "ring_road", "--set", "track.steps=3", "--out")
    assert say(*command, tmp_path / "d.h5")[0] == 0
    status, message = say(*command, tmp_path / "d.h5")
    assert status == 2 and "name another file with --out" in message
    assert say(*command, tmp_path / "e.h5")[0] == 0
    status, message = say(*command, tmp_path / "new" / "d.h5")
    assert status == 2 and "create it first" in message
    (tmp_path / "new").mkdir()
    assert say(*command, tmp_path / "new" / "d.h5")[0] == 0


def test_a_start_from_the_detections_alone_cures_a_wrong_start(tmp_path, drawn, call, capsys):
    """The remedy that a diverged filter names."""
    path = tmp_path / "d.h5"
    shutil.copy(drawn, path)
    assert call("slam", path, "--set", "track.start=[30, 40, 0.2, 300]", "--set", "filter.restart=false") == 3
    remedy = re.search(r"--set (filter.start=\S+)", capsys.readouterr().out).group(1)
    assert call("slam", path, "--set", remedy) == 0
    from dopslam.records import Track
    from dopslam.slam.history import History

    found = dataset.read_record(path, "slam_joint", History).mean[:, :2]
    assert np.linalg.norm(found - dataset.read_record(path, "track", Track).position[:, :2], axis=1).max() < 5
