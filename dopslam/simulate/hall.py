"""`measured_hall`: detections like those of a measurement campaign, with everything wrong that is wrong there.

A person carries a 60 GHz receiver through a hall, faces where it pleases, and stops for a snapshot now and then. All is
in the plane, there is no Doppler, and the clocks walk. Walls reflect once and twice, pillars stand in the way, objects as
high as people scatter, people pass and shadow paths for some positions. Angle errors have heavy tails, the orientation
of the base station is told wrong by 1.5°, and the covariances by a factor of two. Nothing of it is told to a filter: it
gets the detections, the base station, and that the receiver walks.

Paths are those of the image method; their strengths decide nothing but which are found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.models import unmeasured
from dopslam.models.measurement import BS, SP, VA, measure, wrap
from dopslam.models.paths import incidence, mirror
from dopslam.records import SPEED_OF_LIGHT, BaseStations, DetectionSeries, Landmarks, Track, edges_of

Array = NDArray[np.float64]

HEIGHT = 1.5  # m, of receiver, base station and everything else: the plane
TAIL = 3.0  # degrees of freedom of the angle errors
YAW_OFF = np.deg2rad(1.5)
REACH = 100.0  # m, width of the delays that are searched
DOPPLER = 2.0  # m/s, of the search that none was measured in
STRIDE = 0.55  # m between positions, on average
CLOCK_WALK = 0.15  # m per position


@dataclass(frozen=True, slots=True)
class Hall:
    """A drawn campaign: what a filter is told, and the truth.

    Attributes
    ----------
    stations : BaseStations; as told, the yaw off by 1.5°
    detections : DetectionSeries; covariances as told, off by a factor of two
    track, landmarks : the truth
    label : (N,) int; true landmark of each detection, -1 for false ones
    information : (N,) array; factor on the inverse of the told covariance that gives the Fisher information
    """

    stations: BaseStations
    detections: DetectionSeries
    track: Track
    landmarks: Landmarks
    label: NDArray[np.int64]
    information: Array


def measured_hall(seed: int, steps: int = 45) -> Hall:
    """Draw a hall, a walk and its detections; everything from the seed.

    Drawn anew until 20 to 30 % of the positions are without a line of sight.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(60,)))
    while True:
        drawn = _drawn(rng, steps)
        if drawn is not None:
            return drawn


def _drawn(rng: np.random.Generator, steps: int) -> Hall | None:
    size = np.array([rng.uniform(18, 34), rng.uniform(10, 20)])
    station = np.array([rng.uniform(0.2, 0.8) * size[0], rng.uniform(0.3, 1.0), HEIGHT])
    count = int(rng.integers(3, 6))
    pillars, radius = rng.uniform(0.15, 0.85, (count, 2)) * size, rng.uniform(0.25, 0.5, count)
    state = _walk(rng, size, pillars, radius, steps)
    landmarks = _landmarks(rng, size, station, pillars)
    seen = _visible(rng, state, landmarks, station, size, pillars, radius)
    if not 0.2 <= np.mean(~seen[:, 0]) <= 0.3:
        return None
    return _detected(rng, state, landmarks, station, seen)


def _walk(rng: np.random.Generator, size: Array, pillars: Array, radius: Array, steps: int) -> Array:
    """States (K, 4): positions that wander clear of walls and pillars, faces that follow the way only loosely."""
    place, course = rng.uniform(0.25, 0.75, 2) * size, rng.uniform(-np.pi, np.pi)
    facing, bias = rng.uniform(-np.pi, np.pi), rng.uniform(-20, 20)
    states = []
    for _ in range(steps):
        for _ in range(200):
            turned = course + rng.normal(0, 0.5)
            step = STRIDE * rng.uniform(0.6, 1.4)
            ahead = place + step * np.array([np.cos(turned), np.sin(turned)])
            inside = np.all((ahead > 1.0) & (ahead < size - 1.0))
            if inside and np.all(np.hypot(*(pillars - ahead).T) > radius + 0.4):
                break
            course += rng.uniform(-1, 1)
        place, course = ahead, turned
        facing += rng.normal(0, 0.25) + 0.2 * float(wrap(course - facing))
        bias += rng.normal(0, CLOCK_WALK)
        states.append([*place, float(wrap(facing)), bias])
    return np.array(states)


