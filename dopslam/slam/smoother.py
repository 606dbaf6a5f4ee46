"""Fixed-lag iterated smoother on the filter's own associations.

The filter linearizes early and never revisits it. The smoother keeps the last `lag` UE states and all
confirmed landmarks as variables of a nonlinear least-squares problem (motion (1), measurements (3), a
Gaussian prior at the window's tail), relinearizes all of them every step (Gauss-Newton in information form)
and marginalizes the oldest state. With an infinite lag it is the batch MAP estimate. A landmark enters with
no prior information, as in the PCRB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.compiled import compiled
from dopslam.errors import FilterError
from dopslam.models.kernels import cholesky, linearize, propagate_state, subtract
from dopslam.models.motion import CoordinatedTurn, propagate
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

Array = NDArray[np.float64]

CONVERGED = 1e-4  # squared Mahalanobis length of a Gauss-Newton step


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
            raise FilterError(f"SmootherParameters: lag ({self.lag}) and iterations ({self.iterations}) must be ≥ 1")


@compiled
def add_motion(information, vector, at, states, j, weight, model, vectors_only_cost):
    """Add ‖s_{j+1} - f(s_j)‖² to the normal equations, s_j at row `at`; returns its cost."""
    n = states.shape[1]
    jacobian = np.empty((n, n))
    predicted = propagate_state(states[j], model.interval, model.site[4], model.turn_rate, jacobian)
    error = states[j + 1] - predicted
    cost = 0.0
    for a in range(n):
        for b in range(n):
            cost += error[a] * weight[a, b] * error[b]
    if vectors_only_cost:
        return cost
    # residual s' - f(s) ≈ (s' - F s) - c with c = f(s0) - F s0
    constant = predicted - jacobian @ states[j]
    tied = weight @ jacobian
    both = jacobian.T @ tied
    pull = weight @ constant
    back = jacobian.T @ pull
    for a in range(n):
        vector[at + a] -= back[a]
        vector[at + n + a] += pull[a]
        for b in range(n):
            information[at + a, at + b] += both[a, b]
            information[at + n + a, at + n + b] += weight[a, b]
            information[at + n + a, at + b] -= tied[a, b]
            information[at + a, at + n + b] -= tied[b, a]
    return cost


@compiled
def add_measurement(information, vector, at, start, state, landmark, kind, z, whitener, model, only_cost):
    """Add ‖L⁻¹(z - h(s, x))‖² to the normal equations, s at row `at`, x at row `start` (-1: BS); returns its
    cost.
    """
    m, n = z.shape[0], state.shape[0]
    predicted, nu = np.empty(m), np.empty(m)
    by_state, by_landmark = np.empty((m, n)), np.empty((m, 3))
    linearize(state, landmark, kind, model.site, predicted, by_state, by_landmark)
    subtract(z, predicted, by_landmark, by_state, nu)
    d = n + 3 if start >= 0 else n
    white = np.zeros((m, d + 1))
    for i in range(m):
        for k in range(i + 1):
            w = whitener[i, k]
            if w != 0.0:
                for j in range(n):
                    white[i, j] += w * by_state[k, j]
                for j in range(n, d):
                    white[i, j] += w * by_landmark[k, j - n]
                white[i, d] += w * nu[k]
    cost = 0.0
    for i in range(m):
        cost += white[i, d] * white[i, d]
    if only_cost:
        return cost
    for i in range(m):  # J x0 + ν: the measurement as seen from the origin
        for j in range(n):
            white[i, d] += white[i, j] * state[j]
        for j in range(n, d):
            white[i, d] += white[i, j] * landmark[j - n]
    for a in range(d):
        row = at + a if a < n else start + a - n
        for i in range(m):
            vector[row] += white[i, a] * white[i, d]
        for b in range(d):
            column = at + b if b < n else start + b - n
            value = 0.0
            for i in range(m):
                value += white[i, a] * white[i, b]
            information[row, column] += value
    return cost


@compiled
def build(
    prior_information, prior_vector, states, landmarks, kinds, when, which, z, whiteners, weight, model,
    only_cost
):
    """Normal equations Λ x = η of the window linearized at (states, landmarks), and the cost there.

    Variables are ordered s_tail … s_now, x_1 … x_H; the prior is over (s_tail, x_1 … x_H).
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    size = base + 3 * count
    information, vector = np.zeros((size, size)), np.zeros(size)
    index = np.empty(n + 3 * count, dtype=np.int64)
    value = np.empty(n + 3 * count)
    for i in range(n):
        index[i], value[i] = i, states[0, i]
    for i in range(3 * count):
        index[n + i], value[n + i] = base + i, landmarks[i // 3, i % 3]
    cost = 0.0
    for i in range(index.shape[0]):
        vector[index[i]] += prior_vector[i]
        cost -= 2.0 * prior_vector[i] * value[i]
        for j in range(index.shape[0]):
            information[index[i], index[j]] += prior_information[i, j]
            cost += value[i] * prior_information[i, j] * value[j]
    for j in range(window - 1):
        cost += add_motion(information, vector, j * n, states, j, weight, model, only_cost)
    nowhere = np.zeros(3)
    for f in range(when.shape[0]):
        h = which[f]
        cost += add_measurement(
            information,
            vector,
            when[f] * n,
            base + 3 * h if h >= 0 else -1,
            states[when[f]],
            landmarks[h] if h >= 0 else nowhere,
            kinds[h] if h >= 0 else 0,
            z[f],
            whiteners[f],
            model,
            only_cost,
        )
    return information, vector, cost


@compiled
def solve_window(
    prior_information, prior_vector, states, landmarks, kinds, when, which, z, whiteners, weight, model,
    iterations
):
    """Gauss-Newton with step halving over the window.

    Returns
    -------
    states, landmarks : the solution
    covariance : inverse information at the solution
    steps : int; iterations used, -1 if the problem is singular
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    states, landmarks = states.copy(), landmarks.copy()
    size = base + 3 * count
    used = 0
    factor = np.zeros((size, size))
    for used in range(1, iterations + 1):
        information, vector, cost = build(
            prior_information, prior_vector, states, landmarks, kinds, when, which, z, whiteners, weight,
            model, False
        )
        point = np.empty(size)
        for i in range(base):
            point[i] = states[i // n, i % n]
        for i in range(3 * count):
            point[base + i] = landmarks[i // 3, i % 3]
        step = vector - information @ point
        gradient = step.copy()
        scale = np.empty(size)
        for i in range(size):
            scale[i] = 1.0 / np.sqrt(max(information[i, i], 1e-300))
        for i in range(size):
            for j in range(size):
                factor[i, j] = information[i, j] * scale[i] * scale[j]
        if not cholesky(factor, size):
            return states, landmarks, factor, -1
        for i in range(size):
            value = step[i] * scale[i]
            for k in range(i):
                value -= factor[i, k] * step[k]
            step[i] = value / factor[i, i]
        for i in range(size - 1, -1, -1):
            value = step[i]
            for k in range(i + 1, size):
                value -= factor[k, i] * step[k]
            step[i] = value / factor[i, i]
        for i in range(size):
            step[i] *= scale[i]
        length = 0.0
        for i in range(size):
            length += gradient[i] * step[i]
        share = 1.0
        new_states, new_landmarks = states.copy(), landmarks.copy()
        for _ in range(6):
            for i in range(base):
                new_states[i // n, i % n] = point[i] + share * step[i]
            for i in range(3 * count):
                new_landmarks[i // 3, i % 3] = point[base + i] + share * step[base + i]
            if length < 1.0:  # close enough for the quadratic model
                break
            _, _, new_cost = build(
                prior_information,
                prior_vector,
                new_states,
                new_landmarks,
                kinds,
                when,
                which,
                z,
                whiteners,
                weight,
                model,
                True,
            )
            if new_cost <= cost:
                break
            share *= 0.5
        states, landmarks = new_states, new_landmarks
        if length < CONVERGED:
            break
    # covariance = scale · (F Fᵀ)⁻¹ · scale
    inverse = np.zeros((size, size))
    for j in range(size):
        inverse[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, size):
            value = 0.0
            for k in range(j, i):
                value -= factor[i, k] * inverse[k, j]
            inverse[i, j] = value / factor[i, i]
    covariance = inverse.T @ inverse
    for i in range(size):
        for j in range(size):
            covariance[i, j] *= scale[i] * scale[j]
    return states, landmarks, covariance, used


def marginalize(information: Array, vector: Array, drop: NDArray[np.int64]) -> tuple[Array, Array]:
    """Normal equations without the rows `drop` (Schur complement); rows without information just go."""
    size = len(vector)
    keep = np.setdiff1d(np.arange(size), drop)
    drop = drop[np.diag(information)[drop] > 0]
    if not len(drop):
        return information[np.ix_(keep, keep)], vector[keep]
    cross = information[np.ix_(keep, drop)]
    inner = information[np.ix_(drop, drop)]
    scale = 1.0 / np.sqrt(np.diag(inner))
    solved = np.linalg.solve(inner * scale[:, None] * scale, scale[:, None] * np.column_stack([cross.T,
    vector[drop]])) solved *= scale[:, None]
    left = information[np.ix_(keep, keep)] - cross @ solved[:, :-1]
    return 0.5 * (left + left.T), vector[keep] - cross @ solved[:, -1]


class _Window:
    """Variables and factors of the window; the only mutable thing, private to one run."""

    def __init__(self, prior: tuple[Array, Array], motion: CoordinatedTurn, model: Model, parameters: SmootherParameters):
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

    def drop(self, gone: list[int]) -> None:
        """Marginalize landmarks out of the prior."""
        rows = np.array([self.n + 3 * i + j for i in gone for j in range(3)], dtype=np.int64)
        self.information, self.vector = marginalize(self.information, self.vector, rows)
        keep = [i for i in range(len(self.tracks)) if i not in gone]
        self.tracks = [self.tracks[i] for i in keep]
        self.kinds, self.landmarks = self.kinds[keep], self.landmarks[keep]

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
        chosen = [(k, slot[t], row) for k, t, row in self.factors if t in slot and (only is None or k ==
        only)] rows = [row for _, _, row in chosen]
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
            raise FilterError("smoother: the window's information matrix is singular; use a longer lag or a tighter prior")
        self.states, self.landmarks, self.covariance = states, landmarks, covariance

    def slide(self, z: Array, whiteners: Array) -> None:
        """Marginalize the tail state, then take the next state's measurements into the prior."""
        n = self.n
        when, which, z_next, whiteners_next = self.active(z, whiteners, only=self.first + 1)
        information, vector, _ = build(
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
        self.information, self.vector = marginalize(information, vector, np.arange(n))
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
        window.factors += [(k + 1, int(t), int(row)) for t, row in zip(named, own, strict=True) if t >=
        BS_TRACK] window.states = np.vstack([window.states, propagate(window.states[-1], motion)])
        likely = existence * np.where(kind == 1, va, 1.0 - va)
        window.agree(position, kind, track, likely > smoothing.confirmed)
        window.solve(z, whiteners)
        n, base = window.n, window.states.size
        means.append(window.states[-1].copy())
        covariances.append(window.covariance[base - n : base, base - n : base].copy())
        slot = {t: i for i, t in enumerate(window.tracks)}
        for i, t in enumerate(track.tolist()):
            if t in slot:
                rows = slice(base + 3 * slot[t], base + 3 * slot[t] + 3)
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
    return history, diagnose(infos)
