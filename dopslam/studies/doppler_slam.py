"""Paper A's Figs. 2-5 and its table of correct associations, computed and drawn.

What the paper leaves open is set as for its reference figures: p_D = 0.9, SPs seen within 50 m, one clutter
measurement per scan, p_S = 1. Fig. 2: nominal track, everything visible, p_D = 1; PEB, HEB, CEB averaged over
the 40 steps, LEB averaged over the landmarks at the last step. Figs. 3-5: the paper's filter, and ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dopslam.evaluate.bounds import situation_bound
from dopslam.filters import FILTERS
from dopslam.pipeline.problem import told
from dopslam.report.figures import house_style
from dopslam.simulate.world import section_v, unknown_motion
from dopslam.slam.pmb.filters import Joint, Smoother
from dopslam.studies.montecarlo import Study, run_study, summarize

WITH, WITHOUT = "#0072B2", "#D55E00"
FLOOR = "#6b7280"
DOPPLER_STDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
INTENSITIES = (1e-6, 1.5e-5, 1e-4, 2e-4, 2.5e-4, 2.9e-4, 5e-4, 1e-3)
CASES = {"Doppler": True, "no Doppler": False}
PAPER_WEIGHTS = {"Doppler": 0.8622, "no Doppler": 0.6763}

Report = Callable[[str], None]


def figure_2_data(prior: str = "std") -> dict[str, Any]:
    """Bounds over σ_d, and without Doppler."""

    def averages(doppler_std: float, doppler: bool) -> dict[str, float]:
        bound = situation_bound(section_v(doppler_std, prior), doppler=doppler)
        return {
            "peb_m": float(bound.peb.mean()),
            "heb_deg": float(np.degrees(bound.heb.mean())),
            "ceb_m": float(bound.ceb.mean()),
            "leb_m": float(bound.leb[-1, 1:].mean()),
        }

    return {
        "doppler_std": list(DOPPLER_STDS),
        "bounds": [averages(std, True) for std in DOPPLER_STDS],
        "no_doppler": averages(0.1, False),
    }


def filter_cases(runs: int, seed: int, jobs: int, prior: str = "std") -> dict[str, dict[str, Any]]:
    """Monte Carlo summaries of the paper's filter and ours, with and without Doppler, on the same runs."""
    world = section_v(0.1, prior)
    result = {}
    for density in ("marginal", "joint"):
        for name, doppler in CASES.items():
            study = Study(world, FILTERS[density](iterations=2, doppler=doppler))
            result[f"{density}, {name}"] = summarize(run_study(study, runs, seed, jobs), study)
    return result


def association_table(runs: int, seed: int, jobs: int, joint: bool = False) -> list[dict[str, Any]]:
    """Mean weight of the correct association over the undetected intensity λ (VA = SP), which it measures."""
    rows = []
    for intensity in INTENSITIES:
        row: dict[str, Any] = {"intensity_per_m3": intensity}
        for name, doppler in CASES.items():
            chosen = FILTERS["joint" if joint else "marginal"](iterations=2, doppler=doppler)
            world = section_v(0.1)
            study = Study(world, chosen, replace(told(world), undetected=(intensity, intensity)))
            result = summarize(run_study(study, runs, seed, jobs), study)
            row[name] = result["correct_da_weight"]
            row[f"{name} interval"] = result["correct_da_weight_interval"]
        rows.append(row)
    return rows


def motion_studies(runs: int, seed: int, jobs: int) -> dict[str, dict[str, Any]]:
    """Speed and turn rate unknown; a 2 % error in a speed believed known, beside one that is estimated."""
    truth = section_v(0.1)
    motion: Any = truth.motion
    six = unknown_motion(truth)
    lively = unknown_motion(truth, speed_walk=0.5, rate_walk=0.02)
    off, joint = np.array([1, 1, 1, 1, 1.02, 1]), Joint(iterations=2)
    studies = {
        "unknown motion, joint": Study(six, joint),
        "unknown motion, livelier walk, smoother": Study(lively, Smoother(iterations=2)),
        "speed 2 % wrong, believed known": Study(
            truth, joint, replace(told(truth), motion=replace(motion, speed=1.02 * motion.speed))
        ),
        "speed 2 % wrong, in the state": Study(truth, joint, replace(told(six), mean=six.prior_mean * off)),
    }
    return {name: summarize(run_study(study, runs, seed, jobs), study) for name, study in studies.items()}


