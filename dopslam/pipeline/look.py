"""The look ahead at a scenario: a few steps traced with few rays, in seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.pipeline import file as stages
from dopslam.pipeline import preflight
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.outlook import Outlook, chosen_steps, outlook
from dopslam.records import Track

RAYS = 20_000


def look(scenario: Scenario, seed: int = 0) -> Outlook:
    """What a run of the scenario will see; everything that would end it is a fatal finding.

    Raises
    ------
    LLVMError
        If the ray tracer cannot run on this machine.
    """
    from dopslam import raytracing

    track = pipeline.draw_track(scenario, seed)
    scene, found = preflight.examine(scenario, track.position)
    if scene is None or any(finding.fatal for finding in found):
        return Outlook((), tuple(found))
    steps = chosen_steps(track.steps)
    few = Track(
        **{n: getattr(track, n)[steps] for n in ("time", "position", "heading", "velocity", "bias")}, start=track.start
    )
    _, points, settings = pipeline.tracing_inputs(scenario, seed)
    landmarks, paths = raytracing.trace(
        scene, scenario.radio.carrier_frequency, np.array(scenario.base_station.position), few.position, few.velocity, points,
        replace(settings, samples=min(settings.samples, RAYS)),
    )  # fmt: skip
    seen = outlook(scenario, few, landmarks, paths, np.arange(len(steps)))
    return replace(seen, findings=(*found, *seen.findings))


def look_at(path: Path) -> Outlook:
    """The same from the traced paths of a dataset file, before they are estimated."""
    scenario, _ = stages.scenario_of(path)
    track, landmarks, paths, _ = stages.read_truth(path)
    assert paths is not None
    return outlook(scenario, track, landmarks, paths)
