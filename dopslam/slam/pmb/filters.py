"""The EK-PMB filters of paper A as records of choices: joint and marginal density, fixed-lag smoother, mixture.

They share one recursion (:mod:`dopslam.slam.pmb.ek_pmb`); what differs is what is kept after a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dopslam.models import unmeasured
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.slam.filter import Capabilities, Info, Problem, run_steps
from dopslam.slam.history import Diagnostics, History, estimate_of
from dopslam.slam.pmb import ek_pmb, mixture, smoother
from dopslam.slam.pmb.birth import STOREYS
from dopslam.slam.pmb.density import OUTLIER, PMB, FilterParameters, Model, compile_model, initial_density, predicted

OPEN_HEADING = 0.1  # rad per step of process noise, beyond which a heading says little of the next
MANY = 100  # associations that are then kept
EXPECTED = 10.0  # landmarks of a kind thought possible where the detections can come from


def _in_the_plane(scans: Scans) -> float:
    """Least intensity [m⁻³] of undetected landmarks where only the plane is seen, as high as a birth takes it to be.

    In three dimensions the directions of a detection leave next to nothing to chance, and any intensity does; in the plane
    one that is far too low makes an unlikely line of sight of what comes over a landmark.
    """
    spans = np.append(unmeasured.SPANS[:5], scans.doppler_span)
    used = ~unmeasured.missing(np.einsum("nii->ni", scans.covariance), spans)
    width = unmeasured.delay_width(scans.search_volume, scans.doppler_span, used.any(axis=0))
    return EXPECTED / (width**2 * STOREYS)


class State(NamedTuple):
    """What the recursion carries from scan to scan: the density, and how many measurements it has read."""

    problem: Problem
    density: Any
    measurements: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """EK-PMB with the cross-covariances of receiver and map kept through time.

    Attributes
    ----------
    doppler : use the Doppler row
    iterations : linearizations per update; 1 is the plain EKF
    associations : γ, data associations kept per step
    gate : squared Mahalanobis distance beyond which a measurement cannot belong to a track
    intensity_sr : m⁻³, of undetected second reflections; None: a hundredth of the virtual anchors', 0: no such type
    hide, reappear : probabilities per step that a landmark in sight goes out of sight, and that one just gone comes back
    prune_existence : landmarks below this existence are dropped
    linearization : ``"extended"``, or ``"cubature"`` points instead of Jacobians
    reweight : weight associations by the evidence of the joint update; None: where the cross-covariances are kept; always,
        and a hundred of them, where the motion model leaves the heading open
    thinning : reduce the undetected intensity inside the field of view after every scan
    """

    capabilities = Capabilities(states=(4, 6), any_motion=True, intervals=True)
    largest_order: ClassVar[int | None] = 1  # reflections of a virtual anchor that the map may hold; None: any
    correlated: ClassVar[bool] = True

    doppler: bool = True
    iterations: int = 3
    associations: int = 10
    gate: float = 40.0
    intensity_sr: float | None = None
    hide: float = 0.05
    reappear: float = 0.1
    prune_existence: float = 1e-3
    linearization: str = "extended"
    reweight: bool | None = None
    thinning: bool = False

    def parameters(self, problem: Problem, scans: Scans) -> FilterParameters:
        """Choices and problem in the form that the recursion reads."""
        # Exact weights of many associations where the heading may be any from one scan to the next, and with it everything
        # that is seen: products of single likelihoods know nothing of an error that all share.
        turned = bool(np.sqrt(problem.motion.process_noise[2, 2]) > OPEN_HEADING)
        intensity = np.array(problem.undetected)
        planar = unmeasured.planar(np.einsum("nii->ni", scans.covariance))
        if planar:
            intensity = np.maximum(intensity, _in_the_plane(scans))
        second = 0.01 * float(intensity[0]) if self.intensity_sr is None else self.intensity_sr
        return FilterParameters(
            joint=self.correlated,
            doppler=self.doppler,
            iterations=self.iterations,
            associations=max(self.associations, MANY) if turned else self.associations,
            gate=self.gate,
            prune=self.prune_existence,
            cubature=self.linearization == "cubature",
            reweight=(self.correlated if self.reweight is None else self.reweight) or turned,
            thinning=self.thinning,
            survival=problem.survival,
            hide=self.hide,
            reappear=self.reappear,
            intensity=(*intensity.tolist(), second),
            birth_intensity=problem.births,
            detection=problem.detection_of(scans),
            outlier=OUTLIER if scans.cells else 0.0,
            pieces=scans.cells,
            planar=planar,
        )

    def init(self, problem: Problem, rng: np.random.Generator) -> State:
        """The prior of the receiver and an empty map."""
        return State(problem, self._start(initial_density(problem.mean, problem.covariance)))

    def step(self, state: State, scan: Scans, rng: np.random.Generator) -> tuple[State, Info]:
        """One recursion (30)."""
        problem = state.problem
        model = compile_model(self.parameters(problem, scan), problem.motion, problem.anchor, problem.height)
        ek_pmb.check_inputs(scan, self.parameters(problem, scan), model, problem.mean, problem.covariance)
        read = ek_pmb.scan_of(scan, 0, self.doppler, problem.motion.interval)._replace(first=state.measurements)
        if not isinstance(problem.motion, CoordinatedTurn):
            now = problem.motion.paced(read.pace)
            model, read = (
                predicted(model, now, self._reported(state.density).mean[: now.dimension]),
                read._replace(pace=1.0),
            )
        density, told = self._step(state.density, read, model)
        passed = int(np.isneginf(read.log_snr).sum())
        info = Info(
            estimate_of(self._reported(density)), told.nis, told.rows, told.weight, told.track, told.existence, passed
        )
        return State(problem, density, state.measurements + len(scan.z)), info

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """The recursion over all scans, compiled as one; scan by scan if the motion model is none that is compiled."""
        if not isinstance(problem.motion, CoordinatedTurn):
            return run_steps(self, problem, scans, rng)
        return ek_pmb.run(*self._arguments(problem, scans))

    def _arguments(self, problem: Problem, scans: Scans):
        prior = (problem.mean, problem.covariance)
        return scans, prior, problem.motion, problem.anchor, self.parameters(problem, scans), problem.height

    def _start(self, density: PMB) -> Any:
        return density

    def _reported(self, density: Any) -> PMB:
        return density

    def _step(self, density: Any, read: Any, model: Model) -> tuple[Any, ek_pmb.Info]:
        return ek_pmb.single_step(density, read, model)


@dataclass(frozen=True, slots=True, kw_only=True)
class Marginal(Joint):
    """Paper A's filter: only the marginals of receiver and map survive a step, (31)-(32); it becomes overconfident."""

    correlated: ClassVar[bool] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoother(Joint):
    """The joint filter, relinearized over the last ``lag`` steps; every step is estimated from the scans up to it.

    ``step`` is the filter's own: the window is kept by ``run`` alone.
    """

    capabilities = Capabilities(states=(4, 6), intervals=True)

    lag: int = 5

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """Filter and smooth a whole run."""
        chosen = smoother.SmootherParameters(lag=self.lag, delayed=self.capabilities.delayed)
        return smoother.run(*self._arguments(problem, scans), chosen)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lagged(Smoother):
    """The smoother, asked ``lag`` steps later: every step from the scans up to then, with the map of that time.

    ``step`` tells the newest state, as there.
    """

    capabilities = Capabilities(states=(4, 6), delayed=True, intervals=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixture(Joint):
    """EK-PMBM: no projection, at most ``hypotheses`` global hypotheses are kept."""

    capabilities = Capabilities(states=(4, 6), intervals=True)

    hypotheses: int = 20

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """Filter a whole run."""
        return mixture.run(*self._arguments(problem, scans), self.hypotheses)

    def _start(self, density: PMB) -> Any:
        return [mixture.Hypothesis(0.0, density)]

    def _reported(self, density: Any) -> PMB:
        return mixture.merged(density)

    def _step(self, density: Any, read: Any, model: Model) -> tuple[Any, ek_pmb.Info]:
        return mixture.step(density, read, model, self.hypotheses)
