"""Figures of one run that a person understands without the code.

Every function takes records and returns a matplotlib figure; :func:`save_all` writes them. No pyplot state.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from dopslam.evaluate.walls import true_walls, walls
from dopslam.models.measurement import wrap
from dopslam.records import DetectionSeries, FloorPlan, Kind, Landmarks, Paths, Track

TRUE, ESTIMATE, BOUND, VA, SP, RAY, WALL = "#000000", "#0072B2", "#D55E00", "#E69F00", "#009E73", "#9aa5b1", "#6b7280"
SR = "#CC79A7"
_CHI2_95_2D = 5.991  # 95 % ellipse of a two-dimensional Gaussian


OF_WINDOWS = ("backend", "interactive", "toolbar", "webagg", "tk.", "macosx")  # settings that draw nothing in a file


def house_style():
    """Context manager with the shipped style over matplotlib's own defaults, whatever the user's settings are."""
    style = mpl.rc_params_from_file(str(files("dopslam.report") / "dopslam.mplstyle"), use_default_template=False)
    plain = {key: value for key, value in mpl.rcParamsDefault.items() if not key.startswith(OF_WINDOWS)}
    settings: Any = plain | dict(style)  # the stub wants the names of all keys
    return mpl.rc_context(settings)


def _ellipse(axes, mean: np.ndarray, covariance: np.ndarray, color: str, enlarged: float) -> None:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * enlarged * np.sqrt(_CHI2_95_2D * np.maximum(values, 0))
    angle = np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))
    axes.add_patch(
        Ellipse((mean[0], mean[1]), width, height, angle=angle, fill=False, color=color, linewidth=1.2, zorder=4)
    )


def _enlargement(covariances: np.ndarray, extent: float) -> int:
    """Factor (1, 2, 5, 10, …) that makes the median 95 % ellipse about a fiftieth of the picture, and few large ones."""
    if not len(covariances):
        return 1
    sizes = np.sqrt(_CHI2_95_2D * np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0))
    typical = max(np.median(sizes), np.quantile(sizes, 0.95) / 5)
    steps = [m * 10**e for e in range(4) for m in (1, 2, 5)]
    return next((f for f in reversed(steps) if f * typical < 0.02 * extent), 1)


def plan_view(
    plan: FloorPlan | None,
    track: Track,
    landmarks: Landmarks,
    paths: Paths | None,
    history,
    step: int,
    threshold: float = 0.5,
) -> Figure:
    """Scene from above: objects, true and estimated track and map with 95 % ellipses, rays of one step.

    Parameters
    ----------
    plan : outlines of the scene's objects, or None
    track, landmarks, paths : the truth; paths may be None (detections drawn from the model)
    history : ``dopslam.slam.history.History``
    step : whose rays are drawn
    threshold : existence above which a landmark is drawn
    """
    bs = landmarks.position[landmarks.kind == Kind.BS][0]
    upright = [c[:2, :2] for c, n in _upright(true_walls(track, landmarks))]
    low, high = _frame(bs, track, paths, landmarks, upright)
    tall = float((high - low)[1] / (high - low)[0])
    figure = Figure(figsize=(7.4, float(np.clip(6.3 * tall, 2.4, 8.5)) + 1.8))
    axes = figure.add_subplot(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    if plan is not None:
        for w in range(len(plan.name)):
            line = plan.points[plan.offsets[w] : plan.offsets[w + 1]]
            axes.plot(*line.T, color=WALL, linewidth=2.2, label="walls, objects" if w == 0 else None, zorder=1)
    for number, line in enumerate(upright if plan is None else ()):
        axes.plot(
            line[:, 0], line[:, 1], color=WALL, linewidth=4, label="true walls" if number == 0 else None, zorder=1
        )
    if paths is not None:
        _rays(axes, bs, track, paths, step)
    axes.plot(*bs[:2], "*", color=TRUE, markersize=14, label="base station", zorder=5, linestyle="none")
    axes.plot(*track.position[:, :2].T, color=TRUE, linewidth=1.2, label="true track", zorder=3)
    axes.plot(*history.mean[:, :2].T, ".", color=ESTIMATE, markersize=5, label="estimated track", zorder=4)
    last = history.rows(history.steps - 1)
    shown = history.existence[last] > threshold
    within = shown & np.all((history.position[last, :2] >= low) & (history.position[last, :2] <= high), axis=1)
    spreads = np.concatenate([history.covariance[:, :2, :2], history.position_covariance[last][within][:, :2, :2]])
    enlarged = _enlargement(spreads, float(np.max(high - low)))
    _walls(axes, walls(history, bs, float(track.position[0, 2]), threshold=threshold), enlarged)
    for mean, covariance in zip(history.mean, history.covariance, strict=True):
        _ellipse(axes, mean[:2], covariance[:2, :2], ESTIMATE, enlarged)
    twice = (landmarks.kind == Kind.VA) & (landmarks.order > 1)
    for kind, color, marker, name in (
        (Kind.VA, VA, "s", "virtual anchors"),
        (Kind.SP, SP, "o", "scatter points"),
        (Kind.SR, SR, "D", "second reflections"),
    ):
        if kind == Kind.SR and not (twice.any() or (history.kind[last][shown] == kind).any()):
            continue
        where = landmarks.position[twice if kind == Kind.SR else (landmarks.kind == kind) & ~twice][:, :2]
        where = where[np.all((where >= low) & (where <= high), axis=1)]
        label = f"true {name}" if len(where) else None
        axes.plot(*where.T, marker, mfc="none", mec=TRUE, markersize=9, label=label, linestyle="none")
        chosen = within & (history.kind[last] == kind)
        where, spread = history.position[last][chosen], history.position_covariance[last][chosen]
        label = f"estimated {name}" if len(where) else None
        axes.plot(*where[:, :2].T, marker, color=color, markersize=5, label=label, linestyle="none", zorder=4)
        for mean, covariance in zip(where, spread, strict=True):
            _ellipse(axes, mean[:2], covariance[:2, :2], color, enlarged)
    scale = f", drawn {enlarged}× larger" if enlarged > 1 else ""
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"Track and map from above (95 % ellipses and bands{scale})")
    axes.set_aspect("equal", adjustable="box")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def found_view(history, base_station: np.ndarray, height: float, threshold: float = 0.5) -> Figure:
    """What a filter found, from above, where no truth is known: track and map with 95 % ellipses and bands.

    Parameters
    ----------
    history : ``dopslam.slam.history.History``
    base_station : (3,) m; height : m, of the receiver
    threshold : existence above which a landmark is drawn
    """
    found = walls(history, base_station, height, threshold=threshold)
    last = history.rows(history.steps - 1)
    points = (history.existence[last] > threshold) & (history.kind[last] == Kind.SP)
    where, spread = history.position[last][points], history.position_covariance[last][points][:, :2, :2]
    lines = [c[:2, :2] for c, _ in _upright(found)]
    corner = np.concatenate([history.mean[:, :2], base_station[None, :2], where[:, :2], *lines])
    low, high = _spaced(corner)
    tall = float((high - low)[1] / (high - low)[0])
    figure = Figure(figsize=(7.4, float(np.clip(6.3 * tall, 2.4, 8.5)) + 1.8))
    axes = figure.add_subplot(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    enlarged = _enlargement(np.concatenate([history.covariance[:, :2, :2], spread]), float(np.max(high - low)))
    axes.plot(*base_station[:2], "*", color=TRUE, markersize=14, label="base station", zorder=5, linestyle="none")
    axes.plot(
        *history.mean[:, :2].T, ".-", color=ESTIMATE, markersize=5, linewidth=0.8, label="estimated track", zorder=4
    )
    axes.plot(*history.mean[0, :2], "o", mfc="none", mec=ESTIMATE, markersize=9, label="start", linestyle="none")
    _walls(axes, found, enlarged)
    label = "scatter points" if len(where) else None
    axes.plot(*where[:, :2].T, "o", color=SP, markersize=5, label=label, linestyle="none", zorder=4)
    for mean, covariance in zip(history.mean, history.covariance, strict=True):
        _ellipse(axes, mean[:2], covariance[:2, :2], ESTIMATE, enlarged)
    for mean, covariance in zip(where, spread, strict=True):
        _ellipse(axes, mean[:2], covariance, SP, enlarged)
    scale = f", drawn {enlarged}× larger" if enlarged > 1 else ""
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"Track and map from above (95 % ellipses and bands{scale})")
    axes.set_aspect("equal", adjustable="box")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def claims_over_time(time: np.ndarray, history) -> Figure:
    """Standard deviations that a filter gives for position, heading and clock, one panel each."""
    figure = Figure(figsize=(7.0, 6.4))
    variance = np.einsum("kii->ki", history.covariance)
    panels = (
        ("position [m]", variance[:, 0] + variance[:, 1], 1.0),
        ("heading [°]", variance[:, 2], 180 / np.pi),
        ("clock bias [m]", variance[:, 3], 1.0),
    )
    axes = figure.subplots(len(panels), 1, sharex=True)
    for ax, (name, values, unit) in zip(axes, panels, strict=True):
        ax.semilogy(time, unit * np.sqrt(np.maximum(values, 1e-18)), ".-", color=ESTIMATE, linewidth=1)
        ax.set_ylabel(name)
    axes[0].set_title("How sure the filter says it is (standard deviations)")
    axes[-1].set_xlabel("time [s]")
    return figure


def _upright(found) -> list:
    """(corners, normal) of the walls that have a line in the plan; levels (floors) have none."""
    return [(c, n) for c, n in zip(found.corners, found.normal, strict=True) if np.hypot(*n[:2]) >= 0.5]


def _walls(axes, found, enlarged: float) -> None:
    """Walls found, over the extent that was seen, with the band that holds 95 % of their distance, enlarged likewise."""
    label, band = "walls found", "their 95 % band"
    for corners, normal, deviation in zip(found.corners, found.normal, found.deviation, strict=True):
        if np.hypot(*normal[:2]) < 0.5:
            continue
        line, shift = corners[:2, :2], 1.96 * enlarged * deviation * normal[:2]
        axes.plot(*line.T, color=VA, linewidth=2.5, zorder=3, label=label, solid_capstyle="butt")
        ring = np.vstack([line + shift, line[::-1] - shift])
        axes.fill(*ring.T, color=VA, alpha=0.25, linewidth=0, zorder=2, label=band)
        label = band = None


def _frame(bs, track: Track, paths: Paths | None, landmarks: Landmarks, lines, margin: float = 0.06):
    """The corners of what is shown: where the rays went; virtual anchors far outside would squeeze everything else.

    Parameters
    ----------
    lines : (2, 2) m each, true walls over where they are seen

    Returns
    -------
    low, high : (2,) m, corners of the picture
    """
    shown = [track.position[:, :2], bs[None, :2], landmarks.position[landmarks.kind == Kind.SP][:, :2], *lines]
    if paths is not None:
        shown.append(paths.vertices[:, :2])
    points = np.concatenate(shown)
    return _spaced(points, margin)


def _spaced(points: np.ndarray, margin: float = 0.06):
    """Corners (2,) of a box around points with some space."""
    low, high = points.min(axis=0), points.max(axis=0)
    space = margin * max(*(high - low), 1.0)
    return low - space, high + space


def _rays(axes, bs: np.ndarray, track: Track, paths: Paths, step: int) -> None:
    rows = paths.rows(step)
    for count, n in enumerate(range(rows.start, rows.stop)):
        vertices = paths.vertices[paths.vertex_offsets[n] : paths.vertex_offsets[n + 1]]
        line = np.vstack([bs, vertices, track.position[step]])
        label = f"traced rays, step {step + 1}" if count == 0 else None
        axes.plot(*line[:, :2].T, color=RAY, linewidth=0.9, label=label, zorder=2)


def errors_over_time(evaluation) -> Figure:
    """Position, heading and clock errors beside their bounds, one panel each."""
    figure = Figure(figsize=(7.0, 6.4))
    panels = (
        ("position [m]", evaluation.position_error, evaluation.peb, "PEB"),
        ("heading [°]", np.degrees(evaluation.heading_error), np.degrees(evaluation.heb), "HEB"),
        ("clock bias [m]", evaluation.bias_error, evaluation.ceb, "CEB"),
    )
    panels = [panel for panel in panels if np.isfinite(panel[1]).any()]  # a clock whose truth nobody knows has none
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    steps = np.arange(1, len(evaluation.position_error) + 1)
    for ax, (name, error, bound, bound_name) in zip(axes, panels, strict=True):
        ax.semilogy(
            steps, np.maximum(np.abs(error), 1e-6), ".-", color=ESTIMATE, linewidth=1, label="error of this run"
        )
        if np.isfinite(bound).any():
            ax.semilogy(steps, bound, color=BOUND, label=f"{bound_name} (standard deviation)")
        ax.set_ylabel(name)
        ax.legend(loc="upper right", ncols=2)
    axes[0].set_title("Errors beside the posterior Cramér–Rao bound")
    axes[-1].set_xlabel("step")
    return figure


def gospa_over_time(evaluation) -> Figure:
    """GOSPA of virtual anchors and scatter points over time."""
    figure = Figure()
    axes = figure.add_subplot()
    steps = np.arange(1, len(evaluation.gospa_va) + 1)
    axes.plot(steps, evaluation.gospa_va, "s-", color=VA, markersize=4, label="virtual anchors")
    axes.plot(steps, evaluation.gospa_sp, "o-", color=SP, markersize=4, label="scatter points")
    axes.set(xlabel="step", ylabel="GOSPA [m]", title="Map error", ylim=(0, None))
    axes.legend()
    return figure


def detections_over_paths(track: Track, landmarks: Landmarks, paths: Paths, detections: DetectionSeries) -> Figure:
    """What was detected beside what was there: delay and arrival azimuth over the steps."""
    from dopslam.records import SPEED_OF_LIGHT

    figure = Figure(figsize=(7.2, 6.2))
    upper, lower = figure.subplots(2, 1, sharex=True)
    step_of_path = np.repeat(np.arange(paths.steps), np.diff(paths.offsets))
    step_of_detection = np.repeat(np.arange(detections.steps), np.diff(detections.offsets))
    delay = paths.tau * SPEED_OF_LIGHT + track.bias[step_of_path]
    azimuth = np.degrees(wrap(paths.phi_r - track.heading[step_of_path]))
    kinds = landmarks.kind[paths.landmark]
    for kind, color, name in (
        (Kind.BS, TRUE, "line of sight"),
        (Kind.VA, VA, "reflections"),
        (Kind.SP, SP, "scatter points"),
    ):
        chosen = kinds == kind
        upper.plot(
            step_of_path[chosen] + 1, delay[chosen], "o", mfc="none", mec=color, markersize=7, label=f"true: {name}"
        )
        lower.plot(step_of_path[chosen] + 1, azimuth[chosen], "o", mfc="none", mec=color, markersize=7)
    upper.plot(
        step_of_detection + 1, detections.delay * SPEED_OF_LIGHT, "x", color=ESTIMATE, markersize=4, label="detected"
    )
    lower.plot(step_of_detection + 1, np.degrees(detections.aoa[:, 0]), "x", color=ESTIMATE, markersize=4)
    upper.set(ylabel="delay · c + clock bias [m]", title="Detections over true paths")
    lower.set(ylabel="arrival azimuth [°]", xlabel="step")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def save_all(folder: Path, figures: dict[str, Figure]) -> list[Path]:
    """Write figures as PNG and return their paths."""
    written = []
    for name, figure in figures.items():
        path = Path(folder) / f"{name}.png"
        figure.savefig(path)
        written.append(path)
    return written