def figure_2(data: dict[str, Any]) -> Figure:
    """Four bounds over σ_d; the dashed line is without Doppler."""
    names = {"peb_m": "PEB [m]", "heb_deg": "HEB [°]", "ceb_m": "CEB [m]", "leb_m": "average LEB [m]"}
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    for axes, (key, label) in zip(figure.subplots(2, 2).ravel(), names.items(), strict=True):
        axes.semilogx(data["doppler_std"], [b[key] for b in data["bounds"]], "o-", color=WITH)
        axes.axhline(data["no_doppler"][key], color=WITHOUT, linestyle="--")
        axes.set(xlabel="σ_d [m/s]", ylabel=label, ylim=(0, None))
    lines = [Line2D([], [], color=WITH, marker="o"), Line2D([], [], color=WITHOUT, linestyle="--")]
    figure.legend(lines, ["with Doppler", "without"], loc="outside upper center", ncols=2, frameon=False)
    return figure


def figure_map(cases: dict[str, dict[str, Any]], key: str, label: str) -> Figure:
    """GOSPA over time as in Figs. 3 and 4, the paper's filter beside ours."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, density, title in zip(
        panels, ("marginal", "joint"), ("paper's filter (marginal)", "ours (joint)"), strict=True
    ):
        for name, color, style in (("Doppler", WITH, "-"), ("no Doppler", WITHOUT, "--")):
            values = cases[f"{density}, {name}"]["per_step"][key]
            axes.plot(
                range(1, len(values) + 1),
                values,
                color=color,
                linestyle=style,
                label=f"with {name}".replace("with no", "without"),
            )
        for missing in (4, 3, 2, 1):
            axes.axhline(np.sqrt(200 * missing), color=FLOOR, linewidth=0.5, linestyle=":")
        axes.set(title=title, xlabel="step")
    panels[0].set_ylabel(label)
    panels[1].legend(frameon=False)
    return figure


def figure_5(cases: dict[str, dict[str, Any]]) -> Figure:
    """RMSE of position, heading and clock bias, with the bounds as ticks."""
    parts = (
        ("position_rmse_m", "position_bound_m", 1.0, "position [m]"),
        ("heading_rmse_rad", "heading_bound_rad", 180 / np.pi, "heading [°]"),
        ("clock_rmse_m", "clock_bound_m", 1.0, "clock bias [m]"),
    )
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for axes, (rmse, bound, scale, label) in zip(figure.subplots(1, 3), parts, strict=True):
        for place, density in enumerate(("marginal", "joint")):
            for shift, name, color in ((-0.2, "Doppler", WITH), (0.2, "no Doppler", WITHOUT)):
                case = cases[f"{density}, {name}"]
                axes.bar(place + shift, scale * case[rmse], 0.38, color=color)
                level = scale * case[bound]
                axes.plot([place + shift - 0.19, place + shift + 0.19], [level, level], color="black", linewidth=2)
        axes.set_xticks([0, 1], ["paper's", "ours"])
        axes.set_ylabel(f"RMSE, {label}")
    lines = [Line2D([], [], color=c, linewidth=6) for c in (WITH, WITHOUT)] + [
        Line2D([], [], color="black", linewidth=2)
    ]
    figure.legend(lines, ["with Doppler", "without", "PCRB"], loc="outside upper center", ncols=3, frameon=False)
    return figure


def figure_table(rows: Sequence[dict[str, Any]]) -> Figure:
    """Weight of the correct association over λ, with the paper's two figures."""
    figure = Figure(figsize=(6, 3.8), layout="constrained")
    axes = figure.subplots()
    for name, color in (("Doppler", WITH), ("no Doppler", WITHOUT)):
        axes.semilogx([r["intensity_per_m3"] for r in rows], [r[name] for r in rows], "o-", color=color, label=name)
        axes.axhline(PAPER_WEIGHTS[name], color=color, linestyle=":")
    axes.set(xlabel="undetected intensity λ [1/m³]", ylabel="weight of the correct association", ylim=(0, 1.02))
    axes.legend(frameon=False)
    return figure


def reproduce(folder: Path, runs: int, seed: int, jobs: int, say: Report) -> dict[str, Any]:
    """Compute everything, write PNGs into `folder`, return the numbers for JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    say("bounds over the Doppler noise (Fig. 2)")
    bounds = figure_2_data()
    say(f"filters, four cases of {runs} runs (Figs. 3-5)")
    cases = filter_cases(runs, seed, jobs)
    say("weight of the correct association over the undetected intensity")
    table = association_table(runs, seed, jobs)
    say("unknown and mistaken motion")
    motion = motion_studies(runs, seed, jobs)
    with house_style():
        figures = {
            "figure_2_bounds": figure_2(bounds),
            "figure_3_gospa_va": figure_map(cases, "gospa_va_m", "GOSPA of VAs [m]"),
            "figure_4_gospa_sp": figure_map(cases, "gospa_sp_m", "GOSPA of SPs [m]"),
            "figure_5_rmse": figure_5(cases),
            "association_weight": figure_table(table),
        }
        for name, figure in figures.items():
            figure.savefig(folder / f"{name}.png", dpi=150)
    return {
        "runs": runs,
        "seed": seed,
        "figure_2": bounds,
        "filters": cases,
        "associations": table,
        "motion": motion,
    }
