"""The table a run ends with, as a rich table and as text."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.table import Table

from dopslam.evaluate.run import Evaluation


def run_table(summary: dict) -> Table:
    """Figures of every filter variant, one column each.

    Parameters
    ----------
    summary : the content of ``summary.json``; its ``variants`` map a name to figures
    """
    variants = summary["variants"]
    table = Table(
        title=f"{summary['scenario']}, seed {summary['seed']}", title_justify="left", box=None, pad_edge=False
    )
    table.add_column("")
    for name in variants:
        table.add_column(name.replace(", ", "\n"), justify="right")
    for label, text in _shown(variants):
        table.add_row(label, *(text(v) for v in variants.values()), style="bold red" if label == "diverged" else None)
    table.caption = (
        "RMSE: root mean square over the steps; in brackets its ratio to the bound's (PEB, HEB, CEB).\n"
        f"GOSPA, and landmarks and walls found within {summary['found_within_m']:g} m, at the last step.\n"
        "VA: virtual anchor, SP: scatter point."
    )
    whole = [name for name, figures in variants.items() if figures.get("bound") == "smoothing"]
    if whole:
        table.caption += f"\nThe bound of {', '.join(whole)} is that of the whole run (smoothing)."
    for name, figures in variants.items():
        if (bound := figures.get("bound", "")).startswith("lag "):
            table.caption += (
                f"\nThe bound of {name} knows the detections up to {bound.removeprefix('lag ')} steps later."
            )
    table.caption_justify = "left"
    return table


def cells(summary: dict) -> list[list[str]]:
    """The same table as rows of text, the first row holding the filters' names."""
    variants = summary["variants"]
    return [["", *variants], *([label, *(text(v) for v in variants.values())] for label, text in _shown(variants))]


def steps_csv(time: np.ndarray, evaluations: Mapping[str, Evaluation]) -> str:
    """Errors of every filter at every step, signed where they have a sign, as the text of ``errors.csv``."""
    columns = {
        "position_error_m": lambda e: e.position_error,
        "heading_error_deg": lambda e: np.degrees(e.heading_error),
        "clock_bias_error_m": lambda e: e.bias_error,
        "peb_m": lambda e: e.peb,
        "heb_deg": lambda e: np.degrees(e.heb),
        "ceb_m": lambda e: e.ceb,
        "nees": lambda e: e.nees,
        "gospa_va_m": lambda e: e.gospa_va,
        "gospa_sp_m": lambda e: e.gospa_sp,
    }
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(["filter", "step", "time_s", *columns])
    for name, evaluation in evaluations.items():
        table = np.column_stack([column(evaluation) for column in columns.values()])
        for step, (moment, row) in enumerate(zip(time, table, strict=True)):
            lines.writerow([name, step + 1, f"{moment:.9g}", *(f"{value:.9g}" for value in row)])
    return out.getvalue()


def _shown(variants: dict) -> list:
    """The rows that say something: without a lost filter none is about it, nor one about restarts without any."""

    def says(label: str) -> bool:
        if label in ("diverged", "restarted"):
            return any(v.get(label) for v in variants.values())
        if label.startswith(("GOSPA", "VAs", "SPs")):  # nothing is known of a map without a single true landmark
            return any(v["va_total"] + v["sp_total"] for v in variants.values())
        if label.startswith("NIS"):
            return any(v.get("nis_per_row") is not None for v in variants.values())
        if label.startswith("detections passed"):
            return any(v.get("detections_passed_over") for v in variants.values())
        return not label.startswith("walls") or any(v.get("walls_total") for v in variants.values())

    states = max((v.get("nees_states", 4) for v in variants.values()), default=4)
    return [(f"NEES (expect {states})" if label == "NEES" else label, text) for label, text in _ROWS if says(label)]


def _with_ratio(key: str, part: str):
    def cell(v: dict) -> str:
        if not _known(v[key]):
            return "–"
        ratio = v["rmse_over_bound"][part]
        return f"{v[key]:.4f}" + (f" ({ratio:.2f})" if _known(ratio) else "")

    return cell


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _number(key: str, digits: int):
    return lambda v: f"{v[key]:.{digits}f}" if _known(v.get(key)) else "–"


