"""The signal model of eq. (2) of paper A as a product of modes: one code path for every architecture.

``Y[k, n, ...] = sum_i g_i W_n^H a_R(aoa_i) a_T^H(aod_i) p_n exp(-j 2 pi f_k tau_i) exp(+j 2 pi t_n d_i /
lambda) + W_n^H n``

Inside, the data are whitened (``W_n^H W_n = L L^H``, ``y <- L^-1 y``), so that all estimators see white
noise. With ``subbands > 1`` array and Doppler phases are scaled by ``1 + f/f_c`` per sub-band of pilots,
which models beam squint and range migration; 1 is eq. (2) as printed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..errors import ModelError, SignalError
from .arrays import Complex, Manifold, Through
from .directions import Float
from .modes import DelayMode, Mode, ReceiveMode, TimeMode, TransmitMode
from .paths import Geometry
from .schedule import Schedule
from .waveform import Waveform


@dataclass(frozen=True)
class Band:
    """A contiguous block of pilots with its own frequency scale (the only band of a narrowband model is the
    whole).
    """

    pilots: slice
    scale: float
    modes: tuple[Mode, ...]


@dataclass(frozen=True, eq=False)
class SignalModel:
    """Waveform, schedule and arrays of one link.

    Parameters
    ----------
    waveform, schedule : pilots over frequency and time
    transmitter, receiver : arrays; AOD and AOA are measured in their parent frames
    subbands : number of sub-bands with their own steering (1: eq. (2) as printed)
    pilot_covariance : (K, K) noise covariance over the pilots in units of the noise variance, equal for all
        symbols and ports (dense
        multipath); None for white noise
    port_covariance : noise covariance (M, M) of the receive ports, or one behind each combiner (S, M, M), in units of the
        noise variance; None for elements of equal and independent noise: the identity, and ``W_n^H W_n`` behind combiners
    """

    waveform: Waveform
    schedule: Schedule
    transmitter: Manifold
    receiver: Manifold
    subbands: int = 1
    pilot_covariance: Complex | None = None
    port_covariance: Complex | None = None

    def __post_init__(self) -> None:
        schedule = self.schedule
        for book, array, axis, name in (
            (schedule.precoders, self.transmitter, 1, "precoders of the transmitter"),
            (schedule.combiners, self.receiver, 1, "combiners of the receiver"),
        ):
            if book is not None and book.shape[axis] != array.elements:
                raise ModelError(
                    f"SignalModel: the {name} address {book.shape[axis]} elements, the array has {array.elements}"
                )
        if not 1 <= self.subbands <= self.waveform.subcarriers:
            raise ModelError(
                f"SignalModel: subbands must lie between 1 and {self.waveform.subcarriers} "
                f"subcarriers, got {self.subbands}"
            )
        if self.pilot_covariance is not None:
            size = self.waveform.subcarriers
            if self.pilot_covariance.shape != (size, size) or self.subbands > 1:
                raise ModelError(f"SignalModel: pilot_covariance must be ({size}, {size}) and needs subbands=1")
            self.pilot_factor  # noqa: B018  a singular covariance must fail here
        if self.port_covariance is not None:
            ports, settings = self.shape[2], 1 if schedule.combiners is None else len(schedule.combiners)
            given = np.shape(self.port_covariance)
            if given not in ((ports, ports), (settings, ports, ports)):
                raise ModelError(
                    f"SignalModel: port_covariance must be ({ports}, {ports}) or ({settings}, {ports}, {ports}), "
                    f"got {given}"
                )
        self._whitener  # noqa: B018  a singular combiner or covariance must fail here, not in a search

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of a received signal: (K, N, receive ports[, N_T with a digital transmitter])."""
        combiners = self.schedule.combiners
        ports = self.receiver.elements if combiners is None else combiners.shape[2]
        transmit = (self.transmitter.elements,) if self.schedule.precoders is None else ()
        return (self.waveform.subcarriers, self.schedule.symbols, ports, *transmit)

    @cached_property
    def active(self) -> np.typing.NDArray[np.bool_]:
        """(6,) which parameters this link can observe at all."""
        several = self.waveform.subcarriers > 1, bool(np.ptp(self.schedule.times) > 0)
        return np.array([several[0], *self.receiver.observable, *self.transmitter.observable, several[1]])

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """The sub-bands with their modes."""
        edges = np.linspace(0, self.waveform.subcarriers, self.subbands + 1).round().astype(int)
        blocks = [slice(a, b) for a, b in pairwise(edges)]
        frequencies = self.waveform.frequencies
        rest = self._other_modes()
        scales = [1.0] if self.subbands == 1 else [1 + frequencies[b].mean() / self.waveform.carrier for b in blocks]
        return tuple(Band(b, float(s), (DelayMode(frequencies[b]), *rest)) for b, s in zip(blocks, scales, strict=True))

    @cached_property
    def max_delay(self) -> float:
        """Unambiguous delay range [s] of all symbols' pilots together."""
        return self.waveform.reach(self.schedule.offsets)

    @cached_property
    def columns(self) -> np.typing.NDArray[np.intp]:
        """(modes, 7 or 8) derivative column of each mode for (value, six parameters); 0 where a mode does not
        depend on it. Where two modes depend on the delay, the second's part of the product rule is the eighth.
        """
        modes = self.bands[0].modes
        columns = np.zeros((len(modes), 7 if self.schedule.offsets is None else 8), int)
        for row, mode in enumerate(modes):
            for column, parameter in enumerate(mode.parameters):
                columns[row, 7 if row and parameter == 0 else 1 + parameter] = 1 + column
        return columns

    def merged(self, terms: Complex, axis: int = -1) -> Complex:
        """Inner products with an axis of the length of ``columns`` as those with signature and derivatives (7)."""
        if terms.shape[axis] == 7:
            return terms
        value, delay, *rest, other = np.split(terms, terms.shape[axis], axis=axis)
        return np.concatenate([value, delay + other, *rest], axis=axis)

    def _other_modes(self) -> tuple[Mode, ...]:
        schedule = self.schedule
        swept = (
            {}
            if schedule.precoders is None
            else {
                "transmitter": self.transmitter,
                "precoders": schedule.precoders,
                "precoder_index": schedule.precoder_index,
            }
        )
        combined = (
            {}
            if schedule.combiners is None
            else {
                "receiver": self.receiver,
                "combiners": self._whitener @ schedule.combiners.conj().swapaxes(1, 2),
                "combiner_index": schedule.combiner_index,
            }
        )
        time = TimeMode(schedule.times, self.waveform.wavelength, **swept, **combined, offsets=schedule.offsets)
        receive = () if combined else (ReceiveMode(self.heard),)
        transmit = () if swept else (TransmitMode(self.transmitter),)
        return (time, *receive, *transmit)

    @cached_property
    def heard(self) -> Manifold:
        """The receiver as its whitened noise has it; combiners whiten behind it."""
        if self.schedule.combiners is not None or self._whitener is None:
            return self.receiver
        return Through(self.receiver, self._whitener[0])

    @cached_property
    def port_noise(self) -> Complex | None:
        """(S, M, M) noise covariance of the ports for each combiner (S = 1 without), or None if it is the identity."""
        combiners = self.schedule.combiners
        if self.port_covariance is None:
            return None if combiners is None else combiners.conj().swapaxes(1, 2) @ combiners
        given = np.asarray(self.port_covariance, complex)
        settings = 1 if combiners is None else len(combiners)
        return np.broadcast_to(given, (settings, *given.shape[-2:]))

    @cached_property
    def _whitener(self) -> Complex | None:
        """(S, M, M) inverse Cholesky factors of the ports' noise covariance, or None where it is the identity."""
        if self.port_noise is None:
            return None
        if np.any(np.linalg.cond(self.port_noise) > 1e10):
            raise ModelError(
                "SignalModel: a combining matrix W_n has linearly dependent columns; its noise cannot be whitened"
                if self.port_covariance is None
                else "SignalModel: port_covariance is singular; its noise cannot be whitened"
            )
        try:
            return np.linalg.inv(np.linalg.cholesky(self.port_noise))
        except np.linalg.LinAlgError:
            raise ModelError("SignalModel: port_covariance is not positive definite") from None

    @cached_property
    def pilot_factor(self) -> Complex:
        """Cholesky factor (K, K) of the pilot covariance."""
        try:
            return np.linalg.cholesky(np.asarray(self.pilot_covariance, complex))
        except np.linalg.LinAlgError:
            raise ModelError("SignalModel: pilot_covariance is not positive definite") from None

    @cached_property
    def weight(self) -> Complex | None:
        """(K, K) inverse of the pilot covariance, or None for white noise."""
        if self.pilot_covariance is None:
            return None
        inverse = np.linalg.inv(self.pilot_factor)
        return inverse.conj().T @ inverse

    def weighted(self, signal: Complex) -> Complex:
        """A signal times the inverse pilot covariance: what signatures are correlated with."""
        if self.weight is None:
            return signal
        return (self.weight.astype(signal.dtype) @ signal.reshape(len(signal), -1)).reshape(signal.shape)

    @cached_property
    def white(self) -> bool:
        """Whether the received noise is white as it is."""
        return self._whitener is None or np.allclose(self._whitener, np.eye(self.shape[2]))

    def whiten(self, signal: Complex) -> Complex:
        """The signal with white noise (a copy only where needed)."""
        if self.white or self._whitener is None:
            return signal
        return self._at_ports(self._whitener, signal)

    def color(self, noise: Complex) -> Complex:
        """White noise of the model's shape given the covariance of the ports; a whitened signal likewise
        returns to its ports.
        """
        if self.white or self._whitener is None:
            return noise
        return self._at_ports(np.linalg.inv(self._whitener), noise)

    def _at_ports(self, matrices: Complex, signal: Complex) -> Complex:
        matrices = matrices.astype(signal.dtype)
        if self.schedule.combiners is None:
            return np.moveaxis(np.tensordot(matrices[0], signal, axes=(1, 2)), 0, 2)
        return np.einsum("nij,knj...->kni...", matrices[self.schedule.combiner_index], signal)

    def checked(self, signal) -> np.typing.NDArray[np.complex64]:
        """The signal as a contiguous complex64 array; errors as in :meth:`measured`."""
        return self.measured(signal)[0]

    def measured(self, signal) -> tuple[np.typing.NDArray[np.complex64], float]:
        """The signal as a contiguous complex64 array, and its energy.

        Raises
        ------
        SignalError
            if its shape is not ``shape``, it is not numeric, or it holds NaN or infinity.
        """
        try:
            signal = np.ascontiguousarray(signal, dtype=np.complex64)
        except (TypeError, ValueError) as error:
            raise SignalError(f"signal: not convertible to complex numbers ({error})") from None
        if signal.shape != self.shape:
            raise SignalError(
                f"signal: shape {signal.shape} does not match the model's {self.shape} "
                "(subcarriers, symbols, receive ports[, transmit elements])"
            )
        energy = float(np.vdot(signal, signal).real)
        if not np.isfinite(energy):
            raise SignalError(
                "signal: it contains NaN or infinite samples, or overflows single precision; clean or rescale it"
            )
        return signal, energy

    def evaluate(self, geometry: Geometry) -> list[list[Complex]]:
        """Mode blocks per band: a list of bands, each a list over modes of (P, 1 + c, n)."""
        common: dict[float, list[Complex]] = {}
        blocks = []
        for band in self.bands:
            if band.scale not in common:
                common[band.scale] = [mode.evaluate(geometry, band.scale) for mode in band.modes[1:]]
            blocks.append([band.modes[0].evaluate(geometry), *common[band.scale]])
        return blocks

    def steps(self) -> Float:
        """(6,) natural scales of the parameters: the reciprocal bandwidth [s], 1 rad over the apertures,
        wavelength over duration [m/s].
        """
        duration = np.ptp(self.schedule.times) or 1.0
        angle = [
            1.0 / max(2 * np.ptp(getattr(a, "positions", np.zeros((1, 3))), axis=0).max(), 1.0)
            for a in (self.receiver, self.transmitter)
        ]
        delay = 1.0 / (self.waveform.bandwidth or 1.0)
        return np.array([delay, angle[0], angle[0], angle[1], angle[1], self.waveform.wavelength / duration])


def flat(signal: Complex, band: Band) -> Complex:
    """A band's part of a (whitened) signal with one axis per mode."""
    return signal[band.pilots].reshape([mode.size for mode in band.modes])
