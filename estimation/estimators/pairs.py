"""Pairs that one path was fitted to, in phase or not.

Two paths less than a resolution cell apart leave of their common fit what no move and no gain of it explains: out of phase
the first, in phase the second derivative of the signature. Both are what a second path nearby would find in the residual,
once it has paid for what the fitted one explains as well. So every path of a converged fit is tested at points about it,
the products of a few in each mode, by a score test (one pass over the data for all points of all paths); where that is
high, two paths are fitted. Points about a path are few beside those of a whole search, and so is the evidence that is due:
a threshold for the volume of one lobe. A pair that passes it is reported as two paths; one that almost does as one path,
with a covariance grown by the spread of the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gamma, pi

import numpy as np

from ..signal.algebra import Blocks, normalized, weighted_blocks
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.modes import Mode
from ..signal.paths import Geometry
from .cells import ring
from .detect import expected_maxima, threshold_for
from .floor import LARGEST, Floor
from .haze import raised
from .lobes import great_circle
from .noise import Noise
from .polish import less_known
from .projector import Projector
from .refine import Linearization, information, joint_fit, linearize, metric
from .split import Fitter

APART = 0.8
"""Distance of the tested points from a path along each mode, in its metric; a lobe ends near 3."""
SUSPECT = 9.0
"""Least score that a pair is fitted for; one clean path in fifty has more."""
TOLD = 0.004
"""Probability that a single path counts as a pair."""
BLUR = 2.0
"""Variance of the direction in which a pair is apart, in units of the inverse gain in log-likelihood."""
SEPARATE = 4.0
"""Least distance of a reported pair in standard deviations: of what is only out of phase, amplitude and place are one."""
REACH = 1.9
"""Radius, in the metric, of the ball whose peaks in noise a second path competes with, so that single paths look like a
pair at the nominal rate (720 of them on twelve random links)."""
FARTHEST = 3.5
"""Paths farther apart than this in the metric are no pair of one lobe."""
TRIED = 2
"""Paths at most that a second one is fitted to before weaker paths are looked for."""
SETTLED = 0.6
"""Share of what was left about a path that may still be with a second one: errors of a model are not explained by it."""
NEIGHBOR = 0.1
"""Least coherence of paths whose own moves are reckoned with."""
CROWD = 3
"""At most so many of them, the most coherent ones."""


@dataclass(frozen=True, eq=False)
class Suspects:
    """The best point about each path.

    Attributes
    ----------
    statistic : (P,) log-likelihood that a second path there would gain
    step : (P, 6) from the path to it, on the tangents
    """

    statistic: Float
    step: Float


def local_level(rate: float, parameters: int) -> float:
    """Threshold on a gain in log-likelihood that a second path within a lobe of a known one finds in noise at ``rate``."""
    ball = pi ** (parameters / 2) / gamma(parameters / 2 + 1) * REACH**parameters
    return threshold_for(rate, 2 * pi * ball, parameters)


def points_about(modes: tuple[Mode, ...], lengths: Float, active) -> list[Float]:
    """Tangent steps (P, c, 6) per mode to a path itself and to points about it."""
    diagonal = np.einsum("paa->pa", lengths)
    line = np.where(diagonal > 0, APART / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    steps = []
    for row, mode in enumerate(modes):
        total = np.zeros((len(lengths), 1, 6))
        for first in mode.parameters:
            if row and first == 0:
                # Shifted pilots tell delays beyond the comb's; within a lobe of the first mode their phase hardly turns.
                continue
            if first in (0, 5):
                part = np.zeros((len(lengths), 3, 6))
                part[:, 1, first], part[:, 2, first] = line[:, first], -line[:, first]
            elif first in (1, 3):
                # Modes that tell both directions have many points anyway.
                around = slice(first, first + 2)
                part = ring(lengths[:, around, around], APART, active[around], 6 if len(mode.parameters) < 5 else 4)
                part = np.pad(part, ((0, 0), (0, 0), (first, 4 - first)))
            else:
                continue
            total = (total[:, :, None] + part[:, None]).reshape(len(lengths), -1, 6)
        steps.append(total)
    return steps


def suspects(data: Projector, lin: Linearization, noise_variance: float) -> Suspects:
    """Score test for a second path about each one of a converged fit."""
    model, count = data.model, len(lin.gain)
    lengths = metric(np.moveaxis(np.diagonal(lin.gram, axis1=0, axis2=2), -1, 0), model.active)
    modes = model.bands[0].modes
    steps = points_about(modes, lengths, model.active)
    vectors = []
    for mode, step in zip(modes, steps, strict=True):
        points = lin.geometry.take(np.repeat(np.arange(count), step.shape[1])).moved(step.reshape(-1, 6))
        vectors.append(mode.vector(points).reshape(*step.shape[:2], -1))
    inner = data.about(lin.geometry, steps, vectors)
    shape = inner.shape[1:]
    known = weighted_blocks(model, lin.blocks)[0]
    inner = inner.reshape(count, -1) - outer_grams(vectors, [b[None, :, :1] for b in known], model)[..., 0] @ lin.gain
    own = [v if row or model.weight is None else v @ model.weight.T for row, v in enumerate(vectors)]
    norm = _products([np.einsum("pcn,pcn->pc", v.conj(), w).real for v, w in zip(vectors, own, strict=True)])
    scores = np.empty(norm.shape)
    for paths, near in neighbors(lin):
        cross = outer_grams([v[paths] for v in vectors], [b[near] for b in known], model)
        scores[paths] = score(lin, near, cross, inner[paths], norm[paths], model.active)
    best = np.argmax(scores, axis=1)
    every = np.arange(count)
    step = np.sum([s[every, i] for s, i in zip(steps, np.unravel_index(best, shape), strict=True)], axis=0)
    return Suspects(scores[every, best] / noise_variance, step)


def coherence(lin: Linearization) -> Float:
    """Coherence (P, P) of the paths' signatures, each with itself too: where one is fitted anew, so are its neighbors."""
    return normalized(lin.gram[:, 0, :, 0]) + np.eye(len(lin.gain))


