"""From grid points to peaks: every candidate refined alone, in the matched-filter cells around its delay.

A delay vector between two cells is a combination of the matched filters of its neighbors, so that the
filtered residual already holds all that is needed and no pass over the data is due. Eight neighbors leave out
about a thousandth; decisions near the threshold do not notice, and the joint fit works on the data
themselves.
"""

from __future__ import annotations

import numpy as np

from ..signal.algebra import Blocks, gram, gram_diagonal, project_rest
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .folding import Folding, product, project_planes
from .grids import DelayGrid
from .projector import Projector
from .refine import LARGEST_STEP, Linearization, bounded, metric

PROMISE = 2.5
"""A candidate climbs at most this many times what its first step predicts."""
LEAST_NOVELTY = 0.05
"""Of a candidate's energy at least this share counts as new, however close a known path is."""


def novelty(model: SignalModel, geometry: Geometry, known: Linearization | None) -> Float:
    """Share (P,) of the energy of candidates that ``known`` paths could not explain with other gains.

    What a candidate finds in the residual divided by this is what it adds to the explained energy.
    """
    if known is None or not len(geometry):
        return np.ones(len(geometry))
    blocks = [[mode[:, :1] for mode in modes] for modes in model.evaluate(geometry)]
    own = np.real(gram_diagonal(model, blocks, plain=True)[:, 0, 0])
    cross = gram(model, blocks, known.blocks, plain=True)[:, 0, :, 0]
    shared = np.einsum("pk,kl,pl->p", cross, known.inverse, cross.conj()).real
    return np.maximum(1 - shared / np.maximum(own, 1e-300), LEAST_NOVELTY)


class CellProjector:
    """Inner products with a filtered residual (L, rest) for candidates that stay near the delay cell they
    started from.
    """

    def __init__(self, model: SignalModel, grid: DelayGrid, filtered, delay: Float, gather=None) -> None:
        self.model, self.grid = model, grid
        self.filtered = filtered.reshape(len(filtered), -1)
        self.first = grid.around(delay)
        # The search may have put symbols in an order of its own, and left some out.
        self.gather = gather

    def inner(self, geometry: Geometry, blocks: Blocks, index):
        """``<d_a s_p, r>`` (P, 7) of the candidates number ``index``."""
        partial = self.at_delay(blocks[0][0], index)
        if self.gather is not None:
            paths, columns = partial.shape[:2]
            kept = partial.reshape(paths, columns, len(self.gather), -1)
            whole = np.zeros((paths, columns, self.model.schedule.symbols, kept.shape[-1]), kept.dtype)
            whole[:, :, self.gather] = kept
            partial = whole.reshape(paths, columns, -1)
        return project_rest(self.model, partial, blocks[0])

    def at_delay(self, vectors, index):
        """The residual matched to delay vectors (P, c, K): (P, c, rest)."""
        first = self.first[index]
        weights = self.grid.combination(vectors, first)[0].conj().astype(np.complex64)
        out = np.empty((len(weights), weights.shape[1], self.filtered.shape[1]), np.complex64)
        for path, (own, start) in enumerate(zip(weights, first, strict=True)):
            np.matmul(own, self.filtered[start : start + own.shape[1]], out=out[path])
        return out


class MatchedProjector:
    """The same from folded data matched to delay and speed cells (planes (2, L, V, N_R, N_T)); paths ``known`` to be in
    them still are taken out by what the cells see of them.
    """

    def __init__(
        self, model: SignalModel, folding: Folding, grid: DelayGrid, speeds, partial, delay: Float, known=None
    ) -> None:
        self.model, self.folding, self.grid, self.known = model, folding, grid, known
        self.partial = partial.reshape(2, len(grid.delays), -1)
        self.speeds, self.inverse = speeds
        self.first = grid.around(delay)

    def inner(self, geometry: Geometry, blocks: Blocks, index):
        """``<d_a s_p, r>`` (P, 7) of the candidates number ``index``."""
        first = self.first[index]
        frequency, time, *rest = blocks[0]
        weights, frequency = self.grid.combination(frequency, first)
        rates = time @ self.inverse
        # Conjugate-symmetric vectors are real combinations of such; cells that were transformed are not symmetric, their
        # tones count from the first pilot.
        pilots, symbols, *_ = self.folding.axes
        real = pilots.real and self.grid.matrix is not None
        scaled = np.sqrt(frequency.shape[-1]) * (np.real(weights) if real else weights.conj())
        scaled = scaled.astype(np.float32 if real else np.complex64)
        partial = np.empty((2, *weights.shape[:2], self.partial.shape[2]), np.float32)
        for p, start in enumerate(first):
            product(scaled[p], self.partial[:, start : start + scaled.shape[2]], partial[:, p])
        folded = [axis.steering(mode) for axis, mode in zip(self.folding.arrays, rest, strict=True)]
        inner = project_planes(self.model, partial, [weights, rates.real if symbols.real else rates, *folded])
        return less_known(self.model, inner, [[frequency, rates @ self.speeds, *rest]], self.known)