def _mirrored(point: Array, wall: int, size: Array) -> Array:
    """A point's image at wall 0 … 3: x = 0, x = width, y = 0, y = depth."""
    axis = wall // 2
    return mirror(point, np.eye(3)[axis], size[axis] if wall % 2 else 0.0)


def _landmarks(rng: np.random.Generator, size: Array, station: Array, pillars: Array) -> Landmarks:
    """Base station, its images at one and two walls, and what scatters: pillars and objects as high as people."""
    names, kind, place, order = ["BS"], [BS], [station], [0]
    for wall in range(4):
        names.append(f"VA {wall}")
        kind.append(VA)
        place.append(_mirrored(station, wall, size))
        order.append(1)
    for first, second in ((0, 2), (0, 3), (1, 2), (1, 3), (2, 3), (3, 2), (0, 1), (1, 0)):
        names.append(f"VA {first} > {second}")
        kind.append(VA)
        place.append(_mirrored(_mirrored(station, first, size), second, size))
        order.append(2)
    objects = np.vstack([pillars, rng.uniform(0.04, 0.96, (int(rng.integers(7, 13)), 2)) * size])
    for i, point in enumerate(objects):
        names.append(f"SP {i}")
        kind.append(SP)
        place.append(np.array([*point, HEIGHT]))
        order.append(1)
    return Landmarks(np.array(names), np.array(kind, np.int8), np.array(place), np.array(order))


def _crossed(start: Array, end: Array, pillars: Array, radius: Array) -> NDArray[np.bool_]:
    """Whether the ways (..., 2) → (..., 2) cross a pillar."""
    way = end - start
    length = np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
    along = np.einsum("...pi,...i->...p", pillars - start[..., None, :], way / length[..., None])
    nearest = (
        start[..., None, :] + np.clip(along, 0, length[..., None])[..., None] * (way / length[..., None])[..., None, :]
    )
    return np.any(np.linalg.norm(nearest - pillars, axis=-1) < 0.98 * radius, axis=-1)


def _visible(rng, state: Array, landmarks: Landmarks, station: Array, size: Array, pillars: Array, radius: Array):
    """(K, L) which paths are found: not behind a pillar, not shadowed by passers-by, strong enough."""
    steps, count = len(state), len(landmarks)
    here = np.column_stack([state[:, :2], np.full(steps, HEIGHT)])
    seen = np.ones((steps, count), bool)
    for i in range(count):
        target = landmarks.position[i]
        if landmarks.kind[i] == BS:
            turn = np.broadcast_to(station, here.shape)
        elif landmarks.kind[i] == SP:
            turn = np.broadcast_to(target, here.shape)
            near = np.linalg.norm(target[:2] - here[:, :2], axis=1)
            seen[:, i] &= near * np.linalg.norm(target - station) < rng.uniform(20, 90)
        elif landmarks.order[i] == 1:
            turn, fraction = incidence(here, np.broadcast_to(target, here.shape), station)
            seen[:, i] &= (
                (fraction > 0) & (fraction < 1) & np.all((turn[:, :2] > -1e-6) & (turn[:, :2] < size + 1e-6), axis=1)
            )
        else:  # a second reflection loses twice; which of them are strong is the walls' affair
            turn = here
            seen[:, i] = rng.random() < 0.5
        own = landmarks.kind[i] == SP and i < 13 + len(pillars)
        others = np.delete(np.arange(len(pillars)), i - 13) if own else np.arange(len(pillars))
        args = pillars[others], radius[others]
        seen[:, i] &= ~_crossed(here[:, :2], turn[:, :2], *args) & ~_crossed(
            turn[:, :2], np.broadcast_to(station[:2], (steps, 2)), *args
        )
        # Passers-by: a path is lost for a few positions and comes back.
        lost, back = (0.07, 0.35) if landmarks.kind[i] == BS else (0.12, 0.35)
        shadowed = rng.random() < lost / (lost + back)
        for k in range(steps):
            shadowed = rng.random() < (1 - back if shadowed else lost)
            seen[k, i] &= not shadowed
    return seen & (rng.random((steps, count)) < 0.92)