def neighbors(lin: Linearization) -> list[tuple[np.typing.NDArray[np.intp], np.typing.NDArray[np.intp]]]:
    """Paths (B,), and each with those whose moves may be confused with its own (B, Q); equal Q together."""
    overlap = coherence(lin)
    order = np.argsort(-overlap, axis=1)
    close = np.minimum(np.sum(overlap > NEIGHBOR, axis=1), 1 + CROWD)
    return [(paths, order[paths, :size]) for size in np.unique(close) for paths in [np.flatnonzero(close == size)]]


def score(lin: Linearization, near, cross, inner, norm, active) -> Float:
    """Log-likelihood (B, I), in energies, that a second path at points about each of B paths gains to first order in its
    gain, the paths ``near`` (B, Q) free to move and the others not.

    ``cross`` (B, I, Q, 7) are inner products of the points' signatures with the known signatures and their derivatives,
    ``inner`` (B, I) those with the residual, ``norm`` (B, I) their energies.
    """
    columns = 1 + np.flatnonzero(active)
    many, count = near.shape
    size = count * len(columns)
    gram = lin.gram[near[:, :, None], :, near[:, None, :]]  # (B, Q, Q, 7, 7)
    plain = gram[..., 0, 0]
    mixed = gram[:, :, :, 0][..., columns].reshape(many, count, size)
    full = gram[..., columns, :][..., columns].transpose(0, 1, 3, 2, 4).reshape(many, size, size)
    diagonal = np.einsum("bqq->bq", plain).real
    regular = np.where(diagonal > 0, 1e-9 * diagonal, 1.0)  # a path where a pattern vanishes has no signature
    inverse = np.linalg.inv(plain + regular[:, :, None] * np.eye(count))
    weight = np.repeat(lin.gain[near], len(columns), axis=1)
    # What the known signatures can explain goes first, by complex gains; then what moving them can, by real steps.
    share = cross[..., 0] @ inverse
    own = np.maximum(norm - np.einsum("biq,biq->bi", share, cross[..., 0].conj()).real, 0)
    tangent = full - mixed.conj().swapaxes(1, 2) @ inverse @ mixed
    tangent = np.real(tangent * weight.conj()[:, :, None] * weight[:, None])
    along = (cross[..., columns].reshape(*norm.shape, size) - share @ mixed) * weight[:, None]
    diagonal = np.einsum("baa->ba", tangent)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    tangent = np.linalg.inv(tangent * scale[:, :, None] * scale[:, None] + 1e-9 * np.eye(size))
    real, imag = along.real * scale[:, None], along.imag * scale[:, None]
    left = (lin.gradient[near][..., columns - 1].reshape(many, size) * scale)[..., None]
    moved = real @ tangent, imag @ tangent
    first, second = inner.real - (moved[0] @ left)[..., 0], inner.imag - (moved[1] @ left)[..., 0]
    a = own - np.einsum("bia,bia->bi", moved[0], real)
    b = own - np.einsum("bia,bia->bi", moved[1], imag)
    c = -np.einsum("bia,bia->bi", moved[0], imag)
    determinant = a * b - c**2
    told = determinant > 1e-4 * norm**2
    gained = (b * first**2 - 2 * c * first * second + a * second**2) / np.where(told, determinant, 1.0)
    return np.where(told, gained, 0.0)


