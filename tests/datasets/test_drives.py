"""Single drives of a large dataset: whole across shards, and ready for the filters."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.datasets import drives, tracks
from dopslam.datasets.parts import parts_of
from dopslam.errors import DatasetError
from dopslam.formats.export import export
from dopslam.pipeline import file as stages
from dopslam.records import DetectionSeries, Landmarks, Paths, Track, same
from dopslam.store import file as dataset

SMALL = [
    "radio.subcarriers=32", "radio.beams.beams=4", "radio.beams.sweeps=2", "receiver.array.columns=4",
    "base_station.array.columns=4", "estimator.max_paths=3",
]  # fmt: skip


def test_every_drive_is_what_was_driven_and_traced(made, worker, tmp_path):
    files = export(made, tmp_path / "o", "drives")
    assert [f.name for f in files] == [f"drive-{n:05d}.h5" for n in range(7)]
    scenario = load("ring_road", worker.SETTINGS)
    alone = worker.PlainTracer(scenario, 3)
    for number, file in enumerate(files[:-1]):  # the last one is incomplete: 31 positions of five each
        track = tracks.sampled(scenario, 3).drive(number)
        landmarks, paths = alone.trace(track)
        assert same(dataset.read_record(file, "track", Track), track)
        assert same(dataset.read_record(file, "landmarks", Landmarks), landmarks)
        assert same(dataset.read_record(file, "paths", Paths), paths)
        told, _ = stages.scenario_of(file)
        assert told.track.steps == 5 and told.track.start == scenario.track.start
        assert told.track.process_std == scenario.track.process_std
    assert dataset.read_record(files[-1], "track", Track).steps == 1
    assert len({dataset.read_root(file)[1] for file in files}) == 7  # or their noise would be the same


def test_one_drive_with_signal_and_detections_goes_through_the_filters(worker, tmp_path, call):
    folder = tmp_path / "d"
    worker.make(folder, 10, settings=SMALL, signal=True, detections=True)
    assert call("export", folder, "--to", "drives", "--drive", "1", "--out", tmp_path / "o") == 0
    path = tmp_path / "o" / "drive-00001.h5"
    pieces = [part.read("detections", DetectionSeries) for part in parts_of(folder)]
    whole = DetectionSeries.join(pieces)
    time = dataset.read_record(path, "track", Track).time
    assert same(dataset.read_record(path, "detections", DetectionSeries), replace(whole.take(slice(5, 10)), time=time))
    assert np.array_equal(dataset.read_snapshot(path, 3), dataset.read_snapshot(folder / "shard-00001.h5", 1))
    for command in ("slam", "bound"):
        assert call(command, path) == 0
    assert call("evaluate", path, "--out", tmp_path) == 0
    assert (tmp_path / "summary.json").exists()


def test_what_is_not_there_is_named(made, tmp_path):
    with pytest.raises(DatasetError, match="no drive 9; there are 0 to 6"):
        export(made, tmp_path / "o", "drives", 9)
    with pytest.raises(DatasetError, match="--to drives only"):
        export(made, tmp_path / "o", "tum", 0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("sense", [1, -1])
def test_the_filter_of_a_circle_is_told_its_sense(sense):
    scenario = load("ring_road", ["dataset.tracks.kind=circle", "dataset.tracks.radius=30", "dataset.steps=6"])
    drawn = (tracks.sampled(scenario, 0).drive(n) for n in range(20))
    track = next(t for t in drawn if sense * tracks.wrap(t.heading[1] - t.heading[0]) > 0)
    told = drives.told(scenario, track).track
    assert told.turn_rate == pytest.approx(tracks.wrap(track.heading[1] - track.heading[0]) / told.period)
    assert told.start == pytest.approx(track.start)


def test_the_filter_of_a_random_drive_is_told_its_limits():
    scenario = load(
        "ring_road", ["dataset.tracks.kind=drive", "dataset.tracks.polygon=[[-80,-80],[80,-80],[80,80],[-80,80]]",
                      "dataset.tracks.speed=[4, 9]", "dataset.steps=200"],
    )  # fmt: skip
    track = tracks.sampled(scenario, 0).drive(0)
    told = drives.told(scenario, track).track
    turned = tracks.wrap(np.diff(track.heading))
    assert np.all(np.abs(turned) <= np.sqrt(3) * told.process_std[2] + 1e-12)
    assert told.speed == pytest.approx(np.linalg.norm(track.velocity[0]))
