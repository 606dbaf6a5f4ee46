"""Running a filter over a scan sequence, and its score against a synthetic truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.evaluate.metrics import gospa, nees
from dopslam.models.measurement import wrap
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.experiment import Experiment, Truth
from dopslam.slam.belief.rao_blackwell import RaoBlackwell, State
from dopslam.slam.belief.records import Form, Info, Scan
from dopslam.slam.belief.stacked.stacked import Stacked, StackedState
from dopslam.slam.belief.start import Box, informed_start, uniform_start


@dataclass(frozen=True)
class History:
    """Infos of every step, the final state and the time per step [s]: of the CPU for the Rao-Blackwellized engine, by the
    clock for the stacked one, whose backend has threads."""

    infos: list[Info]
    state: State | StackedState
    seconds_per_step: float

    @property
    def positions(self) -> np.ndarray:
        """(K, 3) m."""
        return np.array([info.estimate.position for info in self.infos])

    @property
    def headings(self) -> np.ndarray:
        """(K,) rad."""
        return np.array([info.estimate.heading for info in self.infos])


def run(
    filter_: RaoBlackwell | Conditional | Stacked,
    rng: np.random.Generator,
    scans: Sequence[Scan],
    box: Box,
    size: int,
    *,
    informed: bool = True,
) -> History:
    """Start from the box prior (informed by the first line of sight or not) and filter every scan."""
    if informed:
        start = informed_start(rng, box, scans[0], filter_.parameters, filter_.motion.interval, size)
        state = filter_.init(*start, float(scans[0].amplitude.max(initial=1.0)))
    else:
        state = filter_.init(*uniform_start(rng, box, size))
    return run_from(filter_, rng, scans, state)


def run_from(filter_, rng: np.random.Generator, scans: Sequence[Scan], state) -> History:
    """Filter every scan from a given state."""
    clock = time.perf_counter if isinstance(filter_, Stacked) else time.thread_time
    infos, begin = [], clock()
    for scan in scans:
        state, info = filter_.step(rng, state, scan)
        infos.append(info)
    return History(infos, state, (clock() - begin) / max(len(scans), 1))


@dataclass(frozen=True)
class Score:
    """Score of one run.

    Attributes
    ----------
    position_error : (K,) m, heading_error : (K,) rad, signed
    position_rmse : m and heading_rmse : rad over the steps counted
    type_history : (K, L) belief in the true type of every feature (0 while it is not declared near its place)
    true_type : (L,) at the last step
    map_error : (L,) m, distance of the nearest declared feature at the last step
    nees : (K,) of (x, y, heading)
    gospa_va, gospa_sp : (K, 4) of the declared features by their likeliest type: distance [m] and its parts
        localization, missed, false [m²]
    found : true features with a declared one within ``near``; false : declared ones without a true one
    ghost : whether a feature is declared within ``near`` of the anchor
    """

    position_error: np.ndarray
    heading_error: np.ndarray
    position_rmse: float
    heading_rmse: float
    type_history: np.ndarray
    true_type: np.ndarray
    map_error: np.ndarray
    nees: np.ndarray
    gospa_va: np.ndarray
    gospa_sp: np.ndarray
    found: int
    false: int
    ghost: bool


def evaluate(
    experiment: Experiment,
    truth: Truth,
    history: History,
    types: tuple[Form, ...],
    *,
    skip: int = 0,
    near: float = 0.5,
    cutoff: float = 20.0,
) -> Score:
    """Compare a run with the truth.

    Parameters
    ----------
    types : the filter's types; both virtual-anchor forms count as virtual anchor
    skip : steps left out of the RMSE at the start (convergence from a uniform prior)
    near : m, radius of a feature found
    cutoff : m, of GOSPA
    """
    position_error = np.linalg.norm(history.positions - truth.position, axis=1)
    heading_error = wrap(history.headings - truth.heading)
    scatterer = np.array([form == Form.PS for form in types])
    beliefs = np.zeros((len(history.infos), len(experiment.features)))
    for k, info in enumerate(history.infos):
        estimate = info.estimate
        if not len(estimate.feature):
            continue
        # The likeliest feature of the true type counts wherever its other type's Gaussian may be.
        owner = _owners(experiment, truth.position[k], estimate.feature)
        for place, form in enumerate(experiment.forms):
            mine = owner == place
            same = scatterer if form == Form.PS else ~scatterer
            if mine.any():
                beliefs[k, place] = (estimate.existence[mine] * estimate.type_belief[mine][:, same].sum(axis=1)).max()
    last = history.infos[-1].estimate.feature
    gaps = np.linalg.norm(last[:, None] - experiment.features, axis=2)
    return Score(
        position_error,
        heading_error,
        float(np.sqrt(np.mean(position_error[skip:] ** 2))),
        float(np.sqrt(np.mean(heading_error[skip:] ** 2))),
        beliefs,
        beliefs[-1],
        gaps.min(axis=0) if len(last) else np.full(len(experiment.features), np.inf),
        _nees(truth, history),
        _gospa(experiment, history, scatterer, False, cutoff),
        _gospa(experiment, history, scatterer, True, cutoff),
        int((gaps.min(axis=0) < near).sum()) if len(last) else 0,
        int((gaps.min(axis=1) > near).sum()) if len(last) else 0,
        bool(len(last) and (np.linalg.norm(last - experiment.anchor, axis=1) < near).any()),
    )


def _nees(truth: Truth, history: History) -> np.ndarray:
    """(K,) squared error of (x, y, heading) in units of the particles' covariance."""
    rows = np.array([0, 1, 2])
    covariance = np.array([info.estimate.state_covariance for info in history.infos])[:, rows][:, :, rows]
    error = np.column_stack([history.positions, history.headings]) - np.column_stack([truth.position, truth.heading])
    return nees(np.column_stack([error[:, :2], wrap(error[:, 3])]), covariance)


def _gospa(experiment: Experiment, history: History, scatterer: np.ndarray, kind: bool, cutoff: float) -> np.ndarray:
    """(K, 4) GOSPA distance and parts of the virtual anchors (``kind`` False) or the scatterers (True)."""
    truth = experiment.features[np.array([form == Form.PS for form in experiment.forms]) == kind]
    rows = []
    for info in history.infos:
        declared = scatterer[info.estimate.type_belief.argmax(axis=1)] == kind
        score = gospa(truth, info.estimate.feature[declared], cutoff)
        rows.append([score.distance, score.localization, score.missed, score.false])
    return np.array(rows)


def _owners(experiment: Experiment, position: np.ndarray, features: np.ndarray, near: float = 1.0) -> np.ndarray:
    """(D,) true feature within ``near`` [m] of each estimate, the incidence point counting as well; −1 for none."""
    owners = np.full(len(features), -1)
    for place, (form, q) in enumerate(zip(experiment.forms, experiment.features, strict=True)):
        candidates = [q]
        if form != Form.PS:
            normal = q - experiment.anchor
            middle = 0.5 * (q + experiment.anchor)
            candidates.append(position + (q - position) * ((middle - position) @ normal) / ((q - position) @ normal))
        for candidate in candidates:
            owners[np.linalg.norm(features - candidate, axis=1) < near] = place
    return owners
