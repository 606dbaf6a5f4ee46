#!/usr/bin/env python3
"""One picture per angle and sign of docs/conventions.md: python scripts/angle_pictures.py [folder, default docs/figures]."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc

from dopslam.report.figures import house_style

INK, BLUE, ORANGE, GREEN = "#1c2430", "#0072B2", "#E69F00", "#009E73"


def canvas(title: str, size=(3.3, 3.0)):
    """An empty picture with a title, equal axes and no frame."""
    figure = Figure(figsize=size)
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=10)
    axes.set_aspect("equal")
    axes.axis("off")
    return figure, axes


def arrow(axes, start, end, color=INK, style="-|>", **more):
    """An arrow from one point to another."""
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": style, "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0} | more
    )


def angle(axes, center, first, last, radius, color, text, out=1.28):
    """An arc from one direction to another [degrees], with an arrow head at its end and a name beside it."""
    axes.add_patch(
        Arc(center, 2 * radius, 2 * radius, theta1=min(first, last), theta2=max(first, last), color=color, lw=1.8)
    )
    ends = [
        np.array(center) + radius * np.array([np.cos(a), np.sin(a)])
        for a in np.deg2rad([last - 4 * np.sign(last - first), last])
    ]
    arrow(axes, ends[0], ends[1], color, mutation_scale=12)
    middle = np.deg2rad(0.5 * (first + last))
    axes.text(*(np.array(center) + out * radius * np.array([np.cos(middle), np.sin(middle)])), text, color=color, ha="center", va="center", fontsize=10)  # fmt: skip


def rays(axes, receiver, wall, station):
    """Base station, reflection and receiver."""
    axes.plot(*zip(station, wall, receiver, strict=True), color="#9aa5b1", lw=1.3, zorder=0)
    axes.plot(*station, "*", color=INK, markersize=13)
    axes.plot(*receiver, "o", color=BLUE, markersize=8)
    axes.plot(*wall, "s", color=ORANGE, markersize=6)


def heading():
    """The heading in the world frame."""
    figure, axes = canvas("heading: from the x axis to where the receiver faces")
    arrow(axes, (0, 0), (1.6, 0))
    arrow(axes, (0, 0), (0, 1.3))
    axes.text(1.68, 0, "x (world)", va="center", fontsize=9)
    axes.text(0.04, 1.36, "y", fontsize=9)
    axes.plot(0, 0, "o", color=BLUE, markersize=8)
    arrow(axes, (0, 0), (1.1, 0.9), BLUE)
    axes.text(1.14, 0.94, "facing", color=BLUE, fontsize=9)
    angle(axes, (0, 0), 0, np.degrees(np.arctan2(0.9, 1.1)), 0.6, GREEN, "ϖ")
    axes.set(xlim=(-0.3, 2.4), ylim=(-0.3, 1.6))
    return figure


def aoa_azimuth():
    """Azimuth of arrival in the receiver's frame."""
    figure, axes = canvas("AOA azimuth: from the heading to where the path comes from")
    receiver, wall, station = (0, 0), (0.5, 1.5), (2.2, 0.5)
    rays(axes, receiver, wall, station)
    arrow(axes, receiver, (1.3, 0.25), BLUE)
    axes.text(1.33, 0.16, "heading", color=BLUE, fontsize=9)
    angle(axes, receiver, np.degrees(np.arctan2(0.25, 1.3)), np.degrees(np.arctan2(1.5, 0.5)), 0.62, GREEN, "az > 0")
    axes.text(0.5, 1.62, "last reflection", ha="center", fontsize=9)
    axes.set(xlim=(-0.4, 2.5), ylim=(-0.35, 1.85))
    return figure


def elevation():
    """Elevations, seen from the side."""
    figure, axes = canvas("elevations: up from the horizontal plane, at either end")
    receiver, station = (0, 0), (2.1, 1.2)
    axes.plot(*zip(station, receiver, strict=True), color="#9aa5b1", lw=1.3, zorder=0)
    axes.plot(*station, "*", color=INK, markersize=13)
    axes.plot(*receiver, "o", color=BLUE, markersize=8)
    slope = np.degrees(np.arctan2(1.2, 2.1))
    axes.plot((0, 1.5), (0, 0), ":", color=INK, lw=1)
    axes.plot((2.1, 0.6), (1.2, 1.2), ":", color=INK, lw=1)
    angle(axes, receiver, 0, slope, 0.85, GREEN, "AOA el > 0", out=1.5)
    angle(axes, station, 180, 180 + slope, 0.85, GREEN, "AOD el < 0", out=1.5)
    arrow(axes, (2.7, 0), (2.7, 0.8))
    axes.text(2.76, 0.75, "z", fontsize=9)
    axes.set(xlim=(-0.3, 3.0), ylim=(-0.3, 1.6))
    return figure


def aod_azimuth():
    """Azimuth of departure in the base station's frame."""
    figure, axes = canvas("AOD azimuth: from the station's yaw to where the path leaves")
    station, wall, receiver = (0, 0), (0.6, 1.5), (2.2, 0.5)
    rays(axes, receiver, wall, station)
    arrow(axes, station, (1.3, -0.2), INK)
    axes.text(1.35, -0.27, "its x axis, turned by yaw", fontsize=9)
    angle(axes, station, np.degrees(np.arctan2(-0.2, 1.3)), np.degrees(np.arctan2(1.5, 0.6)), 0.62, GREEN, "az > 0")
    axes.text(0.6, 1.62, "first reflection", ha="center", fontsize=9)
    axes.set(xlim=(-0.4, 2.9), ylim=(-0.5, 1.85))
    return figure


def doppler():
    """The sign of the radial velocity."""
    figure, axes = canvas("radial velocity: positive when the path gets shorter")
    axes.plot(2.2, 0.8, "*", color=INK, markersize=13)
    for x, sign, color in ((0.2, 1, GREEN), (0.2, -1, ORANGE)):
        y = 0.95 if sign > 0 else 0.0
        axes.plot((x, 2.2), (y, 0.8), color="#9aa5b1", lw=1.2, zorder=0)
        axes.plot(x, y, "o", color=BLUE, markersize=8)
        arrow(axes, (x, y), (x + 0.6 * sign, y), color)
        name = "v_r > 0, f_D > 0" if sign > 0 else "v_r < 0, f_D < 0"
        axes.text(x + 0.02, y + 0.16, name, color=color, fontsize=9)
    axes.set(xlim=(-0.6, 2.5), ylim=(-0.3, 1.5))
    return figure


PICTURES = {
    "heading": heading,
    "aoa_azimuth": aoa_azimuth,
    "elevation": elevation,
    "aod_azimuth": aod_azimuth,
    "doppler": doppler,
}


def main() -> None:
    """Write every picture."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/figures")
    folder.mkdir(parents=True, exist_ok=True)
    with house_style():
        for name, picture in PICTURES.items():
            picture().savefig(folder / f"{name}.png", dpi=130)


if __name__ == "__main__":
    main()
