"""Makes a small dataset without a ray tracer: line of sight, one wall and the scatter points by the image method.

python worker.py FOLDER POSITIONS [--resume] [--slow SECONDS]
"""

import sys
import time

import numpy as np

from dopslam.config.scenario import load
from dopslam.datasets import make_plan
from dopslam.datasets import maker as module
from dopslam.raytracing import images as geometry
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths

BS = np.array([0.0, 0.0, 40.0])
WALL = np.array([1.0, 0.0, 0.0]), 100.0
SETTINGS = ["dataset.shard_positions=7", "dataset.steps=5"]


class PlainTracer:
    """What ShardTracer does, in closed form; ``slow`` seconds per shard."""

    slow = 0.0

    def __init__(self, scenario, seed):
        points = [p.position for p in scenario.scatter_point]
        self.points, self.names = np.array(points, float), [p.name for p in scenario.scatter_point]
        self.wavelength = SPEED_OF_LIGHT / scenario.radio.carrier_frequency

    def trace(self, track):
        time.sleep(self.slow)
        count, points = track.steps, len(self.points)
        receiver = np.repeat(track.position, 2 + points, axis=0)
        landmark = np.tile(np.arange(2 + points), count)
        parts = [
            geometry.reflected_paths(BS, track.position, np.zeros((count, 0, 3)), np.zeros((count, 0))),
            geometry.reflected_paths(BS, track.position, np.tile(WALL[0], (count, 1, 1)), np.full((count, 1), WALL[1])),
            *(geometry.scattered_paths(BS, track.position, np.tile(p, (count, 1))) for p in self.points),
        ]
        column = {
            name: np.stack([getattr(part, name) for part in parts], axis=1).reshape(
                -1, *getattr(parts[0], name).shape[1:]
            )
            for name in ("length", "departure", "arrival")
        }
        points_of = np.stack([part.vertices[:, 0] for part in parts[1:]], axis=1).reshape(-1, 3)
        theta_t, phi_t = geometry.zenith_azimuth(column["departure"])
        theta_r, phi_r = geometry.zenith_azimuth(column["arrival"])
        velocity = np.repeat(track.velocity, 2 + points, axis=0)
        paths = Paths(
            offsets=np.arange(count + 1) * (2 + points),
            landmark=landmark,
            a=(1e-3 / column["length"]).astype(complex),
            tau=column["length"] / SPEED_OF_LIGHT,
            theta_t=theta_t, phi_t=phi_t, theta_r=theta_r, phi_r=phi_r,
            doppler=np.sum(velocity * column["arrival"], axis=1) / self.wavelength,
            vertex_offsets=np.concatenate([[0], np.cumsum(np.where(landmark == 0, 0, 1))]),
            vertices=points_of,
        )  # fmt: skip
        assert len(receiver) == len(landmark)
        image = geometry.mirror_images(BS, WALL[0][None], np.array([WALL[1]]))[-1]
        landmarks = Landmarks(
            name=np.array(["BS", "VA wall_east", *(f"SP {name}" for name in self.names)]),
            kind=np.array([0, 1] + [2] * points, np.int8),
            position=np.array([BS, image, *self.points]),
            order=np.array([0] + [1] * (1 + points)),
        )
        return landmarks, paths


def make(folder, positions, resume=False, seed=3, settings=(), **options):
    """Make or resume the dataset; returns its manifest."""
    scenario = load("ring_road", [*SETTINGS, *settings])
    extra = {name: options.pop(name) for name in ("signal", "detections") if name in options}
    plan = make_plan(scenario, positions, seed, **extra)
    original, module.ShardTracer = module.ShardTracer, PlainTracer
    try:
        return module.generate(folder, plan, scenario, resume, **options)
    finally:
        module.ShardTracer = original


if __name__ == "__main__":
    if "--slow" in sys.argv:
        PlainTracer.slow = float(sys.argv[sys.argv.index("--slow") + 1])
    make(sys.argv[1], int(sys.argv[2]), "--resume" in sys.argv)
