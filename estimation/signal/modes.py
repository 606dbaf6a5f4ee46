"""Modes: the factors of a path's signature.

The signature of a path is the outer product of one vector per mode of the data tensor. A mode may depend on
several of the six parameters, and provides its vector and the derivatives in one block ``(P, 1 + c, n)``: the
vector first, then one column for each of its ``parameters`` (indices into the common order, directions by
their tangents). Everything else (synthesis, projections, Gram matrices, Fisher information) is generic over
the list of modes.

| data                           | modes                                                       |
|--------------------------------|-------------------------------------------------------------|
| digital at both ends           | delay x time(speed) x receive(AOA) x transmit(AOD)          |
| swept beams, digital receiver  | delay x time(AOD, speed) x receive(AOA)                     |
| eq. (2) with p_n and W_n       | delay x time(AOA, AOD, speed), over symbols and ports       |

Where the pilots shift from symbol to symbol (``offsets``), the time mode depends on the delay, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .arrays import Complex, Manifold
from .directions import Float, tangents
from .paths import Geometry

DELAY, ARRIVAL, DEPARTURE, SPEED = (0,), (1, 2), (3, 4), (5,)


class Mode(Protocol):
    """One factor of the signature."""

    @property
    def parameters(self) -> tuple[int, ...]:
        """Indices of the parameters this mode depends on, in the order of its derivative columns."""
        ...

    @property
    def size(self) -> int:
        """Length n of the mode."""
        ...

    def evaluate(self, geometry: Geometry, scale: float = 1.0) -> Complex:
        """Vector and derivatives (P, 1 + c, n); ``scale`` is the sub-band's frequency over the carrier."""
        ...

    def vector(self, geometry: Geometry) -> Complex:
        """The vector alone (P, n), at the carrier."""
        ...


@dataclass(frozen=True, eq=False)
class DelayMode:
    """``exp(-j 2 pi f_k tau)`` over the pilot frequencies (K,) [Hz relative to the carrier]."""

    frequencies: Float

    parameters = DELAY

    @property
    def size(self) -> int:
        """Number of subcarriers."""
        return len(self.frequencies)

    def evaluate(self, geometry: Geometry, scale: float = 1.0) -> Complex:
        """Vector and d/d tau, (P, 2, K)."""
        rate = -2j * np.pi * self.frequencies
        vector = np.exp(rate * geometry.delay[:, None])
        return np.stack([vector, rate * vector], axis=1)

    def vector(self, geometry: Geometry) -> Complex:
        """The vector alone (P, K)."""
        return np.exp(-2j * np.pi * self.frequencies * geometry.delay[:, None])


@dataclass(frozen=True, eq=False)
class ReceiveMode:
    """``a_R`` of a digital receiver."""

    array: Manifold

    parameters = ARRIVAL

    @property
    def size(self) -> int:
        """Number of receive elements."""
        return self.array.elements

    def evaluate(self, geometry: Geometry, scale: float = 1.0) -> Complex:
        """Vector and two tangent derivatives, (P, 3, N_R)."""
        return _block(self.array, geometry.arrival, scale)

    def vector(self, geometry: Geometry) -> Complex:
        """The vector alone (P, N_R)."""
        return self.array.response(geometry.arrival)[0]


@dataclass(frozen=True, eq=False)
class TransmitMode:
    """``conj(a_T)`` of a transmitter whose elements are observed separately: eq. (2) has ``a_T^H``."""

    array: Manifold

    parameters = DEPARTURE

    @property
    def size(self) -> int:
        """Number of transmit elements."""
        return self.array.elements

    def evaluate(self, geometry: Geometry, scale: float = 1.0) -> Complex:
        """Vector and two tangent derivatives, (P, 3, N_T)."""
        return _block(self.array, geometry.departure, scale).conj()

    def vector(self, geometry: Geometry) -> Complex:
        """The vector alone (P, N_T)."""
        return self.array.response(geometry.departure)[0].conj()


