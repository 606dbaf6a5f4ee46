"""One law per kind of landmark: how long its path is, where it arrives from, where it departs to, and what is its inverse.

Every path is described by three vectors in the world frame: the receiver p, the base station a (*anchor*) and the landmark
x. It arrives at the receiver from x - p and leaves the base station along its *departure*; neither is a unit vector.
:data:`PATHS` is the only place that knows kinds apart: measurement, simulation, bounds and births read it, and the compiled
laws of :mod:`dopslam.models.kernels` are held equal to it by tests. Everything broadcasts.

A reflecting surface is stored as the base station mirrored at it, x = H a + …, with H = I - 2 n nᵀ and n the unit vector of
x - a. The path is the straight line from x to p; its departure is that line folded back at the surface, H(p - x), which is as
long as the path itself. It exists if base station and receiver are on the same side of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dopslam.records import Kind

Array = NDArray[np.float64]

_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Path:
    """Paths over landmarks.

    Attributes
    ----------
    length : (...) m
    departure : (..., 3), along the direction of departure; zero where nothing explains it
    exists : (...) bool
    """

    length: Array
    departure: Array
    exists: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Slopes:
    """Derivatives of length (..., 3) and departure (..., 3, 3) by the receiver p and the landmark x."""

    length_by_p: Array
    length_by_x: Array
    departure_by_p: Array
    departure_by_x: Array


class PathModel(Protocol):
    """The contract of a kind of landmark.

    Attributes
    ----------
    order : reflections of its path
    explains_departure : whether the landmark says where the path leaves the base station
    known : whether the landmark is the base station itself, whatever x is given
    """

    @property
    def order(self) -> int: ...
    @property
    def explains_departure(self) -> bool: ...
    @property
    def known(self) -> bool: ...

    def path(self, p: Array, anchor: Array, x: Array) -> Path:
        """Length, departure and existence; all arguments (..., 3) [m]."""
        ...

    def slopes(self, p: Array, anchor: Array, x: Array) -> Slopes:
        """Their derivatives."""
        ...

    def place(self, p: Array, anchor: Array, length: Array, arrival: Array, departure: Array) -> Array:
        """The landmark (..., 3) of a path of some length [m] with unit vectors of arrival and departure."""
        ...

    def loss(self, p: Array, anchor: Array, x: Array) -> Array:
        """Geometric spreading loss of its power, up to a constant."""
        ...


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def _outer(a: Array, b: Array) -> Array:
    return a[..., :, None] * b[..., None, :]


def _unit(vector: Array) -> Array:
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(norm > 0, norm, 1.0)


def _squares(vector: Array) -> Array:
    return np.sum(vector**2, axis=-1)


def mirror(points: ArrayLike, normal: ArrayLike, offset: ArrayLike = 0.0) -> Array:
    """Reflect points (..., 3) at planes with unit `normal` (..., 3) and `offset` (...) [m]: x + 2(d - nᵀx)n."""
    points, normal = np.asarray(points, dtype=float), np.asarray(normal, dtype=float)
    distance = np.asarray(offset, dtype=float) - np.sum(points * normal, axis=-1)
    return points + 2.0 * distance[..., None] * normal


class _Straight:
    """What all paths have in common whose length is the distance to the landmark."""

    order, explains_departure, known = 0, True, False

    def loss(self, p: Array, anchor: Array, x: Array) -> Array:
        return _squares(x - p)

    def place(self, p: Array, anchor: Array, length: Array, arrival: Array, departure: Array) -> Array:
        return p + length[..., None] * arrival


class LineOfSight(_Straight):
    """The base station itself."""

    known = True

    def path(self, p: Array, anchor: Array, x: Array) -> Path:
        departure = p - anchor
        return Path(np.linalg.norm(departure, axis=-1), departure, np.full(departure.shape[:-1], True))

    def slopes(self, p: Array, anchor: Array, x: Array) -> Slopes:
        nothing = np.zeros(np.broadcast_shapes(np.shape(p), np.shape(anchor)))
        eye = nothing[..., None] + np.eye(3)
        return Slopes(nothing + _unit(p - anchor), nothing, eye, 0.0 * eye)

    def place(self, p: Array, anchor: Array, length: Array, arrival: Array, departure: Array) -> Array:
        return np.broadcast_to(anchor, np.shape(arrival))


class Reflection(_Straight):
    """A surface that reflects once, as the virtual anchor x."""

    order = 1

    def path(self, p: Array, anchor: Array, x: Array) -> Path:
        a, w = anchor - x, p - x
        return Path(np.linalg.norm(w, axis=-1), mirror(w, _unit(a)), _dot(a, w) > 0.5 * _squares(a))

    def slopes(self, p: Array, anchor: Array, x: Array) -> Slopes:
        a, w = anchor - x, p - x
        square, along = np.maximum(_squares(a), _TINY)[..., None, None], _dot(a, w)[..., None, None]
        mirror = np.eye(3) - 2 * _outer(a, a) / square
        turn = (
            2 * (_outer(a, w) + along * np.eye(3)) / square - 4 * along * _outer(a, a) / square**2
        )  # by -a, n turning
        return Slopes(_unit(w), -_unit(w), mirror, turn - mirror)


class Scatterer(_Straight):
    """A point that scatters."""

    order = 1

    def path(self, p: Array, anchor: Array, x: Array) -> Path:
        departure = np.broadcast_to(x - anchor, np.broadcast_shapes(np.shape(p), np.shape(x), np.shape(anchor)))
        length = np.linalg.norm(x - p, axis=-1) + np.linalg.norm(departure, axis=-1)
        return Path(length, departure, np.full(length.shape, True))

    def slopes(self, p: Array, anchor: Array, x: Array) -> Slopes:
        arriving = _unit(x - p)
        eye = np.zeros_like(arriving)[..., None] + np.eye(3)
        return Slopes(-arriving, arriving + _unit(x - anchor), 0.0 * eye, eye)

    def place(self, p: Array, anchor: Array, length: Array, arrival: Array, departure: Array) -> Array:
        """On the ray of arrival and on that of departure, each where the length fits: in the middle; on the former alone
        where the departure was not measured, that is zero."""
        w = anchor - p
        half = 0.5 * (length**2 - _squares(w))
        first = p + (half / np.maximum(length - _dot(w, arrival), 1e-9))[..., None] * arrival
        second = anchor + (half / np.maximum(length + _dot(w, departure), 1e-9))[..., None] * departure
        return np.where(np.any(departure != 0, axis=-1)[..., None], 0.5 * (first + second), first)

    def loss(self, p: Array, anchor: Array, x: Array) -> Array:
        return _squares(x - p) * _squares(x - anchor)


class SecondReflection(_Straight):
    """Two surfaces, as the base station mirrored at both: only the last is told, so that nothing explains the departure."""

    order, explains_departure = 2, False

    def path(self, p: Array, anchor: Array, x: Array) -> Path:
        w = np.broadcast_to(p - x, np.broadcast_shapes(np.shape(p), np.shape(x), np.shape(anchor)))
        return Path(np.linalg.norm(w, axis=-1), np.zeros_like(w), np.full(w.shape[:-1], True))

    def slopes(self, p: Array, anchor: Array, x: Array) -> Slopes:
        away = np.broadcast_to(_unit(p - x), np.broadcast_shapes(np.shape(p), np.shape(x), np.shape(anchor)))
        nothing = np.zeros((*away.shape, 3))
        return Slopes(away, -away, nothing, nothing)


PATHS: dict[Kind, PathModel] = {
    Kind.BS: LineOfSight(),
    Kind.VA: Reflection(),
    Kind.SP: Scatterer(),
    Kind.SR: SecondReflection(),
}
"""The kinds of landmarks. One of one's own is a number in :class:`~dopslam.records.Kind` and a class here; what is compiled
needs its twin in :mod:`dopslam.models.kernels`."""


def _each(kind: ArrayLike, shape: tuple[int, ...]):
    """Every kind that occurs among landmarks (...), its law, and where it holds."""
    kinds = np.broadcast_to(np.asarray(kind), shape)
    for number in np.unique(kinds):
        yield PATHS[Kind(int(number))], kinds == number


def _vectors(p: ArrayLike, anchor: ArrayLike, x: ArrayLike, kind: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    vectors = [np.asarray(part, dtype=float) for part in (p, anchor, x)]
    shape = np.broadcast_shapes(*(v.shape[:-1] for v in vectors), np.shape(kind))
    return shape, [np.broadcast_to(v, (*shape, 3)) for v in vectors]


def known(kind: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which landmarks are the base station itself."""
    result = np.zeros(shape, dtype=bool)
    for law, where in _each(kind, shape):
        result |= where & law.known
    return result


