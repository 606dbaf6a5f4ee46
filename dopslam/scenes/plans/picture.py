"""A picture of a floor plan: dark is wall. Its scale, in pixels to the meter, must be said."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.plans.raise_ import Feature, extra

DARK = 0.5  # of white
LARGEST = 16_000_000  # pixels
STRAIGHT = 0.7  # pixels, by which an edge may be straightened
SMALLEST = 0.01  # m², smaller spots are dirt


def read_picture(path: Path, pixels_per_meter: float) -> list[Feature]:
    """The dark areas of a picture as blocks, x to the right and y up, the lower left corner at the origin.

    Raises
    ------
    ConfigError
        If it is no picture, or all of one color.
    """
    image, shapely = extra("PIL.Image", "plans"), extra("shapely", "plans")
    contourpy = extra("contourpy", "plans")
    try:
        with image.open(path) as opened:
            if opened.width * opened.height > LARGEST:
                raise ConfigError(
                    f"{path}: {opened.width} × {opened.height} pixels; make it smaller, at most 16 megapixels"
                )
            background = image.new("RGBA", opened.size, "white")
            gray = image.alpha_composite(background, opened.convert("RGBA")).convert("L")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read as a picture ({error})") from error
    light = np.pad(np.asarray(gray, dtype=float)[::-1] / 255.0, 1, constant_values=1.0)
    filled = contourpy.contour_generator(z=1.0 - light, fill_type="OuterOffset").filled(1.0 - DARK, 2.0)
    features = []
    for points, offsets in zip(*filled, strict=True):
        rings = [points[a:b] for a, b in itertools.pairwise(offsets)]
        area = shapely.Polygon(rings[0], rings[1:]).simplify(STRAIGHT)
        if area.is_empty or area.geom_type != "Polygon" or area.area / pixels_per_meter**2 < SMALLEST:
            continue
        outer, *holes = (
            (np.array(ring.coords)[:-1] - 0.5) / pixels_per_meter for ring in (area.exterior, *area.interiors)
        )
        features.append(Feature(f"wall_{len(features) + 1}", outer, True, tuple(holes)))
    if not features:
        raise ConfigError(f"{path}: no dark area; draw walls dark on a light ground")
    return features
