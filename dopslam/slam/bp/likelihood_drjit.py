"""Dr.Jit backend of :mod:`dopslam.slam.bp.likelihood`: one fused kernel per form and number of measurements.

Lanes are row·N + particle. Measurements are read from small uniform buffers, so a kernel is compiled once per padded
number of measurements and reused for any number of rows and particles. On a machine with CUDA the same code runs there.
"""

from __future__ import annotations

import numpy as np

from dopslam.llvm import prepare
from dopslam.slam.bp.likelihood import Constants, _norms, _scan_columns
from dopslam.slam.bp.records import Form, Scan

_PAD = 4  # measurements per kernel are padded to a multiple


class DrJitBackend:
    """Parallel likelihoods; ``cuda`` asks for the GPU."""

    def __init__(self, cuda: bool = False):
        prepare()
        import drjit
        from drjit import cuda as cuda_types
        from drjit import llvm as llvm_types

        self._dr = drjit
        types = cuda_types if cuda else llvm_types
        self._float, self._index = types.Float, types.UInt32

    def evidence(self, form: Form, x, y, u, agent, scan: Scan, c: Constants) -> np.ndarray:
        """Mean of p_d f over the particles, (K, M)."""
        features, particles = x.shape
        if features == 0 or len(scan) == 0:
            return np.zeros((features, len(scan)))
        dr = self._dr
        densities, _, _ = self._densities(form, x, y, u, agent, scan, c, False)
        sums = [dr.block_reduce(dr.ReduceOp.Add, density, particles) for density in densities[: len(scan)]]
        dr.eval(sums)
        return np.stack([s.numpy() for s in sums], axis=1).astype(float) / particles

    def messages(self, form: Form, x, y, u, agent, scan: Scan, nu, c: Constants) -> np.ndarray:
        """λ, (K, N) float32."""
        features, particles = x.shape
        if features == 0:
            return np.zeros(x.shape, np.float32)
        dr = self._dr
        densities, u_lanes, row = self._densities(form, x, y, u, agent, scan, c, True)
        padded = np.zeros((features, len(densities)), np.float32)
        padded[:, : len(scan)] = nu
        weights = self._float(padded.ravel())
        table = self._float(c.missed)
        position = dr.minimum(u_lanes * np.float32(1 / c.missed_step), c.missed.size - 1.001)
        index = self._index(position)
        share = position - self._float(index)
        total = dr.fma(dr.gather(self._float, table, index + 1) - dr.gather(self._float, table, index), share,
                       dr.gather(self._float, table, index))  # fmt: skip
        base = row * len(densities)
        for m, density in enumerate(densities):
            total = dr.fma(dr.gather(self._float, weights, base + m), density, total)
        return total.numpy().reshape(features, particles)

    def _densities(self, form, x, y, u, agent, scan, c, need_row):
        dr, Float = self._dr, self._float
        features, particles = x.shape
        lane = dr.arange(self._index, features * particles)
        row = lane // particles
        own = lane - row * particles
        qx, qy, ui = (Float(a.ravel()) for a in (x, y, u))
        ax, ay, cos, sin = (dr.gather(Float, Float(a), own) for a in agent)
        count = max(_PAD, -(-len(scan) // _PAD) * _PAD)
        columns = np.ones((count, 6), np.float32)
        columns[: len(scan)] = _scan_columns(scan)
        columns[len(scan) :, 0] = 1e9  # padding: a distance with density 0
        z = [Float(np.ascontiguousarray(columns[:, j])) for j in range(6)]
        log_norm, power = _norms(form, c)
        uniform = Float(
            np.concatenate([0.5 / c.unit**2, c.anchor[:2], [np.exp(log_norm), c.quarter_samples]]).astype(np.float32)
        )
        gd, ga, gt, anchor_x, anchor_y, norm, quarter = (dr.gather(Float, uniform, self._index(j)) for j in range(7))
        ex, ey = qx - ax, qy - ay
        inverse = dr.rsqrt(ex * ex + ey * ey)
        d = (ex * ex + ey * ey) * inverse
        ex, ey = ex * inverse, ey * inverse
        px, py = cos * ex + sin * ey, cos * ey - sin * ex
        tx, ty = -ex, -ey
        if form in (Form.PS, Form.VA_AOD):
            nx, ny = qx - anchor_x, qy - anchor_y
            outward = dr.rsqrt(nx * nx + ny * ny)
            if form == Form.PS:
                d += (nx * nx + ny * ny) * outward
            nx, ny = nx * outward, ny * outward
            if form == Form.PS:
                tx, ty = nx, ny
            else:
                en = 2 * (ex * nx + ey * ny)
                tx, ty = en * nx - ex, en * ny - ey
        u2 = ui * ui
        v = 0.5 + quarter * u2
        half = 0.5 / v
        factor = norm * u2 * dr.rsqrt(v * ui)
        if power == 3.0:
            factor *= ui
        correction = 0.125 * v / ui
        densities = []
        for m in range(count):
            zd, zax, zay, ztx, zty, zu = (dr.gather(Float, column, self._index(m)) for column in z)
            delta = zd - d
            across, along = px - zax, py - zay
            cost = gd * delta * delta + ga * dr.fma(across, across, along * along)
            if form != Form.VA:
                across, along = tx - ztx, ty - zty
                cost = dr.fma(gt, dr.fma(across, across, along * along), cost)
            offset = zu - ui
            cost = u2 * cost + half * offset * offset
            densities.append(dr.exp(-cost) * factor * (dr.sqrt(zu) + correction * dr.rsqrt(zu)))
        return densities, ui, row
