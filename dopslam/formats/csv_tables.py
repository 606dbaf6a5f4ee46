"""CSV: a table of paths and one of positions."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.records import Kind


class Csv:
    """Two tables in SI units and radians."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """``paths.csv``, a row per path, SI units and radians; ``positions.csv``, a row per position."""
        with open(out / "paths.csv", "w", newline="", encoding="utf-8") as a, open(out / "positions.csv", "w", newline="", encoding="utf-8") as b:  # fmt: skip
            paths_file, positions_file = csv.writer(a), csv.writer(b)
            columns = ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler")
            paths_file.writerow(["index", "landmark", "kind", "order", "a_real", "a_imag", *columns])
            positions_file.writerow(
                ["index", "drive", "step", "time", "x", "y", "z", "heading", "vx", "vy", "vz", "bias"]
            )
            for part in parts:
                track, steps, landmarks, paths = part.track, part.steps, part.landmarks, part.paths
                mark = paths.landmark
                owner = np.repeat(steps.index, np.diff(paths.offsets))
                paths_file.writerows(zip(
                    owner.tolist(), landmarks.name[mark].tolist(), [Kind(k).name for k in landmarks.kind[mark].tolist()],
                    landmarks.order[mark].tolist(), np.real(paths.a).tolist(), np.imag(paths.a).tolist(),
                    *(getattr(paths, name).tolist() for name in columns), strict=True,
                ))  # fmt: skip
                positions_file.writerows(zip(
                    steps.index.tolist(), steps.drive.tolist(), steps.step.tolist(), track.time.tolist(),
                    *track.position.T.tolist(), track.heading.tolist(), *track.velocity.T.tolist(), track.bias.tolist(), strict=True,
                ))  # fmt: skip
