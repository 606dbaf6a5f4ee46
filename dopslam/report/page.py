"""``report.html``: one run on one page that needs no network.

What happened in sentences, a replay in three dimensions with a time slider, the table beside the bounds, the figures, the
configuration and the versions. Scripts, style, pictures and data are all inside the file.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import pairwise

from matplotlib.figure import Figure

LEGEND = (
    ("#111111", "truth"),
    ("#0072b2", "estimated track"),
    ("#e69f00", "walls found, their virtual anchors"),
    ("#009e73", "scatter points"),
    ("#9aa5b1", "true rays of the step"),
    ("#d55e00", "base station"),
)
LAYERS = (
    ("scene", "scene"),
    ("rays", "true rays"),
    ("map", "map"),
    ("walls", "walls found"),
    ("truth", "truth"),
    ("names", "names"),
)
LISTED = 12  # walls that are told one by one


def report_page(
    summary: Mapping, table: list[list[str]], figures: Mapping[str, Figure], replay: Mapping, configuration: str
) -> str:
    """The page as text.

    Parameters
    ----------
    summary : the content of ``summary.json``
    table : rows of cells, the first row holds the filters' names
    figures : title → figure, drawn as SVG
    replay : tree of :func:`dopslam.report.replay.replay`
    configuration : the effective ``scenario.toml``
    """
    figure_list = "".join(svg(n, f) for n, f in figures.items())
    return document(
        f"{summary['scenario']}, seed {summary['seed']}",
        _subtitle(summary, replay),
        [
            _lead(summary),
            replay_section(replay, LEGEND, LAYERS),
            _walls_section(summary, replay),
            f'<section><h2>Errors beside their bounds</h2><div class="scroll">{table_of(table)}</div>{_reading(summary)}</section>',
            f'<section><h2>Figures</h2><div class="figures">{figure_list}</div></section>',
            details("Configuration", configuration),
            details(
                "Versions", "\n".join(f"{name} {version}" for name, version in summary.get("versions", {}).items())
            ),
        ],
        replay,
    )


def document(title: str, subtitle: Sequence[str], sections: Sequence[str], replay: Mapping) -> str:
    """A whole page: heading and sections of HTML, with scripts, style and the data of the replay inside."""
    return "\n".join([
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>dopslam: {escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<style>{_asset('page.css')}</style></head><body><main>",
        f"<header><h1>{escape(title)}</h1>{''.join(f'<p>{escape(line)}</p>' for line in subtitle)}</header>",
        *sections,
        "<footer>Made by dopslam. Drag to turn, pinch or scroll to zoom, right-drag or two fingers to move.</footer>",
        "</main>",
        f'<script type="application/json" id="replay-data">{_embedded(replay)}</script>',
        f"<script>{_asset('three.bundle.js')}</script>",
        f"<script>{_asset('replay.js')}</script>",
        "</body></html>",
    ]) + "\n"  # fmt: skip


def _asset(name: str) -> str:
    return (files("dopslam.report") / "assets" / name).read_text(encoding="utf-8")


def _embedded(tree: Mapping) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(tree, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _subtitle(summary: Mapping, replay: Mapping) -> list[str]:
    """Where the receiver went, in a sentence."""
    track, moment = replay["truth"]["position"], replay["time"]
    way = sum(math.dist(a, b) for a, b in pairwise(track))
    spent = sum(summary.get("seconds", {}).values())
    made = f", computed in {spent:.0f} s" if spent else ""
    (x, y, *_), (u, v, *_) = track[0], track[-1]
    return [
        f"A receiver moved {length_text(way)} in {moment[-1] - moment[0]:.1f} s, from x {x:.1f}, y {y:.1f} m to x {u:.1f}, "
        f"y {v:.1f} m. From the echoes of one base station it found where it was, which way it faced, and the walls and "
        "objects around it.",
        f"Filter {summary['filter']}{made}.",
    ]


def length_text(meters: float) -> str:
    """A length as a person says it."""
    for limit, unit, factor, digits in ((0.01, "mm", 1e3, 1), (1.0, "cm", 1e2, 1), (1e3, "m", 1.0, 2)):
        if abs(meters) < limit:
            return f"{factor * meters:.{digits}f} {unit}"
    return f"{meters / 1e3:.2f} km"


def card(figure: str, what: str, more: str) -> str:
    """A figure in large, what it is, and what stands beside it."""
    return f"<div><b>{escape(figure)}</b><span>{escape(what)}</span><i>{escape(more)}</i></div>"


def _cards(summary: Mapping) -> str:
    """The figures that a stranger asks for first."""
    v = summary["variants"][summary["filter"]]
    ratios, nees = v.get("rmse_over_bound", {}), v["nees"]

    def beside(part: str) -> str:
        ratio = ratios.get(part)
        return f"{ratio:.2f} times the bound" if ratio is not None and math.isfinite(ratio) else ""

    off = v.get("wall_distance_m")
    trust = "about right" if 2 <= nees <= 8 else "too narrow" if nees > 8 else "too wide"
    cards = [
        (length_text(v["position_rmse_m"]), "position error", beside("position")),
        (f"{v['heading_rmse_deg']:.3f}°", "heading error", beside("heading")),
        (
            f"{v.get('walls_found', v['va_found'])} of {v.get('walls_total', v['va_total'])}",
            "walls found",
            "" if off is None else f"{length_text(off)} off",
        ),
        *([(f"{v['sp_found']} of {v['sp_total']}", "small objects found", "scatter points")] if v["sp_total"] else []),
        (trust, "its own error bars", f"NEES {nees:.1f}, 4 expected"),
    ]
    return '<div class="cards">' + "".join(card(*one) for one in cards) + "</div>"


def _lead(summary: Mapping) -> str:
    name = summary["filter"]
    v = summary["variants"][name]
    ratio = v.get("rmse_over_bound", {}).get("position")
    beside = (
        f", {ratio:.2f} times the posterior Cramér–Rao bound, which no filter can stay below on average"
        if ratio is not None and math.isfinite(ratio)
        else ""
    )
    clock = v["clock_bias_rmse_m"]
    timed = (
        f" and its clock to {length_text(clock)} of light travel" if clock is not None and math.isfinite(clock) else ""
    )
    sentences = [
        f"The receiver was found to {length_text(v['position_rmse_m'])}{beside}; its heading to "
        f"{v['heading_rmse_deg']:.3f}°{timed} (root mean squares over the steps).",
        "A wall is found as the mirror image of the base station behind it, its virtual anchor; a scatter point is a small "
        "object that throws the wave about.",
    ]
    body = _cards(summary) + "".join(f'<p class="lead">{escape(s)}</p>' for s in sentences)
    lost = [n for n, figures in summary["variants"].items() if figures.get("diverged")]
    alarm = f'<p class="lead alarm">Diverged: {escape(", ".join(lost))}. Do not use this track.</p>' if lost else ""
    anew = "".join(
        f'<p class="lead">{escape(f"{name} lost the receiver and was started anew {why}.")}</p>'
        for name, why in ((n, figures.get("restarted")) for n, figures in summary["variants"].items())
        if why
    )
    return f"<section><h2>What came out</h2>{alarm}{body}{anew}</section>"


def replay_section(replay: Mapping, legend_of: Sequence[tuple[str, str]], layers: Sequence[tuple[str, str]]) -> str:
    """The replay with its slider, what can be hidden in it (key, label), and what its colors mean."""
    boxes = "".join(
        f'<label><input type="checkbox" data-layer="{key}" checked> {label}</label>' for key, label in layers
    )
    note = f'<p class="note">{escape(replay["note"])}</p>' if replay["note"] else ""
    legend = "".join(f'<li><i style="background:{color}"></i>{label}</li>' for color, label in legend_of)
    return (
        '<section><h2>Replay</h2><div id="replay-stage"></div>'
        '<div class="controls"><button id="replay-play" aria-label="play">▶</button>'
        '<input id="replay-step" type="range" min="0" value="0" aria-label="step"></div>'
        '<p id="replay-readout"></p>'
        f'<div class="controls"><label>filter <select id="replay-filter"></select></label>'
        '<label class="wide">show uncertainty larger <input id="replay-enlarge" class="small" type="range" min="0" max="2.5" step="0.1" '
        f'value="0"></label>{boxes}</div><ul class="legend">{legend}</ul>{note}</section>'
    )


def _walls_section(summary: Mapping, replay: Mapping) -> str:
    """Which walls were found, one by one, and which were not; nothing where no wall is known."""
    v = summary["variants"][summary["filter"]]
    if not v.get("walls_total") or "walls" not in v:
        return ""
    rows = [["wall", "seen over", "off by", "turned by", "its own ±"]]
    true = [wall for wall in v["walls"] if wall["name"]]
    for wall in true[:LISTED]:
        off, turned = length_text(wall["distance_m"]), f"{wall['angle_deg']:.2f}°"
        rows.append([wall["name"], length_text(wall["width_m"]), off, turned, f"± {length_text(1.96 * wall['std_m'])}"])
    found = {wall["name"] for wall in true}
    walls = [
        mark["name"].removeprefix("VA ") for mark in replay["landmarks"] if mark["kind"] == 1 and mark["order"] == 1
    ]
    missed = [name for name in walls if name not in found]
    rows += [[name, "not found", "", "", ""] for name in missed[:LISTED]]
    notes = [f"{len(true) - LISTED} more were found." if len(true) > LISTED else ""]
    if len(missed) > LISTED:
        notes.append(f"{len(missed) - LISTED} more were not found.")
    if unsure := [wall["name"] for wall in true if wall["distance_m"] > 3 * wall["std_m"]]:
        notes.append(f"Farther off than the filter thinks possible: {', '.join(unsure[:LISTED])}.")
    if false := len(v["walls"]) - len(true):
        notes.append(f"{false} of its walls {'is' if false == 1 else 'are'} none.")
    notes.append("Off and turned are from the true wall; ± is what the filter itself says, for 95 %.")
    told = " ".join(note for note in notes if note)
    table = f'<div class="scroll">{table_of(rows)}</div>' if len(rows) > 1 else ""
    return f'<section><h2>Walls it found</h2>{table}<p class="note">{escape(told)}</p></section>'


def table_of(rows: list[list[str]]) -> str:
    """A table whose first row heads its columns."""
    head, *body = rows
    return (
        f"<table><thead><tr>{''.join(f'<th>{escape(cell)}</th>' for cell in head)}</tr></thead><tbody>"
        + "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in body)
        + "</tbody></table>"
    )


def details(title: str, text: str) -> str:
    """A section that opens on demand."""
    return f"<section><details><summary>{title}</summary><pre>{escape(text)}</pre></details></section>"


CAPTIONS = {
    "plan": "Where it went and what it found: the true track and walls in black and gray, estimates in color. Ellipses and bands "
    "hold 95 % of what the filter thinks possible.",
    "errors": "Blue: how far off it was at every step. Orange: the standard deviation that the best filter would have.",
    "gospa": "How wrong the map is: missed and false landmarks and distances in one number that falls as the map is learned.",
    "found": "Where it went and what it found. Ellipses and bands hold 95 % of what the filter thinks possible.",
    "claimed": "The standard deviations that the filter gives for its own position, heading and clock.",
    "detections": "What the channel estimator reported (crosses) over what was there (circles).",
}


def _reading(summary: Mapping) -> str:
    """How the table is read, in words."""
    near = f"{summary['found_within_m']:g} m"
    return (
        '<p class="note">In brackets the error over its bound: 1 is the best that can be on average, one run may be luckier. NEES compares the errors with the '
        "filter's own covariance, 4 is right, more is overconfident. GOSPA counts missed, false and shifted landmarks, "
        f"0 is a perfect map, and one missed landmark alone makes it large. VA: virtual anchor, SP: scatter point; found means within {near} at the last step.</p>"
    )


def svg(name: str, figure: Figure) -> str:
    """The picture as an inline SVG element with its caption."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg")
    text = buffer.getvalue()
    caption = f"<figcaption>{escape(CAPTIONS[name])}</figcaption>" if name in CAPTIONS else ""
    return f"<figure>{text[text.index('<svg') :]}{caption}</figure>"
