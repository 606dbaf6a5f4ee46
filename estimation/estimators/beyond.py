"""Paths beyond the searched region: found at the end of a line that leaves it, not as a comb of their side lobes.

A strong path outside the searched speeds or delays shows inside by its side lobes, one candidate after the other. They have
its delay or its speed, and its directions where these are modes of their own. So the strongest candidate of a pass is looked at
along either line, as far as the link can tell; where the line is higher outside, that is where the path is. Beams and
combiners turn directions into a course over time as a speed is one: along the line of speeds they are searched again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..signal.arrays import Complex
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.modes import TimeMode
from ..signal.paths import Geometry
from .floor import CANDIDATE, Floor
from .polish import ResidualProjector, separate_fit

FARTHEST = 4.0
"""Speeds are looked at up to this multiple of the largest one searched."""
HIGHER = 1.3
"""Energy outside over that of the candidate inside that makes it a side lobe."""
SCALLOPED = 0.6
"""Share of it that a point of the line may hold at least: cells of directions are coarse."""
Ends = tuple[Float, Float]


def speeds_about(model: SignalModel, max_speed: float) -> Float:
    """Speeds (V,) inside and outside the searched region, three for each that the link resolves."""
    bin_width = model.waveform.wavelength / np.ptp(model.schedule.times)
    far = int(np.ceil(3 * FARTHEST * max_speed / bin_width))
    return bin_width / 3 * np.arange(-far, far + 1)


def along_speeds(floor: Floor, path: Geometry, speeds: Float, grids: Ends) -> tuple[Geometry, Float]:
    """Points at all ``speeds``, each in the direction of ``grids`` (A, 3), (D, 3) that explains most where the time mode
    tells directions, and their energies (V,).
    """
    mode = floor.data.model.bands[0].modes[1]
    assert isinstance(mode, TimeMode)
    fiber = floor.along(path, 1, CANDIDATE).reshape(len(mode.times), mode.ports)
    beam, sent, departures = np.zeros(len(mode.times), int), np.ones((1, 1), complex), path.departure
    setting, heard, arrivals = np.zeros(len(mode.times), int), np.ones((1, 1, 1), complex), path.arrival
    if mode.transmitter is not None and mode.precoders is not None and mode.precoder_index is not None:
        departures = np.concatenate([path.departure, grids[1]])
        beam, sent = mode.precoder_index, mode.transmitter.response(departures)[0].conj() @ mode.precoders.T
    if mode.receiver is not None and mode.combiners is not None and mode.combiner_index is not None:
        arrivals = np.concatenate([path.arrival, grids[0]])
        setting, heard = mode.combiner_index, np.tensordot(mode.receiver.response(arrivals)[0], mode.combiners, (1, 2))
    beams, settings = sent.shape[1], heard.shape[1]
    looks = np.zeros((beams * settings, len(mode.times)), np.float32)
    looks[beam * settings + setting, np.arange(len(mode.times))] = 1
    counts = looks.sum(axis=1).reshape(beams, settings)
    norm = np.abs(sent) ** 2 @ counts @ np.sum(np.abs(heard) ** 2, axis=2).T
    energy, departure, arrival = np.empty(len(speeds)), np.empty(len(speeds), int), np.empty(len(speeds), int)
    turned = mode.times / mode.wavelength
    late = 0 if mode.offsets is None else mode.offsets * path.delay
    for number, speed in enumerate(speeds):
        still: Complex = fiber * np.exp(2j * np.pi * (late - turned * speed))[:, None]
        seen = (looks @ still).reshape(beams, -1)
        power = np.abs(sent.conj() @ seen @ heard.reshape(len(heard), -1).conj().T) ** 2 / np.maximum(norm, 1e-300)
        departure[number], arrival[number] = np.unravel_index(np.argmax(power), power.shape)
        energy[number] = power.max()
    return Geometry(np.repeat(path.delay, len(speeds)), arrivals[arrival], departures[departure], speeds), energy


def along_delays(floor: Floor, path: Geometry) -> tuple[Geometry, Float]:
    """Points at all delays that the pilots tell apart, and their energies."""
    model = floor.data.model
    delay = np.arange(0, model.max_delay, 1 / (3 * model.waveform.bandwidth))
    points = replace(path.take(np.zeros(len(delay), int)), delay=delay)
    vectors = model.bands[0].modes[0].vector(points)
    fiber = floor.along(path, 0, CANDIDATE)
    return points, np.abs(vectors.conj() @ fiber) ** 2 / np.maximum(np.sum(np.abs(vectors) ** 2, axis=1), 1e-300)


def beyond(
    floor: Floor, path: Geometry, energy: float, max_delay: float, max_speed: float, grids: Ends
) -> Geometry | None:
    """The point outside the region whose side lobe ``path`` (one, of so much energy) is, or None.

    A point that another one inside explains as well, for instance a speed that symbols too far apart cannot tell from it, is
    none. Shifted pilots make a delay show in two modes; there only speeds are looked at.
    """
    model = floor.data.model
    if model.subbands > 1 or model.weight is not None:
        return None
    lines = []
    if model.active[5] and max_speed > 0:
        lines.append(along_speeds(floor, path, speeds_about(model, max_speed), grids))
    if model.active[0] and model.schedule.offsets is None and max_delay < model.max_delay * (1 - 1e-6) < np.inf:
        lines.append(along_delays(floor, path))
    best = None
    for points, power in lines:
        outside = (np.abs(points.speed) > max_speed) | (points.delay > max_delay)
        inside = max(energy, power[~outside].max(initial=0.0))
        power = np.where(outside, power, -1.0)
        if power.max() < SCALLOPED * HIGHER * inside:
            continue
        # Of several that explain it alike the nearest one.
        alike = np.flatnonzero(power > power.max() / HIGHER)
        near = int(alike[np.argmin(np.abs(points.speed[alike]) + points.delay[alike])])
        first = max(near - 2, 0)
        top = points.take([first + int(np.argmax(power[first : near + 3]))])
        rest = ResidualProjector(floor.data, floor.known)
        top, polished = separate_fit(rest, top, floor.variance, np.inf, iterations=12)
        if polished[0] > HIGHER * inside and (abs(top.speed[0]) > max_speed or top.delay[0] > max_delay):
            best, energy = top, float(polished[0]) / HIGHER
    return best
