"""How many lost receivers are recognized as such, and how many good runs are suspected: drawn worlds, wrong starts.

Everything is drawn from the seed: walls, scatter points, the drive, accuracies and false alarms. Every world is driven
right, with a line of sight that is hidden for a part of the run, with twice the false alarms that the filter is told, and
from wrong starts. Whether a receiver is lost is told by the truth, and by :mod:`dopslam.slam.health` without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.evaluate import metrics
from dopslam.evaluate.bounds import situation_bound
from dopslam.evaluate.run import LOST_NEES
from dopslam.models.measurement import BS, SP, VA
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.pipeline.problem import told
from dopslam.records import edges_of
from dopslam.simulate.world import FixedNoise, Situation, simulate
from dopslam.slam.filter import Filter, run
from dopslam.slam.health import divergence
from dopslam.slam.history import History

Array = NDArray[np.float64]

STEPS = 30
WRONG_START, WRONG = "wrong start", 2  # wrong starts of every world
BEYOND = 10.0  # m at the end, and 30 times the bound: lost by the truth, as `Evaluation.diverged` has it


@dataclass(frozen=True, slots=True)
class Verdict:
    """One run of a drawn world.

    Attributes
    ----------
    seed : of the world
    name : what was done to it: right, hidden, clutter, or the number of a wrong start
    lost : by the truth
    said : why it counts as lost without the truth; empty if nothing was said
    failed : the filter itself ended with an error, which names it; then neither of the two is asked
    """

    seed: int
    name: str
    lost: bool
    said: str
    failed: bool = False

    @property
    def wrong(self) -> bool:
        """Whether the start was a wrong one."""
        return self.name.startswith(WRONG_START)


def world(rng: np.random.Generator) -> Situation:
    """Walls, scatter points, a start, a motion, accuracies and false alarms: all drawn."""
    bs = np.array([0, 0, rng.uniform(3, 40)])
    walls, points = rng.integers(2, 6), rng.integers(0, 6)
    bearing, distance = rng.uniform(0, 2 * np.pi, walls), rng.uniform(30, 120, walls)
    va = bs + 2 * distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(walls)])
    sp = rng.uniform([-80, -80, 1], [80, 80, 15], (points, 3))
    reach, place, course = rng.uniform(15, 60), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    angle = 10 ** rng.uniform(-2.3, -1.3)
    std = np.array([10 ** rng.uniform(-1.7, -0.5), *[angle] * 4, 10 ** rng.uniform(-1.3, -0.3)])
    noise = np.diag([0.1, 0.1, 0.003, 0.1]) ** 2 * rng.uniform(0.5, 2) ** 2
    return Situation(
        bs=bs,
        kind=np.array([BS] + [VA] * walls + [SP] * points),
        position=np.vstack([bs, va, sp]),
        motion=CoordinatedTurn(rng.uniform(0.1, 0.5), noise, rng.uniform(1, 20), rng.uniform(-0.4, 0.4)),
        prior_mean=np.array([reach * np.cos(place), reach * np.sin(place), course, rng.uniform(-300, 300)]),
        prior_covariance=np.diag([0.3, 0.3, 0.01, 0.3]) ** 2 * rng.uniform(0.3, 2) ** 2,
        steps=STEPS,
        noise=FixedNoise(std, rng.uniform(0.7, 0.98)),
        clutter_count=rng.uniform(0.05, 3),
        clutter_range=400.0,
        doppler_limit=25.0,
        height=1.5,
    )


def wrong_start(rng: np.random.Generator) -> Array:
    """An error (4,) of position, heading, clock, or all of them; from hardly any to a hundred metres and half a turn."""
    course, which = rng.uniform(-np.pi, np.pi), rng.integers(0, 4)
    error = np.zeros(4)
    if which in (0, 3):
        error[:2] = 10 ** rng.uniform(-0.5, 2) * np.array([np.cos(course), np.sin(course)])
    if which in (1, 3):
        error[2] = min(10 ** rng.uniform(-1.5, 0.5), np.pi) * rng.choice([-1, 1])
    if which in (2, 3):
        error[3] = 10 ** rng.uniform(-0.5, 2) * rng.choice([-1, 1])
    return error


def hidden(scans: Scans, rng: np.random.Generator) -> Scans:
    """The line of sight is blocked for a part of the run."""
    assert scans.label is not None
    first = rng.integers(0, 20)
    step = scans.step_of_row
    keep = ~((scans.label == 0) & (step >= first) & (step < first + rng.integers(8, 25)))
    rows = {name: getattr(scans, name)[keep] for name in ("z", "covariance", "anchor", "label")}
    return replace(scans, **rows, offsets=edges_of(np.bincount(step[keep], minlength=scans.steps)))


def truly_lost(situation: Situation, states: Array, history: History) -> bool:
    """By the truth, as ``Evaluation.diverged`` has it."""
    error = metrics.state_errors(history.mean, states)
    far = np.hypot(*error[-1, :2]) > max(BEYOND, 30 * situation_bound(situation, states).peb[-1])
    return bool(far or np.median(metrics.nees(error, history.covariance)) > LOST_NEES)


def verdicts(seed: int, chosen: Filter) -> list[Verdict]:
    """All runs of one drawn world, none of them restarted."""
    rng = np.random.default_rng(seed)
    situation = world(rng)
    states, scans = simulate(situation, seed, 0)
    noisy = simulate(replace(situation, clutter_count=2 * situation.clutter_count), seed, 0)[1]
    runs = [
        ("right", scans, np.zeros(4)),
        ("hidden", hidden(scans, rng), np.zeros(4)),
        ("clutter", replace(noisy, clutter_count=scans.clutter_count), np.zeros(4)),
        *((f"{WRONG_START} {i}", scans, wrong_start(rng)) for i in range(WRONG)),
    ]
    problem, found = told(situation), []
    for name, read, error in runs:
        try:
            history, _ = run(replace(problem, mean=problem.mean + error), read, chosen, seed)
        except FilterError as failure:
            found.append(Verdict(seed, name, True, str(failure), failed=True))
            continue
        said = divergence(history, read, situation.bs, situation.height)
        found.append(Verdict(seed, name, truly_lost(situation, states, history), said))
    return found


def shares(found: list[Verdict]) -> dict[str, int]:
    """Lost and good runs, the lost ones that are recognized, the good ones that are suspected, and those that ended early.

    Good are those from a right start: a wrong one may be named, if the receiver is far off or not.
    """
    lost = [v for v in found if v.lost and not v.failed]
    good = [v for v in found if not v.lost and not v.wrong]
    return {
        "failed": sum(v.failed for v in found),
        "lost": len(lost),
        "recognized": sum(bool(v.said) for v in lost),
        "good": len(good),
        "suspected": sum(bool(v.said) for v in good),
    }
