"""Belief-propagation SLAM of paper B on the detections that all filters read, as a record of choices."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dopslam.models.detection import ConstantDetection
from dopslam.models.scans import Scans
from dopslam.slam.belief import adapter
from dopslam.slam.belief.adapter import Setup, turning
from dopslam.slam.belief.records import AOD_FOR_SINGLE_BOUNCE, Assumptions
from dopslam.slam.filter import Capabilities, Info, Problem
from dopslam.slam.history import Diagnostics, History


class State(NamedTuple):
    """What is carried from scan to scan; the engine is made at the first one."""

    setup: Setup
    engine: Any = None
    beliefs: Any = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """Rao-Blackwellized belief propagation: particles for the receiver, Gaussians for the features.

    Attributes
    ----------
    doppler : use the Doppler row, where the features are conditional on the receiver
    particles : number of them
    assumptions : on the features, Sections IV and VI-A
    false_alarm_tail : share of false alarms as strong as paths
    correlation : False drops that of receiver and features after every step, everything else equal (a control experiment)
    """

    largest_order: ClassVar[int | None] = None

    doppler: bool = True
    particles: int = 1000
    assumptions: Assumptions = field(default_factory=lambda: Assumptions(types=AOD_FOR_SINGLE_BOUNCE))
    false_alarm_tail: float = 0.1
    correlation: bool = True

    @property
    def capabilities(self) -> Capabilities:
        """Paper B's measurements have no Doppler, and neither has its form of the features."""
        return Capabilities(doppler=self.assumptions.features == "conditional", intervals=True)

    def setup(self, problem: Problem) -> Setup:
        """Choices and problem as belief propagation reads them."""
        motion: Any = problem.motion  # a coordinated turn: it takes four states alone
        detection = problem.detection
        return Setup(
            anchor=problem.anchor,
            height=problem.height,
            mean=problem.mean,
            covariance=problem.covariance,
            motion=turning(motion.interval, motion.turn_rate, np.sqrt(np.diag(motion.process_noise))),
            speed=motion.speed,
            assumptions=self.assumptions,
            false_alarm_tail=self.false_alarm_tail,
            doppler=self.doppler,
            doppler_span=2 * problem.doppler_limit,
            correlation=self.correlation,
            detection_probability=detection.probability if isinstance(detection, ConstantDetection) else 0.9,
        )

    def init(self, problem: Problem, rng: np.random.Generator) -> State:
        """State before the first scan."""
        return State(self.setup(problem))

    def step(self, state: State, scan: Scans, rng: np.random.Generator) -> tuple[State, Info]:
        """One scan. The search region is that of the first scan here, and that of the whole run in :meth:`run`."""
        setup, engine, beliefs = state
        if engine is None or beliefs is None:
            engine = adapter.filter_of(scan, setup, particles=self.particles)
            beliefs = adapter.beginning(engine, setup, rng, self.particles)
        pace = float(scan.pace(setup.motion.interval)[0])
        beliefs, info = adapter.paced(engine, setup, pace).step(rng, beliefs, adapter.scans_of(scan, setup)[0])
        return State(setup, engine, beliefs), Info(adapter.common(info.estimate, setup.assumptions.types))

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """All scans of a run."""
        return adapter.slam(scans, self.setup(problem), particles=self.particles, rng=rng), Diagnostics.none(
            scans.steps
        )