_ROWS = (
    ("diverged", lambda v: "YES" if v.get("diverged") else ""),
    ("restarted", lambda v: "yes" if v.get("restarted") else ""),
    ("position RMSE, m", _with_ratio("position_rmse_m", "position")),
    ("heading RMSE, °", _with_ratio("heading_rmse_deg", "heading")),
    ("clock bias RMSE, m", _with_ratio("clock_bias_rmse_m", "clock")),
    ("NEES", _number("nees", 1)),
    ("NIS per row (expect 1)", _number("nis_per_row", 2)),
    ("detections passed over (pieces of one path)", lambda v: f"{v.get('detections_passed_over', 0)}"),
    ("GOSPA of VAs, m", _number("gospa_va_m", 2)),
    ("GOSPA of SPs, m", _number("gospa_sp_m", 2)),
    ("VAs found", lambda v: f"{v['va_found']} of {v['va_total']}"),
    ("SPs found", lambda v: f"{v['sp_found']} of {v['sp_total']}"),
    ("walls off by, m", _number("wall_distance_m", 3)),
    ("walls turned by, °", _number("wall_angle_deg", 3)),
)


def ratios(results: dict[str, dict]) -> Table:
    """RMSE over bound of every filter with its 95 % interval."""
    many = len(results) > 1
    table = Table("", *(["filter"] if many else []), "RMSE / bound", "95 %", box=None)
    for name, result in results.items():
        for quantity, value in result["rmse_over_bound"].items():
            low, high = result["rmse_over_bound_interval"][quantity]
            table.add_row(quantity, *([name] if many else []), f"{value:.3f}", f"{low:.3f} – {high:.3f}")
    return table


def as_text(table: Table, width: int = 100) -> str:
    """The table as plain text."""
    buffer = io.StringIO()
    Console(file=buffer, width=width, color_system=None, markup=False).print(table)
    return buffer.getvalue()


def study_text(result: dict) -> str:
    """Tables of a traced study (``dopslam.studies.traced.study``) as Markdown: estimator, filters, gain of Doppler."""
    d = result["detections"]
    bands = ", ".join(f"{band} dB: {b['found']}/{b['of']}" for band, b in d["found_by_rho_db"].items() if b["of"])
    sight = sum(result["line_of_sight"]) / len(result["line_of_sight"])
    lines = [
        f"{result['scenario']}, seeds {result['seeds'][0]}–{result['seeds'][-1]}, line of sight in {sight:.0%} of the steps",
        "",
        f"Estimator {result['estimator_kind']}: {d['per_snapshot']:.2f} detections and {d['false_per_snapshot']:.3f} "
        f"false ones per snapshot, NEES/6 {d['nees_over_6']:.3f}; found by ρ: {bands}",
    ]
    for noise, title in (("estimator", "R of the estimator"), ("paper", "noise of paper A's R added")):
        if noise not in result:
            continue
        lines += [
            "",
            f"| {title} | position m | × PEB | heading ° | clock m | NEES | lost | GOSPA VA / SP m | within 1 m | of 2 reflections |",
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        for name, v in result[noise].items():
            if name == "doppler_gain":
                continue
            within, higher = v["landmarks_within_1_m"], v["higher_order_va_within_1_m"]
            lines.append(
                f"| {name} | {_with_interval(v['position_rmse_m'], 4)} | "
                f"{_with_interval(v['rmse_over_bound']['position'], 2)} | "
                f"{v['heading_rmse_deg']['mean']:.4f} | {v['clock_bias_rmse_m']['mean']:.4f} | "
                f"{_with_interval(v['nees'], 1)} | {v['lost']} | {v['gospa_va_m']['mean']:.2f} / {v['gospa_sp_m']['mean']:.2f} | "
                f"{within['found']} of {within['of']} | {higher['found']} of {higher['of']} |"
            )
        gains = result[noise]["doppler_gain"]
        if gains:
            lines += ["", "Position RMSE without over with Doppler, paired: " + "; ".join(
                f"{name} {_with_interval(gain, 2)}" for name, gain in gains.items()
            )]  # fmt: skip
    return "\n".join(lines) + "\n"


def _with_interval(value: dict, digits: int) -> str:
    return f"{value['mean']:.{digits}f} ({value['low']:.{digits}f}–{value['high']:.{digits}f})"
