"""Fisher information and Cramer-Rao bounds of the path parameters, complex gains as nuisance (Slepian-Bangs,
white noise after whitening).

``J_ab = (2 / sigma^2) Re{(d_a mu)^H (W^H W)^{-1} (d_b mu)}`` over all parameters and gains of all paths; the
Schur complement eliminates the gains, and the (6, 6) diagonal blocks of the inverse are the paths' marginal
covariances.
"""

from __future__ import annotations

import numpy as np

from .errors import EstimationError
from .estimators.refine import Linearization, information, inverted
from .signal.algebra import gram
from .signal.directions import Float
from .signal.model import SignalModel
from .signal.paths import PathTable, tangent_jacobian

NOTHING = 1e-24
"""Share of the information of the path that tells most of a parameter below which another tells nothing of it."""
UNSEEN = 1e-13
"""Share of the strongest path's energy per gain below which a path leaves no trace."""


def fisher_information(model: SignalModel, paths: PathTable, noise_variance: float) -> Float:
    """(6P, 6P) information on delay [s], AOA and AOD tangents [rad], radial velocity [m/s] of all paths,
    gains eliminated.
    """
    if not noise_variance > 0:
        raise EstimationError(f"fisher_information: noise_variance must be positive, got {noise_variance}")
    blocks = model.evaluate(paths.geometry)
    matrix = gram(model, blocks)
    inverse = inverted(matrix[:, 0, :, 0])
    lin = Linearization(paths.geometry, blocks, paths.gain, matrix, inverse, 0.0, *np.zeros((2, len(paths), 6)))
    return information(lin, model.active) * 2 / noise_variance


def crb(model: SignalModel, paths: PathTable, noise_variance: float) -> Float:
    """Cramer-Rao bound (P, 6, 6) per path in (delay [s], AOA az, el, AOD az, el [rad], radial velocity
    [m/s]).
    """
    tangent = path_covariances(fisher_information(model, paths, noise_variance), model.active)
    scale = tangent_jacobian(paths.geometry)
    with np.errstate(invalid="ignore"):
        return tangent * scale[:, :, None] * scale[:, None]


def snr(model: SignalModel, paths: PathTable, noise_variance: float) -> Float:
    """Post-integration SNR rho (P,) of each path with all others known but their gains: ``|g|^2 / (sigma^2
    [G^-1]_pp)``.

    A path that the link does not see at all (it leaves or arrives where an element's pattern is zero) has ρ = 0, and so
    has one that the others imitate entirely.
    """
    matrix = gram(model, model.evaluate(paths.geometry))[:, 0, :, 0]
    result = np.zeros(len(paths))
    own = np.real(np.diag(matrix))
    seen = own > UNSEEN * own.max(initial=0.0)
    if not seen.any():
        return result
    scale = 1 / np.sqrt(own[seen])
    correlation = matrix[np.ix_(seen, seen)] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(correlation)
    inverse = np.sum(np.abs(vectors) ** 2 / np.maximum(values, UNSEEN), axis=1)
    rho = np.abs(paths.gain[seen]) ** 2 * own[seen] / (noise_variance * inverse)
    result[seen] = np.where(inverse * UNSEEN > 1e-3, 0.0, rho)  # imitated by others to rounding: nothing of its own
    return result


def path_covariances(information: Float, active) -> Float:
    """Diagonal blocks (P, 6, 6) of the inverse information; infinite variance for parameters that the link
    does not observe, or a path tells nothing of.

    A pseudo-inverse after scaling to unit diagonal gives a singular direction (azimuth at a pole) a huge but
    finite variance.
    """
    paths = len(information) // 6
    diagonal = np.diag(information)
    told = diagonal > NOTHING * np.max(diagonal.reshape(paths, 6), axis=0, initial=0.0)[None].repeat(paths, 0).ravel()
    observed = np.tile(np.asarray(active, bool), paths) & told
    reduced = information[np.ix_(observed, observed)]
    scale = 1 / np.sqrt(np.diag(reduced))
    values, vectors = np.linalg.eigh(reduced * np.outer(scale, scale))
    values = np.maximum(values, 1e-10)
    inverse = (vectors / values) @ vectors.T * np.outer(scale, scale)
    full = np.diag(np.where(observed, 0.0, np.inf))
    full[np.ix_(observed, observed)] = inverse
    return full.reshape(paths, 6, paths, 6)[np.arange(paths), :, np.arange(paths)].copy()
