"""Traces a scene: from positions to landmarks and propagation paths.

Sionna RT finds which paths exist, over which faces, and their complex gains; its single precision is not good
enough for the rest (τc to 5e-5 m, carrier phase to 0.04 rad). Delay, angles, Doppler and interaction points
are therefore computed again in float64 by the image method from the planes that a path touched, and checked
against Sionna's.

Scatter points are a sensing target of Sionna's radar solver: one speck below the scene that carries all
points with unit cross-section, scaled here by √σ e^{jψ}. The receivers are traced in chunks of at most 2000:
with more in one call, hash collisions drop paths silently, as they do with the default size of the hash
table. The deterministic solver is used, whose results repeat bit for bit and do not depend on the chunks; it
is the one that needs memory for every ray and receiver.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dopslam.errors import SceneError
from dopslam.raytracing.backend import backend
from dopslam.raytracing.images import PathGeometry, reflected_paths, scattered_paths, zenith_azimuth
from dopslam.raytracing.landmarks import Naming, landmarks_of
from dopslam.raytracing.mends import CountingSolver, Receivers
from dopslam.raytracing.objects import TARGET, TRANSMITTER
from dopslam.raytracing.scene import LoadedScene, SceneSource, load_scene
from dopslam.raytracing.settings import JONES, MAX_CHUNK, ScatterPoints, TraceSettings
from dopslam.raytracing.surfaces import check_positions
from dopslam.raytracing.traced import Traced, join
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths

PAIRS_PER_CALL = 20_000_000  # the radar solver pairs (points) × (points × receivers) legs in memory
SPECULAR = 1


class _Found(NamedTuple):
    """Paths of one call.

    Receiver (N,), planes (N, D) padded with −1, point (N,) or −1, gains (N, 2, 2), Sionna's τc (N,) m.
    """

    receiver: np.ndarray
    planes: np.ndarray
    point: np.ndarray
    transfer: np.ndarray
    length: np.ndarray


class Tracer:
    """A loaded scene with its base station and scatter points, ready for any number of receivers.

    Parameters
    ----------
    source : where the scene comes from
    carrier_frequency : Hz
    bs_position : (3,) m
    scatter_points : their names, positions, cross-sections
    settings : of the ray tracer

    Raises
    ------
    SceneError
        For a scene that cannot be loaded, an undefined material, a base station or scatter point inside an
        object or closer than 1 cm to a surface.
    LLVMError
        If the ray tracer cannot run on this machine.
    """

    def __init__(
        self,
        source: SceneSource | LoadedScene,
        carrier_frequency: float,
        bs_position: np.ndarray,
        scatter_points: ScatterPoints | None = None,
        settings: TraceSettings | None = None,
    ):
        self.settings = settings or TraceSettings()
        self.points = scatter_points or ScatterPoints()
        self.wavelength = SPEED_OF_LIGHT / carrier_frequency
        self.bs_position = np.asarray(bs_position, dtype=float).reshape(3)
        loaded = source if isinstance(source, LoadedScene) else load_scene(source, carrier_frequency)
        if loaded.carrier_frequency != carrier_frequency:
            raise SceneError(
                f"scene {loaded.name!r} was loaded for {loaded.carrier_frequency / 1e9:g} GHz and cannot be "
                f"traced at {carrier_frequency / 1e9:g} GHz; load it for that frequency"
            )
        self.scene, self.surfaces = loaded.scene, loaded.surfaces
        self._authors_name = loaded.authors_name
        self.naming = Naming(self.surfaces)
        self._fixed = {"the base station": self.bs_position} | {
            f"scatter point {name!r}": position
            for name, position in zip(self.points.names, self.points.positions, strict=True)
        }
        check_positions(self.surfaces, self._fixed)
        self._prepare_scene()

    def _prepare_scene(self) -> None:
        rt, mi = backend()
        # A scene that another tracer has used still holds that tracer's devices and target.
        leftover = [*self.scene.transmitters, *self.scene.receivers]
        for name in leftover + [name for name in (TARGET, f"{TARGET}-material") if self.scene.get(name)]:
            self.scene.remove(name)
        self.scene.add(rt.Transmitter(name=TRANSMITTER, position=mi.Point3f(*map(float, self.bs_position))))
        if len(self.points.names):
            self._add_points()
        identifiers = {item.object_id: name for name, item in self.scene.objects.items()}
        index = {name: i for i, name in enumerate(self.surfaces.objects)}
        self._object_of = np.full(max(identifiers, default=0) + 1, -1, dtype=np.intp)
        for identifier, name in identifiers.items():
            self._object_of[identifier] = index.get(self._authors_name.get(name, name), -1)
        self._solver = CountingSolver(self.settings.deterministic)
        self._receivers = Receivers(self.scene)

    def _add_points(self) -> None:
        """One millimeter-sized target below everything, so that it hides nothing, carries all the points."""
        _, mi = backend()
        rcs = importlib.import_module("sionna.rt.rcs")
        corners = np.concatenate([self.surfaces.triangles.reshape(-1, 3), self.points.positions, [self.bs_position]])
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        home = np.array([middle[0], middle[1], corners[:, 2].min() - 10.0]).round()
        model = rcs.ScatteringModel(
            mi.Point3f((self.points.positions - home).T.astype(np.float32)),
            rcs=rcs.ConstantRCS(sigma=1.0),
            cpm=rcs.ConstantCPM(xpr_db=None),
        )
        size = {"length": 1e-3, "width": 1e-3, "height": 1e-3}
        self.scene.add(
            rcs.SensingTarget(name=TARGET, scattering_model=model, position=mi.Point3f(*map(float, home)), **size)
        )
        self._radar = rcs.RCSSolver(deterministic=True)

    @property
    def receivers_per_call(self) -> int:
        """Receivers that one call of the tracer takes at most, so that memory stays bounded."""
        return min(self.settings.receivers_per_call, self._receivers_per_radar_call)

    @property
    def _receivers_per_radar_call(self) -> int:
        return max(1, min(MAX_CHUNK, PAIRS_PER_CALL // max(1, len(self.points.names)) ** 2))

    def chunks(
        self, receivers: np.ndarray, velocities: np.ndarray | None = None, together: int = 1
    ) -> Iterator[Traced]:
        """Trace receivers (K, 3) m with velocities (K, 3) m/s, chunk by chunk; memory does not grow.

        Every chunk has its own :class:`Landmarks` with the same names and order rules; :func:`join` unites
        them. The radar solver, whose calls cost much and whose receivers little, takes several chunks in one
        call: at least ``together`` where that fits, so that runs of several lengths share one kernel.
        """
        receivers = np.asarray(receivers, dtype=float).reshape(-1, 3)
        velocities = np.zeros_like(receivers) if velocities is None else np.asarray(velocities, dtype=float)
        if velocities.shape != receivers.shape:
            raise SceneError(f"{len(receivers)} receivers but velocities of shape {velocities.shape}; give one each")
        count = len(receivers)
        if not count:
            raise SceneError("no receiver positions to trace; give at least one")
        check_positions(self.surfaces, {"the receiver at step": receivers, **self._fixed})
        # Equal chunks: another number of receivers would compile another kernel.
        size = -(-count // -(-count // self.receivers_per_call))
        together = max(1, min(max(together, -(-count // size)), self._receivers_per_radar_call // size))
        for first in range(0, count, together * size):
            group = receivers[first : first + together * size]
            scattered = self._scattered(group, together * size)
            for start in range(0, len(group), size):
                mine = [_of_receivers(found, start, size) for found in scattered]
                rows = slice(first + start, min(first + start + size, count))
                yield self._chunk(receivers[rows], velocities[rows], size, mine)

    def _chunk(self, receivers: np.ndarray, velocities: np.ndarray, size: int, scattered: list[_Found]) -> Traced:
        self._receivers.place(_filled(receivers, size))
        found = [self._reflected(), *scattered]
        depth = max(f.planes.shape[1] for f in found)
        planes = np.concatenate([
            np.pad(f.planes, ((0, 0), (0, depth - f.planes.shape[1])), constant_values=-1) for f in found
        ])  # fmt: skip
        rest = (np.concatenate(column) for column in zip(*(f[:1] + f[2:] for f in found), strict=True))
        receiver, point, transfer, length = rest
        keep = _first_of_each(np.column_stack([receiver, point, planes])) & (receiver < len(receivers))
        receiver, planes, point, transfer, length = (c[keep] for c in (receiver, planes, point, transfer, length))
        geometry = self._geometry(receivers[receiver], planes, point)
        self._compare(geometry.length, length)
        return self._records(receiver, planes, point, transfer, geometry, velocities)

    def _reflected(self) -> _Found:
        """Line of sight and specular reflections."""
        s = self.settings
        paths = self._solver(
            self.scene, max_depth=s.max_depth, samples_per_src=s.samples, synthetic_array=True, los=True,
            specular_reflection=True, diffuse_reflection=False, refraction=s.refraction, diffraction=False,
            seed=s.seed,
        )  # fmt: skip
        receiver, where = _valid(paths)
        specular = paths.interactions.numpy()[(slice(None), *where)].T == SPECULAR  # (N, D)
        objects, primitives = (t.numpy()[(slice(None), *where)].T for t in (paths.objects, paths.primitives))
        planes = np.full(specular.shape, -1)
        owner = self._object_of[objects[specular].astype(np.intp)]
        triangle = self.surfaces.first_triangle[owner] + primitives[specular].astype(np.intp)
        planes[specular] = self.surfaces.triangle_plane[triangle]
        # Passing through a wall leaves no mark on the geometry: move the reflections to the front.
        planes = np.take_along_axis(planes, np.argsort(~specular, axis=1, kind="stable"), axis=1)
        point = np.full(len(receiver), -1)
        return _Found(receiver, planes, point, _transfer(paths, where), _lengths(paths, where))

    def _scattered(self, receivers: np.ndarray, size: int) -> list[_Found]:
        """Paths over the scatter points, both legs unobstructed."""
        if not len(self.points.names):
            return []
        self._receivers.place(_filled(receivers, size))
        paths = self._radar(
            self.scene, max_depth=1, samples_per_sp=1, buffer_size_per_sp=size + 10, synthetic_array=True,
            los=True, specular_reflection=False, refraction=False, seed=self.settings.seed,
        )  # fmt: skip
        receiver, where = _valid(paths)
        point = paths.primitives.numpy()[(0, *where)].astype(np.intp)
        scale = np.sqrt(self.points.rcs) * np.exp(1j * self.points.phases)
        transfer = _transfer(paths, where) * scale[point][:, None, None]
        planes = np.full((len(receiver), 0), -1, dtype=np.intp)
        return [_Found(receiver, planes, point, transfer, _lengths(paths, where))]

    def _geometry(self, receivers: np.ndarray, planes: np.ndarray, point: np.ndarray) -> PathGeometry:
        """Float64 geometry of every path, group by group of equal depth."""
        count, depth = len(receivers), max(planes.shape[1], 1)
        geometry = PathGeometry(
            np.empty(count), np.empty((count, 3)), np.empty((count, 3)), np.full((count, depth, 3), np.nan)
        )
        orders = np.where(point >= 0, -1, np.sum(planes >= 0, axis=1))
        for order in np.unique(orders):
            rows = np.flatnonzero(orders == order)
            if order < 0:
                part = scattered_paths(self.bs_position, receivers[rows], self.points.positions[point[rows]])
            else:
                sequence = planes[rows, :order]
                part = reflected_paths(
                    self.bs_position, receivers[rows],
                    self.surfaces.plane_normal[sequence], self.surfaces.plane_offset[sequence],
                )  # fmt: skip
            geometry.length[rows], geometry.departure[rows], geometry.arrival[rows] = (
                part.length, part.departure, part.arrival,
            )  # fmt: skip
            geometry.vertices[rows, : part.vertices.shape[1]] = part.vertices
        return geometry

    def _compare(self, length: np.ndarray, traced: np.ndarray) -> None:
        """Sionna's lengths, right to single precision, must be those of the planes: guards bookkeeping."""
        wrong = np.abs(length - traced) > 2e-2 + 1e-5 * length
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise SceneError(
                f"{int(wrong.sum())} of {len(length)} traced paths do not fit the planes (first: "
                f"{traced[row]:.3f} m traced, {length[row]:.3f} m by the image method); the meshes may be "
                "curved or damaged"
            )

    def _records(self, receiver, planes, point, transfer, geometry: PathGeometry, velocities) -> Traced:
        distinct, which = np.unique(np.column_stack([point, planes]), axis=0, return_inverse=True)
        ends = [(p, tuple(plane for plane in row if plane >= 0)) for p, *row in distinct.tolist()]
        canonical = {sequence: self.naming.canonical(sequence) for p, sequence in ends if p < 0}
        landmarks, rows = landmarks_of(
            self.surfaces, self.bs_position, set(canonical.values()), self.naming, self.points.names,
            self.points.positions,
        )  # fmt: skip
        first_point = len(landmarks) - len(self.points.names)
        row_of = [first_point + p if p >= 0 else rows[canonical[sequence]] for p, sequence in ends]
        landmark = np.array(row_of, dtype=np.int64)[which.reshape(-1)]
        order = np.lexsort((geometry.length, landmark, receiver))
        landmark, receiver, transfer = landmark[order], receiver[order], transfer[order]
        length, departure, arrival = (c[order] for c in (geometry.length, geometry.departure, geometry.arrival))
        vertices = geometry.vertices[order]
        real = np.isfinite(vertices[..., 0])
        theta_t, phi_t = zenith_azimuth(departure)
        theta_r, phi_r = zenith_azimuth(arrival)
        to_ue, to_bs = (np.array(JONES[name]) for name in reversed(self.settings.polarization))
        paths = Paths(
            offsets=np.concatenate([[0], np.cumsum(np.bincount(receiver, minlength=len(velocities)))]),
            landmark=landmark,
            a=np.einsum("i,nij,j->n", to_ue, transfer, to_bs),
            tau=length / SPEED_OF_LIGHT,
            theta_t=theta_t, phi_t=phi_t, theta_r=theta_r, phi_r=phi_r,
            doppler=np.sum(velocities[receiver] * arrival, axis=1) / self.wavelength,
            vertex_offsets=np.concatenate([[0], np.cumsum(real.sum(axis=1))]),
            vertices=vertices[real],
        )  # fmt: skip
        return Traced(landmarks, paths, transfer)


