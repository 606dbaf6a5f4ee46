"""MATLAB: flat tables."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.datasets.tracks import Steps
from dopslam.records import DetectionSeries, Landmarks, Paths, Track
from dopslam.store import file as dataset


class Mat:
    """A MATLAB file per part."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """A MATLAB file per part: structs of flat columns; every row of ``paths`` names its position (from 1) and
        landmark (from 1)."""
        from scipy.io import savemat

        kinds = {"track": Track, "steps": Steps, "landmarks": Landmarks, "paths": Paths, "detections": DetectionSeries}
        for number, part in enumerate(parts):
            content: dict = {}
            for group, kind in kinds.items():
                if not part.has(group):
                    continue
                record = dataset.read_record(part.path, group, kind)
                columns = {f.name: getattr(record, f.name) for f in fields(record)}
                if "offsets" in columns:
                    columns["position"] = np.repeat(np.arange(record.steps), np.diff(record.offsets)) + 1
                if "landmark" in columns:
                    columns["landmark"] = columns["landmark"] + 1
                if "name" in columns:
                    columns["name"] = columns["name"].astype(object)
                content[group] = columns
            savemat(
                out / f"part-{number:05d}.mat", content, do_compression=True, oned_as="column", long_field_names=True
            )
