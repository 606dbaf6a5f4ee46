"""What in a mode of beams and symbols goes wrong together.

An element that is off at one end turns what that end adds to the mode, the same in every sweep, and leaves the other end's
share as it is; a phase that wanders turns all ports of a symbol alike. So of a strong path's fiber along such a mode the error
lies in few dimensions: one for each beam, for each output of each combiner, for each of the two together, or for each symbol.
Each dimension is the sum of the samples that share it, weighted as the strong path has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.arrays import Complex
from ..signal.modes import ARRIVAL, DEPARTURE, SPEED, TimeMode


@dataclass(frozen=True, eq=False)
class Part:
    """Dimensions in which a mode may be wrong: the ``number`` (n,) of that of each sample, how many there are, and the
    ``parameters`` that such an error moves.
    """

    number: np.typing.NDArray[np.intp]
    size: int
    parameters: tuple[int, ...]

    def sums(self, samples: Complex, strong: Complex) -> Complex:
        """Samples (n,) in these dimensions (size,), at the noise of a sample, where a path of vector ``strong`` (n,) is
        wrong.
        """
        turned, weight = samples * strong.conj(), np.abs(strong) ** 2
        real, imag, norm = (
            np.bincount(self.number, part, self.size) for part in (np.real(turned), np.imag(turned), weight)
        )
        return (real + 1j * imag) / np.sqrt(np.maximum(norm, 1e-300))


def parts_of(mode: TimeMode, fewest: int) -> list[Part]:
    """The parts of a mode that have more than ``fewest`` dimensions, and fewer than there are samples."""
    symbols = len(mode.times)
    still = np.zeros(symbols, int)
    beam = np.repeat(still if mode.precoder_index is None else mode.precoder_index, mode.ports)
    setting = np.repeat(still if mode.combiner_index is None else mode.combiner_index, mode.ports)
    port, symbol = np.tile(np.arange(mode.ports), symbols), np.repeat(np.arange(symbols), mode.ports)
    output = setting * mode.ports + port
    found: dict[int, Part] = {}
    for together, moved in (
        (beam * (output.max() + 1) + output, ARRIVAL + DEPARTURE),
        (beam, DEPARTURE),
        (output, ARRIVAL),
        (symbol, SPEED),
    ):
        number = np.unique(together, return_inverse=True)[1]
        size = int(number.max()) + 1
        if fewest < size < len(number):
            found.setdefault(size, Part(number, size, tuple(p for p in moved if p in mode.parameters)))
    return list(found.values())