def _filled(receivers: np.ndarray, size: int) -> np.ndarray:
    """The last position fills up an incomplete call."""
    return np.concatenate([receivers, np.repeat(receivers[-1:], size - len(receivers), axis=0)])


def _of_receivers(found: _Found, start: int, size: int) -> _Found:
    """The paths of some receivers, which count from 0 then."""
    mine = (found.receiver >= start) & (found.receiver < start + size)
    part = _Found(*(column[mine] for column in found))
    return part._replace(receiver=part.receiver - start)


def _valid(paths) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Receiver of every valid path and its index into Sionna's [rx, tx, path] tensors, by receiver."""
    valid = paths.valid.numpy()
    where = np.nonzero(valid) if valid.ndim == 3 else (np.zeros(0, dtype=np.intp),) * 3
    return where[0], where


def _transfer(paths, where) -> np.ndarray:
    """(N, 2, 2) complex gains, from [rx, rx_pol, tx, tx_pol, path] tensors."""
    real, imaginary = (part.numpy() for part in paths.a)
    receiver, transmitter, path = where
    if not len(receiver):
        return np.zeros((0, 2, 2), dtype=complex)
    pick = (receiver, slice(None), transmitter, slice(None), path)
    return real[pick].astype(float) + 1j * imaginary[pick].astype(float)


def _lengths(paths, where) -> np.ndarray:
    return paths.tau.numpy()[where].astype(float) * SPEED_OF_LIGHT


def _first_of_each(keys: np.ndarray) -> np.ndarray:
    """Mask of the first row of every distinct row of keys (N, ·)."""
    mask = np.zeros(len(keys), dtype=bool)
    mask[np.unique(keys, axis=0, return_index=True)[1]] = True
    return mask


def trace(
    source: SceneSource | LoadedScene,
    carrier_frequency: float,
    bs_position: np.ndarray,
    receivers: np.ndarray,
    velocities: np.ndarray | None = None,
    scatter_points: ScatterPoints | None = None,
    settings: TraceSettings | None = None,
) -> tuple[Landmarks, Paths]:
    """Trace a base station to K receivers; see :class:`Tracer` for the parameters and errors.

    Examples
    --------
    >>> landmarks, paths = trace(SceneSource("scene.xml"), 28e9, [0, 0, 40], positions)  # doctest: +SKIP
    """
    tracer = Tracer(source, carrier_frequency, bs_position, scatter_points, settings)
    joined = join(list(tracer.chunks(receivers, velocities)))
    return joined.landmarks, joined.paths
