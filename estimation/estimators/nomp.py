"""NOMP: greedy search on a dictionary, joint refinement, likelihood-ratio stop, backward elimination. The default estimator.

One pass: search the residual, refine the candidates each alone, accept those above the threshold, refine all paths jointly until the
likelihood stops growing. No new path is looked for before the joint fit has converged, since a path added to an unconverged fit ends in a
wrong local optimum. After the last pass every component must be worth its threshold against a refitted model without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..detections import Detections
from ..errors import ModelError
from ..signal.algebra import coherence, signal_of
from ..signal.model import SignalModel
from ..signal.paths import Geometry, PathTable
from ..signal.synthesis import white_noise
from . import report
from .detect import effective_volume, search_volume, threshold_for
from .grids import View, directions_in
from .refine import Linearization, joint_fit, linearize, separate_fit
from .search import StagedSearch, distinct


@dataclass(frozen=True, eq=False)
class Nomp:
    """Newtonized orthogonal matching pursuit with a calibrated stop.

    Parameters
    ----------
    model : the link
    false_alarm_rate : expected false paths per snapshot
    max_delay : longest delay searched [s]; default: the unambiguous range
    max_speed : largest |radial velocity| searched [m/s]
    arrival_view, departure_view : directions searched, in the arrays' parent frames
    dynamic_range : several peaks are accepted in one pass only within this ratio of the strongest [dB]; sidelobes lie below
    max_paths : give up looking for more
    calibration : noise-only searches that measure the effective search volume when the estimator is made; 0 trusts Rice's formula
    threshold : fixed threshold on rho instead of a false-alarm rate
    """

    model: SignalModel
    false_alarm_rate: float = 0.01
    max_delay: float | None = None
    max_speed: float = 25.0
    arrival_view: View = View()
    departure_view: View = View()
    dynamic_range: float = 10.0
    max_paths: int = 40
    calibration: int = 24
    threshold: float | None = None
    search_options: dict = field(default_factory=dict)
    _search: StagedSearch = field(init=False, repr=False)
    volume: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        period = self.model.waveform.max_delay
        longest = period if self.max_delay is None else self.max_delay
        if not 0 <= longest <= period * (1 + 1e-9):
            raise ModelError(f"Nomp: max_delay {longest:.3e} s must lie between 0 and the unambiguous {period:.3e} s of the pilot spacing")
        if not (np.isfinite(self.max_speed) and self.max_speed >= 0):
            raise ModelError(f"Nomp: max_speed must be finite and not negative, got {self.max_speed} m/s")
        object.__setattr__(self, "max_delay", longest)
        search = StagedSearch.build(self.model, longest, self.max_speed, self.arrival_view, self.departure_view, **self.search_options)
        object.__setattr__(self, "_search", search)
        arrivals, arrival_angle = directions_in(self.arrival_view, self.model.receiver)
        departures, departure_angle = directions_in(self.departure_view, self.model.transmitter)
        volume = search_volume(self.model, longest, (-self.max_speed, self.max_speed), arrivals, departures, (arrival_angle, departure_angle))
        object.__setattr__(self, "volume", volume)
        if self.calibration and self.threshold is None:
            object.__setattr__(self, "volume", effective_volume(self.suprema(self.calibration), self.parameters))
        if self.threshold is None:
            object.__setattr__(self, "threshold", threshold_for(self.false_alarm_rate, self.volume, self.parameters))

    @property
    def parameters(self) -> int:
        """Number of observable parameters per path."""
        return int(self.model.active.sum())

    def suprema(self, count: int, seed: int = 0):
        """Largest statistics (count,) found in noise alone: the material of the calibration."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        return np.array([self._candidates(white_noise(self.model.shape, 1.0, rng), 1.0)[1].max() for _ in range(count)])

    def run(self, signal, noise_variance: float | None = None, prior: PathTable | Detections | None = None) -> Detections:
        """Estimate all paths in a received signal (``model.shape``).

        Parameters
        ----------
        signal : received burst
        noise_variance : of the noise before combining; estimated from the residual if not given
        prior : predicted paths to start from (warm start); those not found in the data are eliminated again

        Raises
        ------
        SignalError
            if the signal does not fit the model or is not finite.
        """
        data = self.model.whiten(self.model.checked(signal))
        energy = float(np.vdot(data, data).real)
        if energy == 0.0:
            return report.empty(self, 0.0 if noise_variance is None else noise_variance)
        lin = None
        if prior is not None and len(prior):
            table = prior.table if isinstance(prior, Detections) else prior
            lin = self._fit(data, table.geometry, energy, noise_variance)
        while lin is None or len(lin.gain) < self.max_paths:
            variance = self._variance(lin, energy, noise_variance)
            residual = data if lin is None else data - signal_of(self.model, self.model.evaluate(lin.geometry), lin.gain)
            found, statistic = self._candidates(residual, variance)
            found = self._accepted(found, statistic)
            if not len(found):
                break
            start = found if lin is None else lin.geometry.joined(found)
            grown = self._eliminated(data, self._fit(data, start, energy, noise_variance), energy, noise_variance, refit=False)
            # A pass must pay for itself, or the same residual of an imperfect model would be split up for ever.
            before = 0.0 if lin is None else lin.explained
            if grown is None or grown.explained - before < self.threshold * variance:
                break
            lin = grown
        lin = None if lin is None else self._eliminated(data, lin, energy, noise_variance, refit=True)
        if lin is None:
            return report.empty(self, self._variance(None, energy, noise_variance))
        variance = self._variance(lin, energy, noise_variance)
        lin = joint_fit(self.model, data, lin, variance, tolerance=1e-3)
        return report.detections(self, data, lin, variance)

    def _variance(self, lin: Linearization | None, energy: float, known: float | None) -> float:
        if known is not None:
            return known
        paths = 0 if lin is None else len(lin.gain)
        explained = 0.0 if lin is None else lin.explained
        return max(energy - explained, 1e-12 * energy) / (np.prod(self.model.shape) - 4 * paths)

    def _fit(self, data, start: Geometry, energy: float, known: float | None) -> Linearization:
        lin = linearize(self.model, data, start)
        return joint_fit(self.model, data, lin, self._variance(lin, energy, known), tolerance=0.5)

    def _candidates(self, residual, variance: float) -> tuple[Geometry, np.ndarray]:
        """Refined candidates in a residual and their statistics, strongest first."""
        points, _ = self._search.candidates(self.model, residual)
        points, energies = separate_fit(self.model, residual, points, noise_variance=variance)
        order = np.argsort(energies)[::-1]
        return points.take(order), energies[order] / variance

    def _accepted(self, found: Geometry, statistic) -> Geometry:
        strong = statistic > max(self.threshold, statistic[0] * 10 ** (-self.dynamic_range / 10))
        found, statistic = found.take(strong), statistic[strong]
        return found.take(distinct(self.model, found, statistic, len(found), limit=0.25)) if len(found) else found

    def _eliminated(self, data, lin: Linearization | None, energy: float, known: float | None, refit: bool) -> Linearization | None:
        """Remove components that are not worth the threshold; with ``refit`` also against a re-optimized model without them."""
        while lin is not None:
            variance = self._variance(lin, energy, known)
            worth = lin.drop / variance
            weakest = int(np.argmin(worth))
            if worth[weakest] < self.threshold:
                rest = np.delete(np.arange(len(worth)), weakest)
                lin = self._fit(data, lin.geometry.take(rest), energy, known) if len(rest) else None
                continue
            smaller = self._smaller(data, lin, worth, variance) if refit and len(worth) > 1 else None
            if smaller is None:
                return lin
            lin = smaller
        return None

    def _smaller(self, data, lin: Linearization, worth, variance: float) -> Linearization | None:
        """A refitted model with one component less that loses less than the threshold, if there is one."""
        overlap = coherence(self.model, lin.geometry) - np.eye(len(worth))
        for index in np.argsort(worth):
            # A distant component's worth cannot be taken over by its neighbors.
            if overlap[index].max() < 0.1 or worth[index] * (1 - overlap[index].max() ** 2) > 30 * self.threshold:
                continue
            rest = np.delete(np.arange(len(worth)), index)
            without = joint_fit(self.model, data, lin.geometry.take(rest), variance, tolerance=0.5)
            if lin.explained - without.explained < self.threshold * variance:
                return without
        return None