@dataclass(frozen=True, eq=False)
class TimeMode:
    """Doppler phase over the symbols, times beam gains ``a_T^H p_n``, times combiner outputs ``W_n^H a_R``,
    as far as present.

    Parameters
    ----------
    times : (N,) [s] from the burst center
    wavelength : carrier wavelength [m]
    transmitter, precoders, precoder_index : array, (Q, N_T) and (N,), or None
    receiver, combiners, combiner_index : array, (S, M, N_R) already conjugate-transposed and whitened, and
        (N,), or None
    offsets : (N,) shifts of the pilots [Hz], or None
    """

    times: Float
    wavelength: float
    transmitter: Manifold | None = None
    precoders: Complex | None = None
    precoder_index: np.typing.NDArray | None = None
    receiver: Manifold | None = None
    combiners: Complex | None = None
    combiner_index: np.typing.NDArray | None = None
    offsets: Float | None = None

    @property
    def parameters(self) -> tuple[int, ...]:
        """AOA if combined, AOD if precoded, the speed, and the delay if the pilots shift."""
        arrival = () if self.receiver is None else ARRIVAL
        departure = () if self.transmitter is None else DEPARTURE
        return (*arrival, *departure, *SPEED, *(() if self.offsets is None else DELAY))

    @property
    def ports(self) -> int:
        """Combiner outputs per symbol in this mode (1 with a digital receiver)."""
        return 1 if self.combiners is None else self.combiners.shape[1]

    @property
    def size(self) -> int:
        """Number of symbols times combiner outputs."""
        return len(self.times) * self.ports

    def evaluate(self, geometry: Geometry, scale: float = 1.0) -> Complex:
        """Vector and derivatives in the order of ``parameters``, (P, 1 + c, N * M)."""
        rates = [2j * np.pi * scale / self.wavelength * self.times]
        doppler = np.exp(rates[0] * geometry.speed[:, None])
        if self.offsets is not None:
            rates.append(-2j * np.pi * self.offsets)
            doppler *= np.exp(rates[1] * geometry.delay[:, None])
        if self.transmitter is None or self.precoders is None:
            beams = np.ones((len(geometry), 1, len(self.times)))
        else:
            departure = _block(self.transmitter, geometry.departure, scale).conj()
            beams = (departure @ self.precoders.T)[:, :, self.precoder_index]
        timed = beams * doppler[:, None]
        if self.receiver is None or self.combiners is None:
            return np.concatenate([timed, *(rate * timed[:, :1] for rate in rates)], axis=1)
        arrival = _block(self.receiver, geometry.arrival, scale)
        ports = np.einsum("smr,pcr->pcsm", self.combiners, arrival)[:, :, self.combiner_index]
        columns = [
            timed[:, :1, :, None] * ports,
            timed[:, 1:, :, None] * ports[:, :1],
            *((rate * timed[:, :1])[..., None] * ports[:, :1] for rate in rates),
        ]
        return np.concatenate(columns, axis=1).reshape(len(geometry), 1 + len(self.parameters), self.size)

    def vector(self, geometry: Geometry) -> Complex:
        """The vector alone (P, N * M)."""
        transmitter, precoders, receiver, combiners = self.transmitter, self.precoders, self.receiver, self.combiners
        timed = np.exp(2j * np.pi / self.wavelength * self.times * geometry.speed[:, None])
        if self.offsets is not None:
            timed *= np.exp(-2j * np.pi * self.offsets * geometry.delay[:, None])
        if transmitter is not None and precoders is not None:
            sent = transmitter.response(geometry.departure)[0].conj() @ precoders.T
            timed = timed * sent[:, self.precoder_index]
        if receiver is None or combiners is None:
            return timed
        ports = np.tensordot(receiver.response(geometry.arrival)[0], combiners, axes=(1, 2))
        return (timed[:, :, None] * ports[:, self.combiner_index]).reshape(len(geometry), self.size)


def _block(array: Manifold, directions: Float, scale: float) -> Complex:
    steering, derivative = array.response(directions, tangents(directions), scale)
    return np.concatenate([steering[:, None], derivative], axis=1)
