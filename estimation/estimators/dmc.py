"""Dense multipath: the diffuse part of the channel as noise with a delay profile, estimated from the residual
and whitened.

Thousands of unresolvable echoes behave as Gaussian noise that is colored over the pilots. What the specular
paths leave of the data, averaged over symbols and ports, estimates that covariance (Toeplitz: the profile is
stationary in frequency); with its inverse as weight the likelihood knows the echoes for what they are, and
stops explaining them by false paths.
"""

from __future__ import annotations

import numpy as np

from ..signal.waveform import Waveform


def pilot_covariance(residual, waveform: Waveform):
    """Toeplitz covariance (K, K) over the pilots of a whitened residual (K, ...), positive definite by
    construction.

    The autocorrelation over pilot lags becomes a delay profile, which is clipped at a hundredth of its
    median, a noise floor that single
    cells scatter about, and transformed back.
    """
    rows = np.asarray(residual).reshape(len(residual), -1)
    count = len(rows)
    sample = rows @ rows.conj().T / rows.shape[1]
    if waveform.spacing is None:
        # Without a uniform comb there is no Toeplitz structure to exploit: shrink towards the
        # diagonal instead.
        shrinkage = min(1.0, count / rows.shape[1])
        return (1 - shrinkage) * sample + shrinkage * np.mean(np.diag(sample).real) * np.eye(count)
    lags = np.array([np.trace(sample, -lag) / (count - lag) for lag in range(count)])
    # A triangular taper keeps the profile positive in expectation.
    taper = 1 - np.arange(count) / count
    circular = np.concatenate([lags * taper, [0], (lags * taper)[:0:-1].conj()])
    profile = np.fft.fft(circular).real
    profile = np.maximum(profile, 0.01 * np.median(profile))
    lags = np.fft.ifft(profile)[:count]
    index = np.arange(count)
    difference = index[:, None] - index
    return np.where(difference >= 0, lags[np.abs(difference)], lags[np.abs(difference)].conj())


def exponential_profile(waveform: Waveform, power: float, delay: float, spread: float):
    """Covariance (K, K) of white noise of unit variance plus dense multipath of ``power`` per sample.

    Its delay profile starts at ``delay`` [s] and decays over ``spread`` [s] (the model of Richter's RIMAX).
    """
    difference = waveform.frequencies[:, None] - waveform.frequencies
    echo = power * np.exp(-2j * np.pi * difference * delay) / (1 + 2j * np.pi * difference * spread)
    return np.eye(waveform.subcarriers) + echo
