"""Synthesis of received signals from path tables, eq. (2) of paper A."""

from __future__ import annotations

import numpy as np

from ..errors import ModelError
from .algebra import add_signal
from .model import SignalModel
from .noise import white_noise
from .paths import PathTable


def synthesize(
    model: SignalModel, paths: PathTable, noise_variance: float = 0.0, rng: np.random.Generator | None = None
) -> np.typing.NDArray[np.complex64]:
    """One received burst ``Y`` (``model.shape``), complex64.

    Parameters
    ----------
    model : the link; its ``subbands`` decide about beam squint and range migration
    paths : propagation paths (possibly none)
    noise_variance : variance of each entry of the white noise vector ``n`` before combining; behind combiners
        the noise has the
        covariance ``noise_variance * W_n^H W_n``
    rng : generator of the noise; needed if there is any

    Raises
    ------
    ModelError
        for a negative or non-finite variance, or noise without a generator.
    """
    if not np.isfinite(noise_variance) or noise_variance < 0:
        raise ModelError(f"synthesize: noise_variance must be finite and not negative, got {noise_variance}")
    if noise_variance == 0:
        signal = np.zeros(model.shape, np.complex64)
    elif rng is None:
        raise ModelError("synthesize: noise needs rng=np.random.default_rng(seed)")
    else:
        signal = noise_of(model, noise_variance, rng)
    if len(paths):
        signal = add_signal(model, model.evaluate(paths.geometry), paths.gain, signal)
    return model.color(signal)


def noise_of(model: SignalModel, variance: float, rng: np.random.Generator) -> np.typing.NDArray[np.complex64]:
    """Noise before the combiners color it: white, or with the model's covariance over the pilots."""
    noise = white_noise(model.shape, variance, rng)
    if model.pilot_covariance is None:
        return noise
    return (model.pilot_factor.astype(np.complex64) @ noise.reshape(len(noise), -1)).reshape(noise.shape)
