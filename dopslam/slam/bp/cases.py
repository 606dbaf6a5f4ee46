"""The named studies of the synthetic experiment: what varies, how many particles, which start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from dopslam.slam.bp.experiment import (
    Experiment,
    blocked,
    cluttered,
    spatial,
    spurious,
    weak,
)
from dopslam.slam.bp.rao_blackwell import RaoBlackwell
from dopslam.slam.bp.records import AOD_FOR_VA, PAPER, Form
from dopslam.slam.bp.study import RunResult, motion_of, one_run


@dataclass(frozen=True)
class Case:
    """One study: experiment, types of the filter, particles, informed start or not, steps left out of the RMSE."""

    experiment: Experiment
    types: tuple[Form, ...] = PAPER
    particles: int = 1000
    informed: bool = True
    skip: int = 0

    @property
    def filter(self) -> RaoBlackwell:
        """The filter matched to the experiment."""
        return RaoBlackwell(replace(self.experiment.parameters, types=self.types), motion_of(self.experiment))


CASES: dict[str, Case] = {
    "paper": Case(Experiment()),
    "aod": Case(Experiment(), AOD_FOR_VA),
    "uniform": Case(Experiment(), PAPER, 3000, informed=False, skip=20),
    "cluttered": Case(cluttered()),
    "weak": Case(weak()),
    "blocked": Case(blocked()),
    "spurious": Case(spurious()),
    "spatial": Case(spatial(), AOD_FOR_VA),
    "va_only": Case(Experiment(), (Form.VA,)),
    "ps_only": Case(Experiment(), (Form.PS,)),
}


def run_case(
    case: Case, runs: int, seed: int = 1, particles: int | None = None, done: Callable[[int], None] = lambda _: None
) -> list[RunResult]:
    """``runs`` independent runs; run r depends on (seed, r) only."""
    results = []
    for r in range(runs):
        size = particles or case.particles
        results.append(one_run(case.experiment, case.filter, size, (seed, r), informed=case.informed, skip=case.skip))
        done(r + 1)
    return results
