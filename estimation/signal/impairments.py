"""What real hardware does to the signal of eq. (2), each as a switch: so that an estimator meets a model that is not quite
its own.

Errors of elements and phase noise come from a generator of their own, so that the noise of a burst is the same with and
without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import ModelError
from .arrays import Array, Complex, Manifold, Pattern
from .directions import Float
from .model import SignalModel
from .paths import PathTable
from .synthesis import synthesize


@dataclass(frozen=True)
class Impairments:
    """Root mean squares of errors that are drawn, and sizes of those that are not; 0 switches each off.

    Parameters
    ----------
    position : of the elements at either end, along each axis [wavelengths]
    gain_db, phase_deg : of the elements at either end [dB], [degrees]
    phase_noise_deg : of a common phase, new in every symbol [degrees]
    phase_walk_deg : of the steps of a common phase from symbol to symbol [degrees]
    frequency_offset : carrier frequency offset [Hz]; it adds lambda times itself to every radial velocity
    iq_gain_db, iq_phase_deg : imbalance of the receiver's two branches
    bits : of the converters of real and imaginary part, full scale at four root mean squares; 0: none
    """

    position: float = 0.0
    gain_db: float = 0.0
    phase_deg: float = 0.0
    phase_noise_deg: float = 0.0
    phase_walk_deg: float = 0.0
    frequency_offset: float = 0.0
    iq_gain_db: float = 0.0
    iq_phase_deg: float = 0.0
    bits: int = 0

    def hardware(self, model: SignalModel, rng: np.random.Generator) -> SignalModel:
        """The link as it is built: positions, gains and phases of the elements off by a draw."""
        if not (self.position or self.gain_db or self.phase_deg):
            return model
        return replace(
            model, receiver=self._array(model.receiver, rng), transmitter=self._array(model.transmitter, rng)
        )

    def _array(self, array: Manifold, rng: np.random.Generator) -> Array:
        if not isinstance(array, Array):
            raise ModelError(
                f"Impairments: errors of the elements need an Array of known positions, got {type(array).__name__}"
            )
        count = array.elements
        decibel, degrees = self.gain_db * rng.standard_normal(count), self.phase_deg * rng.standard_normal(count)
        weights = 10 ** (decibel / 20) * np.exp(1j * np.deg2rad(degrees))
        positions = array.positions + self.position * rng.standard_normal((count, 3))
        return Array(positions, WeightedPattern(weights, array.pattern), array.orientation)

    def signal(
        self,
        model: SignalModel,
        paths: PathTable,
        noise_variance: float,
        rng: np.random.Generator,
        seed: int | np.random.SeedSequence = 0,
        phases: np.random.Generator | None = None,
    ) -> np.typing.NDArray[np.complex64]:
        """One received burst of an impaired link; ``seed`` draws its errors, ``rng`` its noise.

        With combiners the common phase and the converters act on their outputs. ``phases`` draws what is new in every burst
        where several have the same hardware; default: ``seed`` too.
        """
        elements, own = (np.random.default_rng(s) for s in np.random.SeedSequence(_entropy(seed)).spawn(2))
        phases = own if phases is None else phases
        built = self.hardware(model, elements)
        noise_free = synthesize(built, paths)
        times = model.schedule.times
        phase = self.phase_noise_deg * phases.standard_normal(len(times))
        phase += np.cumsum(self.phase_walk_deg * phases.standard_normal(len(times)))
        turn = np.exp(1j * (np.deg2rad(phase) + 2 * np.pi * self.frequency_offset * times))
        shape = (1, -1, *(1,) * (noise_free.ndim - 2))
        received = noise_free * turn.reshape(shape)
        if noise_variance:
            received = received + synthesize(model, paths.take([]), noise_variance, rng)
        return self.converted(received).astype(np.complex64)

    def converted(self, signal: Complex) -> Complex:
        """A signal behind the receiver's mixer and converters."""
        if self.iq_gain_db or self.iq_phase_deg:
            wrong = 10 ** (self.iq_gain_db / 20) * np.exp(1j * np.deg2rad(self.iq_phase_deg))
            signal = 0.5 * (1 + wrong) * signal + 0.5 * (1 - wrong.conj()) * signal.conj()
        if self.bits:
            full = 4 * np.sqrt(np.mean(np.abs(signal) ** 2) / 2)
            step = 2 * full / 2**self.bits
            parts = [
                np.clip(step * (np.floor(part / step) + 0.5), -full, full)
                for part in (np.real(signal), np.imag(signal))
            ]
            signal = parts[0] + 1j * parts[1]
        return signal


def _entropy(seed: int | np.random.SeedSequence):
    return seed.generate_state(4) if isinstance(seed, np.random.SeedSequence) else seed


@dataclass(frozen=True, eq=False)
class WeightedPattern:
    """A pattern whose elements have complex ``weights`` (M,) of their own: a calibration, or the lack of one."""

    weights: Complex
    pattern: Pattern | None = None

    def gain(self, directions: Float) -> Complex:
        """Gains (P, M)."""
        own = np.ones((len(directions), 1)) if self.pattern is None else self.pattern.gain(directions)
        return own * self.weights

    def gradient(self, directions: Float) -> Complex:
        """Gradients (P, M, 3)."""
        if self.pattern is None:
            return np.zeros((len(directions), len(self.weights), 3), complex)
        return self.pattern.gradient(directions) * self.weights[:, None]