def explains_departure(kind: ArrayLike) -> NDArray[np.bool_]:
    """Which landmarks (...) say where their path leaves the base station."""
    result = np.zeros(np.shape(kind), dtype=bool)
    for law, where in _each(kind, np.shape(kind)):
        result |= where & law.explains_departure
    return result


def landmarks_of(anchor: ArrayLike, x: ArrayLike, kind: ArrayLike) -> Array:
    """Landmarks (..., 3), those that are the base station itself at its place."""
    shape, (place, x_, _) = _vectors(anchor, x, x, kind)
    return np.where(known(kind, shape)[..., None], place, x_)


def paths(p: ArrayLike, anchor: ArrayLike, x: ArrayLike, kind: ArrayLike) -> Path:
    """Paths over landmarks x (..., 3) of kinds (...)."""
    shape, vectors = _vectors(p, anchor, x, kind)
    length, departure, exists = np.empty(shape), np.empty((*shape, 3)), np.empty(shape, dtype=bool)
    for law, where in _each(kind, shape):
        found = law.path(*(v[where] for v in vectors))
        length[where], departure[where], exists[where] = found.length, found.departure, found.exists
    return Path(length, departure, exists)


def slopes(p: ArrayLike, anchor: ArrayLike, x: ArrayLike, kind: ArrayLike) -> Slopes:
    """Derivatives of :func:`paths`."""
    shape, vectors = _vectors(p, anchor, x, kind)
    parts = [np.empty((*shape, 3)), np.empty((*shape, 3)), np.empty((*shape, 3, 3)), np.empty((*shape, 3, 3))]
    for law, where in _each(kind, shape):
        found = law.slopes(*(v[where] for v in vectors))
        for part, value in zip(
            parts, (found.length_by_p, found.length_by_x, found.departure_by_p, found.departure_by_x), strict=True
        ):
            part[where] = value
    return Slopes(*parts)


