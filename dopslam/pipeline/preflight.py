"""What is wrong with a scenario and its scene, all of it, before the first stage that takes minutes.

A finding that is ``fatal`` would end a run; the others are told. Nothing here traces or estimates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.errors import DopslamError, SceneError
from dopslam.pipeline import link as radio
from dopslam.scenes.generators import generate, scene_xml
from estimation.errors import EstimationError

if TYPE_CHECKING:
    from dopslam.raytracing import LoadedScene, SceneSource

SLOPE = 0.02  # m, of the receiver's height, that does no harm


@dataclass(frozen=True)
class Finding:
    """One fault: where it is, and what is wrong, with its remedy."""

    where: str
    what: str
    fatal: bool = True

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


def scene_source(scenario: Scenario) -> SceneSource:
    """Where the scenario's geometry comes from."""
    from dopslam.raytracing import SceneSource

    scene = scenario.scene
    if scene.generator is not None:
        made = generate(scene.generator, scene.seed, scene.options, scenario.radio.carrier_frequency)
        return SceneSource(scenario.name, scene.materials, scene_xml(made))
    if scenario.scene_file is None and scene.builtin is None:
        raise SceneError(
            "the scenario says no scene; to trace give one of scene.file, scene.builtin and scene.generator"
        )
    return SceneSource(scenario.scene_file or str(scene.builtin), scene.materials)


def findings(scenario: Scenario, scene: LoadedScene, positions: np.ndarray) -> list[Finding]:
    """Everything that is wrong with a scenario in a scene.

    Parameters
    ----------
    scene : loaded for the scenario's carrier, or for its geometry alone
    positions : (K, 3) m of the receiver at every step
    """
    return [finding for rule in RULES for finding in rule(scenario, scene, np.asarray(positions, float).reshape(-1, 3))]


def checked_scene(scenario: Scenario, positions: np.ndarray) -> LoadedScene:
    """The scenario's scene, loaded for its carrier, if nothing is wrong with it.

    Raises
    ------
    SceneError
        Naming every fatal finding.
    LLVMError
        If the ray tracer cannot run on this machine.
    """
    scene, found = examine(scenario, positions)
    refuse([finding for finding in found if finding.fatal])
    assert scene is not None  # whatever kept it from loading is a finding
    return scene


def examine(scenario: Scenario, positions: np.ndarray) -> tuple[LoadedScene | None, list[Finding]]:
    """The scene, None if it cannot be loaded for the scenario's carrier, and everything that is wrong."""
    from dopslam import raytracing

    source, found = scene_source(scenario), []
    try:
        scene = loaded = raytracing.load_scene(source, scenario.radio.carrier_frequency)
    except SceneError as error:
        scene, found = None, [Finding("scene", str(error))]
        try:
            loaded = raytracing.load_geometry(source)
        except SceneError:  # the file itself is broken, and said to be
            return None, found
    return scene, found + findings(scenario, loaded, positions)


def refuse(found: list[Finding]) -> None:
    """Raise :class:`SceneError` with all findings, if there are any."""
    if len(found) == 1:
        raise SceneError(str(found[0]))
    if found:
        listed = "; ".join(f"({number}) {finding}" for number, finding in enumerate(found, start=1))
        raise SceneError(f"{len(found)} faults, found before anything was traced: {listed}")


def _positions(scenario: Scenario, scene: LoadedScene, positions: np.ndarray) -> list[Finding]:
    """Base station, scatter points and receiver inside of objects or too close to them."""
    from dopslam.raytracing import position_faults

    points = {"the receiver at step": positions, "the base station": np.array(scenario.base_station.position)}
    points |= {f"scatter point {point.name!r}": np.array(point.position) for point in scenario.scatter_point}
    return [Finding("scene", what) for what in position_faults(scene.surfaces, points)]


def _link(scenario: Scenario, scene: LoadedScene, positions: np.ndarray) -> list[Finding]:
    """Arrays, beams and estimator that cannot work together."""
    try:
        radio.estimator(scenario, radio.signal_model(scenario), threshold=1.0)
    except (DopslamError, EstimationError) as error:
        return [Finding("radio", str(error))]
    return []


def _leaving(scenario: Scenario, scene: LoadedScene, positions: np.ndarray) -> list[Finding]:
    """Steps beyond all of the scene's objects, seen from above: there is nothing there that echoes."""
    corners = scene.surfaces.triangles.reshape(-1, 3)[:, :2]
    if not len(corners):
        return []
    outside = np.any((positions[:, :2] < corners.min(axis=0)) | (positions[:, :2] > corners.max(axis=0)), axis=1)
    if not outside.any():
        return []
    step = int(np.argmax(outside))
    what = f"{outside.sum()} of {len(outside)} steps, the first {step}, lie beyond all objects; see [track] start and speed"
    return [Finding("track", what, fatal=False)]


def _height(scenario: Scenario, scene: LoadedScene, positions: np.ndarray) -> list[Finding]:
    """A receiver that climbs: the filters hold its height for known and constant."""
    off = np.abs(positions[:, 2] - scenario.receiver.height)
    most = max(SLOPE, 3 * scenario.track.process_std[0])
    if not len(off) or off.max() <= most:
        return []
    what = (
        f"at step {int(np.argmax(off))} the receiver is {off.max():.2g} m above or below receiver.height = "
        f"{scenario.receiver.height:g} m, which the filters hold for constant: track and map bend by as much; keep z within "
        f"{most:.2g} m"
    )
    return [Finding("track", what, fatal=False)]


Rule = Callable[[Scenario, "LoadedScene", np.ndarray], list[Finding]]
RULES: tuple[Rule, ...] = (_positions, _link, _leaving, _height)
