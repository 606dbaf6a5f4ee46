"""How far loopy data association is from the exact marginals, as a distribution over random cases.

Two kinds of cases. *Random*: all logarithms normal with standard deviation 2, every feature compatible with every
measurement, far loopier than a map. *Crowded*: features and false alarms uniform in a square of a whitened measurement
space, detections with p_D = 0.9 and unit noise, likelihoods as a filter forms them; the density of features sets how
many compete for a measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.slam.association.loopy import exact_association, loopy_association

_DETECTION = 0.9
_QUANTILES = (0.5, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class LoopyErrors:
    """Per kind of case: worst marginal error of every case, and the share of cases whose likeliest association differs.

    Attributes
    ----------
    worst : name → (cases,) largest |loopy − exact| over all marginals of a case
    differs : name → share of features whose likeliest association is another one
    unconverged : name → cases that used up the iterations
    """

    worst: dict[str, np.ndarray]
    differs: dict[str, float]
    unconverged: dict[str, int]

    def table(self) -> dict:
        """Quantiles of the worst error per kind, ready for JSON."""
        return {
            name: {
                "cases": len(values),
                **{f"quantile_{q:g}": float(np.quantile(values, q)) for q in _QUANTILES},
                "likeliest_differs": self.differs[name],
                "unconverged": self.unconverged[name],
            }
            for name, values in self.worst.items()
        }


def random_case(rng: np.random.Generator, features: int, measurements: int, spread: float = 2.0):
    """(log_missed, log_detected, log_new) with independent normal entries."""
    return (
        rng.normal(0, spread, features),
        rng.normal(0, spread, (features, measurements)),
        rng.normal(0, spread, measurements),
    )


def crowded_case(rng: np.random.Generator, features: int, density: float, false_alarms: float = 2.0):
    """A scan of ``features`` at ``density`` per unit area of the whitened two-dimensional measurement space."""
    side = np.sqrt(features / density)
    places = rng.uniform(0, side, (features, 2))
    seen = places[rng.random(features) < _DETECTION]
    z = np.concatenate([seen + rng.standard_normal(seen.shape), rng.uniform(0, side, (rng.poisson(false_alarms), 2))])[
        :12
    ]  # the oracle's cost doubles with every measurement
    squared = ((places[:, None] - z) ** 2).sum(axis=2)
    log_detected = np.log(_DETECTION / (2 * np.pi)) - 0.5 * squared
    log_new = np.full(len(z), np.log(max(false_alarms, 0.1) / side**2))
    return np.full(features, np.log(1 - _DETECTION)), log_detected, log_new


def error_distribution(cases: int = 2000, seed: int = 0) -> LoopyErrors:
    """The distribution over ``cases`` of each kind; the same for the same seed."""
    kinds = {
        "random, 5 × 5": lambda rng: random_case(rng, 5, 5),
        "crowded, 1 feature per 100 σ²": lambda rng: crowded_case(rng, 6, 0.01),
        "crowded, 1 feature per 20 σ²": lambda rng: crowded_case(rng, 6, 0.05),
        "crowded, 1 feature per 5 σ²": lambda rng: crowded_case(rng, 6, 0.2),
    }
    worst, differs, unconverged = {}, {}, {}
    for index, (name, draw) in enumerate(kinds.items()):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        errors, other, open_ = np.zeros(cases), [], 0
        for c in range(cases):
            case = draw(rng)
            loopy, exact = loopy_association(*case), exact_association(*case)
            errors[c] = np.abs(loopy.marginal - exact).max()
            other.append(loopy.marginal.argmax(axis=1) != exact.argmax(axis=1))
            open_ += not loopy.converged
        worst[name], differs[name], unconverged[name] = errors, float(np.concatenate(other).mean()), open_
    return LoopyErrors(worst, differs, unconverged)
