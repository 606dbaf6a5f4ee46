"""Dr.Jit backend of :mod:`dopslam.slam.belief.stacked.likelihood`: one fused kernel per form and number of measurements.

Lanes are row·N + particle. Measurements are read from small uniform buffers, so a kernel is compiled once per
padded number of measurements and reused for any number of rows and particles. On a machine with CUDA the same
code runs there.
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.llvm import prepare
from dopslam.slam.belief.records import Form, Scan
from dopslam.slam.belief.stacked.likelihood import Constants, norms, scan_columns

_PAD = 4  # measurements per kernel are padded to a multiple
_BLOCK = 256  # particles summed in one place


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
        dr, Float = self._dr, self._float
        blocks = -(-particles // _BLOCK)
        lane = dr.arange(self._index, features * blocks * _BLOCK)
        row = lane // (blocks * _BLOCK)
        own = lane - row * (blocks * _BLOCK)
        valid = own < particles
        own = dr.minimum(own, particles - 1)
        buffers = [Float(a.ravel()) for a in (x, y, u)], [Float(a) for a in agent]
        uniform, z = self._uniform(form, scan, c)
        count = dr.width(z[0])
        densities, _ = self._densities(form, buffers, row * particles + own, own, uniform, z, count)
        # One sum per block, and a block is never shared by threads: the order of the additions is always the
        # same.
        sums = [dr.zeros(Float, features * blocks) for _ in range(count)]
        for total, density in zip(sums, densities, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, total, density, lane // _BLOCK, valid, mode=dr.ReduceMode.Local)
        dr.eval(sums)
        parts = np.stack([total.numpy() for total in sums[: len(scan)]], axis=1).astype(float)
        return parts.reshape(features, blocks, len(scan)).sum(axis=1) / particles

    def messages(self, form: Form, x, y, u, agent, scan: Scan, nu, c: Constants) -> np.ndarray:
        """λ, (K, N) float32."""
        features, particles = x.shape
        if features == 0:
            return np.zeros(x.shape, np.float32)
        dr, Float = self._dr, self._float
        lane = dr.arange(self._index, features * particles)
        row = lane // particles
        buffers = [Float(a.ravel()) for a in (x, y, u)], [Float(a) for a in agent]
        uniform, z = self._uniform(form, scan, c)
        count = dr.width(z[0])
        densities, u_lanes = self._densities(form, buffers, lane, lane - row * particles, uniform, z, count)
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

    def _uniform(self, form, scan, c):
        """Buffers of constants and of the padded measurements' columns."""
        count = max(_PAD, -(-len(scan) // _PAD) * _PAD)
        columns = np.ones((count, 6), np.float32)
        columns[: len(scan)] = scan_columns(scan)
        columns[len(scan) :, 0] = 1e9  # padding: a distance with density 0
        log_norm, _ = norms(form, c)
        constants = [*(0.5 / c.unit**2), *c.anchor[:2], np.exp(log_norm), c.quarter_samples]
        return self._float(np.array(constants, np.float32)), [
            self._float(np.ascontiguousarray(columns[:, j])) for j in range(6)
        ]

    def _densities(self, form, buffers, index, own, uniform, z, count):
        """p_d f of every measurement at lanes that read particle ``index`` of the rows and ``own`` of the agent."""
        dr, Float = self._dr, self._float
        qx, qy, ui = (dr.gather(Float, a, index) for a in buffers[0])
        ax, ay, cos, sin = (dr.gather(Float, a, own) for a in buffers[1])
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
        if form != Form.VA:
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
        return densities, ui
