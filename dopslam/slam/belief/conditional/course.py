"""The motions of belief propagation as compiled code reads them: one step with its Jacobian and noise, and the pose.

Twin of :mod:`dopslam.slam.belief.motion` for one state instead of many particles, in closed form.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dopslam.compute.compiled import clear, compiled
from dopslam.slam.belief.motion import Motion, SpeedHeading


class Course(NamedTuple):
    """A motion.

    Attributes
    ----------
    polar : speed and heading, else a velocity
    interval : s; turn_rate : rad/s
    speed, heading, vertical, position, bias : standard deviations per step
    """

    polar: bool
    interval: float
    turn_rate: float
    speed: float
    heading: float
    vertical: float
    position: float
    bias: float


def course_of(motion: Motion) -> Course:
    """A motion's numbers."""
    if isinstance(motion, SpeedHeading):
        walks = motion.speed_walk, motion.heading_walk, 0.0, motion.position_walk, motion.bias_walk
        return Course(True, float(motion.interval), float(motion.turn_rate), *map(float, walks))
    walks = motion.speed_increment, 0.0, motion.vertical_increment, 0.0, motion.bias_walk
    return Course(False, float(motion.interval), 0.0, *map(float, walks))


@compiled
def wrapped(angle):
    """The angle in [−π, π)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@compiled
def advance(course, mean, moved, transition, noise):
    """f(mean) (c,), F (c, c) and Q (c, c) of one step, as :meth:`Dynamics.linearize` finds them by differences."""
    size, t = mean.shape[0], course.interval
    clear(transition)
    clear(noise)
    for i in range(size):
        moved[i] = mean[i]
        transition[i, i] = 1.0
    noise[size - 1, size - 1] = course.bias**2
    if not course.polar:
        for a in range(3):
            s = (course.vertical if a == 2 else course.speed) ** 2
            moved[a] += t * mean[3 + a]
            transition[a, 3 + a] = t
            noise[a, a], noise[3 + a, 3 + a] = 0.25 * t * t * s, s
            noise[a, 3 + a] = noise[3 + a, a] = 0.5 * t * s
        return
    half = 0.5 * course.turn_rate * t
    along = t if abs(half) < 1e-12 else t * math.sin(half) / half  # the chord of an arc is shorter by sinc
    c, s = math.cos(mean[4] + half), math.sin(mean[4] + half)
    chord = along * mean[3]
    moved[0] += chord * c
    moved[1] += chord * s
    moved[4] = wrapped(mean[4] + 2.0 * half)
    transition[0, 3], transition[1, 3] = along * c, along * s
    transition[0, 4], transition[1, 4] = -chord * s, chord * c
    turned = chord * math.sin(0.5 * course.heading)  # half of what ± one standard deviation moves
    by_speed, by_heading = (0.5 * along * c, 0.5 * along * s, 1.0, 0.0), (-turned * s, turned * c, 0.0, course.heading)
    where = (0, 1, 3, 4)
    for i in range(4):
        for j in range(4):
            noise[where[i], where[j]] = by_speed[i] * by_speed[j] * course.speed**2 + by_heading[i] * by_heading[j]
    noise[0, 0] += course.position**2
    noise[1, 1] += course.position**2


@compiled
def place(course, mean, active, pose, by_coordinate):
    """Pose (8,) and its slopes (8, d) by the coordinates that are uncertain, as :meth:`Dynamics.pose`."""
    for a in range(3):
        pose[a] = mean[a]
    if course.polar:
        c, s = math.cos(mean[4]), math.sin(mean[4])
        pose[3], pose[4], pose[5] = mean[3] * c, mean[3] * s, 0.0
        pose[6], pose[7] = mean[5], wrapped(mean[4])
    else:
        for a in range(3, 7):
            pose[a] = mean[a]
        pose[7] = math.atan2(mean[4], mean[3])
    clear(by_coordinate)
    for j in range(active.shape[0]):
        k = active[j]
        if k < 3:
            by_coordinate[k, j] = 1.0
        elif not course.polar:
            by_coordinate[k, j] = 1.0
            square = max(pose[3] ** 2 + pose[4] ** 2, 1e-24)
            if k == 3:
                by_coordinate[7, j] = -pose[4] / square
            elif k == 4:
                by_coordinate[7, j] = pose[3] / square
        elif k == 3:
            by_coordinate[3, j], by_coordinate[4, j] = math.cos(pose[7]), math.sin(pose[7])
        elif k == 4:
            by_coordinate[3, j], by_coordinate[4, j], by_coordinate[7, j] = -pose[4], pose[3], 1.0
        else:
            by_coordinate[6, j] = 1.0
