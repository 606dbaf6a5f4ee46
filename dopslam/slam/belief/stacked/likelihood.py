"""Likelihoods of stacked particles: three backends with one meaning.

Rows are features of one form, N particles each: position x, y [m] and amplitude u (K, N), stacked by index
with agent particles x, y, cos κ, sin κ (N,). In the plane, single precision. Every density is p_d(u) f(z | x,
y, u): Gaussian in distance, in the chords of AOA and AOD (von Mises; the squared chord keeps the digits that
1 − cos loses) with the Fisher variances at u, and the untruncated Rician amplitude in its asymptotic form
√(z/(2πσ_u²u)) exp(−(z − u)²/2σ_u²)(1 + σ_u²/(8zu)), exact to 1 % for zu > 2.

``evidence`` averages over particles, (K, M); ``messages`` gives λ = 1 − p_d + Σ_m ν_m p_d f(z_m | ·), (K, N),
without storing anything of size (M, N).

The backends: ``numpy`` is the plain vectorized version, ``numba`` the compiled loop for small N, ``drjit``
the parallel one (LLVM on the CPU, and the same code on a GPU), which needs a working libLLVM; by their names in
:mod:`dopslam.slam.belief.stacked.backends`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.models.amplitude import AmplitudeModel, Radio
from dopslam.slam.belief.records import Form, Scan

Array = np.ndarray
_MISSED_BINS = 256


@dataclass(frozen=True, slots=True)
class Constants:
    """What the likelihoods need besides particles and scan: unit deviations (3,), anchor (3,), 1/(4 N_s), the
    table of 1 − p_d(u) over ``missed_step``·index."""

    unit: Array
    anchor: Array
    quarter_samples: float
    missed: Array
    missed_step: float

    @staticmethod
    def of(radio: Radio, amplitude: AmplitudeModel, anchor: Array) -> Constants:
        """Constants of a radio, a detector and an anchor."""
        end = amplitude.threshold + 6.0
        grid = np.linspace(0, end, _MISSED_BINS)
        return Constants(
            radio.unit_deviations,
            np.asarray(anchor, float),
            0.25 / amplitude.samples,
            amplitude.missed_probability(grid).astype(np.float32),
            end / (_MISSED_BINS - 1),
        )


class Backend(Protocol):
    """Sums over particles of one group of rows with the same form; agent is (4, N)."""

    def evidence(self, form: Form, x: Array, y: Array, u: Array, agent: Array, scan: Scan, c: Constants) -> Array: ...

    def messages(
        self, form: Form, x: Array, y: Array, u: Array, agent: Array, scan: Scan, nu: Array, c: Constants
    ) -> Array: ...


def scan_columns(scan: Scan) -> Array:
    """(M, 6) float32: distance, AOA x y, AOD x y, amplitude."""
    return np.column_stack([scan.distance, scan.aoa[:, :2], scan.aod[:, :2], scan.amplitude]).astype(np.float32)


def norms(form: Form, c: Constants) -> tuple[float, float]:
    """ln of the constant factor of the density without u, and the power of u in it."""
    directions = 1 if form == Form.VA else 2
    log_norm = -np.log(c.unit[: 1 + directions]).sum() - 0.5 * (2 + directions) * np.log(2 * np.pi)
    if form == Form.VA:
        log_norm -= np.log(2 * np.pi)  # its AOD is uniform
    return float(log_norm), 1.0 + directions


class NumpyBackend:
    """Plain NumPy, one measurement at a time."""

    def _geometry(self, form, x, y, agent, c):
        ax, ay, cos, sin = agent
        ex, ey = x - ax, y - ay
        r = np.sqrt(ex * ex + ey * ey)
        ex, ey = ex / r, ey / r
        px, py = cos * ex + sin * ey, cos * ey - sin * ex
        if form == Form.VA:
            return r, px, py, px, py
        if form == Form.LOS:
            return r, px, py, -ex, -ey
        nx, ny = x - np.float32(c.anchor[0]), y - np.float32(c.anchor[1])
        reach = np.sqrt(nx * nx + ny * ny)
        nx, ny = nx / reach, ny / reach
        if form == Form.PS:
            return r + reach, px, py, nx, ny
        en = 2 * (ex * nx + ey * ny)
        return r, px, py, en * nx - ex, en * ny - ey

    def _densities(self, form, x, y, u, agent, scan, c):
        """Yields p_d f of every measurement, (K, N) each."""
        d, px, py, tx, ty = self._geometry(form, x, y, agent, c)
        u2 = u * u
        v = np.float32(0.5) + np.float32(c.quarter_samples) * u2
        half = np.float32(0.5) / v
        log_norm, power = norms(form, c)
        factor = np.float32(np.exp(log_norm)) * u ** np.float32(power) / np.sqrt(v * u)
        gd, ga, gt = (np.float32(0.5 / s**2) for s in c.unit)
        for z in scan_columns(scan):
            cost = gd * (z[0] - d) ** 2 + ga * ((px - z[1]) ** 2 + (py - z[2]) ** 2)
            if form != Form.VA:
                cost += gt * ((tx - z[3]) ** 2 + (ty - z[4]) ** 2)
            cost = u2 * cost + half * (z[5] - u) ** 2
            yield np.exp(-cost) * factor * np.sqrt(z[5]) * (1 + v / (8 * z[5] * u))

    def evidence(self, form, x, y, u, agent, scan, c):
        """Mean of p_d f over the particles, (K, M)."""
        result = np.zeros((len(x), len(scan)))
        for m, density in enumerate(self._densities(form, x, y, u, agent, scan, c)):
            result[:, m] = density.mean(axis=1)
        return result

    def messages(self, form, x, y, u, agent, scan, nu, c):
        """λ, (K, N) float32."""
        result = missed_of(u, c)
        for m, density in enumerate(self._densities(form, x, y, u, agent, scan, c)):
            result += nu[:, m, None].astype(np.float32) * density
        return result


def missed_of(u: Array, c: Constants) -> Array:
    """1 − p_d(u) from the table by linear interpolation, float32."""
    position = np.minimum(u / np.float32(c.missed_step), np.float32(_MISSED_BINS - 1.001))
    index = position.astype(np.int32)
    share = position - index
    return c.missed[index] * (1 - share) + c.missed[index + 1] * share


class NumbaBackend:
    """Compiled loops; skips particles whose exponent is below −80."""

    def evidence(self, form, x, y, u, agent, scan, c):
        """Mean of p_d f over the particles, (K, M)."""
        columns = scan_columns(scan)
        nu = np.zeros((len(x), len(columns)), np.float32)
        log_norm, power = norms(form, c)
        anchor, unit = c.anchor.astype(np.float32), (0.5 / c.unit**2).astype(np.float32)
        return _numba_pass(
            int(form), x, y, u, agent, columns, nu, anchor, unit, np.float32(np.exp(log_norm)), int(power),
            np.float32(c.quarter_samples), c.missed, np.float32(c.missed_step), np.empty((0, 0), np.float32),
        )  # fmt: skip

    def messages(self, form, x, y, u, agent, scan, nu, c):
        """λ, (K, N) float32."""
        out = np.empty(x.shape, np.float32)
        log_norm, power = norms(form, c)
        anchor, unit = c.anchor.astype(np.float32), (0.5 / c.unit**2).astype(np.float32)
        _numba_pass(
            int(form), x, y, u, agent, scan_columns(scan), nu.astype(np.float32), anchor, unit,
            np.float32(np.exp(log_norm)), int(power), np.float32(c.quarter_samples), c.missed,
            np.float32(c.missed_step), out,
        )  # fmt: skip
        return out


@compiled
def _numba_pass(form, x, y, u, agent, scan, nu, anchor, gain, norm, power, quarter, missed, step, out):
    """Both passes: averages (K, M), or λ into ``out`` when it has rows."""
    features, particles = x.shape
    measurements = len(scan)
    sums = np.zeros((features, measurements))
    second = out.shape[0] > 0
    f1, f2, f8, half = np.float32(1.0), np.float32(2.0), np.float32(0.125), np.float32(0.5)
    cut = np.float32(80.0)
    last = np.float32(missed.size - 1.001)
    root = np.sqrt(scan[:, 5])
    for k in range(features):
        for i in range(particles):
            ex, ey = x[k, i] - agent[0, i], y[k, i] - agent[1, i]
            r = np.sqrt(ex * ex + ey * ey)
            ex, ey = ex / r, ey / r
            px, py = agent[2, i] * ex + agent[3, i] * ey, agent[2, i] * ey - agent[3, i] * ex
            d = r
            tx, ty = -ex, -ey
            if form >= 2:
                nx, ny = x[k, i] - anchor[0], y[k, i] - anchor[1]
                reach = np.sqrt(nx * nx + ny * ny)
                nx, ny = nx / reach, ny / reach
                if form == 2:
                    d += reach
                    tx, ty = nx, ny
                else:
                    en = f2 * (ex * nx + ey * ny)
                    tx, ty = en * nx - ex, en * ny - ey
            ui = u[k, i]
            u2 = ui * ui
            v = half + quarter * u2
            factor = norm * u2 / np.sqrt(v * ui)
            if power == 3:
                factor *= ui
            total = np.float32(0.0)
            if second:
                position = min(ui / step, last)
                index = int(position)
                share = position - np.float32(index)
                total = missed[index] * (f1 - share) + missed[index + 1] * share
            for m in range(measurements):
                if second and nu[k, m] == 0:
                    continue
                delta = scan[m, 0] - d
                across, along = px - scan[m, 1], py - scan[m, 2]
                cost = gain[0] * delta * delta + gain[1] * (across * across + along * along)
                if form != 1:
                    across, along = tx - scan[m, 3], ty - scan[m, 4]
                    cost += gain[2] * (across * across + along * along)
                delta = scan[m, 5] - ui
                cost = u2 * cost + half * delta * delta / v
                if cost < cut:
                    value = np.exp(-cost) * factor * root[m] * (f1 + f8 * v / (scan[m, 5] * ui))
                    if second:
                        total += nu[k, m] * value
                    else:
                        sums[k, m] += value
            if second:
                out[k, i] = total
    return sums / particles
