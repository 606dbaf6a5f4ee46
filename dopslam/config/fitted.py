"""Defaults that fit themselves: what follows from carrier, bandwidth, base station and drive where it is not given.

A person says the carrier and perhaps the bandwidth, the arrays, where the base station is and looks, and where the receiver
goes. From that follow pilots that reach far enough, the region that the estimator searches, how far a drive may stray from
its model, and how densely unknown landmarks fill the space. Whatever the scenario gives itself is left alone.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dopslam.config.measured import Shown
    from dopslam.config.sections import Sections
    from dopslam.config.trackfile import Drive

SPEED_OF_LIGHT = 299_792_458.0  # m/s; dopslam.records has it too, but needs NumPy, which --help does without
# Up to a carrier [Hz]: bandwidth and subcarrier spacing [Hz] that are usual there (3GPP FR1, FR2-1, FR2-2).
USUAL = ((7.2e9, 100e6, 30e3), (24e9, 200e6, 60e3), (52.6e9, 192e6, 120e3), (math.inf, 800e6, 480e3))
PREFIX = 1.0704  # length of an OFDM symbol with its cyclic prefix, over 1/spacing
SYMBOL_WAVELENGTHS = 28e9 * 35.68e-6  # carrier times symbol period: a resolution of some 1.2 m/s at 128 symbols
MARGIN = 40.0  # m, beyond the longest path that is foreseen
FEWEST_PILOTS = 64
STRAY = 0.02  # of the way driven in a step
CLOCK = 0.05  # m/√s, walk of a clock
TURN, TURN_TIMES_SPEED = 0.01, 0.02  # rad/√s; m/√s³: a walker turns more freely than a car
UNKNOWN = {"intensity_va": 8.0, "intensity_sp": 80.0}  # landmarks within the farthest distance of the drive
SMALLEST_SPACE = 3.0  # m
WALKING = 3.0  # m/s, the fastest walk
SLOWEST_WALK = 0.05  # m/s per step
TURNED_IN = 1.5  # 1/s: two thirds of a second from straight ahead to the sharpest turn


def fitted(scenario: Sections, drive: Drive | None = None, shown: Shown | None = None) -> dict[str, Any]:
    """Values, by section and key, of what a scenario leaves open; ``model_fields_set`` tells what it gives.

    ``drive`` is its own, if it has one: how far it goes and its largest speed count; its turns and stops the filter does not
    know, only how sharply such a receiver can turn and accelerate. ``shown`` is what measurements show of one that nobody
    described.
    """
    far = reach(scenario, drive) if shown is None else max(SMALLEST_SPACE, shown.reach)
    speed = scenario.track.speed if drive is None else float(abs(drive.speed).max())
    speed = speed if shown is None else shown.speed
    agile = {} if drive is None and shown is None else _agility(scenario, speed)
    walks = (agile["speed_walk"], agile["turn_rate_walk"]) if agile else (0.0, 0.0)
    found = {
        "radio": _radio(scenario, far),
        "track": _track(scenario, speed, walks),
        "estimator": {"max_radial_velocity": float(round(max(1.25 * speed, speed + 1.5), 3))},
        "filter": _filter(far) | agile,
    }
    given = {name: getattr(scenario, name).model_fields_set for name in found}
    kept = {name: {k: v for k, v in keys.items() if k not in given[name]} for name, keys in found.items()}
    return {name: keys for name, keys in kept.items() if keys}


def reach(scenario: Sections, drive: Drive | None = None) -> float:
    """Farthest distance [m] between base station and receiver on the nominal drive, or on its own."""
    track, station = scenario.track, scenario.base_station.position
    if drive is not None:
        return max(SMALLEST_SPACE, *(math.dist(place, station) for place in drive.position.tolist()))
    x, y, heading, _ = track.start
    farthest = 0.0
    for step in range(0, track.steps + 1, max(1, track.steps // 50)):
        turned = track.turn_rate * track.period * step
        half = turned / 2
        chord = track.speed * track.period * step * (math.sin(half) / half if half else 1.0)
        place = x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), scenario.receiver.height
        farthest = max(farthest, math.dist(place, station))
    return max(farthest, SMALLEST_SPACE)


def _radio(scenario: Sections, far: float) -> dict[str, Any]:
    """Pilots as far apart as the longest delay allows: the power is shared by all of them, so more would tell no more."""
    radio, track = scenario.radio, scenario.track
    given = radio.model_fields_set
    usual = next(row for row in USUAL if radio.carrier_frequency <= row[0])
    spacing = radio.subcarrier_spacing if "subcarrier_spacing" in given else usual[2]
    bandwidth = radio.bandwidth or usual[1]
    longest = (2 + 2 * scenario.trace.max_depth) * far + MARGIN
    longest += abs(track.start[3]) + 3 * track.start_std[3]
    if "comb" in given or radio.stagger is not None:
        comb = radio.comb
    elif "subcarriers" in given:
        comb = max(1, round(bandwidth / (radio.subcarriers * spacing)))
    else:
        comb = max(1, min(int(SPEED_OF_LIGHT / (spacing * longest)), int(bandwidth / (FEWEST_PILOTS * spacing))))
    pilots = max(2, round(bandwidth / (comb * spacing))) if radio.pilots is None else len(radio.pilots)
    symbol = PREFIX / spacing
    return {
        "subcarrier_spacing": spacing,
        "comb": comb,
        "subcarriers": pilots,
        "symbol_period": symbol * max(1, round(SYMBOL_WAVELENGTHS / (radio.carrier_frequency * symbol))),
    }


def _track(scenario: Sections, speed: float, walks: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """How far a receiver strays in a step: aside, from unsteadiness; and by what its speed and turn rate (``walks`` [m/s,
    rad/s] a step) change while the step lasts, which a white acceleration over T integrates to T/√3 of the change."""
    period = scenario.track.period
    time, within = math.sqrt(period), period / math.sqrt(3)
    aside = math.hypot(max(1e-3, STRAY * speed * period), walks[0] * within)
    turn = math.hypot(min(TURN, TURN_TIMES_SPEED / speed if speed else TURN) * time, walks[1] * within)
    return {"process_std": tuple(float(f"{v:.3g}") for v in (aside, aside, turn, CLOCK * time))}


def _agility(scenario: Sections, speed: float) -> dict[str, Any]:
    """Speed and turn rate are unknown: a step changes them by the sharpest maneuver at most.

    Too small a walk loses the receiver at the first abrupt turn; three times too large a one costs nothing that could be
    measured, since detections tell a receiver's heading and speed far better than its past does.
    """
    track, car = scenario.track, speed > WALKING
    acceleration = track.max_acceleration or (3.0 if car else 1.5)
    turn = track.max_turn_rate or (0.6 if car else 1.5)
    return {
        "motion": "unknown",
        "speed_std": max(0.1, 0.2 * speed),
        "turn_rate_std": 0.5 * turn,
        "speed_walk": max(SLOWEST_WALK, min(acceleration * track.period, speed)),
        "turn_rate_walk": turn * min(TURNED_IN * track.period, 1.0),
    }


def _filter(far: float) -> dict[str, Any]:
    space = 4 / 3 * math.pi * far**3
    return {name: float(f"{count / space:.3g}") for name, count in UNKNOWN.items()}
