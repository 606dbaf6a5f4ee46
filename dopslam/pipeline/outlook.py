"""What a run will see, from a few traced steps, before anything is estimated: landmarks, their strength, and what is in the
way of them.

All of it is told with a remedy, and none ends a run, but that no path is seen at all; what else would is found by
:mod:`dopslam.pipeline.preflight`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dopslam.config.arrays import PlanarArray
from dopslam.config.scenario import Scenario
from dopslam.models.detection import probability_from_snr
from dopslam.pipeline import link
from dopslam.pipeline.preflight import Finding
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths, Track
from estimation import SignalModel, snr
from estimation.ambiguities import LIMIT, ambiguity

STEPS = 6  # that are looked at
THRESHOLD = 26.0  # on ρ, near what the estimators take for a false path in a hundred snapshots
UNRESOLVED = 0.1  # of a path's ρ alone, left where its neighbors' gains are unknown as well
MEMORY = 2e9  # bytes of one snapshot and its copies
SLOWEST_TURN = 2 * math.pi  # rad, beyond which a heading is asked about


@dataclass(frozen=True)
class Expected:
    """One landmark: at how many of the steps looked at it has a path, and how well that is seen.

    Attributes
    ----------
    name : str
    steps : int, of ``of``
    rho_db : median post-integration SNR, −inf if the arrays do not see it
    detection : mean probability of detection where there is a path
    """

    name: str
    steps: int
    of: int
    rho_db: float
    detection: float


@dataclass(frozen=True)
class Outlook:
    """Landmarks in their order, and what is worth saying."""

    landmarks: tuple[Expected, ...]
    findings: tuple[Finding, ...]


def chosen_steps(steps: int) -> np.ndarray:
    """The steps that are looked at, over the whole drive."""
    return np.unique(np.linspace(0, steps - 1, STEPS).round().astype(int))


def outlook(
    scenario: Scenario, track: Track, landmarks: Landmarks, paths: Paths, steps: np.ndarray | None = None
) -> Outlook:
    """Look ahead.

    Parameters
    ----------
    track, paths : of the same steps
    steps : which of them to look at; None: a few over the whole drive
    """
    steps = chosen_steps(paths.steps) if steps is None else steps
    model, noise = link.signal_model(scenario), link.noise_variance(scenario)
    rho, unresolved = np.zeros(len(paths.a)), np.zeros(len(paths.a), dtype=bool)
    for step in steps:
        rows = paths.rows(step)
        if rows.start == rows.stop:
            continue
        table = link.path_table(scenario, track, paths, step)
        rho[rows] = snr(model, table, noise)
        unresolved[rows] = _crowded(model, table, rho[rows], noise)
    looked = np.isin(paths.step_of_row, steps)
    rows = [_expected(landmarks, index, paths, rho, looked, len(steps)) for index in range(len(landmarks))]
    findings = [
        *_reach(scenario, track, paths, looked, model),
        *_speeds(scenario, model),
        *_behind(scenario, track, paths, looked),
        *_weak(rows),
        *_close(landmarks, paths, looked & unresolved, steps),
        *_dark(paths, rho, steps),
        *_odd(scenario),
        *_size(scenario, model),
    ]
    return Outlook(tuple(rows), tuple(findings))


def _expected(landmarks: Landmarks, index: int, paths: Paths, rho, looked, steps: int) -> Expected:
    mine = rho[looked & (paths.landmark == index)]
    seen = len(np.unique(paths.step_of_row[looked & (paths.landmark == index)]))
    median = float(np.median(mine)) if len(mine) else 0.0
    found = float(np.mean(probability_from_snr(mine, THRESHOLD))) if len(mine) else 0.0
    return Expected(
        str(landmarks.name[index]), seen, steps, 10 * math.log10(median) if median > 0 else -math.inf, found
    )


def _crowded(model: SignalModel, table, rho: np.ndarray, noise: float) -> np.ndarray:
    """Paths (P,) of which the others leave less than a share of UNRESOLVED of what they would be alone."""
    alone = np.array([snr(model, _only(table, i), noise)[0] for i in range(len(table))])
    return (alone > THRESHOLD) & (rho < UNRESOLVED * alone)


def _only(table, index: int):
    one = slice(index, index + 1)
    return replace(
        table, delay=table.delay[one], aoa=table.aoa[one], aod=table.aod[one],
        radial_velocity=table.radial_velocity[one], gain=table.gain[one],
    )  # fmt: skip


def _reach(scenario: Scenario, track: Track, paths: Paths, looked, model: SignalModel) -> list[Finding]:
    """Delays within the unambiguous region of the pilots."""
    reach = model.max_delay * SPEED_OF_LIGHT
    if not looked.any() or not reach:
        return []
    lengths = paths.tau[looked] * SPEED_OF_LIGHT
    spread, uncertain = float(np.ptp(lengths)), 6 * scenario.track.start_std[3]
    if spread + uncertain <= reach:
        return []
    key, value = "comb", scenario.radio.comb
    if scenario.radio.stagger is not None:
        key, value = "subcarrier_spacing", scenario.radio.subcarrier_spacing
    least = max(1, int(value * reach / (1.2 * (spread + uncertain))))
    return [
        Finding(
            "radio",
            f"paths of {lengths.min():.0f} to {lengths.max():.0f} m and a clock known to ±{uncertain / 2:.1f} m do not fit "
            f"into the {reach:.0f} m that the pilots tell apart; set radio.{key} = {least}",
            fatal=False,
        )
    ]


def _speeds(scenario: Scenario, model: SignalModel) -> list[Finding]:
    """Speeds within what is searched, and beams that do not look like Doppler."""
    found, searched = [], scenario.estimator.max_radial_velocity
    if scenario.track.speed > searched:
        found.append(
            Finding(
                "estimator",
                f"the receiver drives {scenario.track.speed:g} m/s, but paths are searched up to {searched:g} m/s; set "
                f"estimator.max_radial_velocity = {1.25 * scenario.track.speed:.3g}",
                fatal=False,
            )
        )
    examined = ambiguity(model, searched)
    if model.schedule.precoders is not None and examined.level.max() > LIMIT:
        where = ", ".join(f"{speed:.1f}" for speed in examined.ambiguous_speeds[:3])
        what = f'beams and Doppler look alike at speed differences of {where} m/s; use radio.beams.order = "permuted"'
        found.append(Finding("radio", what, fatal=False))
    return found


def _behind(scenario: Scenario, track: Track, paths: Paths, looked) -> list[Finding]:
    """Paths behind a panel: folded to the front by isotropic elements, and never seen by others."""
    found = []
    rows = np.flatnonzero(looked)
    heading = track.heading[paths.step_of_row[rows]]
    ends = (
        ("base_station", scenario.base_station.array, paths.phi_t[rows] - math.radians(scenario.base_station.yaw_deg), paths.theta_t[rows]),
        ("receiver", scenario.receiver.array, paths.phi_r[rows] - heading, paths.theta_r[rows]),
    )  # fmt: skip
    for name, array, azimuth, zenith in ends:
        if not isinstance(array, PlanarArray) or not len(rows):
            continue
        behind = np.sin(zenith) * np.cos(azimuth) < 0
        count = int(behind.sum())
        if not count:
            continue
        if array.pattern != "cosine":
            what = (
                f"{count} of {len(rows)} paths lie behind this panel of {array.pattern} elements, which takes them for paths "
                f'in front: every one is a false detection; set {name}.array.pattern = "cosine", or use a cylinder'
            )
        else:
            remedy = "turn base_station.yaw_deg" if name == "base_station" else "use a cylinder to see all around"
            what = f"{count} of {len(rows)} paths lie behind this panel and are not seen; {remedy} if they matter"
        found.append(Finding(f"{name}.array", what, fatal=False))
    return found


def _weak(rows: list[Expected]) -> list[Finding]:
    """Landmarks that are there and will hardly ever be detected."""
    weak = [row for row in rows if row.steps and math.isfinite(row.rho_db) and row.detection < 0.5]
    if not weak:
        return []
    rho = [row.rho_db for row in weak]
    lacking = [max(0, math.ceil(10 * math.log10(2 * THRESHOLD) - level)) for level in (max(rho), min(rho))]
    named = ", ".join(f"{row.name} ({row.rho_db:.0f} dB)" for row in weak[:4]) + (" …" if len(weak) > 4 else "")
    what = (
        f"{len(weak)} of {sum(bool(row.steps) for row in rows)} landmarks are too weak to be detected often: {named}; "
        f"raise source.traced.transmit_power_dbm by {lacking[0]} dB for the first of them, {lacking[1]} dB for all"
    )
    return [Finding("link", what, fatal=False)]


def _close(landmarks: Landmarks, paths: Paths, close: np.ndarray, steps: np.ndarray) -> list[Finding]:
    """Paths that the signal cannot tell apart."""
    if not close.any():
        return []
    names, counts = np.unique(landmarks.name[paths.landmark[close]], return_counts=True)
    order = np.argsort(-counts)[:4]
    named = ", ".join(f"{names[i]} at {counts[i]} of {len(steps)} steps" for i in order)
    what = (
        f"paths too close to others to be told apart: {named}{' …' if len(names) > 4 else ''}; more radio.bandwidth or "
        "larger arrays separate them"
    )
    return [Finding("radio", what, fatal=False)]


def _dark(paths: Paths, rho: np.ndarray, steps: np.ndarray) -> list[Finding]:
    """Steps at which there is too little to find a position from."""
    if not any(paths.rows(step).stop > paths.rows(step).start for step in steps):
        what = (
            f"no path leads from the base station to the receiver at any of the {len(steps)} steps looked at; one of them is "
            "outside of the walls, or hidden: see base_station.position, [track] start and receiver.height"
        )
        return [Finding("scene", what)]
    counts = np.array([int((rho[paths.rows(step)] > THRESHOLD).sum()) for step in steps])
    if not np.any(counts < 2):
        return []
    which = ", ".join(str(step) for step in steps[counts < 2])
    what = (
        f"fewer than two paths can be detected at step {which} (of the {len(steps)} looked at): position and clock are not "
        "both observable there; more power, another place for the base station, or small objects ([[scatter_point]]) help"
    )
    return [Finding("track", what, fatal=False)]


def _odd(scenario: Scenario) -> list[Finding]:
    """Numbers that look as if they were in other units."""
    found, heading, rate = [], scenario.track.start[2], scenario.track.turn_rate
    if abs(heading) > SLOWEST_TURN:
        what = f"start has the heading {heading:g} rad; if degrees were meant, write {math.radians(heading):.4g}"
        found.append(Finding("track", what, fatal=False))
    if abs(rate) > math.pi:
        what = f"turn_rate = {rate:g} rad/s; if degrees per second were meant, write {math.radians(rate):.4g}"
        found.append(Finding("track", what, fatal=False))
    if (
        0 < abs(scenario.base_station.yaw_deg) < math.pi
        and abs(math.remainder(scenario.base_station.yaw_deg, math.pi / 4)) < 1e-3
    ):
        what = (
            f"yaw_deg = {scenario.base_station.yaw_deg:g} is in degrees; if radians were meant, write "
            f"{math.degrees(scenario.base_station.yaw_deg):.1f}"
        )
        found.append(Finding("base_station", what, fatal=False))
    return found


def _size(scenario: Scenario, model: SignalModel) -> list[Finding]:
    """Snapshots that are large."""
    needed = 6 * 8 * math.prod(model.shape)  # as sent, received, residual and transformed
    if needed < MEMORY:
        return []
    what = (
        f"a snapshot of {' × '.join(map(str, model.shape))} samples takes some {needed / 1e9:.1f} GB while it is estimated; "
        "fewer radio.subcarriers (a larger comb), radio.beams.sweeps or elements take less"
    )
    return [Finding("radio", what, fatal=False)]
