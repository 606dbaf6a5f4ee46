"""``report.html``: one run on one page that needs no network.

What happened in sentences, a replay in three dimensions with a time slider, the table beside the bounds, the figures, the
configuration and the versions. Scripts, style, pictures and data are all inside the file.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from html import escape
from importlib.resources import files

from matplotlib.figure import Figure

LEGEND = (
    ("#111111", "truth"),
    ("#0072b2", "estimated track"),
    ("#e69f00", "virtual anchors, their walls"),
    ("#009e73", "scatter points"),
    ("#9aa5b1", "true rays of the step"),
    ("#d55e00", "base station"),
)
LAYERS = (("scene", "scene"), ("rays", "true rays"), ("map", "map"), ("walls", "walls found"), ("truth", "truth"))


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
    title = f"{summary['scenario']}, seed {summary['seed']}"
    return "\n".join([
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>dopslam: {escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<style>{_asset('page.css')}</style></head><body><main>",
        f"<header><h1>{escape(title)}</h1>{''.join(f'<p>{escape(line)}</p>' for line in _subtitle(summary))}</header>",
        _lead(summary),
        _replay_section(),
        f'<section><h2>Errors beside their bounds</h2><div class="scroll">{_table(table)}</div></section>',
        f'<section><h2>Figures</h2><div class="figures">{"".join(map(_svg, figures.values()))}</div></section>',
        _details("Configuration", configuration),
        _details("Versions", "\n".join(f"{name} {version}" for name, version in summary.get("versions", {}).items())),
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


def _subtitle(summary: Mapping) -> list[str]:
    seconds = summary.get("seconds")
    lines = [f"filter {summary['filter']}"]
    if seconds:
        lines.append("seconds: " + ", ".join(f"{stage} {value:.1f}" for stage, value in seconds.items()))
    return lines


def _lead(summary: Mapping) -> str:
    name = summary["filter"]
    v = summary["variants"][name]
    ratio = v.get("rmse_over_bound", {}).get("position")
    beside = f", {ratio:.2f} times the posterior Cramér–Rao bound" if ratio is not None and math.isfinite(ratio) else ""
    clock = v["clock_bias_rmse_m"]
    timed = f", its clock to {clock:.3f} m" if clock is not None and math.isfinite(clock) else ""
    sentences = [
        f"The receiver was found to {v['position_rmse_m']:.3f} m{beside}, its heading to "
        f"{v['heading_rmse_deg']:.3f}°{timed} (root mean squares over the steps).",
        f"In the final map: {v['va_found']} of {v['va_total']} reflecting walls (virtual anchors) and "
        f"{v['sp_found']} of {v['sp_total']} scatter points.",
    ]
    body = "".join(f'<p class="lead">{escape(s)}</p>' for s in sentences)
    lost = [n for n, figures in summary["variants"].items() if figures.get("diverged")]
    alarm = f'<p class="lead alarm">Diverged: {escape(", ".join(lost))}. Do not use this track.</p>' if lost else ""
    anew = "".join(
        f'<p class="lead">{escape(f"{name} lost the receiver and was started anew {why}.")}</p>'
        for name, why in ((n, figures.get("restarted")) for n, figures in summary["variants"].items())
        if why
    )
    return f"<section><h2>What came out</h2>{alarm}{body}{anew}</section>"


def _replay_section() -> str:
    boxes = "".join(
        f'<label><input type="checkbox" data-layer="{key}" checked> {label}</label>' for key, label in LAYERS
    )
    legend = "".join(f'<li><i style="background:{color}"></i>{label}</li>' for color, label in LEGEND)
    return (
        '<section><h2>Replay</h2><div id="replay-stage"></div>'
        '<div class="controls"><button id="replay-play" aria-label="play">▶</button>'
        '<input id="replay-step" type="range" min="0" value="0" aria-label="step"></div>'
        '<p id="replay-readout"></p>'
        f'<div class="controls"><label>filter <select id="replay-filter"></select></label>'
        '<label>ellipsoids and bands larger <input id="replay-enlarge" class="small" type="range" min="0" max="2.5" step="0.1" '
        f'value="0"></label>{boxes}</div><ul class="legend">{legend}</ul></section>'
    )


def _table(rows: list[list[str]]) -> str:
    head, *body = rows
    return (
        f"<table><thead><tr>{''.join(f'<th>{escape(cell)}</th>' for cell in head)}</tr></thead><tbody>"
        + "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in body)
        + "</tbody></table>"
    )


def _details(title: str, text: str) -> str:
    return f"<section><details><summary>{title}</summary><pre>{escape(text)}</pre></details></section>"


def _svg(figure: Figure) -> str:
    """The picture as an inline SVG element."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg")
    text = buffer.getvalue()
    return f"<figure>{text[text.index('<svg') :]}</figure>"
