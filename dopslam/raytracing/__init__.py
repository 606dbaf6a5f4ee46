"""The ray tracer: scene and positions in, ground-truth landmarks and propagation paths out.

The only room that imports Sionna and Mitsuba, and only when something is traced: importing this module is
cheap.
"""

from dopslam.raytracing.scene import (
    LoadedScene,
    SceneSource,
    builtin_scenes,
    defined_materials,
    load_geometry,
    load_scene,
)
from dopslam.raytracing.settings import ScatterPoints, TraceSettings
from dopslam.raytracing.surfaces import Surfaces, floor_plan, position_faults, solids
from dopslam.raytracing.traced import Traced, join
from dopslam.raytracing.tracer import Tracer, trace

__all__ = [
    "LoadedScene", "ScatterPoints", "SceneSource", "Surfaces", "TraceSettings", "Traced", "Tracer",
    "builtin_scenes", "defined_materials", "floor_plan", "join", "load_geometry", "load_scene", "position_faults", "solids", "trace",
]  # fmt: skip
