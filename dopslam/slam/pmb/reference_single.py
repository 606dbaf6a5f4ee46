"""One landmark and one measurement in the plain NumPy filter (:mod:`dopslam.slam.pmb.reference`): path, p_D, birth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from dopslam.models.detection import ConstantDetection, soft_range
from dopslam.models.measurement import SP, directions, jacobians, measure, residual
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.paths import paths, place
from dopslam.models.pose import positions
from dopslam.slam.pmb.birth import CONVERGED, MAX_STEPS, REDUNDANT_LIMIT
from dopslam.slam.pmb.density import FilterParameters

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Setting:
    """What the filter is told: its choices, the motion (1), the base station [m] and the height of the receiver's plane."""

    parameters: FilterParameters
    motion: CoordinatedTurn
    bs: Array
    height: float = 0.0

    @property
    def detection(self) -> ConstantDetection:
        """p_D, which is constant here."""
        assert isinstance(self.parameters.detection, ConstantDetection)  # anything else is refused
        return self.parameters.detection


def linearize(state: Array, x: Array, kind: int, setting: Setting, m: int) -> tuple[Array, Array, Array]:
    """h(s, x), A = ∂h/∂s and B = ∂h/∂x, m rows of (3)-(12) and (18)-(25)."""
    told = {"speed": setting.motion.speed, "height": setting.height}
    by_state, by_landmark = jacobians(state, x, kind, setting.bs, **told)
    return measure(state, x, kind, setting.bs, **told)[:m], by_state[:m], by_landmark[:m]


def there(state: Array, x: Array, kind: int, setting: Setting) -> bool:
    """Whether the path exists: a virtual anchor's incidence point lies between it and the receiver."""
    return bool(paths(positions(state, setting.height), setting.bs, x, kind).exists)


def detection_probability(x: Array, spread: Array, state: Array, kind: int, setting: Setting) -> float:
    """p_D of a landmark; a scatter point's times the share of its density, seen from the receiver, within the range."""
    told, arrival = setting.detection, x - positions(state, setting.height)
    distance = np.linalg.norm(arrival)
    limit = told.sp_range if kind == SP else None
    return told.probability * float(soft_range(distance, limit, np.sqrt(max(arrival @ spread @ arrival, 0)) / distance))


def starting_point(z: Array, state: Array, kind: int, setting: Setting) -> Array | None:
    """Landmark of one measurement in closed form; None if its path is shorter than the direct one."""
    ue, length = positions(state, setting.height), z[0] - state[3]
    if not length > np.linalg.norm(setting.bs - ue):
        return None
    arrival, departure = directions(z[1] + state[2], z[2]), directions(z[3], z[4])
    return place(ue, setting.bs, length, arrival, departure, kind)


class Fit(NamedTuple):
    """x̂, G = (BᵀR̃⁻¹B)⁻¹BᵀR̃⁻¹, (BᵀR̃⁻¹B)⁻¹, χ²_min and -½ ln|R̃| - ½ ln|BᵀR̃⁻¹B|."""

    x: Array
    gain: Array
    own: Array
    chi2: float
    log_volume: float


def fit(
    z: Array, noise: Array, state: Array, spread: Array, kind: int, x: Array, enough: float, setting: Setting
) -> Fit | None:
    """Gauss-Newton for x̂ = argmin χ²(x) with R̃ = R + A P_s Aᵀ; None where no such landmark exists. Ends where
    ``enough`` cannot be reached any more."""
    for iteration in range(MAX_STEPS):
        h, by_state, by_landmark = linearize(state, x, kind, setting, len(z))
        valid = there(state, x, kind, setting)
        root = np.linalg.cholesky(noise + by_state @ spread @ by_state.T)
        white, nu = (solve_triangular(root, part, lower=True) for part in (by_landmark, residual(z, h)))
        information, chi2 = white.T @ white, nu @ nu
        move = np.linalg.solve(information, white.T @ nu)
        decrease, reach = move @ information @ move, np.linalg.norm(x - positions(state, setting.height))
        x = x + min(1.0, 0.3 * reach / max(np.linalg.norm(move), 1e-12)) * move
        log_volume = -np.log(np.diag(root)).sum() - 0.5 * np.linalg.slogdet(information)[1]
        if decrease < CONVERGED or log_volume - 0.5 * (chi2 - decrease) < enough:
            chi2 -= decrease
            break
        if iteration == 0 and chi2 - decrease > 4 * REDUNDANT_LIMIT + 100:
            return None
    own = np.linalg.inv(information)
    if not valid or np.trace(own) > reach**2:  # nowhere in particular: anywhere along a ray
        return None
    return Fit(x, own @ solve_triangular(root, white, lower=True, trans=1).T, own, float(chi2), float(log_volume))