def outer_grams(vectors, blocks, model: SignalModel):
    """Inner products (P, I, Q, 1 or 7) of all outer products of vectors (P, c, n), one of each mode, with signatures and
    derivatives in blocks (P or 1, Q, d, n).
    """
    columns = model.columns if blocks[0].shape[2] > 1 else np.zeros((len(blocks), 1), int)
    total = np.ones((1, 1, 1, 1))
    for row, (own, other) in enumerate(zip(vectors, blocks, strict=True)):
        _, count, _, size = other.shape
        part = own.conj() @ other.reshape(len(other), -1, size).swapaxes(1, 2)
        part = part.reshape(len(own), own.shape[1], count, -1)[..., columns[row]]
        total = (total[:, :, None] * part[:, None]).reshape(len(own), -1, count, columns.shape[1])
    return total if columns.shape[1] == 1 else model.merged(total)


def _products(factors):
    total = np.ones((1, 1))
    for factor in factors:
        total = (total[:, :, None] * factor[:, None]).reshape(len(factor), -1)
    return total


@dataclass(frozen=True, eq=False)
class Rest:
    """Data less paths that stay as they are: what :func:`~.refine.joint_fit` needs of it."""

    data: Projector
    known: Linearization

    @property
    def model(self) -> SignalModel:
        """The link."""
        return self.data.model

    def inner(self, geometry: Geometry, blocks: Blocks):
        """``<d_a s_p, y>`` (P, 7) of signatures and derivatives with what is left."""
        return less_known(self.model, self.data.inner(geometry, blocks), blocks, self.known)


def gained_alone(data: Projector, lin: Linearization, path: int, second: Geometry, noise_variance: float) -> float:
    """Log-likelihood that a second path beside one gains, those that do not overlap with it left as they are."""
    overlap = coherence(lin)[path]
    close, others = np.flatnonzero(overlap > NEIGHBOR), np.flatnonzero(overlap <= NEIGHBOR)
    rest = Rest(data, lin.sorted(others)) if len(others) else data
    pair = joint_fit(rest, lin.geometry.take(close).joined(second), noise_variance, 0.5)
    return (pair.explained - linearize(rest, lin.geometry.take(close)).explained) / noise_variance


def separated(lin: Linearization, path: int, apart: Float, active, noise_variance: float) -> float:
    """Squared distance of a path from the last one, ``apart`` (6,) tangent steps, in terms of its covariance."""
    seen = np.tile(np.asarray(active, bool), len(lin.gain))
    matrix = information(lin, active)[np.ix_(seen, seen)] * 2 / noise_variance
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    size = int(np.sum(active))
    to = np.zeros((size, len(matrix)))
    to[:, path * size : (path + 1) * size], to[:, -size:] = -np.eye(size), np.eye(size)
    inverse = np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-10, hermitian=True)
    covariance = (to * scale) @ inverse @ (to * scale).T
    unit = 1 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    step = apart[np.asarray(active, bool)] * unit
    return float(step @ np.linalg.solve(covariance * np.outer(unit, unit) + 1e-9 * np.eye(size), step))


