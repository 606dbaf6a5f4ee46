"""``dopslam new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from dopslam.cli.common import Seed, positive


def new(
    out: Path,
    *,
    kind: str | None = None,
    source: Annotated[Path | None, Parameter(name="--from")] = None,
    seed: Seed = 0,
    scale: float | None = None,
    carrier: str = "28e9",
    bandwidth: str | None = None,
    height: float | None = None,
    wall: str | None = None,
) -> None:
    """Write a scene folder that runs: scenario.toml with comments, scene.xml.

    Without --kind and --from it asks.

    Parameters
    ----------
    out
        Folder to make.
    kind
        street, plaza, room, corridor, hall, or builtin:NAME for a scene that ships with Sionna RT.
    source
        Floor plan or map (.geojson; .png with --scale), OpenStreetMap extract (.osm), or model (.glb, .ply, .obj).
    seed
        Of what is drawn: the scene of a kind, or where base station and drive are put.
    scale
        Pixels to the meter, of a picture.
    carrier
        Hz.
    bandwidth
        Hz; by default what is usual at the carrier.
    height
        Of walls or buildings where the plan says none, in meters.
    wall
        ITU material of walls where the plan says none.
    """
    from rich.console import Console

    from dopslam.pipeline.create import new_scene
    from dopslam.scenes.plans.raise_ import Usual

    if kind is None and source is None:
        kind, source = _asked()
    given: dict[str, Any] = {"wall": wall} if wall else {}
    if height is not None:
        positive(str(height), "--height", "give meters, above 0")
        given |= {"height": height, "building_height": height}
    if scale is not None:
        positive(str(scale), "--scale", "give pixels to the meter, above 0")
    new_scene(
        out, kind, source, seed, scale, positive(carrier, "--carrier", "give Hz, for instance 28e9"),
        None if bandwidth is None else positive(bandwidth, "--bandwidth", "give Hz, for instance 400e6"), Usual(**given),
    )  # fmt: skip
    Console(markup=False, highlight=False, soft_wrap=True).print(f"{out}: made; now: dopslam run {out}")


def _asked() -> tuple[str | None, Path | None]:
    """What to start from, asked on a terminal."""
    import sys

    from rich.prompt import Prompt

    from dopslam.errors import ConfigError
    from dopslam.raytracing import builtin_scenes
    from dopslam.scenes.generators import GENERATORS

    if not sys.stdin.isatty():
        raise ConfigError("give --kind street (plaza, room, corridor, hall, builtin:NAME) or --from FILE")
    choices = f"{', '.join(GENERATORS)}, builtin:NAME ({', '.join(builtin_scenes())}), or a file"
    answer = Prompt.ask(f"What scene? {choices}", default="street").strip()
    known = answer in GENERATORS or answer.startswith("builtin:")
    return (answer, None) if known else (None, Path(answer))
