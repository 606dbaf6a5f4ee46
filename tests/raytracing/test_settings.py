"""Settings and scatter points refuse impossible values; nothing is traced here."""

import subprocess
import sys

import numpy as np
import pytest

from dopslam.errors import SceneError
from dopslam.raytracing import ScatterPoints, TraceSettings, builtin_scenes


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"max_depth": -1}, "max_depth is -1"),
        ({"samples": 0}, "samples is 0"),
        ({"chunk": 2001}, "chunk is 2001.*lose paths"),
        ({"polarization": ("V", "X")}, "polarization is 'X'"),
    ],
)
def test_settings(wrong, message):
    with pytest.raises(SceneError, match=message):
        TraceSettings(**wrong)


def test_scatter_points():
    assert ScatterPoints().positions.shape == (0, 3)
    points = ScatterPoints(("a", "b"), [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(points.rcs, 1.0)
    with pytest.raises(SceneError, match="same name"):
        ScatterPoints(("a", "a"), np.zeros((2, 3)))
    with pytest.raises(SceneError, match="do not match"):
        ScatterPoints(("a", "b"), np.zeros((1, 3)))
    with pytest.raises(SceneError, match="rcs is -1"):
        ScatterPoints(("a",), np.zeros((1, 3)), [-1.0])


def test_importing_the_room_or_listing_scenes_does_not_import_the_ray_tracer():
    code = (
        "import sys; from dopslam.raytracing import builtin_scenes;"
        "assert 'simple_street_canyon' in builtin_scenes();"
        "assert not {'sionna', 'mitsuba', 'drjit'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})
    assert builtin_scenes()["munich"].is_file()


def test_too_little_address_space_is_said_before_the_tracer_dies_of_it(monkeypatch):
    from dopslam.errors import LLVMError
    from dopslam.raytracing import backend

    monkeypatch.setattr(backend.resource, "getrlimit", lambda _: (900_000 * 1024, -1))
    with pytest.raises(LLVMError, match=r"limited to 0\.9 GB \(ulimit -v\)"):
        backend._refuse_little_room()
    monkeypatch.setattr(backend.resource, "getrlimit", lambda _: (backend.resource.RLIM_INFINITY, -1))
    backend._refuse_little_room()
