"""What an array can tell of a direction: the rank of its metric, and the directions that it confuses.

The normalized information about a direction, ``M = Re(D^H D - D^H a a^H D / |a|^2) / |a|^2`` with the derivatives D of
the response a along the two tangents, has rank 2 where both angles are seen, rank 1 for a line of equal elements, which
sees a cone about its own axis, and rank 0 for a single element. It is a matter of the response alone, whoever made it:
positions, patterns or measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .directions import Float, sphere, tangents

LEAST = 0.01
"""Information [1/rad^2] below which a direction is not seen: turning it by a radian changes the phases between elements by
less than a tenth of one."""
DIRECTIONS = 400


class Responding(Protocol):
    """Anything with an array's response."""

    def response(self, directions: Float, tangents: Float | None = None, scale: float = 1.0) -> tuple[Any, Any]:
        """Responses (P, M) and derivatives (P, 2, M)."""
        ...


@dataclass(frozen=True, eq=False)
class Sight:
    """What an array sees.

    Attributes
    ----------
    rank : number of angles that it tells, 0 to 2
    axis : (3,) unit vector about which it sees cones, in the parent frame; None unless the rank is 1
    """

    rank: int
    axis: Float | None

    @property
    def observable(self) -> tuple[bool, bool]:
        """Whether azimuth and elevation can be told: of a line along z elevation only, of any other azimuth only."""
        if self.axis is None:
            return self.rank == 2, self.rank == 2
        vertical = bool(np.hypot(self.axis[0], self.axis[1]) < 1e-3)
        return not vertical, vertical

    @property
    def side(self) -> Float:
        """(3,) horizontal unit vector across the axis, towards +x (then +y): where a line of elements faces."""
        if self.axis is None or np.hypot(self.axis[0], self.axis[1]) < 1e-3:
            return np.array([1.0, 0.0, 0.0])
        across = np.array([self.axis[1], -self.axis[0], 0.0]) / np.hypot(self.axis[0], self.axis[1])
        return across * (np.sign(across[0]) if abs(across[0]) > 1e-9 else np.sign(across[1]))


def sight_of(array: Responding) -> Sight:
    """What ``array`` sees, from its response in all directions in which it is not blind."""
    directions = sphere(DIRECTIONS)
    along = tangents(directions)
    metrics, strength = direction_metric(array, directions, along)
    seen = strength > 1e-3 * strength.max(initial=0.0)
    if not seen.any():
        return Sight(0, None)
    values, vectors = np.linalg.eigh(metrics[seen])
    typical = np.median(values, axis=0)
    rank = int(np.sum(typical > LEAST))
    if rank != 1:
        return Sight(rank, None)
    # What a line does not see is the turn about its axis, everywhere at right angles to it.
    blind = np.einsum("pb,pbi->pi", vectors[:, :, 0], along[seen])
    axis = np.linalg.eigh(blind.T @ blind)[1][:, 0]
    return Sight(1, axis)


def direction_metric(array: Responding, directions: Float, along: Float):
    """Normalized information (P, 2, 2) about directions and the energy (P,) of the responses."""
    value, slope = array.response(directions, along)
    strength = np.sum(np.abs(value) ** 2, axis=1)
    norm = np.maximum(strength, 1e-300)[:, None, None]
    cross = slope.conj() @ value[:, :, None]
    metric = np.real(slope.conj() @ slope.swapaxes(1, 2) - cross @ cross.conj().swapaxes(1, 2) / norm) / norm
    return metric, strength


ALIKE = 1e-3
"""Share of the energy that two responses may differ in and still be the same to a receiver."""
CONE = 0.02
"""The same for directions on a cone, which samples of the sphere only come near to."""


def mirrored(directions: Float, normal: Float) -> Float:
    """Unit vectors (P, 3) reflected at the plane across ``normal`` (3,)."""
    return directions - 2 * (directions @ normal)[:, None] * normal


def confused(array: Responding, directions: Float, others: Float, share: float = ALIKE):
    """(P,) whether the responses to two directions are the same but for a factor near one."""
    first, second = array.response(directions)[0], array.response(others)[0]
    own, other = (np.sum(np.abs(a) ** 2, axis=-1) for a in (first, second))
    product = np.abs(np.sum(first.conj() * second, axis=-1)) ** 2
    return (product >= (1 - share) * own * other) & (other > 0.1 * own) & (own > 0)


def cone_variance(array: Responding, directions: Float, candidates: Float):
    """(P,) mean squared azimuth [rad^2], about that of ``directions``, over those ``candidates`` (n, 3) that a line of
    elements takes for the same: what not knowing the elevation does to the azimuth.
    """
    first, second = array.response(directions)[0], array.response(candidates)[0]
    own, other = (np.sum(np.abs(a) ** 2, axis=1) for a in (first, second))
    product = np.abs(first.conj() @ second.T) ** 2 / np.maximum(own[:, None] * other, 1e-300)
    near = product >= 1 - CONE
    offset = np.arctan2(candidates[:, 1], candidates[:, 0]) - np.arctan2(directions[:, 1], directions[:, 0])[:, None]
    offset = (offset + np.pi) % (2 * np.pi) - np.pi
    return np.sum(near * offset**2, axis=1) / np.maximum(near.sum(axis=1), 1)
