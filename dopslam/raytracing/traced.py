"""What tracing a run of receivers gives, and how chunks of it are united."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dopslam.records import Kind, Landmarks, Paths


class Traced(NamedTuple):
    """What was found for one run of receivers; ``transfer`` (N, 2, 2) is the polarimetric gain of every path.

    Rows of ``transfer`` are the receiver's V and H, columns the base station's V and H (isotropic elements,
    world frame).
    """

    landmarks: Landmarks
    paths: Paths
    transfer: np.ndarray


def join(chunks: Sequence[Traced]) -> Traced:
    """Unite chunks of the same scene and base station into one record, landmarks and indices included."""
    merged: dict[str, tuple] = {}
    for chunk in chunks:
        marks = chunk.landmarks
        for row in zip(marks.name.tolist(), marks.kind.tolist(), marks.position, marks.order.tolist(), strict=True):
            merged.setdefault(row[0], row)
    points = [row[0] for row in merged.values() if row[1] == Kind.SP]
    rows = sorted(
        merged.values(),
        key=lambda row: (row[1], row[3], points.index(row[0]) if row[1] == Kind.SP else row[0]),
    )
    landmarks = Landmarks(
        name=np.array([row[0] for row in rows]),
        kind=np.array([row[1] for row in rows], dtype=np.int8),
        position=np.array([row[2] for row in rows]),
        order=np.array([row[3] for row in rows], dtype=np.int64),
    )
    index = {row[0]: i for i, row in enumerate(rows)}
    paths = Paths.join([replace(chunk.paths, landmark=_rows(chunk, index)[chunk.paths.landmark]) for chunk in chunks])
    return Traced(landmarks, paths, np.concatenate([chunk.transfer for chunk in chunks]))


def _rows(chunk: Traced, index: dict[str, int]) -> np.ndarray:
    """Row of every landmark of a chunk in the united record."""
    return np.array([index[name] for name in chunk.landmarks.name.tolist()], dtype=np.int64)
