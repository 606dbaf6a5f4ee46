"""The named studies of the synthetic experiment: what varies, how many particles, which start and engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from joblib import Parallel, delayed

from dopslam.errors import FilterError
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.experiment import (
    Experiment,
    blocked,
    cluttered,
    spatial,
    spurious,
    weak,
)
from dopslam.slam.belief.rao_blackwell import RaoBlackwell
from dopslam.slam.belief.records import AOD_FOR_VA, PAPER, Form, Parameters
from dopslam.slam.belief.stacked.backends import backend
from dopslam.slam.belief.stacked.stacked import Stacked
from dopslam.studies.bp_study import RunResult, motion_of, one_run


@dataclass(frozen=True)
class Case:
    """One study.

    Parameters
    ----------
    experiment : what is drawn
    types : likelihood forms of the filter
    particles : N
    informed : whether the first line of sight informs the start
    skip : first steps left out of the RMSE
    engine : "rao_blackwellized", or "stacked" on the likelihood ``backend``
    speed_increment : of the filter's motion model per step and axis [m/s]
    parameters : the filter's; default those matched to the experiment. ``types`` replaces theirs
    """

    experiment: Experiment
    types: tuple[Form, ...] = PAPER
    particles: int = 1000
    informed: bool = True
    skip: int = 0
    engine: str = "rao_blackwellized"
    backend: str = "drjit"
    speed_increment: float = 0.02
    parameters: Parameters | None = field(default=None)

    @property
    def filter(self) -> RaoBlackwell | Conditional | Stacked:
        """The filter."""
        parameters = replace(self.parameters or self.experiment.parameters, types=self.types)
        motion = motion_of(self.experiment, self.speed_increment)
        if self.engine == "rao_blackwellized":
            if parameters.features == "independent":
                return RaoBlackwell(parameters, motion)
            return Conditional(parameters, motion, particles=self.particles)
        if self.experiment.spatial:
            raise FilterError("the stacked engine is planar; use rao_blackwellized for a spatial experiment")
        return Stacked(parameters, motion, self.experiment.radio, backend(self.backend))


CASES: dict[str, Case] = {
    "paper": Case(Experiment()),
    "aod": Case(Experiment(), AOD_FOR_VA),
    "uniform": Case(Experiment(), PAPER, 3000, informed=False, skip=20),
    "cluttered": Case(cluttered()),
    "weak": Case(weak()),
    "blocked": Case(blocked()),
    "spurious": Case(spurious()),
    "spatial": Case(spatial(), AOD_FOR_VA),
    "stacked": Case(Experiment(), PAPER, 100_000, engine="stacked"),
    "va_only": Case(Experiment(), (Form.VA,)),
    "ps_only": Case(Experiment(), (Form.PS,)),
}


def run_case(
    case: Case,
    runs: int,
    seed: int = 1,
    particles: int | None = None,
    done: Callable[[int], None] = lambda _: None,
    jobs: int = 1,
) -> list[RunResult]:
    """``runs`` independent runs; run r depends on (seed, r) only, whatever the number of worker processes."""
    if runs < 1:
        raise FilterError(f"run_case: runs is {runs}; it must be at least 1")
    tasks = (delayed(_run)(case, (seed, r), particles or case.particles) for r in range(runs))
    results = []
    for result in Parallel(n_jobs=jobs, return_as="generator")(tasks):
        results.append(result)
        done(len(results))
    return results


def _run(case: Case, seed: tuple[int, int], particles: int) -> RunResult:
    """One run, after two steps that load the compiled code, so that times exclude it."""
    short, filter_ = replace(case.experiment, steps=2), replace(case, particles=particles).filter
    one_run(short, filter_, 64, (0, 0), informed=case.informed)
    return one_run(case.experiment, filter_, particles, seed, informed=case.informed, skip=case.skip)