def _detected(rng, state: Array, landmarks: Landmarks, station: Array, seen) -> Hall:
    """The detections of the visible paths with their errors, and false ones, in the form of an imported file."""
    steps = len(state)
    yaw = rng.uniform(-np.pi, np.pi)
    told_yaw = yaw + YAW_OFF * rng.choice([-1, 1])
    told_factor = float(rng.choice([0.5, 2.0]))  # of the covariance
    exact = measure(state[:, None], landmarks.position, landmarks.kind.astype(np.int64), station, height=HEIGHT)
    double = landmarks.order == 2
    widths = np.array([REACH, 2 * np.pi, np.pi, 2 * np.pi, np.pi, 2 * DOPPLER])
    unseen = unmeasured.deviation(widths)
    z, std, label, counts = [], [], [], []
    for k in range(steps):
        rows = np.flatnonzero(seen[k])
        false = int(rng.poisson(0.7))
        scale = rng.uniform(0.7, 1.5, (len(rows) + false, 1))
        own = scale * [0.12, np.deg2rad(1.5), 0, np.deg2rad(1.5), 0, 0]
        values = exact[k, rows]
        # A double bounce leaves the base station in the direction that its two walls send back.
        values[double[rows], 3] = wrap(_first_way(values[double[rows], 1] + state[k, 2], landmarks, rows[double[rows]]))
        error = rng.standard_normal((len(rows), 6))
        error[:, [1, 3]] = rng.standard_t(TAIL, (len(rows), 2))
        low = exact[k, :, 0].min()
        wrong = np.zeros((false, 6))
        wrong[:, 0] = rng.uniform(low, low + 40, false)
        wrong[:, [1, 3]] = rng.uniform(-np.pi, np.pi, (false, 2))
        mixed = np.vstack([values + own[: len(rows)] * error, wrong])
        order = rng.permutation(len(mixed))
        z.append(mixed[order])
        std.append(own[order])
        label.append(np.concatenate([rows, np.full(false, -1)])[order])
        counts.append(len(mixed))
    z, std, label = np.concatenate(z), np.concatenate(std), np.concatenate(label)
    z[:, [2, 4, 5]] = 0.0
    covariance = np.zeros((len(z), 6, 6))
    covariance[:, range(6), range(6)] = np.where(
        [True, True, False, True, False, False], told_factor * std**2, unseen**2
    )
    units = np.array([1 / SPEED_OF_LIGHT, 1, 1, 1, 1, 1])
    detections = DetectionSeries(
        offsets=edges_of(counts),
        delay=z[:, 0] / SPEED_OF_LIGHT,
        aoa=np.column_stack([wrap(z[:, 1]), z[:, 2]]),
        aod=np.column_stack([wrap(z[:, 3] - yaw), z[:, 4]]),
        radial_velocity=z[:, 5],
        gain=np.zeros(len(z), complex),
        covariance=covariance * units[:, None] * units,
        snr=np.full(len(z), 100.0),
        noise_variance=np.ones(steps),
        threshold=10.0,
        false_alarm_rate=0.7,
        search_volume=unmeasured.volume(widths, np.array([False, False, True, False, True, True])),
        time=np.arange(1.0, steps + 1),
    )
    track = Track(
        time=np.arange(1.0, steps + 1),
        position=np.column_stack([state[:, :2], np.full(steps, HEIGHT)]),
        heading=state[:, 2],
        velocity=np.zeros((steps, 3)),
        bias=state[:, 3],
        start=state[0],
    )
    return Hall(
        BaseStations(station[None], np.array([told_yaw])), detections, track, landmarks, label,
        np.full(len(z), told_factor),
    )  # fmt: skip


def _first_way(arrival: Array, landmarks: Landmarks, which: NDArray[np.int64]) -> Array:
    """Departure azimuths of second reflections from their arrival azimuths in the world (towards the last wall).

    Backwards along the path each wall mirrors the direction: walls of one axis twice leave it, of both turn it about.
    """
    first = np.array([str(landmarks.name[i]).split()[1] for i in which]).astype(int)
    second = np.array([str(landmarks.name[i]).split()[-1] for i in which]).astype(int)
    same = first // 2 == second // 2
    return np.where(same, arrival + np.pi, arrival)
