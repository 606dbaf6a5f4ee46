"""SigMF: the received signal."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part, scenario_of
from dopslam.errors import DatasetError
from dopslam.store import file as dataset


class SigMf:
    """A recording per part."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
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
