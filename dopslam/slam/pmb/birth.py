"""New landmarks from single measurements: closed-form start, Gauss-Newton, and the birth integral by
Laplace's method.

With R̃ = R + A P_s Aᵀ, the term of type m in ρ^new is
p_D λ (2π)^{(3 - m_z)/2} |R̃|^{-1/2} |BᵀR̃⁻¹B|^{-1/2} exp(-χ²_min/2): the residual of the m_z - 3 redundant
rows rejects clutter. It does not tell VA from SP: every SP has a VA twin with the same measurement. A second reflection
has two rows less to be rejected by, and pays for it with the density 1/2π² of its departure.

Where no elevation is measured nothing tells a landmark's height. The integral then goes over the plane: walls stand
upright, so that the images of the base station are as high as it is, and objects are as high as the receiver. To the
rows of a fit that is one more, the height with the deviation `HELD`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import clear, compiled
from dopslam.compute.linalg import cholesky, solve_lower
from dopslam.models.kernels import SP, VA, linearize, log_spreading, noise_entry, starting_point, subtract
from dopslam.models.unmeasured import UNSEEN
from dopslam.slam.pmb.density import BIRTHS, look_up

Array = NDArray[np.float64]

MAX_STEPS = 8
OUTWEIGHED = 9.0  # a birth e^-9 times as likely as an existing track needs no refinement
TWIN = 5.0  # an SP is hardly more than e^5 times as likely as its VA twin, equal intensities given (both fit alike)
CONVERGED = 1e-2  # remaining decrease of χ² below which Gauss-Newton stops
HELD = 1e-3  # m, deviation of a height that nothing tells from where it is held
STOREYS = 10.0  # m, heights over which the landmarks that λ counts per m³ are spread, where only the plane is seen
REDUNDANT_LIMIT = 50.0  # χ²_min above which a measurement is no single-bounce path


@compiled
def first_guess(z, noise, state, kind, site, x):
    """:func:`starting_point`; of a path that one end alone was measured of, from the point of its ray where the length fits."""
    arrives, departs = noise[1, 1] < UNSEEN[1], noise[3, 3] < UNSEEN[3]
    if arrives == departs or (arrives and kind != SP):
        return starting_point(z, state, kind, site, x)
    length = z[0] - state[3]
    wx, wy, wz = site[0] - state[0], site[1] - state[1], site[2] - site[3]
    excess = length * length - (wx * wx + wy * wy + wz * wz)
    if not excess > 0.0 or length <= 0.0:
        return False
    sign, row, azimuth = (-1.0, 2, z[1] + state[2]) if arrives else (1.0, 4, z[3])
    flat = math.cos(z[row])
    rx, ry, rz = flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(z[row])
    reach = 0.5 * excess / (length + sign * (wx * rx + wy * ry + wz * rz))
    from_end = 0.0 if arrives else 1.0
    x[0], x[1], x[2] = from_end * wx + reach * rx, from_end * wy + reach * ry, from_end * wz + reach * rz
    if kind != SP:  # the image lies behind it, as far as the path is long
        behind = length / math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        x[0], x[1], x[2] = behind * x[0], behind * x[1], behind * x[2]
    x[0], x[1], x[2] = state[0] + x[0], state[1] + x[1], site[3] + x[2]
    return True


class Fitting(NamedTuple):
    """Arrays of one fit, made once for many: allocating them takes as long as the fit."""

    predicted: Array
    nu: Array
    by_state: Array
    by_landmark: Array
    moved: Array
    factor: Array
    white: Array  # (m, 4): L⁻¹B and L⁻¹ν
    information: Array
    inverse: Array
    step: Array


@compiled
def fitting(m, n):
    """Buffers for measurements of m rows and a UE of n entries."""
    return Fitting(
        np.empty(m), np.empty(m), np.empty((m, n)), np.empty((m, 3)), np.empty((m, n)), np.empty((m, m)), np.empty((m, 4)),
        np.empty((3, 3)), np.empty((3, 3)), np.empty(3),
    )  # fmt: skip


@compiled
def fit_landmark(z, noise, state, state_covariance, kind, site, planar, enough, x, gain, covariance, work):
    """Gauss-Newton for x̂ = argmin χ²(x) with the UE's uncertainty in R̃.

    Parameters
    ----------
    z, noise : (m,), (m, m) measurement and R
    state, state_covariance : (n,), (n, n)
    kind : int
    site : 5-tuple
    planar : bool; no elevation tells the height, which is held
    enough : float; stop after one step if log_volume - ½χ²_min is expected below this (-inf: always converge)
    x : (3,) array, start; overwritten with x̂
    gain : (3, m) array, written: G = (BᵀR̃⁻¹B)⁻¹BᵀR̃⁻¹
    covariance : (3, 3) array, written: (BᵀR̃⁻¹B)⁻¹
    work : Fitting for this m and n

    Returns
    -------
    valid : bool
    chi2 : float, χ²_min
    log_volume : float, -½ ln|R̃| - ½ ln|BᵀR̃⁻¹B|
    """
    m = z.shape[0]
    n = state.shape[0]
    predicted, nu, by_state, by_landmark, moved, factor, white, information, inverse, step = work
    hold = HELD**-2 if planar else 0.0
    level = site[3] if kind == SP else site[2]
    chi2 = np.inf
    log_volume = 0.0
    reach = 0.0
    for iteration in range(MAX_STEPS):
        valid = linearize(state, x, kind, site, predicted, by_state, by_landmark)
        subtract(z, predicted, by_landmark, by_state, nu)
        for i in range(m):
            for b in range(n):
                value = 0.0
                for a in range(n):
                    value += by_state[i, a] * state_covariance[a, b]
                moved[i, b] = value
            for j in range(i + 1):
                value = noise_entry(noise, kind, i, j)
                for b in range(n):
                    value += moved[i, b] * by_state[j, b]
                factor[i, j] = value
        if not cholesky(factor, m):
            return False, np.inf, 0.0
        for i in range(m):
            for j in range(3):
                white[i, j] = by_landmark[i, j]
            white[i, 3] = nu[i]
        solve_lower(factor, m, white)
        for i in range(3):
            step[i] = 0.0
            for j in range(3):
                information[i, j] = 0.0
            for k in range(m):
                step[i] += white[k, i] * white[k, 3]
                for j in range(3):
                    information[i, j] += white[k, i] * white[k, j]
        chi2 = 0.0
        for k in range(m):
            chi2 += white[k, 3] * white[k, 3]
        if planar:
            step[2] += hold * (level - x[2])
            information[2, 2] += hold
            chi2 += hold * (level - x[2]) ** 2
        if not cholesky(information, 3):
            return False, np.inf, 0.0
        decrease = 0.0
        for i in range(3):  # forward, then backward substitution
            for k in range(i):
                step[i] -= information[i, k] * step[k]
            step[i] /= information[i, i]
            decrease += step[i] * step[i]
        for i in range(2, -1, -1):
            for k in range(i + 1, 3):
                step[i] -= information[k, i] * step[k]
            step[i] /= information[i, i]
        reach = math.sqrt((x[0] - state[0]) ** 2 + (x[1] - state[1]) ** 2 + (x[2] - site[3]) ** 2)
        length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        shrink = min(1.0, 0.3 * reach / max(length, 1e-12))
        for i in range(3):
            x[i] += shrink * step[i]
        log_volume = 0.0
        for i in range(m):
            log_volume -= math.log(factor[i, i])
        for i in range(3):
            log_volume -= math.log(information[i, i])
        if decrease < CONVERGED or log_volume - 0.5 * (chi2 - decrease) < enough:
            chi2 -= decrease
            break
        if iteration == 0 and chi2 - decrease > 4.0 * REDUNDANT_LIMIT + 100.0:
            return False, chi2, 0.0
    if not valid:
        return False, chi2, 0.0
    # covariance = (C Cᵀ)⁻¹ with the Cholesky factor C; gain = covariance · (L⁻¹B)ᵀ L⁻¹
    clear(inverse)
    for j in range(3):
        inverse[j, j] = 1.0 / information[j, j]
        for i in range(j + 1, 3):
            value = 0.0
            for k in range(j, i):
                value -= information[i, k] * inverse[k, j]
            inverse[i, j] = value / information[i, i]
    for i in range(3):
        for j in range(3):
            value = 0.0
            for k in range(3):
                value += inverse[k, i] * inverse[k, j]
            covariance[i, j] = value
    if covariance[0, 0] + covariance[1, 1] + covariance[2, 2] > reach * reach:
        return (
            False,
            chi2,
            0.0,
        )  # nowhere in particular: Laplace's volume would be anything (a second reflection overhead)
    for j in range(m - 1, -1, -1):  # rows of (L⁻¹B)ᵀ L⁻¹ by back substitution with Lᵀ
        for c in range(3):
            value = white[j, c]
            for k in range(j + 1, m):
                value -= factor[k, j] * white[k, c]
            white[j, c] = value / factor[j, j]
    for i in range(3):
        for j in range(m):
            gain[i, j] = (
                covariance[i, 0] * white[j, 0] + covariance[i, 1] * white[j, 1] + covariance[i, 2] * white[j, 2]
            )
    return True, chi2, log_volume


@compiled
def visible_share(x, spread, state, kind, model):
    """Φ((range - d)/σ_d): the share of an SP's distance density that lies within the SP range; 1 for other
    kinds.

    `spread` is the covariance (3, 3) of the vector from the UE to the landmark.
    """
    if kind != SP or model.sp_range == np.inf:
        return 1.0
    rx, ry, rz = x[0] - state[0], x[1] - state[1], x[2] - model.site[3]
    distance = math.sqrt(rx * rx + ry * ry + rz * rz)
    variance = (
        rx * (spread[0, 0] * rx + 2.0 * spread[0, 1] * ry + 2.0 * spread[0, 2] * rz)
        + ry * (spread[1, 1] * ry + 2.0 * spread[1, 2] * rz)
        + rz * spread[2, 2] * rz
    ) / (distance * distance)
    return 0.5 * math.erfc((distance - model.sp_range) / math.sqrt(2.0 * max(variance, 1e-12)))


@compiled
def undetected_intensity(x, spread, kind, reference, density, model):
    """λ^m(x) before this scan: λ ← p_S (1 - p_D(x)) λ + λ_B over the UE's trail, or constant without
    thinning.
    """
    start = model.intensity[kind - VA]
    born = model.birth_intensity[kind - VA]
    if not model.thinning:
        return start + born
    total, kept = born, 1.0
    past = density.mean[: density.mean.shape[0] - 3 * (density.kind.shape[0] - 1)].copy()
    for k in range(density.trail.shape[0] - 1, -1, -1):
        past[0], past[1] = density.trail[k, 0], density.trail[k, 1]
        detected = visible_share(x, spread, past, kind, model)
        if detected > 0.0:
            detected *= look_up(model.table, reference - log_spreading(kind, x, past, model.site))
        kept *= model.survival * (1.0 - detected)
        total += kept * born
        if kept < 1e-12:
            return total
    return total + kept * model.survival * start


@compiled
def new_hypotheses(density, n, scan, local, model):
    """Birth terms of every measurement.

    Returns
    -------
    log_term : (M, 3) array; log of the birth integral of VA, SP and SR, -inf where impossible
    log_new : (M,) array; ln ρ^new = ln(c + Σ terms)
    position : (M, 3, 3) array; x̂ of each
    """
    count, m = scan.z.shape
    state = density.mean[:n]
    state_covariance = density.covariance[:n, :n].copy()
    log_term = np.full((count, BIRTHS), -np.inf)
    log_new = np.empty(count)
    position = np.zeros((count, BIRTHS, 3))
    gain = np.empty((3, m))
    covariance = np.empty((3, 3))
    work = fitting(m, n)
    constant = 0.5 * (3 - m) * math.log(2.0 * math.pi)
    if model.planar:  # λ per m² times the density of the height that is held
        constant += math.log(STOREYS / (math.sqrt(2.0 * math.pi) * HELD))
    for p in range(count):
        total = scan.clutter
        best_track = -np.inf
        for t in range(local.log_ratio.shape[1]):
            best_track = max(best_track, local.log_ratio[p, t])
        twin = np.inf  # how well the VA fits, and with it the SP at its incidence point
        for t in range(BIRTHS):
            kind = VA + t
            if model.intensity[t] + model.birth_intensity[t] <= 0.0 or scan.log_snr[p] == -np.inf:
                continue
            most = math.log(model.intensity[t] + model.birth_intensity[t]) + constant
            x = position[p, t]
            if t == 1 and twin + TWIN + most < best_track - OUTWEIGHED:
                continue
            if not first_guess(scan.z[p], scan.covariance[p], state, kind, model.site, x):
                continue
            valid, chi2, log_volume = fit_landmark(
                scan.z[p],
                scan.covariance[p],
                state,
                state_covariance,
                kind,
                model.site,
                model.planar,
                best_track - OUTWEIGHED - most,
                x,
                gain,
                covariance,
                work,
            )
            if not valid or not chi2 < REDUNDANT_LIMIT:
                continue
            if t == 0:
                twin = log_volume - 0.5 * chi2
            reference = scan.log_snr[p] + log_spreading(kind, x, state, model.site)
            detected = look_up(model.table, scan.log_snr[p]) * visible_share(x, covariance, state, kind, model)
            intensity = undetected_intensity(x, covariance, kind, reference, density, model)
            if detected * intensity <= 0.0:
                continue
            log_term[p, t] = math.log(detected * intensity) + constant + log_volume - 0.5 * chi2
            total += math.exp(log_term[p, t])
        log_new[p] = math.log(total)
    return log_term, log_new, position
