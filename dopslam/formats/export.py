"""Datasets for other programs: MATLAB, DeepMIMO v4, TUM trajectories, SigMF, CSV, GeoJSON, glTF, PLY, MCAP; and single drives
for this one.

Every function takes a dataset file or a folder made by ``dopslam dataset`` and writes a new folder whole or not at all.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.datasets.drives import write_drive, write_drives
from dopslam.datasets.parts import Part, parts_of, scenario_of
from dopslam.datasets.tracks import Steps
from dopslam.errors import DatasetError
from dopslam.formats import geojson, mcap, mesh
from dopslam.records import DetectionSeries, Kind, Landmarks, Paths, Track
from dopslam.store import file as dataset

MAX_PATHS = 25  # of a receiver, in DeepMIMO
MAX_INTERACTIONS = 10  # of a path, in DeepMIMO


def export(
    source: str | Path, out: str | Path, kind: str, drive: int | None = None, origin: geojson.Origin | None = None
) -> list[Path]:
    """Write a dataset in another format; returns the files made.

    Parameters
    ----------
    source : dataset file or folder
    out : folder that must not exist yet
    kind : ``mat``, ``deepmimo``, ``tum``, ``sigmf``, ``csv``, ``geojson``, ``gltf``, ``ply``, ``mcap``, or ``drives``: dataset files of one drive
        each
    origin : of the world frame on earth; ``geojson`` alone
    drive : number of the only drive that is wanted; ``drives`` alone

    Raises
    ------
    DatasetError
        For an existing ``out``, a source that lacks what the format needs, or a disk that cannot be written.
    """
    out = Path(out)
    if out.exists():
        raise DatasetError(f"{out}: exists already; remove it or name another folder with --out")
    if drive is not None and kind != "drives":
        raise DatasetError(f"--drive {drive}: goes with --to drives only")
    if origin is not None and kind != "geojson":
        raise DatasetError("--origin goes with --to geojson only")
    parts = parts_of(source)
    place = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))  # nobody else's
        place.chmod(0o755)
        if origin is not None:
            geojson.write(parts, place, origin)
        elif drive is None:
            KINDS[kind](parts, place)
        else:
            write_drive(parts, drive, place / f"drive-{drive:05d}.h5")
        os.replace(place, out)
    except OSError as error:
        raise DatasetError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        if place is not None:
            shutil.rmtree(place, ignore_errors=True)
    return sorted(out.iterdir())


def _csv(parts: list[Part], out: Path) -> None:
    """``paths.csv``, a row per path, SI units and radians; ``positions.csv``, a row per position."""
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


def _mat(parts: list[Part], out: Path) -> None:
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
        savemat(out / f"part-{number:05d}.mat", content, do_compression=True, oned_as="column", long_field_names=True)


def _tum(parts: list[Part], out: Path) -> None:
    """``drive-00000.tum``: time x y z qx qy qz qw of every true drive; ``slam_….tum`` of every filter history in a
    file."""
    handles: dict[int, Path] = {}
    for part in parts:
        track, steps = part.track, part.steps
        for drive in np.unique(steps.drive).tolist():
            rows = np.flatnonzero(steps.drive == drive)
            path = handles.setdefault(drive, out / f"drive-{drive:05d}.tum")
            with open(path, "a", encoding="ascii") as file:
                file.writelines(_pose_lines(track.time[rows], track.position[rows], track.heading[rows]))
        from dopslam.slam.history import History

        for group in dataset.groups(part.path):
            if group.startswith("slam_"):
                mean = dataset.read_record(part.path, group, History).mean
                position = np.column_stack([mean[:, :2], track.position[:, 2]])
                (out / f"{group}.tum").write_text(
                    "".join(_pose_lines(track.time, position, mean[:, 2])), encoding="ascii"
                )


def _pose_lines(time: np.ndarray, position: np.ndarray, heading: np.ndarray) -> Iterator[str]:
    for t, (x, y, z), angle in zip(time.tolist(), position.tolist(), heading.tolist(), strict=True):
        yield f"{t:.9f} {x:.9f} {y:.9f} {z:.9f} 0 0 {np.sin(angle / 2):.12f} {np.cos(angle / 2):.12f}\n"


def _deepmimo(parts: list[Part], out: Path) -> None:
    """Matrices of DeepMIMO v4: one ``.mat`` per quantity, NaN where a receiver has fewer paths, strongest first.

    Angles in degrees in the world frame (``…_el`` is the zenith angle), power 20 log₁₀|a| in dB, phase of
    ``a·e^{−j2πf_cτ}`` left
    to the reader: ``a`` excludes it. Interaction codes 0 line of sight, 1 reflection, 3 scattering, a digit per
    bounce from the
    transmitter on.
    """
    from scipy.io import savemat

    scenario, tables = scenario_of(parts), [_deepmimo_part(part) for part in parts]
    width = max(table["power"].shape[1] for table in tables)
    depth = max(table["inter_pos"].shape[2] for table in tables)
    for name in tables[0]:
        blocks = []
        for table in tables:
            block = table[name]
            if name != "rx_pos":
                pad = [(0, 0), (0, width - block.shape[1])] + (
                    [(0, depth - block.shape[2]), (0, 0)] if block.ndim == 4 else []
                )
                block = np.pad(block, pad, constant_values=np.nan)
            blocks.append(block)
        savemat(out / f"{name}_t000_tx000_r001.mat", {name: np.concatenate(blocks).astype(np.float32)})
    bs = np.array([scenario.base_station.position], np.float32)
    savemat(out / "tx_pos_t000_tx000_r001.mat", {"tx_pos": bs})
    savemat(out / "vertices.mat", {"vertices": np.zeros((0, 3))})  # no geometry: it stays in the scene's own file
    (out / "objects.json").write_text("[]", encoding="utf-8")
    count = sum(len(table["rx_pos"]) for table in tables)
    active = sum(int(np.isfinite(table["power"][:, :1]).sum()) for table in tables)
    (out / "params.json").write_text(json.dumps(_deepmimo_params(scenario, count, active), indent=2), encoding="utf-8")


def _deepmimo_part(part: Part) -> dict[str, np.ndarray]:
    track, landmarks, paths = part.track, part.landmarks, part.paths
    owner = np.repeat(np.arange(track.steps), np.diff(paths.offsets))
    order = np.lexsort((-np.abs(paths.a), owner))
    rank = np.arange(len(order)) - paths.offsets[owner[order]]
    order, rank = order[rank < MAX_PATHS], rank[rank < MAX_PATHS]
    rows = owner[order]
    bounces, kind = landmarks.order[paths.landmark], landmarks.kind[paths.landmark]
    reflections = np.array([int("1" * int(n)) if n else 0 for n in bounces.tolist()])
    columns = {
        "power": 20 * np.log10(np.maximum(np.abs(paths.a), 1e-30)), "phase": np.degrees(np.angle(paths.a)), "delay": paths.tau,
        "aoa_az": np.degrees(paths.phi_r), "aoa_el": np.degrees(paths.theta_r),
        "aod_az": np.degrees(paths.phi_t), "aod_el": np.degrees(paths.theta_t),
        "inter": np.where(kind == Kind.SP, 3, reflections),
    }  # fmt: skip
    width = int(rank.max(initial=0)) + 1
    tables = {name: np.full((track.steps, width), np.nan) for name in columns}
    for name, column in columns.items():
        tables[name][rows, rank] = column[order]
    depth = min(int(bounces.max(initial=1)) or 1, MAX_INTERACTIONS)
    places = np.full((track.steps, width, depth, 3), np.nan)
    for bounce in range(depth):
        those = np.flatnonzero(bounces[order] > bounce)
        places[rows[those], rank[those], bounce] = paths.vertices[paths.vertex_offsets[order[those]] + bounce]
    return tables | {"inter_pos": places, "rx_pos": track.position}


def _deepmimo_params(scenario: Scenario, count: int, active: int) -> dict:
    depth = scenario.trace.max_depth
    ends = {
        "num_ant": 1, "dual_pol": False, "ant_rel_pos": [[0, 0, 0]], "array_orientation": [0, 0, 0],
    }  # fmt: skip
    return {
        "version": "4.0.0",
        "rt_params": {
            "raytracer_name": "Sionna Ray Tracing", "raytracer_version": "2.2.0", "frequency": scenario.radio.carrier_frequency,
            "max_path_depth": depth, "max_reflections": depth, "max_diffractions": 0, "max_scattering": 1, "max_transmissions": 0,
            "num_rays": scenario.trace.samples, "synthetic_array": True,
        },
        "txrx_sets": {
            "txrx_set_0": {"name": "bs", "id": 0, "is_tx": True, "is_rx": False, "num_points": 1, "num_active_points": 1, **ends},
            "txrx_set_1": {
                "name": "ue", "id": 1, "is_tx": False, "is_rx": True, "num_points": count, "num_active_points": active, **ends,
            },
        },
        "scene": {"num_scenes": 1, "n_objects": 0, "n_vertices": 0, "n_faces": 0, "n_triangular_faces": 0},
        "materials": {},
    }  # fmt: skip


def _sigmf(parts: list[Part], out: Path) -> None:
    """A SigMF recording per part: complex float32 in the order (position, subcarrier, symbol, receive element)."""
    scenario = scenario_of(parts)
    spacing = scenario.radio.subcarrier_spacing * scenario.radio.comb
    for number, part in enumerate(parts):
        steps = dataset.signal_steps(part.path)
        if not steps:
            raise DatasetError(
                f"{part.path}: holds no signal; make the dataset with --signal, or run 'dopslam synthesize'"
            )
        digest, shape, name = hashlib.sha512(), None, f"part-{number:05d}"
        with open(out / f"{name}.sigmf-data", "wb") as file:
            for step in range(steps):
                y = np.ascontiguousarray(dataset.read_snapshot(part.path, step), "<c8")
                shape = y.shape
                file.write(y.tobytes())
                digest.update(y.tobytes())
        assert shape is not None
        size = int(np.prod(shape))
        times = part.track.time
        meta = {
            "global": {
                "core:datatype": "cf32_le", "core:version": "1.0.0", "core:sample_rate": spacing * shape[0],
                "core:sha512": digest.hexdigest(), "core:recorder": "dopslam",
                "core:description": "Frequency-domain pilots of a MIMO-OFDM channel: per capture (subcarrier, symbol, receive "
                f"element) = {shape}, sqrt(W), subcarriers {spacing:g} Hz apart",
            },
            "captures": [
                {"core:sample_start": k * size, "core:frequency": scenario.radio.carrier_frequency} for k in range(steps)
            ],
            "annotations": [
                {"core:sample_start": k * size, "core:sample_count": size, "core:comment": f"time {times[k]:g} s"}
                for k in range(steps)
            ],
        }  # fmt: skip
        (out / f"{name}.sigmf-meta").write_text(json.dumps(meta, indent=1), encoding="utf-8")


KINDS: dict[str, Callable[[list[Part], Path], None]] = {
    "mat": _mat, "deepmimo": _deepmimo, "tum": _tum, "sigmf": _sigmf, "csv": _csv, "drives": write_drives,
    "geojson": geojson.write, "gltf": mesh.write_gltf, "ply": mesh.write_ply, "mcap": mcap.write,
}  # fmt: skip