def steps_between(start: Geometry, end: Geometry) -> Float:
    """Tangent steps (P, 6) from paths to others."""
    return np.column_stack([
        end.delay - start.delay,
        great_circle(start.arrival, end.arrival),
        great_circle(start.departure, end.departure),
        end.speed - start.speed,
    ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pair:
    """A converged fit with a second path, the last one, about one of its paths.

    Attributes
    ----------
    grown : the fit
    gained : log-likelihood over the fit without it
    apart : (6,) tangent steps between the two
    lengths : (6, 6) metric of the path
    left : noise about the path that the fit still leaves, of :meth:`~.floor.Floor.about`
    stands : whether it is two paths rather than a single one and the errors of a model
    """

    grown: Linearization
    gained: float
    apart: Float
    lengths: Float
    left: float
    stands: bool


def thresholds(estimator: Fitter) -> tuple[float, float]:
    """Gains in log-likelihood from which on a pair is two paths, and from which on it is a pair at all."""
    rate = min(float(expected_maxima(estimator.level, estimator.volume, estimator.parameters)), 0.01)
    return local_level(max(0.1 * rate, 1e-12), estimator.parameters), local_level(TOLD, estimator.parameters)


def paired(
    estimator: Fitter,
    data: Projector,
    lin: Linearization,
    path: int,
    step: Float,
    noise: Noise,
    levels: tuple[float, float],
) -> Pair | None:
    """The fit with a second path ``step`` (6,) from a ``path``; None if it is no pair, by the ``levels`` of
    :func:`thresholds`.
    """
    model, variance = data.model, noise.variance(lin)
    due, told = levels
    one = lin.geometry.take([path])
    second = one.moved(step[None])
    if gained_alone(data, lin, path, second, variance) < told:
        return None
    grown = estimator._fit(data, lin.geometry.joined(second), noise)
    gained = (grown.explained - lin.explained) / variance
    two = grown.geometry.take([path, -1])
    lengths = metric(lin.gram[path, :, path], model.active)
    apart = steps_between(two.take([0]), two.take([1]))[0] * model.active
    if gained < told or apart @ lengths @ apart > FARTHEST**2:
        return None
    strength = lin.drop[path] / variance
    left = Floor(data, grown, variance).about(one)
    needed = due * left + estimator.error_share * strength
    stands = gained > min(needed, max(LARGEST * strength, due))
    stands = stands and separated(grown, path, apart, model.active, variance) > SEPARATE**2
    return Pair(grown, gained, apart, lengths, left, stands)


def nearest(estimator: Fitter, data: Projector, lin: Linearization, noise: Noise, least: float) -> Linearization | None:
    """The fit with one of its paths in two, if a second path about one gains more than ``least`` in log-likelihood; None
    otherwise. Where that much is left about a path no weaker one can be looked for: it is what errors of a model would leave.
    """
    if data.model.subbands > 1 or not data.model.active.any():
        return None
    variance = noise.variance(lin)
    found, levels, floor = suspects(data, lin, variance), thresholds(estimator), Floor(data, lin, variance)
    for path in np.argsort(-found.statistic)[:TRIED]:
        if found.statistic[path] < max(SUSPECT, least):
            break
        pair = paired(estimator, data, lin, int(path), found.step[path], noise, levels)
        if pair is None or not pair.stands or pair.gained <= least:
            continue
        if pair.left < SETTLED * floor.about(lin.geometry.take([path])):
            return pair.grown
    return None


def told_apart(estimator: Fitter, data: Projector, lin: Linearization, noise: Noise) -> tuple[Linearization, Float]:
    """A converged fit with its pairs in two, and of those that cannot be told apart the spread (P, 6, 6): the second moment
    of the two about one path, on its tangents, 0 for single paths.
    """
    model, spread = data.model, np.zeros((len(lin.gain), 6, 6))
    if model.subbands > 1 or not model.active.any():
        return lin, spread
    found, levels = suspects(data, lin, noise.variance(lin)), thresholds(estimator)
    # About a path in a haze there is more than noise whether it is one or two.
    evidence = found.statistic / raised(model, noise.hazes, lin.geometry, noise.variance(lin))
    for path in np.argsort(-evidence):
        if evidence[path] < SUSPECT or noise.clock.over:
            break
        pair = paired(estimator, data, lin, int(path), found.step[path], noise, levels)
        if pair is None:
            continue
        if pair.stands:
            lin, spread = pair.grown, np.concatenate([spread, np.zeros((1, 6, 6))])
            continue
        apart, gain = pair.apart, pair.grown.gain
        length = apart @ pair.lengths @ apart
        # Two that all but cancel have their centroid far away, but the one path is within a lobe.
        total = gain[path] + gain[-1]
        weight = min(abs(gain[path] * gain[-1]) / max(abs(total) ** 2, 1e-300), FARTHEST**2 / max(length, 1e-300))
        # What barely shows has a direction as uncertain: in the path's metric, some of the spread goes everywhere.
        wide = np.linalg.pinv(pair.lengths, rcond=1e-9, hermitian=True) * length * BLUR / pair.gained
        spread[path] = weight * (np.outer(apart, apart) + wide)
    return lin, spread


def worthwhile(
    estimator: Fitter, data: Projector, lin: Linearization, spread: Float, noise: Noise
) -> tuple[Linearization, Float]:
    """Without the paths, and their spread, that the finer fit or the second of a pair has left next to nothing of: they were
    part of another. The strongest stays.
    """
    while len(lin.gain) > 1:
        kept = np.flatnonzero((lin.drop >= estimator.level * noise.variance(lin)) | (lin.drop == lin.drop.max()))
        if len(kept) == len(lin.gain):
            break
        lin, spread = joint_fit(data, lin.geometry.take(kept), noise.variance(lin), 3e-3), spread[kept]
    return lin, spread
