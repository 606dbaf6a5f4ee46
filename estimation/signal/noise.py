"""Circular complex Gaussian noise, several times faster than a general-purpose generator.

A counter is hashed into two words per sample (three rounds of a 32-bit finalizer under keys drawn from the
caller's generator), and Box and Muller's transform turns them into a pair of normals; logarithm and sine are
polynomials, so that whole vector registers work at a time. Reproducible: the noise is a function of the
generator's state and the shape. Tails end at 6.7 standard deviations.
"""

from __future__ import annotations

import numpy as np

from ..jit import compiled

BLOCK = 256


def white_noise(shape: tuple[int, ...], variance: float, rng: np.random.Generator) -> np.typing.NDArray[np.complex64]:
    """Circular complex Gaussian noise of the given variance per sample, complex64."""
    out = np.empty(shape, np.complex64)
    if out.size:
        keys = rng.integers(0, 2**32, 4, dtype=np.uint32)
        _fill(out.reshape(-1).view(np.float32), np.float32(variance), keys)
    return out


@compiled
def _hash(value, key):
    """A 32-bit mixing function (multiply and xor-shift) with a key."""
    # Numba widens products of 32-bit words; every step is cut back to keep registers full.
    value = np.uint32(value ^ key)
    value = np.uint32(np.uint32(value ^ np.uint32(value >> np.uint32(16))) * np.uint32(0x7FEB352D))
    value = np.uint32(np.uint32(value ^ np.uint32(value >> np.uint32(15))) * np.uint32(0x846CA68B))
    return np.uint32(value ^ np.uint32(value >> np.uint32(16)))


@compiled
def _fill(out, variance, keys):
    # Many short loops over few arrays each: the compiler turns those into vector instructions, one long
    # loop it does not.
    count = len(out) // 2
    first, second = np.empty(BLOCK, np.uint32), np.empty(BLOCK, np.uint32)
    uniform, radius = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    sine, cosine = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    bits = uniform.view(np.int32)
    exponent, mantissa_bits = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
    mantissa = mantissa_bits.view(np.float32)
    one, two = np.float32(1), np.float32(2)
    k0, k1, k2, k3 = keys[0], keys[1], keys[2], keys[3]
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for i in range(BLOCK):
            word = _hash(np.uint32(start + i), k0)
            first[i] = _hash(word, k1)
            second[i] = _hash(np.uint32(word + k2), k3)
        for i in range(BLOCK):
            uniform[i] = (np.float32(np.int32(first[i] >> np.uint32(1))) + np.float32(0.5)) * np.float32(2.0**-31)
        for i in range(BLOCK):
            exponent[i] = (bits[i] >> np.int32(23)) - np.int32(127)
        for i in range(BLOCK):
            mantissa_bits[i] = (bits[i] & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
        for i in range(BLOCK):
            m = mantissa[i]
            s = (m - one) / (m + one)
            q = s * s
            # 2 artanh(s) = log(m) for m in [1, 2), s below 1/3.
            series = np.float32(1 / 9) + q * np.float32(1 / 11)
            series = np.float32(1 / 3) + q * (np.float32(1 / 5) + q * (np.float32(1 / 7) + q * series))
            log = np.float32(exponent[i]) * np.float32(0.6931471805599453) + two * s * (one + q * series)
            radius[i] = np.sqrt(abs(variance * log))
        for i in range(BLOCK):
            # Half the angle lies within a quarter turn, where short polynomials do; it is doubled below.
            x = np.float32(np.int32(second[i])) * np.float32(np.pi * 2.0**-32)
            y = x * x
            tail = np.float32(1 / 362880) + y * (np.float32(-1 / 39916800) + y * np.float32(1 / 6227020800))
            tail = np.float32(-1 / 6) + y * (np.float32(1 / 120) + y * (np.float32(-1 / 5040) + y * tail))
            sine[i] = x + x * y * tail
            tail = np.float32(-1 / 3628800) + y * (np.float32(1 / 479001600) - y * np.float32(1 / 87178291200))
            tail = np.float32(1 / 24) + y * (np.float32(-1 / 720) + y * (np.float32(1 / 40320) + y * tail))
            cosine[i] = one + y * (np.float32(-0.5) + y * tail)
        for i in range(BLOCK):
            cosine[i] = two * sine[i] * cosine[i] * radius[i]
        for i in range(BLOCK):
            sine[i] = (one - two * sine[i] * sine[i]) * radius[i]
        part = out[2 * start : 2 * (start + size)]
        for i in range(size):
            part[2 * i] = sine[i]
            part[2 * i + 1] = cosine[i]
