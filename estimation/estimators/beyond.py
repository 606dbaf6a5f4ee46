"""Paths beyond the searched region: found at the end of a line that leaves it, not as a comb of their side lobes.

A strong path outside the searched speeds or delays shows inside by its side lobes, one candidate after the other. They have
its directions, and its delay or its speed. So the strongest candidate of a pass is looked at along either line, as far as
the link can tell; where the line is higher outside, that is where the path is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .floor import CANDIDATE, Floor

FARTHEST = 4.0
"""Speeds are looked at up to this multiple of the largest one searched."""
HIGHER = 1.3
"""Energy outside over that of the candidate inside that makes it a side lobe."""


def lines(model: SignalModel, path: Geometry, max_delay: float, max_speed: float) -> list[Geometry]:
    """Points along speed and delay through a path, inside and outside the searched region; along speed alone where shifted
    pilots make a delay show in two modes.
    """
    found = []
    if model.active[5] and max_speed > 0:
        bin_width = model.waveform.wavelength / np.ptp(model.schedule.times)
        far = int(np.ceil(3 * FARTHEST * max_speed / bin_width))
        speed = bin_width / 3 * np.arange(-far, far + 1)
        found.append(replace(_repeated(path, len(speed)), speed=speed))
    period = model.max_delay
    if model.active[0] and model.schedule.offsets is None and np.isfinite(period) and max_delay < period * (1 - 1e-6):
        delay = np.arange(0, period, 1 / (3 * model.waveform.bandwidth))
        found.append(replace(_repeated(path, len(delay)), delay=delay))
    return found


def beyond(floor: Floor, path: Geometry, energy: float, max_delay: float, max_speed: float) -> Geometry | None:
    """The point outside the region whose side lobe ``path`` (one, of so much energy) is, or None.

    A point that another one inside explains as well, for instance a speed that symbols too far apart cannot tell from it, is
    none.
    """
    model = floor.data.model
    if model.subbands > 1 or model.weight is not None:
        return None
    best, highest = None, HIGHER * energy
    for points in lines(model, path, max_delay, max_speed):
        mode = 0 if points.delay[0] != points.delay[-1] else 1
        blocks = model.evaluate(points)[0]
        fiber = floor.along(path, mode, CANDIDATE)
        vectors = blocks[mode][:, 0]
        power: Float = np.abs(vectors.conj() @ fiber) ** 2 / np.maximum(np.sum(np.abs(vectors) ** 2, axis=1), 1e-300)
        outside = (np.abs(points.speed) > max_speed) | (points.delay > max_delay)
        level = max(highest, HIGHER * power[~outside].max(initial=0.0))
        power = np.where(outside, power, -1.0)
        if power.max() > level:
            # Of several that explain it alike the nearest one.
            alike = np.flatnonzero(power > power.max() / HIGHER)
            near = int(alike[np.argmin(np.abs(points.speed[alike]) + points.delay[alike])])
            first = max(near - 2, 0)
            top = first + int(np.argmax(power[first : near + 3]))
            best, highest = points.take([top]), float(power.max())
    return best


def _repeated(path: Geometry, count: int) -> Geometry:
    return path.take(np.zeros(count, int))
