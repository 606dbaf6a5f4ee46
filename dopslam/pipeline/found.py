"""The report of a run whose truth nobody knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dopslam.errors import DatasetError
from dopslam.pipeline.file import histories, read_detections, scenario_of
from dopslam.pipeline.judge import split_variant, walls_of
from dopslam.records import Kind, Landmarks
from dopslam.report import figures, folder, found, replay
from dopslam.store import file as dataset


def has_truth(path: Path) -> bool:
    """Whether a dataset file holds a true track that a filter's can be compared with."""
    return "track" in dataset.groups(path)


def report(path: Path, target: Path) -> None:
    """Write ``report.html``, ``found.png`` and ``claimed.png`` of what the filters of a dataset file found into a folder.

    Raises
    ------
    DatasetError
        If no filter has run on it.
    """
    scenario, _ = scenario_of(path)
    runs = {name: (history, walls_of(scenario, history)) for name, history in histories(path).items()}
    if not runs:
        raise DatasetError(f"{path}: holds no filter history; run 'dopslam slam {path}' first")
    main = next((name for name in runs if split_variant(name)[0] == scenario.filter.density), next(iter(runs)))
    station = np.array(scenario.base_station.position, float)
    height, least = scenario.receiver.height, scenario.filter.report_existence
    time = read_detections(path).time
    if time is None:
        time = scenario.track.period * (1.0 + np.arange(runs[main][0].steps))
    alone = Landmarks(np.array(["BS"]), np.array([Kind.BS], np.int8), station[None], np.zeros(1, np.int64))
    shown = replay.replay(
        None, alone, None, None, {name: history for name, (history, _) in runs.items()}, None, height, least, time=time
    )
    Path(target).mkdir(parents=True, exist_ok=True)
    with figures.house_style():
        drawn = {
            "found": figures.found_view(runs[main][0], station, height, least),
            "claimed": figures.claims_over_time(time, runs[main][0]),
        }
        figures.save_all(target, drawn)
        text = found.found_page(scenario.name, runs, main, least, drawn, shown, scenario.to_toml(), folder.versions())
    folder.write_text(Path(target) / "report.html", text)
