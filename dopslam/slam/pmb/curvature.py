"""How far a measurement may lie from its linear prediction because the receiver or the landmark is not known well enough.

Where detections are much sharper than the prediction (hundredths of a millimetre in front of decimetres at the start of a
drive), what a linearization leaves out is larger than their noise, and no gate passes what is plainly the base station. The
second-order terms of a Gaussian of spread σ at distance r have the deviations σ²/√2r in a length and σ²/√2r² in an angle;
they widen the noise of the association. The update relinearizes and needs them not.
"""

from __future__ import annotations

import math

from dopslam.compute.compiled import compiled
from dopslam.models.kernels import SP, SR, moving
from dopslam.slam.pmb.density import start_of


@compiled
def add_curvature(density, n, block, spread, model, noise):
    """Add the variances of the second-order terms of a block's prediction to the diagonal of `noise` (m, m).

    Parameters
    ----------
    density : PMB
    n, block : int
    spread : (3, 3) array; covariance of the vector from the receiver to the block
    model : Model
    """
    m = noise.shape[0]
    state, site, start = density.mean, model.site, start_of(n, block)
    own = 0.0
    x, y, z = site[0], site[1], site[2]
    if block > 0:
        x, y, z = state[start], state[start + 1], state[start + 2]
        for i in range(3):
            own += density.covariance[start + i, start + i]
    arrival = _turned(x - state[0], y - state[1], z - site[3], spread[0, 0] + spread[1, 1] + spread[2, 2])
    noise[0, 0] += 0.5 * arrival[2]
    noise[1, 1] += 0.5 * arrival[0]
    noise[2, 2] += 0.5 * arrival[1]
    if m == 6:
        speed, doubt = own_speed(state, density.covariance, n, site)
        turn = math.sqrt(arrival[0]) + density.covariance[2, 2]
        noise[5, 5] += 0.5 * (speed * turn) ** 2
        if doubt > 0.0:
            noise[5, 5] += doubt * turn
    kind = density.kind[block]
    if kind == SR:
        return
    if kind == SP:
        arrival = _turned(x - site[0], y - site[1], z - site[2], own)
        noise[0, 0] += 0.5 * arrival[2]
    noise[3, 3] += 0.5 * arrival[0]
    noise[4, 4] += 0.5 * arrival[1]


@compiled
def own_speed(state, covariance, n, site):
    """Speed of the receiver and its variance, under any motion model."""
    if len(site) == 5:
        if n == 4:
            return site[4], 0.0
        return abs(state[4]), covariance[4, 4]
    vx, vy, vz = moving(state[:n], site)
    speed, variance = math.sqrt(vx * vx + vy * vy + vz * vz), 0.0
    for i in range(n):
        along = (site[5][0, i] * vx + site[5][1, i] * vy + site[5][2, i] * vz) / max(speed, 1e-6)
        variance += along * along * covariance[i, i]
    return speed, variance


@compiled
def _turned(x, y, z, variance):
    """Squares of σ²/r² with the horizontal distance, with the whole one, and of σ²/r."""
    flat, square = max(x * x + y * y, 1e-6), max(x * x + y * y + z * z, 1e-6)
    return (variance / flat) ** 2, (variance / square) ** 2, variance * variance / square
