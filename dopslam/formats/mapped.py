"""What the exports of maps and logs take from a dataset file: its filter histories, their walls, and what belongs to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dopslam.config.scenario import parse
from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.evaluate.walls import Walls
from dopslam.pipeline.judge import walls_of
from dopslam.records import DetectionSeries, Kind
from dopslam.slam.history import History
from dopslam.store import file as dataset

NAMES = {Kind.VA: "virtual anchor", Kind.SP: "scatter point", Kind.SR: "second reflection"}


@dataclass(frozen=True)
class Mapped:
    """One filter's run.

    Attributes
    ----------
    name : of the group, for file names
    time : (K,) s; position : (K, 3) m; heading : (K,) rad
    base_station : (3,) m; yaw : rad
    walls : of the final map
    last : rows of the history that the final map reports
    period : s, between two steps
    threshold : least existence of what a map reports
    """

    name: str
    history: History
    time: np.ndarray
    position: np.ndarray
    base_station: np.ndarray
    yaw: float
    walls: Walls
    last: np.ndarray
    period: float
    threshold: float


def runs_of(parts: list[Part]) -> Iterator[Mapped]:
    """Every filter history of a dataset file.

    Raises
    ------
    DatasetError
        If there is none.
    """
    found = False
    for part in parts:
        for group in (name for name in part.groups if name.startswith("slam_")):
            found = True
            yield _mapped(part, group)
    if not found:
        raise DatasetError(f"{parts[0].path}: holds no map; run 'dopslam slam {parts[0].path}' first")


def _mapped(part: Part, group: str) -> Mapped:
    text, _ = dataset.read_root(part.path)
    scenario, history = parse(text, source=str(part.path)), part.read(group, History)
    time = part.read("detections", DetectionSeries).time if part.has("detections") else None
    if time is None:
        time = part.track.time if part.has("track") else scenario.track.period * (1 + np.arange(history.steps))
    rows = np.arange(len(history.existence))[history.rows(history.steps - 1)]
    return Mapped(
        name=group,
        history=history,
        time=time,
        position=np.column_stack([history.mean[:, :2], np.full(history.steps, scenario.receiver.height)]),
        base_station=np.array(scenario.base_station.position, float),
        yaw=float(np.deg2rad(scenario.base_station.yaw_deg)),
        walls=walls_of(scenario, history),
        last=rows[history.existence[rows] > scenario.filter.report_existence],
        period=scenario.track.period,
        threshold=scenario.filter.report_existence,
    )
