"""Whether records of one dataset belong together: as many steps everywhere, no index that points at nothing."""

from __future__ import annotations

import numpy as np

from dopslam.records import Kind

STEPPED = ("track", "paths", "detections")


def misfits(records: dict) -> list[tuple[str, str]]:
    """Faults of records by the names of their groups, each as (where, what); groups that are None or absent are no fault."""
    have = {name: record for name, record in records.items() if record is not None}
    found = []
    steps = {name: record.steps for name, record in have.items() if name in STEPPED or name.startswith("slam_")}
    steps |= {name: len(record.covariance) for name, record in have.items() if name.startswith("bound_")}
    if len(set(steps.values())) > 1:
        found.append((next(iter(steps)), f"numbers of steps differ: {', '.join(f'{n} {k}' for n, k in steps.items())}"))
    landmarks, paths, stations = (have.get(name) for name in ("landmarks", "paths", "base_stations"))
    if landmarks is not None:
        if not np.all(np.isin(landmarks.kind, list(Kind))):
            found.append(("landmarks/kind", "holds an unknown kind; known are 0 BS, 1 VA, 2 SP"))
        if len(landmarks) and landmarks.order.min() < 0:
            found.append(("landmarks/order", "holds numbers of bounces below 0"))
    if paths is not None and landmarks is not None:
        found += _outside("paths/landmark", paths.landmark, len(landmarks), "landmarks")
    for name in ("paths", "detections"):
        if stations is not None and name in have:
            found += _outside(f"{name}/anchor", have[name].anchor, len(stations), "base stations")
    return found


def _outside(where: str, index: np.ndarray, count: int, what: str) -> list[tuple[str, str]]:
    wrong = (index < 0) | (index >= count)
    if not wrong.any():
        return []
    row = int(np.argmax(wrong))
    return [(where, f"points outside the {count} {what}: row {row} says {index[row]}")]