class ResidualProjector:
    """The same from the data, less the known paths by their Gram matrix: for searches that keep no delay
    cells.
    """

    def __init__(self, data: Projector, known: Linearization | None) -> None:
        self.model, self.data, self.known = data.model, data, known

    def inner(self, geometry: Geometry, blocks: Blocks, index):
        """``<d_a s_p, r>`` (P, 7)."""
        return less_known(self.model, self.data.inner(geometry, blocks), blocks, self.known)


def less_known(model: SignalModel, inner, blocks: Blocks, known: Linearization | None):
    """Inner products (P, 7) with the data turned into those with what ``known`` paths leave of them."""
    if known is None:
        return inner
    return inner - gram(model, blocks, known.blocks, plain=True)[..., 0] @ known.gain


def separate_fit(
    data: CellProjector | MatchedProjector | ResidualProjector,
    geometry: Geometry,
    noise_variance: float,
    interest: float = 0.0,
    iterations: int = 6,
    tolerance: float = 0.3,
    doubt: float = 0.8,
    novel: Float | float = 1.0,
) -> tuple[Geometry, Float]:
    """Levenberg-Marquardt of P candidates, each alone in the residual.

    Candidates whose predicted gain in log-likelihood falls below ``tolerance`` (or is a trifle beside their energy)
    take it as predicted and stop; so do those out of whose reach is ``interest`` (an energy; if infinite, the best of
    them), at first with ``doubt`` about a prediction from afar. ``novel`` (P,) is the share of their energy that would be
    new: only what adds to known paths counts.

    Returns
    -------
    geometry, energy : refined candidates and their ``|<s, r>|^2 / |s|^2`` (P,)
    """
    count = len(geometry)
    gained = np.zeros(count)
    vectors = [np.array(a) for a in (geometry.delay, geometry.arrival, geometry.departure, geometry.speed)]
    energy = np.zeros(count)
    gradient, lengths = np.zeros((count, 6)), np.zeros((count, 6, 6))
    damping = np.full(count, 1e-2)
    live = np.arange(count)
    fresh = np.broadcast_to(novel, (count,))
    trial = geometry
    for iteration in range(iterations + 1):
        trial_energy, trial_gradient, trial_lengths = _assess(data, trial, live)
        better = trial_energy >= energy[live]
        moved = live[better]
        for own, new in zip(vectors, (trial.delay, trial.arrival, trial.departure, trial.speed), strict=True):
            own[moved] = new[better]
        energy[moved], gradient[moved], lengths[moved] = (
            trial_energy[better],
            trial_gradient[better],
            trial_lengths[better],
        )
        damping[live] = np.where(better, damping[live] / 10, damping[live] * 10)
        if iteration == iterations:
            break
        step = _step(energy[live], gradient[live], lengths[live], damping[live])
        rise = np.einsum("pa,pa->p", gradient[live], step)
        step = bounded(step, lengths[live], LARGEST_STEP)
        # A strong candidate need not be exact: it goes through the joint fit anyway.
        done = rise <= np.maximum(tolerance * noise_variance, 0.03 * energy[live])
        reach = energy[live] + PROMISE * rise
        goal = (interest if np.isfinite(interest) else energy.max()) * fresh[live]
        hopeless = reach <= (doubt * goal if iteration == 0 else goal)
        # So short a step does as predicted; there is no need to look.
        last = live[done]
        ends = Geometry(*(v[last] for v in vectors)).moved(step[done])
        for own, new in zip(vectors, (ends.delay, ends.arrival, ends.departure, ends.speed), strict=True):
            own[last] = new
        gained[last] = rise[done]
        live, step = live[~done & ~hopeless], step[~done & ~hopeless]
        if not len(live):
            break
        trial = Geometry(*(v[live] for v in vectors)).moved(step)
    energy = energy + gained
    return Geometry(*vectors), energy


def _assess(data, geometry: Geometry, index):
    model = data.model
    blocks = model.evaluate(geometry)
    inner = data.inner(geometry, blocks, index)
    own = gram_diagonal(model, blocks)
    norm = np.maximum(np.real(own[:, 0, 0]), 1e-300)
    gain = inner[:, 0] / norm
    slope = np.real(gain.conj()[:, None] * (inner - own[:, :, 0] * gain[:, None])[:, 1:])
    return np.abs(inner[:, 0]) ** 2 / norm, slope * model.active, metric(own, model.active)


def _step(energy: Float, gradient: Float, lengths: Float, damping: Float) -> Float:
    diagonal = np.einsum("paa->pa", lengths)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = lengths * scale[:, :, None] * scale[:, None] + damping[:, None, None] * np.eye(6)
    target = scale * gradient / np.maximum(energy, 1e-300)[:, None]
    return scale * np.linalg.solve(scaled, target[..., None])[..., 0]
