"""CSV: tables of the true paths and positions, and of what the filters found."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.formats.mapped import Mapped, runs_of
from dopslam.records import Kind


class Csv:
    """Tables in SI units and radians."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """Where the truth is there ``paths.csv``, a row per path, and ``positions.csv``, a row per position; of every filter
        history ``slam_….csv``, a row per step, and ``slam_…_map.csv``, a row per landmark of the final map.

        Raises
        ------
        DatasetError
            If there is neither.
        """
        true = all(part.has("track") and part.has("paths") for part in parts)
        if true:
            _write_truth(parts, out)
        if not true or any(group.startswith("slam_") for part in parts for group in part.groups):
            for run in runs_of(parts):
                _write_run(run, out)


def _write_truth(parts: list[Part], out: Path) -> None:
    with open(out / "paths.csv", "w", newline="", encoding="utf-8") as a, open(out / "positions.csv", "w", newline="", encoding="utf-8") as b:  # fmt: skip
        paths_file, positions_file = csv.writer(a), csv.writer(b)
        columns = ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler")
        paths_file.writerow(["index", "landmark", "kind", "order", "a_real", "a_imag", *columns])
        positions_file.writerow(["index", "drive", "step", "time", "x", "y", "z", "heading", "vx", "vy", "vz", "bias"])
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


STATE = ("x", "y", "heading", "bias")
PLACE = ("x", "y", "z")


def _write_run(run: Mapped, out: Path) -> None:
    """Track and final map of one filter; ``cov_x_y`` and the like are the upper triangle of the covariance."""
    history = run.history
    with open(out / f"{run.name}.csv", "w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file)
        lines.writerow(["step", "time", *STATE, *_triangle_names(STATE)])
        for step, (time, mean, covariance) in enumerate(
            zip(run.time.tolist(), history.mean[:, :4], history.covariance[:, :4, :4], strict=True)
        ):
            lines.writerow([step, time, *mean.tolist(), *covariance[np.triu_indices(4)].tolist()])
    with open(out / f"{run.name}_map.csv", "w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file)
        lines.writerow(["kind", "existence", *PLACE, *_triangle_names(PLACE)])
        for row in run.last.tolist():
            place, covariance = history.position[row], history.position_covariance[row]
            triangle = covariance[np.triu_indices(3)].tolist()
            kind = Kind(int(history.kind[row])).name
            lines.writerow([kind, float(history.existence[row]), *place.tolist(), *triangle])


def _triangle_names(names: tuple[str, ...]) -> list[str]:
    return [f"cov_{names[i]}_{names[j]}" for i, j in zip(*np.triu_indices(len(names)), strict=True)]
