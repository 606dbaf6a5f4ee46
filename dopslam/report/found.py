"""``report.html`` of a run whose truth nobody knows: what the filter found, and how sure it says it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from dopslam.evaluate.walls import Walls
from dopslam.records import Kind
from dopslam.report.page import card, details, document, length_text, replay_section, svg, table_of
from dopslam.slam.history import History

LEGEND = (
    ("#0072b2", "estimated track"),
    ("#e69f00", "walls found, their virtual anchors"),
    ("#009e73", "scatter points"),
    ("#d55e00", "base station"),
)
LAYERS = (("map", "map"), ("walls", "walls found"), ("names", "names"))
NOBODY_KNOWS = (
    "No true track is beside this run, so nothing here says how far off it was: the figures are what the filter itself "
    "claims. NIS per row near 1 says that the detections are as far from the map as their covariances and the map's allow; "
    "well above 1 they are farther, and the claims are too bold."
)


def found_page(
    name: str,
    runs: Mapping[str, tuple[History, Walls]],
    main: str,
    threshold: float,
    figures: Mapping[str, Figure],
    replay: Mapping,
    configuration: str,
    versions: Mapping[str, str],
) -> str:
    """The page as text.

    Parameters
    ----------
    name : of the scenario
    runs : history and final walls by filter; main : the one that leads
    threshold : least existence of a landmark that is reported
    figures : title → figure
    replay : tree of :func:`dopslam.report.replay.replay`, made without a truth
    configuration : the effective ``scenario.toml``
    """
    history, walls = runs[main]
    rows = [["", *runs], *([label, *(cell(*run, threshold) for run in runs.values())] for label, cell in _ROWS)]
    lost = [n for n, (found, _) in runs.items() if found.lost]
    alarm = "".join(
        f'<p class="lead alarm">{escape(f"{n} lost the receiver: {runs[n][0].lost}. Do not use this track.")}</p>'
        for n in lost
    )
    lead = f'<p class="lead">{escape(NOBODY_KNOWS)}</p>'
    return document(
        name,
        [_way(replay, main), f"Filter {main}."],
        [
            f"<section><h2>What it found</h2>{alarm}{_cards(history, walls, threshold)}{lead}</section>",
            replay_section(replay, LEGEND, LAYERS),
            _walls_section(walls),
            f'<section><h2>What every filter says</h2><div class="scroll">{table_of(rows)}</div></section>',
            f'<section><h2>Figures</h2><div class="figures">{"".join(svg(n, f) for n, f in figures.items())}</div></section>',
            details("Configuration", configuration),
            details("Versions", "\n".join(f"{package} {version}" for package, version in versions.items())),
        ],
        replay,
    )


def _way(replay: Mapping, main: str) -> str:
    """Where the receiver went by its own account."""
    track, moment = replay["filters"][main]["position"], replay["time"]
    way = sum(math.dist(a, b) for a, b in pairwise(track))
    (x, y, *_), (u, v, *_) = track[0], track[-1]
    return (
        f"By its own account the receiver moved {length_text(way)} in {moment[-1] - moment[0]:.1f} s, from x {x:.1f}, "
        f"y {y:.1f} m to x {u:.1f}, y {v:.1f} m. All of this was found from the echoes of a base station."
    )


def _count(history: History, kind: Kind, threshold: float) -> int:
    last = history.rows(history.steps - 1)
    return int(np.sum((history.existence[last] > threshold) & (history.kind[last] == kind)))


def _deviation(history: History, part: slice) -> float:
    """Root of the mean over the steps of the variance of a part of the state."""
    return float(np.sqrt(np.mean(np.trace(history.covariance[:, part, part], axis1=1, axis2=2))))


def _nis(history: History, *_) -> str:
    return f"{history.nis_per_row:.2f}" if math.isfinite(history.nis_per_row) else "–"


_ROWS = (
    ("lost", lambda history, walls, threshold: "YES" if history.lost else "no"),
    ("says of its position, m", lambda history, *_: f"± {_deviation(history, slice(0, 2)):.4f}"),
    ("says of its heading, °", lambda history, *_: f"± {math.degrees(_deviation(history, slice(2, 3))):.4f}"),
    ("says of its clock bias, m", lambda history, *_: f"± {_deviation(history, slice(3, 4)):.4f}"),
    ("NIS per row (expect 1)", _nis),
    ("walls", lambda history, walls, threshold: str(len(walls))),
    ("scatter points", lambda history, walls, threshold: str(_count(history, Kind.SP, threshold))),
)


def _cards(history: History, walls: Walls, threshold: float) -> str:
    heading = math.degrees(_deviation(history, slice(2, 3)))
    cards = [
        (f"± {length_text(_deviation(history, slice(0, 2)))}", "says of its position", "standard deviation"),
        (f"± {heading:.3f}°", "says of its heading", "standard deviation"),
        (str(len(walls)), "walls found", ""),
        (str(_count(history, Kind.SP, threshold)), "small objects found", "scatter points"),
        (_nis(history), "NIS per row", "1 expected"),
    ]
    return f'<div class="cards">{"".join(card(*one) for one in cards)}</div>'


def _walls_section(walls: Walls) -> str:
    """Wall by wall, the widest seen first."""
    if not len(walls):
        return ""
    width = np.linalg.norm(walls.corners[:, 1] - walls.corners[:, 0], axis=-1)
    rows = [["wall", "faces", "seen over", "middle at x, y, z", "its own ±"]]
    for i in np.argsort(-width, kind="stable").tolist():
        x, y, z = np.round(walls.center[i], 1) + 0.0  # no −0.0
        rows.append([
            str(walls.track[i]), _facing(walls.normal[i]), length_text(float(width[i])), f"{x:.1f}, {y:.1f}, {z:.1f} m",
            f"± {length_text(1.96 * float(walls.deviation[i]))}",
        ])  # fmt: skip
    note = "Faces: azimuth, from the x axis, in which the base station lies. ±: what the filter says of the distance, for 95 %."
    table = f'<div class="scroll">{table_of(rows)}</div>'
    return f'<section><h2>Walls it found</h2>{table}<p class="note">{escape(note)}</p></section>'


def _facing(normal: np.ndarray) -> str:
    """Where a wall looks: towards the base station, against its normal."""
    if np.hypot(*normal[:2]) < 0.5:
        return "up" if normal[2] < 0 else "down"
    return f"{round(math.degrees(math.atan2(-normal[1], -normal[0]))) % 360}°"
