"""Fixed-lag iterated smoother on the filter's own associations.

The filter linearizes early and never revisits it. The smoother keeps the last `lag` UE states and all
confirmed landmarks as variables of a nonlinear least-squares problem (motion (1), measurements (3), a
Gaussian prior at the window's tail), relinearizes all of them every step (Gauss-Newton in information form)
and marginalizes the oldest state. With a lag as long as the run it is the batch MAP estimate. A landmark
enters with no prior information, as in the PCRB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.kernels import propagate_state
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.slam.ek_pmb import (
    Diagnostics,
    FilterParameters,
    History,
    check_inputs,
    collect,
    diagnose,
    extract,
    filter_steps,
)
from dopslam.slam.pmb import BS_TRACK, Model, compile_model
from dopslam.slam.window import build, eliminate, solve_window

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SmootherParameters:
    """Choices of the fixed-lag smoother.

    Attributes
    ----------
    lag : int
        Steps that are revisited.
    iterations : int
        Most Gauss-Newton iterations per step.
    confirmed : float
        Existence times type probability from which a track's measurements are used.
    """

    lag: int = 5
    iterations: int = 5
    confirmed: float = 0.95

    def __post_init__(self) -> None:
        if self.lag < 1 or self.iterations < 1:
            raise FilterError(f"SmootherParameters: lag {self.lag}, iterations {self.iterations} must be ≥ 1")


class _Window:
    """Variables and factors of the window; the only mutable thing, private to one run."""

    def __init__(
        self,
        prior: tuple[Array, Array],
        motion: CoordinatedTurn,
        model: Model,
        parameters: SmootherParameters,
    ) -> None:
        self.motion, self.model, self.parameters = motion, model, parameters
        self.n = len(prior[0])
        self.information = np.linalg.inv(prior[1])
        self.vector = self.information @ prior[0]
        self.states = np.array([prior[0]], dtype=float)
        self.first = 0  # step of states[0]; the prior itself is step 0, scans are steps 1, 2, …
        self.tracks: list[int] = []
        self.kinds = np.empty(0, dtype=np.int64)
        self.landmarks = np.empty((0, 3))
        self.factors: list[tuple[int, int, int]] = []  # step, track, row of the measurement
        self.weight = np.linalg.inv(motion.process_noise + 1e-12 * np.eye(self.n))
        self.covariance = prior[1]

    def extend(self) -> None:
        """Append the predicted next state."""
        motion, jacobian = self.motion, np.empty((self.n, self.n))
        state = propagate_state(self.states[-1], motion.interval, motion.speed, motion.turn_rate, jacobian)
        self.states = np.concatenate([self.states, state[None]])

    def drop(self, gone: list[int]) -> None:
        """Marginalize landmarks out of the prior."""
        self._eliminate(np.array([self.n + 3 * i + j for i in gone for j in range(3)], dtype=np.int64))
        keep = [i for i in range(len(self.tracks)) if i not in gone]
        self.tracks = [self.tracks[i] for i in keep]
        self.kinds, self.landmarks = self.kinds[keep], self.landmarks[keep]

    def _eliminate(self, drop: NDArray[np.int64]) -> None:
        keep = np.delete(np.arange(len(self.vector)), drop)
        self.information, self.vector, valid = eliminate(self.information, self.vector, keep, drop)
        if not valid:
            raise FilterError("smoother: information matrix is singular; use a longer lag or a tighter prior")

    def agree(self, position: Array, kind: NDArray[np.int64], track: NDArray[np.int64], confirmed: Array) -> None:
        """Follow the filter: forget tracks it dropped or retyped, take up those it has confirmed."""
        alive = dict(zip(track.tolist(), kind.tolist(), strict=True))
        gone = [i for i, t in enumerate(self.tracks) if alive.get(t) != self.kinds[i]]
        if gone:
            self.drop(gone)
        new = [i for i in np.flatnonzero(confirmed) if int(track[i]) not in self.tracks]
        used = {t for _, t, _ in self.factors}
        new = [i for i in new if int(track[i]) in used]
        if new:
            old, size = len(self.vector), len(self.vector) + 3 * len(new)
            information, vector = np.zeros((size, size)), np.zeros(size)
            information[:old, :old], vector[:old] = self.information, self.vector
            self.information, self.vector = information, vector
            self.tracks += [int(track[i]) for i in new]
            self.kinds = np.concatenate([self.kinds, kind[new]])
            self.landmarks = np.concatenate([self.landmarks, position[new]])

    def active(self, z: Array, whiteners: Array, only: int | None = None):
        """Factors whose landmark is a variable (or the BS): window index, landmark index, z, whitener."""
        slot = {t: i for i, t in enumerate(self.tracks)} | {BS_TRACK: -1}
        chosen = [(k, slot[t], row) for k, t, row in self.factors if t in slot and (only is None or k == only)]
        rows = [row for _, _, row in chosen]
        when = np.array([k - self.first for k, _, _ in chosen], dtype=np.int64)
        which = np.array([h for _, h, _ in chosen], dtype=np.int64)
        return when, which, z[rows], whiteners[rows]

    def solve(self, z: Array, whiteners: Array) -> None:
        """Relinearize and solve the whole window."""
        arrays = self.active(z, whiteners)
        states, landmarks, covariance, used = solve_window(
            self.information,
            self.vector,
            self.states,
            self.landmarks,
            self.kinds,
            *arrays,
            self.weight,
            self.model,
            self.parameters.iterations,
        )
        if used < 0:
            raise FilterError("smoother: information matrix is singular; use a longer lag or a tighter prior")
        self.states, self.landmarks, self.covariance = states, landmarks, covariance

    def slide(self, z: Array, whiteners: Array) -> None:
        """Marginalize the tail state, then take the next state's measurements into the prior."""
        when, which, z_next, whiteners_next = self.active(z, whiteners, only=self.first + 1)
        self.information, self.vector, _ = build(
            self.information,
            self.vector,
            self.states[:2],
            self.landmarks,
            self.kinds,
            when,
            which,
            z_next,
            whiteners_next,
            self.weight,
            self.model,
            False,
        )
        self._eliminate(np.arange(self.n))
        self.states = self.states[1:].copy()
        self.first += 1
        self.factors = [f for f in self.factors if f[0] > self.first]


