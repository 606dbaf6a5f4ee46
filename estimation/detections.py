"""Detections: what an estimator hands on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from .errors import EstimationError
from .estimators.detect import detection_probability
from .signal.directions import Float, unit_vectors
from .signal.directions import tangents as tangents_of
from .signal.paths import PARAMETERS, PathTable


class Flag(IntFlag):
    """What to mind about a detection (a bit field)."""

    NONE = 0
    CLOSE_PAIR = 1
    """Its signature overlaps another path's (coherence above 0.3): errors of the two are correlated."""
    EDGE_OF_VIEW = 2
    """At or beyond the border of the searched delays, speeds or views."""
    WEAK = 4
    """Within 1.5 dB of the detection threshold."""
    SINGULAR = 8
    """Information nearly singular (for instance azimuth at a pole); rely on ``direction_covariance``."""
    AMBIGUOUS = 16
    """An array takes another direction in its view for the same. A line of elements sees only a cone about its axis:
    elevation is reported as 0 with infinite variance, azimuth on the side that the line faces (+x, or +y of a line along
    x) with the variance of the azimuths on the cone. The mirror image behind a planar array is not in the covariance."""
    MERGED = 32
    """The residual about the path is not noise: two paths in one, or a model that does not fit. The covariance has grown
    by what that can have moved it."""
    LIMITED = 64
    """The search of this burst ended at ``max_paths`` or ``max_seconds``; there may be more."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Paths estimated from one burst, strongest first.

    Attributes
    ----------
    delay : (P,) [s], within the unambiguous range of the pilots (``model.max_delay``): a longer one comes back in at its
        beginning, and nothing in the burst can tell
    aoa, aod : (P, 2) azimuth and elevation [rad], in the receiver's and transmitter's frame
    radial_velocity : (P,) [m/s], positive when approaching
    gain : (P,) complex amplitude at the carrier and burst center
    covariance : (P, 6, 6) of (delay, AOA az, el, AOD az, el, radial velocity), gains and all other paths as
        nuisance
    tangent_covariance : (P, 6, 6) the same with azimuth errors times cos(el), regular at the poles
    snr : (P,) post-integration SNR rho, linear
    noise_variance : per whitened sample, estimated or given
    threshold : on rho
    false_alarm_rate : expected false paths per snapshot
    flags : (P,) bits of :class:`Flag`
    active : (6,) parameters that the link observes; the covariance of the others is infinite
    misfit : energy, relative to that of the strongest paths, of what the model gets wrong about them along any one mode; 0
        if that is no more than noise
    """

    delay: Float
    aoa: Float
    aod: Float
    radial_velocity: Float
    gain: np.typing.NDArray[np.complex128]
    covariance: Float
    tangent_covariance: Float
    snr: Float
    noise_variance: float
    threshold: float
    false_alarm_rate: float
    flags: np.typing.NDArray[np.uint8]
    active: np.typing.NDArray[np.bool_]
    misfit: float = 0.0

    @staticmethod
    def of(
        paths: PathTable,
        covariance: Float,
        *,
        snr: Float | float = 1.0,
        noise_variance: float = 1.0,
        threshold: float = 1.0,
        false_alarm_rate: float = 0.01,
        flags=None,
        active=None,
    ) -> Detections:
        """Detections from a path table and covariances (P, 6, 6): what an estimator of one's own returns.

        Raises
        ------
        EstimationError
            if the covariances do not fit the paths.
        """
        count = len(paths)
        covariance = np.asarray(covariance, float)
        if covariance.shape != (count, 6, 6):
            raise EstimationError(
                f"Detections: covariance must be of shape ({count}, 6, 6) over {', '.join(PARAMETERS)}, "
                f"got {covariance.shape}"
            )
        scale = np.ones((count, 6))
        scale[:, 1], scale[:, 3] = np.cos(paths.aoa[:, 1]), np.cos(paths.aod[:, 1])
        return Detections(
            paths.delay,
            paths.aoa,
            paths.aod,
            paths.radial_velocity,
            paths.gain,
            covariance,
            covariance * scale[:, :, None] * scale[:, None],
            np.broadcast_to(np.asarray(snr, float), (count,)).copy(),
            float(noise_variance),
            float(threshold),
            float(false_alarm_rate),
            np.zeros(count, np.uint8) if flags is None else np.asarray(flags, np.uint8),
            np.ones(6, bool) if active is None else np.asarray(active, bool),
        )

    def __len__(self) -> int:
        return len(self.delay)

    @property
    def vector(self) -> Float:
        """(P, 6) parameters in the common order."""
        return np.column_stack([self.delay, self.aoa, self.aod, self.radial_velocity])

    @property
    def table(self) -> PathTable:
        """As a path table, for synthesis or as a warm start."""
        return PathTable(self.delay, self.aoa, self.aod, self.radial_velocity, self.gain)

    def p_d(self, snr) -> Float:
        """Model probability of detecting a path of true post-integration SNR ``snr`` (linear)."""
        return detection_probability(snr, self.threshold, int(self.active.sum()))

    def direction_covariance(self, end: str) -> Float:
        """(P, 3, 3) covariance of the unit vector at ``end`` = "aoa" or "aod"; regular where azimuth is not."""
        if end not in ("aoa", "aod"):
            raise EstimationError(f'direction_covariance: end must be "aoa" or "aod", got {end!r}')
        part = slice(1, 3) if end == "aoa" else slice(3, 5)
        basis = tangents_of(unit_vectors(getattr(self, end)))
        return np.einsum("pai,pab,pbj->pij", basis, self.tangent_covariance[:, part, part], basis)

    def take(self, index) -> Detections:
        """A selection of the paths (index array, mask or slice)."""
        columns = (
            "delay",
            "aoa",
            "aod",
            "radial_velocity",
            "gain",
            "covariance",
            "tangent_covariance",
            "snr",
            "flags",
        )
        rest = ("noise_variance", "threshold", "false_alarm_rate", "active", "misfit")
        return Detections(**{c: getattr(self, c)[index] for c in columns}, **{r: getattr(self, r) for r in rest})
