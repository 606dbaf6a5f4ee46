"""What to trace with: settings of the ray tracer, and the scatter points of a scenario."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.errors import SceneError

MAX_CHUNK = 2000
LANES_PER_CALL = 8_000_000  # reflections × rays × receivers of one call; 30 bytes each in memory
JONES = {
    "V": (1.0, 0.0),
    "H": (0.0, 1.0),
    "+45": (np.sqrt(0.5), np.sqrt(0.5)),
    "-45": (np.sqrt(0.5), -np.sqrt(0.5)),
}


@dataclass(frozen=True)
class TraceSettings:
    """Settings of the ray tracer.

    Attributes
    ----------
    max_depth : largest number of reflections of a path
    samples : rays launched from the base station to find candidate walls; a wall is missed only if no ray
        hits it
    refraction : whether paths may pass through walls (outdoors rarely wanted: it multiplies the paths)
    seed : of the rays' sampling
    chunk : receivers per call of the tracer at most, up to 2000; many rays or reflections make it smaller
    deterministic : whether gains repeat to the last bit, whatever the chunks; without, they may differ by
        1e-6, and many rays or reflections take a fraction of the time and memory
    polarization : of the isotropic antennas (base station, receiver), each ``"V"``, ``"H"``, ``"+45"`` or
        ``"-45"``
    """

    max_depth: int = 1
    samples: int = 200_000
    refraction: bool = False
    seed: int = 1
    chunk: int = 500
    deterministic: bool = True
    polarization: tuple[str, str] = ("V", "V")

    @property
    def receivers_per_call(self) -> int:
        """Receivers per call of the tracer, so that memory stays bounded."""
        if not self.deterministic:
            return self.chunk
        return min(self.chunk, max(1, LANES_PER_CALL // (self.samples * max(self.max_depth, 1))))

    def __post_init__(self):
        if not 0 <= self.max_depth <= 8:
            raise SceneError(f"max_depth is {self.max_depth}; give a number of reflections from 0 to 8")
        if not 1 <= self.samples <= 10_000_000:
            raise SceneError(f"samples is {self.samples}; give a number of rays from 1 to 1e7")
        if not 1 <= self.chunk <= MAX_CHUNK:
            raise SceneError(f"chunk is {self.chunk}; give 1 to {MAX_CHUNK}: larger ones lose paths silently")
        for end in self.polarization:
            if end not in JONES:
                raise SceneError(f"polarization is {end!r}; known are {', '.join(JONES)}")


@dataclass(frozen=True)
class ScatterPoints:
    """Small objects as points with a constant bistatic radar cross-section.

    Their paths are base station, point, receiver, both legs unobstructed; no wall reflects them further.

    Attributes
    ----------
    names : (P,) str
    positions : (P, 3) m
    rcs : (P,) σ, m²
    phases : (P,) ψ, rad, of the reflection
    """

    names: tuple[str, ...] = ()
    positions: np.ndarray = None  # type: ignore[assignment]
    rcs: np.ndarray = None  # type: ignore[assignment]
    phases: np.ndarray = None  # type: ignore[assignment]

    def __post_init__(self):
        count = len(self.names)
        positions = np.zeros((0, 3)) if self.positions is None else np.asarray(self.positions, dtype=float)
        object.__setattr__(self, "names", tuple(map(str, self.names)))
        object.__setattr__(self, "positions", positions.reshape(-1, 3))
        object.__setattr__(self, "rcs", np.ones(count) if self.rcs is None else np.asarray(self.rcs, dtype=float))
        phases = np.zeros(count) if self.phases is None else np.asarray(self.phases, dtype=float)
        object.__setattr__(self, "phases", phases)
        if not len(self.positions) == len(self.rcs) == len(self.phases) == count:
            raise SceneError(f"scatter points: {count} names do not match the positions, cross-sections or phases")
        if len(set(self.names)) < count:
            raise SceneError("scatter points: two have the same name; give each its own")
        if np.any(self.rcs < 0) or not np.all(np.isfinite(self.rcs)):
            raise SceneError(f"scatter points: rcs is {self.rcs.min():g} m²; give non-negative finite numbers")
