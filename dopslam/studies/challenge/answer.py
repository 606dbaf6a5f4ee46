"""Answers to a suite: a CSV table, or dataset files with the history of a filter.

The table has a header and a row for every estimated state and every landmark of the final map; columns in any order::

    case        name of the case
    what        state, VA (virtual anchor: the base station mirrored at a wall) or SP (scatter point)
    time_s      of the snapshot, as in the case's files; empty for landmarks
    x_m, y_m    position in the world frame
    z_m         of a landmark; empty for states
    heading_rad azimuth of the receiver, bias_m: clock bias times c; empty for landmarks
    cov_11 …    upper triangle of the covariance: of (x, y, heading, bias) for states, of (x, y, z) for landmarks; may be left
                out or empty

Every snapshot of an answered case needs its state; cases may be left out and count as not answered.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dopslam.errors import DatasetError
from dopslam.records import Kind, edges_of
from dopslam.slam.history import History
from dopslam.store import file as dataset

COLUMNS = ("case", "what", "time_s", "x_m", "y_m", "z_m", "heading_rad", "bias_m")
STATE = [(i, j) for i in range(4) for j in range(i, 4)]
POINT = [(i, j) for i in range(3) for j in range(i, 3)]
WHAT = {"VA": Kind.VA, "SP": Kind.SP}
SHARP = 1e-12  # m², variance of a landmark whose covariance is not told


@dataclass(frozen=True)
class Answer:
    """What is answered to one case.

    Attributes
    ----------
    time : (K,) s
    mean : (K, 4); covariance : (K, 4, 4), NaN where it is not told
    kind : (M,), position : (M, 3) m, spread : (M, 3, 3) m²; the final map
    """

    time: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    kind: np.ndarray
    position: np.ndarray
    spread: np.ndarray

    def history(self) -> History:
        """As the history of a filter that holds the final map at every step."""
        steps, count = len(self.mean), len(self.kind)
        types = np.eye(len(Kind))[self.kind.astype(int)].reshape(-1, len(Kind))
        return History(
            mean=self.mean,
            covariance=self.covariance,
            map_offsets=edges_of(np.full(steps, count)).astype(np.int64),
            position=np.tile(self.position, (steps, 1)),
            position_covariance=np.tile(self.spread, (steps, 1, 1)),
            existence=np.ones(steps * count),
            type_probability=np.tile(types, (steps, 1)),
            kind=np.tile(self.kind, steps).astype(np.int64),
            track=np.tile(np.arange(count), steps),
        )


def of_history(time: np.ndarray, history: History, threshold: float = 0.5) -> Answer:
    """The answer that a filter's history is: its states, and what its last map reports."""
    last = history.rows(history.steps - 1)
    shown = (history.existence[last] > threshold) & np.isin(history.kind[last], list(WHAT.values()))
    return Answer(
        time, history.mean[:, :4], history.covariance[:, :4, :4], history.kind[last][shown], history.position[last][shown],
        history.position_covariance[last][shown],
    )  # fmt: skip


def to_rows(case: str, answer: Answer) -> list[list[str]]:
    """Rows of the table, header left out (:func:`header`)."""

    def text(values) -> list[str]:
        return ["" if np.isnan(v) else f"{v:.17g}" for v in values]

    rows = []
    for t, s, c in zip(answer.time, answer.mean, answer.covariance, strict=True):
        rows.append([case, "state", *text([t, s[0], s[1]]), "", *text([s[2], s[3]]), *text(c[i, j] for i, j in STATE)])
    names = {kind: name for name, kind in WHAT.items()}
    for k, p, c in zip(answer.kind, answer.position, answer.spread, strict=True):
        upper = {pair: f"{c[pair]:.17g}" for pair in POINT}
        rows.append([case, names[Kind(int(k))], "", *text(p), "", "", *(upper.get(pair, "") for pair in STATE)])
    return rows


def header() -> list[str]:
    """Names of the columns of the table."""
    return [*COLUMNS, *(f"cov_{i + 1}{j + 1}" for i, j in STATE)]


