"""What numbers in a foreign table can be: everything else is a slip of the unit or of the column."""

from __future__ import annotations

import numpy as np

from dopslam.errors import DatasetError
from dopslam.records import SPEED_OF_LIGHT

QUANTITIES = ("delay", "aoa_azimuth", "aoa_elevation", "aod_azimuth", "aod_elevation", "radial_velocity")
# (largest magnitude, largest standard deviation) of every quantity in SI units, and what to call it.
POSSIBLE = (
    (1e6 / SPEED_OF_LIGHT, 1e6 / SPEED_OF_LIGHT, "delay of more than 1000 km"),
    (4 * np.pi, 2 * np.pi, "azimuth beyond two turns: degrees taken for radians?"),
    (np.pi / 2 + 1e-6, np.pi, "elevation beyond 90°: degrees taken for radians, or counted from the zenith?"),
    (4 * np.pi, 2 * np.pi, "azimuth beyond two turns: degrees taken for radians?"),
    (np.pi / 2 + 1e-6, np.pi, "elevation beyond 90°: degrees taken for radians, or counted from the zenith?"),
    (1e5, 1e5, "radial velocity of more than 100 km/s"),
)  # fmt: skip


def refuse_impossible(path, z: np.ndarray, std: np.ndarray, row: np.ndarray) -> None:
    """Refuse numbers that cannot be, with row (of the data, from 1) and column."""
    for i, (most, widest, what) in enumerate(POSSIBLE):
        bad = np.abs(z[:, i]) > most
        if bad.any():
            n = int(np.argmax(bad))
            raise DatasetError(
                f"{path}: {QUANTITIES[i]} = {z[n, i]:g} (SI) in data row {row[n] + 1} is impossible: {what}"
            )
        wild = ~np.isnan(std[:, i]) & ~((std[:, i] > 1e-15) & (std[:, i] < widest))
        if wild.any():
            n = int(np.argmax(wild))
            raise DatasetError(
                f"{path}: standard deviation {std[n, i]:g} (SI) of {QUANTITIES[i]} in data row {row[n] + 1} cannot be; "
                "check its unit"
            )


def refuse_strengths(path, snr: np.ndarray, order: np.ndarray) -> None:
    """Refuse SNRs (N,), linear, that no receiver measures; ``order`` (N,) is the data row that each came from."""
    wrong = ~((snr >= WEAKEST) & (snr <= STRONGEST))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DatasetError(
            f"{path}: data row {order[row] + 1}: its SNR is {snr[row]:.3g} (linear), outside {WEAKEST:g} to {STRONGEST:g}; "
            "check units.snr or units.power (linear or dB), offsets and noise_floor_db"
        )


WEAKEST, STRONGEST = 1e-9, 1e15  # post-integration SNR