def run(
    scans: Scans,
    prior: tuple[Array, Array],
    motion: CoordinatedTurn,
    bs: Array,
    parameters: FilterParameters | None = None,
    height: float = 0.0,
    smoothing: SmootherParameters | None = None,
) -> tuple[History, Diagnostics]:
    """Filter a whole run and smooth it with a fixed lag; the record holds the state and map at each step's
    own time.

    Parameters as in `ek_pmb.run`, with `smoothing`. Unconfirmed landmarks are reported as the filter has
    them.
    """
    parameters, smoothing = parameters or FilterParameters(), smoothing or SmootherParameters()
    model = compile_model(parameters, motion, bs, height)
    check_inputs(scans, parameters, model, prior[0])
    m = 6 if parameters.doppler else 5
    z = np.ascontiguousarray(scans.z[:, :m])
    whiteners = np.linalg.inv(np.linalg.cholesky(scans.covariance[:, :m, :m]))
    window = _Window(prior, motion, model, smoothing)
    posteriors, infos, means, covariances, maps = [], [], [], [], []
    for k, (posterior, info) in enumerate(filter_steps(scans, prior, parameters, model)):
        position, spread, existence, va, kind, track = extract(posterior)
        named = info.track[0].copy()
        own = scans.offsets[k] + np.arange(len(named))
        named[named == -2] = np.where(np.isin(own, track), own, -2)[named == -2]
        window.factors += [(k + 1, int(t), int(row)) for t, row in zip(named, own, strict=True) if t >= BS_TRACK]
        window.extend()
        likely = existence * np.where(kind == 1, va, 1.0 - va)
        window.agree(position, kind, track, likely > smoothing.confirmed)
        window.solve(z, whiteners)
        n = window.n
        means.append(window.states[-1].copy())
        covariances.append(window.covariance[:n, :n].copy())
        slot = {t: i for i, t in enumerate(window.tracks)}
        for i, t in enumerate(track.tolist()):
            if t in slot:
                rows = slice(n + 3 * slot[t], n + 3 * slot[t] + 3)
                position[i], spread[i] = window.landmarks[slot[t]], window.covariance[rows, rows]
        maps.append((position, spread))
        if len(window.states) > smoothing.lag + 1:
            window.slide(z, whiteners)
        posteriors.append(posterior)
        infos.append(info)
    history = replace(
        collect(posteriors),
        mean=np.array(means),
        covariance=np.array(covariances),
        position=np.concatenate([p for p, _ in maps]),
        position_covariance=np.concatenate([s for _, s in maps]),
    )
    return history, diagnose(infos, posteriors)
