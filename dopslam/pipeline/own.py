"""The true track of a scenario with a drive of its own."""

from __future__ import annotations

import numpy as np

from dopslam.config.driven import drive_of
from dopslam.config.scenario import Scenario
from dopslam.pipeline.seeds import Component, generator
from dopslam.records import Track


def own_track(scenario: Scenario, seed: int) -> Track:
    """The file's or the waypoints' drive; the clock walks as ``[track]`` says where the file has none."""
    drive, config = drive_of(scenario, scenario._folder), scenario.track
    steps = len(drive.position) - 1
    bias = drive.bias[1:] if drive.bias is not None else np.full(steps, config.start[3])
    if drive.bias is None and config.random:
        rng = generator(seed, Component.TRACK)
        bias = bias + config.start_std[3] * rng.normal() + np.cumsum(config.process_std[3] * rng.normal(size=steps))
    return Track(
        time=drive.period * np.arange(1, steps + 1),
        position=drive.position[1:],
        heading=drive.heading[1:],
        velocity=drive.velocity[1:],
        bias=bias,
        start=np.array(config.start),
    )
