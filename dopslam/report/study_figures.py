"""Figures of traced studies: errors over time of several runs, and the map with its type beliefs (paper B, Fig. 4)."""

from __future__ import annotations

from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from dopslam.records import FloorPlan, Kind, Landmarks, Track
from dopslam.report.figures import BOUND, ESTIMATE, TRUE, WALL

_COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000")


def errors_over_runs(curves: dict[str, dict], line_of_sight: np.ndarray) -> Figure:
    """Position and heading RMSE over the runs at every step, with the bound (paper B, Fig. 4 a and b).

    Parameters
    ----------
    curves : label → the ``steps`` columns of :func:`dopslam.studies.traced.study`; the bound is the first one's
    line_of_sight : (K,) share of the runs with a line of sight; steps where most have none are shaded
    """
    figure = Figure(figsize=(7.0, 5.0))
    panels = figure.subplots(2, 1, sharex=True)
    steps = 1 + np.arange(len(line_of_sight))
    bound = next(iter(curves.values()))
    rows = (("position_rmse_m", "peb_m", "position RMSE [m]"), ("heading_rmse_deg", "heb_deg", "heading RMSE [°]"))
    for axes, (error, limit, title) in zip(panels, rows, strict=True):
        for (label, columns), color in zip(curves.items(), cycle(_COLORS), strict=False):
            axes.semilogy(steps, columns[error], color=color, linewidth=1.2, label=label)
        axes.semilogy(steps, bound[limit], "--", color=BOUND, label="PCRB")
        blocked = np.asarray(line_of_sight) < 0.5
        axes.fill_between(
            steps, 0, 1, where=blocked, transform=axes.get_xaxis_transform(), color="0.9", linewidth=0, zorder=0,
            label="line of sight blocked" if blocked.any() else None,
        )  # fmt: skip
        axes.set_ylabel(title)
    panels[-1].set_xlabel("step")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def belief_map(plan: FloorPlan | None, track: Track, landmarks: Landmarks, history, threshold: float = 0.5) -> Figure:
    """Map at the last step from above, colored by the belief in the type (paper B, Fig. 4 c).

    Parameters
    ----------
    plan : outlines of the scene's objects, or None
    track, landmarks : the truth
    history : ``dopslam.slam.history.History``
    threshold : existence above which a feature is drawn
    """
    figure = Figure(figsize=(7.0, 6.0))
    axes = figure.add_subplot()
    if plan is not None:
        for w in range(len(plan.name)):
            axes.plot(*plan.points[plan.offsets[w] : plan.offsets[w + 1]].T, color=WALL, linewidth=1.6, zorder=1)
    bs = landmarks.position[landmarks.kind == Kind.BS][0]
    axes.plot(*bs[:2], "*", color=TRUE, markersize=13, linestyle="none", label="base station")
    axes.plot(*track.position[:, :2].T, color=TRUE, linewidth=2, label="true track")
    axes.plot(*history.mean[:, :2].T, color=ESTIMATE, linewidth=1, label="estimated track")
    groups = (
        (landmarks.kind == Kind.SP, "o", 9, "scatter points"),
        ((landmarks.kind == Kind.VA) & (landmarks.order == 1), "s", 10, "virtual anchors"),
        ((landmarks.kind == Kind.VA) & (landmarks.order > 1), "D", 10, "virtual anchors, two reflections"),
    )
    for chosen, marker, size, name in groups:
        if chosen.any():
            where = landmarks.position[chosen, :2].T
            axes.plot(*where, marker, mfc="none", mec=TRUE, markersize=size, linestyle="none", label=name)
    last = history.rows(history.steps - 1)
    shown = history.existence[last] > threshold
    dots = axes.scatter(
        *history.position[last][shown][:, :2].T, c=history.type_probability[last][shown][:, Kind.VA], cmap="coolwarm", vmin=0,
        vmax=1, s=22, zorder=4,
    )  # fmt: skip
    figure.colorbar(dots, ax=axes, shrink=0.8, label="belief: virtual anchor (1), scatter point (0)")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
