"""DeepMIMO v4: matrices of paths."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.datasets.parts import Part, scenario_of
from dopslam.records import Kind

MAX_PATHS = 25  # of a receiver
MAX_INTERACTIONS = 10  # of a path


class DeepMimo:
    """Matrices of DeepMIMO v4."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
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
        (out / "params.json").write_text(
            json.dumps(_deepmimo_params(scenario, count, active), indent=2), encoding="utf-8"
        )


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
