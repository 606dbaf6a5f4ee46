"""Noise that is not alike at all ports: an interferer from some direction, a port that is noisier than the others.

It is there at every delay, as no path is: of the residual over delay bins the quieter half tells its covariance over the
ports, whatever the paths and the echoes in the other half. With that covariance in the model the ports are white again,
and what the interferer looks like is no longer taken for paths.
"""

from __future__ import annotations

import numpy as np

from ..signal.arrays import Complex
from ..signal.model import SignalModel

WORTH = 1.25
"""Ratio of the largest (or the mean over the smallest) noise of a combination of ports to the mean below which it is left
as it is."""
FEW = 100_000
"""Samples that show whether noise is white."""
LEAST = 4
"""Samples per port and port below which a covariance over the ports is not estimated."""


def port_covariance(model: SignalModel, residual: Complex) -> Complex | None:
    """Noise covariance (S, M, M) of the ports in units of its mean, from what paths leave of a whitened signal (K, N, M,
    ...); None if it is white.
    """
    combiners = model.schedule.combiner_index
    settings = np.zeros(residual.shape[1], int) if combiners is None else combiners
    count, ports = int(settings.max()) + 1, residual.shape[2]
    rows = np.moveaxis(residual, 2, -1).reshape(*residual.shape[:2], -1, ports)
    few = rows[:: max(1, rows.size // FEW)]
    if not _colored(_covariances(few, settings, count), few.size // ports // count):
        return None
    if model.waveform.spacing is not None and len(rows) >= 2 * LEAST:
        # Far from a delay nothing is left of it behind a Hann window.
        window = np.hanning(len(rows) + 2)[1:-1].astype(np.float32)
        rows = np.fft.fft(rows * window[:, None, None, None], axis=0)
        loud = np.sum(np.abs(rows) ** 2, axis=(1, 2, 3))
        rows = rows[np.sort(np.argsort(loud)[: len(rows) // 2])]
    # Neighboring bins behind the window tell the same twice.
    covariance = _covariances(rows, settings, count)
    if not _colored(covariance, rows.size // ports // count // 2):
        return None
    scaled = covariance / np.trace(covariance, axis1=1, axis2=2).real.mean() * ports
    factor = np.eye(ports) if model.port_noise is None else np.linalg.cholesky(model.port_noise)
    return factor @ scaled @ factor.conj().swapaxes(-1, -2)


def _covariances(rows: Complex, settings, count: int) -> Complex:
    """(S, M, M) of rows (K, N, T, M)."""
    found = []
    for setting in range(count):
        part = rows[:, settings == setting].reshape(-1, rows.shape[-1])
        found.append((part.T @ part.conj()) / max(len(part), 1))
    return np.array(found, complex)


def _colored(covariance: Complex, samples: int) -> bool:
    """Whether covariances (S, M, M) of so many samples each are further from white than chance, and than is worth a word."""
    ports = covariance.shape[-1]
    if ports < 2 or samples < LEAST * ports:
        return False
    values = np.linalg.eigvalsh(covariance)
    mean = max(float(values.mean()), 1e-300)
    edge = 2 * np.sqrt(ports / samples) + ports / samples + 4 / np.sqrt(samples)
    return bool(values.max() / mean > max(WORTH, 1 + edge) or mean / max(values.min(), 1e-300) > max(WORTH, 1 + edge))