def place(
    p: ArrayLike, anchor: ArrayLike, length: ArrayLike, arrival: Array, departure: Array, kind: ArrayLike
) -> Array:
    """Landmarks (..., 3) of kinds (...) that paths stand for; a path must be longer than the direct one."""
    shape, (p_, anchor_, arrival_) = _vectors(p, anchor, arrival, kind)
    length, departure = np.broadcast_to(length, shape), np.broadcast_to(departure, (*shape, 3))
    found = np.empty((*shape, 3))
    for law, where in _each(kind, shape):
        found[where] = law.place(p_[where], anchor_[where], length[where], arrival_[where], departure[where])
    return found


def spreading_loss(kind: ArrayLike, landmark: ArrayLike, ue: ArrayLike, bs: ArrayLike) -> Array:
    """Geometric loss: squared distance to the anchor, or for a scatter point the product of both squared distances [m²,
    m⁴]."""
    shape, (p, anchor, x) = _vectors(ue, bs, landmark, kind)
    loss = np.empty(shape)
    for law, where in _each(kind, shape):
        loss[where] = law.loss(p[where], anchor[where], x[where])
    return loss


def incidence(ue: ArrayLike, va: ArrayLike, bs: ArrayLike) -> tuple[Array, Array]:
    """Where the path of a virtual anchor meets its surface.

    Returns
    -------
    point : (..., 3) incidence point x_VA + t·(x_U - x_VA)
    t : (...,) fraction of the way from the VA to the UE; the path exists for 0 < t < 1
    """
    ue, va, bs = (np.asarray(part, dtype=float) for part in (ue, va, bs))
    a, w = bs - va, ue - va
    along = _dot(a, w)
    t = 0.5 * _squares(a) / np.where(np.abs(along) < _TINY, _TINY, along)
    return va + t[..., None] * w, t
