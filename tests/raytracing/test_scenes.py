"""The scenes that ship are what their files promise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dopslam.raytracing import ScatterPoints, SceneSource, Tracer, TraceSettings, join

pytestmark = pytest.mark.rt

COURTYARD = Path(__file__).parents[2] / "scenes" / "courtyard" / "scene.xml"


def test_courtyard(expected_paths):
    """The tree hides the base station for a quarter of the track; second-order anchors; nothing lost."""
    steps = np.arange(0, 200, 5)
    receivers = np.column_stack([8 + 0.0648 * steps, 6 + 0.0052 * steps, np.full(len(steps), 1.5)])
    points = ScatterPoints(("window", "pillar"), [[9.8, 0.05, 2.9], [4.0, 15.0, 3.05]], [3.0, 3.0])
    settings = TraceSettings(max_depth=2, samples=50_000)
    tracer = Tracer(SceneSource(COURTYARD), 28e9, [0.4, 12.0, 4.0], points, settings)
    landmarks, paths, _ = join(list(tracer.chunks(receivers)))
    owner = np.repeat(np.arange(len(steps)), np.diff(paths.offsets))
    names = landmarks.name[paths.landmark]
    hidden = len(steps) - np.count_nonzero(names == "BS")
    assert len(steps) / 4 <= hidden <= len(steps) / 2
    first = {"VA ground", "VA wall_east", "VA wall_north", "VA wall_south"}
    assert set(landmarks.name[(landmarks.kind == 1) & (landmarks.order == 1)]) == first  # none behind the array
    assert {"VA wall_east > wall_north", "VA wall_south > wall_north"} <= set(landmarks.name[landmarks.order == 2])
    window = owner[names == "SP window"]
    assert len(window) == len(steps)
    # The oracle's planes are exact and all reflect: leave out the panes (4 mm in front) and the absorbers.
    surfaces = tracer.surfaces
    kept = np.array(["window" not in surfaces.objects[i] for i in surfaces.triangle_object])
    bare = replace(surfaces, triangles=surfaces.triangles[kept], triangle_plane=surfaces.triangle_plane[kept])
    expected = {
        (row, "BS" if not planes else tracer.naming.name(tracer.naming.canonical(planes)))
        for row, planes in expected_paths(bare, tracer.bs_position, receivers, 2)
        if all(surfaces.plane_name[p].startswith(("wall", "ground")) for p in planes)
    }
    reflected = landmarks.kind[paths.landmark] < 2
    found = {(int(r), str(n)) for r, n in zip(owner[reflected], names[reflected], strict=True)}
    assert found == expected