def read(path: Path, cases: Sequence[dict], told: Path) -> dict[str, Answer]:
    """Answers by the name of the case.

    Parameters
    ----------
    path : table (.csv), dataset file (.h5), or folder of dataset files
    cases : of the manifest
    told : folder of the suite

    Raises
    ------
    DatasetError
        Naming the file, the row and what is wrong with it.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.h5"))
        if not files:
            raise DatasetError(f"{path}: holds no .h5 file; give a table (.csv), a dataset file, or a folder of them")
        return {name: found for file in files for name, found in [_of_dataset(file, cases)]}
    if path.suffix == ".csv":
        return _of_table(path, {c["name"] for c in cases})
    return dict([_of_dataset(path, cases)])


def _of_dataset(path: Path, cases: Sequence[dict]) -> tuple[str, Answer]:
    hashes = dataset.stored_hashes(path)
    case = next((c["name"] for c in cases if c["content"] == hashes.get("detections")), None)
    if case is None:
        raise DatasetError(
            f"{path}: its detections are of no case of this suite; run 'dopslam slam' on a copy of a case's .h5"
        )
    groups = [name for name in hashes if name.startswith("slam_")]
    if len(groups) != 1:
        which = f"{len(groups)} histories ({', '.join(groups)})" if groups else "no history; run 'dopslam slam' on it"
        raise DatasetError(f"{path}: holds {which}; an answer holds one")
    history = dataset.read_record(path, groups[0], History)
    from dopslam.records import DetectionSeries

    time = dataset.read_record(path, "detections", DetectionSeries).time
    assert time is not None
    return case, of_history(time, history)


def _of_table(path: Path, names: set[str]) -> dict[str, Answer]:
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            missing = [column for column in COLUMNS if column not in (reader.fieldnames or ())]
            if missing:
                raise DatasetError(f"{path}: has no column {missing[0]!r}; an answer has {', '.join(header())}")
            rows = list(enumerate(reader, start=2))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path}: no readable table ({error}); give CSV in UTF-8") from error
    by_case: dict[str, list[tuple[int, dict]]] = {}
    for line, row in rows:
        if row["case"] not in names:
            raise DatasetError(f"{path}, line {line}: {row['case']!r} is no case of this suite; see its suite.json")
        by_case.setdefault(row["case"], []).append((line, row))
    return {name: _answer(path, lines) for name, lines in by_case.items()}


def _answer(path: Path, lines: list[tuple[int, dict]]) -> Answer:
    states, points = [], []
    for line, row in lines:
        where = f"{path}, line {line}"
        if row["what"] == "state":
            numbers = [_number(where, row, c) for c in ("time_s", "x_m", "y_m", "heading_rad", "bias_m")]
            states.append((numbers[0], numbers[1:], _covariance(where, row, STATE, 4)))
        elif row["what"] in WHAT:
            place = [_number(where, row, c) for c in ("x_m", "y_m", "z_m")]
            points.append((WHAT[row["what"]], place, _covariance(where, row, POINT, 3)))
        else:
            raise DatasetError(f"{where}: what is {row['what']!r}; write state, {' or '.join(WHAT)}")
    states.sort(key=lambda s: s[0])
    spread = np.array([s for *_, s in points]).reshape(-1, 3, 3)
    return Answer(
        time=np.array([t for t, *_ in states]),
        mean=np.array([m for _, m, _ in states]).reshape(-1, 4),
        covariance=np.array([c for *_, c in states]).reshape(-1, 4, 4),
        kind=np.array([int(k) for k, *_ in points], dtype=np.int64),
        position=np.array([p for _, p, _ in points], dtype=float).reshape(-1, 3),
        spread=np.where(np.isnan(spread), SHARP * np.eye(3), spread),
    )


def _number(where: str, row: dict, column: str) -> float:
    try:
        value = float(row[column])
    except (TypeError, ValueError):
        value = np.nan
    if not np.isfinite(value):
        raise DatasetError(f"{where}: {column} is {row[column]!r}, no finite number")
    return value


def _covariance(where: str, row: dict, pairs: list[tuple[int, int]], size: int) -> np.ndarray:
    """Covariance of a row; NaN where none of it is told."""
    texts = {(i, j): (row.get(f"cov_{i + 1}{j + 1}") or "").strip() for i, j in pairs}
    if all(text in ("", "NaN", "nan") for text in texts.values()):
        return np.full((size, size), np.nan)
    matrix = np.empty((size, size))
    for (i, j), _ in texts.items():
        matrix[i, j] = matrix[j, i] = _number(where, row, f"cov_{i + 1}{j + 1}")
    if np.linalg.eigvalsh(matrix)[0] < -1e-9 * max(np.trace(matrix), 0.0):
        raise DatasetError(f"{where}: its covariance has a negative eigenvalue; give the upper triangle in SI units")
    return matrix
