"""ESPRIT in all dimensions at once, for fully digital links of uniform pilots and arrays that are shift-invariant.

The data as a matrix (pilots x symbols) by (receive x transmit elements) have the paths' outer products as
their leading singular vectors. Shifts by one pilot and one symbol act on the left subspace, shifts between
displaced subarrays on the right one; eigenvectors of a mixture of the shifts separate the paths on either
side, and the core matrix pairs the sides. No search, but a subspace stands out of the noise only above
``sqrt(rows) + sqrt(columns)``: it needs some 20 dB more than a matched filter. Use it as a start at high SNR,
or alone where speed is all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..detections import Detections
from ..errors import ModelError
from ..signal.arrays import Array
from ..signal.directions import Float
from ..signal.paths import Geometry, PathTable
from . import report
from .noise import Noise
from .nomp import Nomp
from .projector import Projector
from .refine import linearize
from .sound import pruned


@dataclass(frozen=True, eq=False)
class Esprit(Nomp):
    """ESPRIT with the parameters of :class:`~estimation.Nomp`; ``refine`` adds its joint Levenberg-Marquardt
    fit and elimination.
    """

    refine: bool = True

    def __post_init__(self) -> None:
        shifts(self)
        # No search: Rice's threshold serves the elimination, there is nothing to calibrate.
        object.__setattr__(self, "calibration", 0)
        Nomp.__post_init__(self)

    def run(
        self, signal, noise_variance: float | None = None, prior: PathTable | Detections | None = None
    ) -> Detections:
        """Estimate all paths whose singular values stand out of the noise; ``prior`` is ignored."""
        data = Projector(self.model, self.model.checked(signal), self._basis)
        noise = Noise(float(np.vdot(data.signal, data.signal).real), data.signal.size, noise_variance)
        if noise.energy == 0.0:
            return report.empty(self, 0.0 if noise_variance is None else noise_variance)
        geometry = self._subspace(data.signal, noise_variance)
        if not len(geometry):
            return report.empty(self, noise.variance(None))
        lin = linearize(data, geometry)
        if not self.refine:
            return report.detections(self, data, lin, noise.variance(lin))
        return self._reported(
            data, pruned(self, data, self._eliminated(data, self._fit(data, lin, noise), noise), noise), noise
        )

    def _subspace(self, signal, noise_variance: float | None) -> Geometry:
        pilots, symbols, ports, elements = self.model.shape
        matrix = signal.reshape(pilots * symbols, ports * elements)
        rows, columns = matrix.shape
        most = max(min(self.max_paths, pilots * (symbols - 1) - 1, (pilots - 1) * symbols - 1, columns - 1), 1)
        left, values, right = leading(matrix, most)
        energy = float(np.vdot(matrix, matrix).real)
        variance = noise_variance if noise_variance is not None else energy / matrix.size
        count = 0
        for _ in range(20):
            # Everything outside the subspace is noise; the subspace is what stands out of that.
            edge = variance * (np.sqrt(rows) + np.sqrt(columns)) ** 2 * 1.1
            previous, count = count, int(np.sum(values**2 > edge))
            if noise_variance is None:
                variance = max(energy - float(np.sum(values[:count] ** 2)), 0.0) / (
                    matrix.size - count * (rows + columns - count)
                )
            if count == previous:
                break
        if count == 0:
            return Geometry.empty()
        left, values, right = left[:, :count], values[:count], right[:, :count]
        delay_shift, time_shift, receive, transmit = shifts(self)
        receiver, transmitter = self.model.receiver, self.model.transmitter
        assert isinstance(receiver, Array) and isinstance(transmitter, Array)  # or it has no shifts
        cube = left.reshape(pilots, symbols, count)
        sides = []
        for tensor, pairs in (
            (
                cube,
                [
                    ((slice(None, -1),), (slice(1, None),)),
                    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
                ],
            ),
            (
                right.conj().reshape(ports, elements, count),
                [
                    *[((a,), (b,)) for a, b in receive[1]],
                    *[((slice(None), a), (slice(None), b)) for a, b in transmit[1]],
                ],
            ),
        ):
            operators = [
                np.linalg.lstsq(tensor[a].reshape(-1, count), tensor[b].reshape(-1, count), rcond=None)[0]
                for a, b in pairs
            ]
            mixture = sum(w * o for w, o in zip((1.0, 0.618, 0.382, 0.2361), operators, strict=False))
            vectors = np.linalg.eig(mixture)[1]
            roots = [np.diag(np.linalg.solve(vectors, o @ vectors)) for o in operators]
            sides.append((vectors, roots))
        (left_vectors, left_roots), (right_vectors, right_roots) = sides
        # Y = L S R^H with L = A_l V_l^-1 and so on: the paired core is a permuted diagonal.
        core = np.linalg.solve(left_vectors, np.linalg.solve(right_vectors, np.diag(np.sqrt(values[:count]))).T)
        strength = (
            np.abs(core) * np.linalg.norm(left @ left_vectors, axis=0)[:, None] * np.linalg.norm(right_vectors, axis=0)
        )
        row, column = linear_sum_assignment(-strength)
        delay = np.mod(-np.angle(left_roots[0][row]) / (2 * np.pi * delay_shift), 1 / delay_shift)
        speed = np.angle(left_roots[1][row]) / (2 * np.pi * time_shift) * self.model.waveform.wavelength
        phases = [np.angle(r[column]) / (2 * np.pi) for r in right_roots]
        split = len(receive[0])
        arrival = directions_from(receiver, receive[0], np.stack(phases[:split], axis=1))
        departure = directions_from(transmitter, transmit[0], -np.stack(phases[split:], axis=1))
        return Geometry(delay, arrival, departure, speed)


def leading(matrix, count: int, surplus: int = 8, iterations: int = 3):
    """The ``count`` leading singular triplets (left (m, c), values (c,), right (n, c)) by randomized subspace
    iteration.
    """
    rng = np.random.default_rng(0)
    width = min(count + surplus, min(matrix.shape))
    basis = (rng.standard_normal((matrix.shape[1], width)) + 0j).astype(matrix.dtype)
    for _ in range(iterations):
        basis = np.linalg.qr(matrix @ basis)[0]
        basis = np.linalg.qr(matrix.conj().T @ basis)[0]
    left, values, right = np.linalg.svd(matrix @ basis, full_matrices=False)
    right = basis @ right.conj().T
    return left[:, :count].astype(complex), values[:count].astype(float), right[:, :count].astype(complex)


def shifts(estimator: Esprit):
    """Pilot spacing [Hz], symbol spacing [s], and both arrays' shift invariances.

    Raises
    ------
    ModelError
        if the link is not digital and uniform, or an array has fewer than two independent displacements.
    """
    model = estimator.model
    times = np.diff(model.schedule.times)
    digital = model.schedule.precoders is None and model.schedule.combiners is None
    if not digital or model.waveform.spacing is None or len(times) == 0 or np.ptp(times) > 1e-9 * abs(times[0]):
        raise ModelError(
            "Esprit: it needs a fully digital link with uniform pilots and at least two uniformly spaced symbols"
        )
    return model.waveform.spacing, float(times[0]), invariance(model.receiver), invariance(model.transmitter)


def invariance(array) -> tuple[Float, list]:
    """Two displacements (2, 3) [wavelengths] between many pairs of elements, and those pairs."""
    if not isinstance(array, Array) or array.pattern is not None:
        raise ModelError("Esprit: arrays must be of identical isotropic elements")
    positions = array.positions
    difference = np.round((positions[None] - positions[:, None]), 9)
    found, vectors, pairs = np.unique(difference.reshape(-1, 3), axis=0, return_counts=True), [], []
    order = np.lexsort((np.linalg.norm(found[0], axis=1), -found[1]))
    for index in order:
        vector = found[0][index]
        length = np.linalg.norm(vector)
        # Up to half a wavelength a phase is unambiguous; one of each pair +-v is enough.
        if not 1e-9 < length <= 0.5 + 1e-9 or vector[np.flatnonzero(np.abs(vector) > 1e-9)[0]] < 0:
            continue
        if np.linalg.matrix_rank(np.array([*vectors, vector]), tol=1e-6) > len(vectors):
            vectors.append(vector)
            pairs.append(np.nonzero(np.all(np.abs(difference - vector) < 1e-8, axis=2)))
        if len(vectors) == 2:
            return np.array(vectors), pairs
    raise ModelError(
        "Esprit: an array has fewer than two displacements of at most half a wavelength between its elements; use nomp"
    )


def directions_from(array: Array, displacements: Float, phases: Float) -> Float:
    """Unit vectors (P, 3) on the facing side from phases (P, 2) [cycles] of the two displacements."""
    plane = phases @ np.linalg.pinv(displacements).T
    normal = np.cross(displacements[0], displacements[1])
    normal /= np.linalg.norm(normal)
    length = np.linalg.norm(plane, axis=1)
    plane = plane * np.minimum(1.0, 0.999 / np.maximum(length, 1e-12))[:, None]
    out = plane + normal * np.sqrt(np.maximum(1 - np.sum(plane**2, axis=1), 0))[:, None]
    if array.orientation is not None:
        out = array.orientation.apply(out)
    mirrored = ~array.faces(out)
    if mirrored.any():
        flipped = plane - normal * np.sqrt(np.maximum(1 - np.sum(plane**2, axis=1), 0))[:, None]
        flipped = flipped if array.orientation is None else array.orientation.apply(flipped)
        out[mirrored] = flipped[mirrored]
    return out
