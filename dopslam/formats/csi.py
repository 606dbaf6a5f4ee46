"""Channel measurements (CSI) of one's own, as a dataset file that ``dopslam estimate`` runs on.

A file of complex numbers (``.npy``, ``.npz``, ``.mat`` of any version, HDF5) and a small TOML: a scenario's ``[radio]``,
``[receiver]`` and ``[base_station]`` tables say what the link is, and ``[csi]`` what the axes of the array mean::

    [csi]
    variable = "H"             # the array's name in the file, if it holds several
    axes = ["snapshot", "rx", "tx", "symbol", "subcarrier"]   # in the array's order
    phase = "falling"          # over subcarriers, of a later path: exp(-j 2 pi f tau); or "rising"
    order = "rising"           # of the subcarriers; or "fft": the carrier first, negative frequencies last
    time = "t"                 # the name of the snapshots' times [s] in the file; or period = 0.1
    select = { user = 0 }      # of axes of other names: which entry is taken

    [radio]
    carrier_frequency = 28e9   # Hz
    subcarrier_spacing = 120e3 # Hz, of the OFDM grid
    comb = 1                   # every which subcarrier the array holds; or pilots = [-28, -26, ...], their numbers
    symbol_period = 125e-6     # s, between the symbols of a snapshot

    [receiver]
    array = { kind = "planar", rows = 2, columns = 4 }    # rx = row * columns + column
    [base_station]
    position = [0, 0, 10]      # m, for maps; default the origin
    array = { kind = "custom", positions_wavelengths = [[0, 0, 0], [0, 0.5, 0]] }

``rx``, ``tx``, ``symbol`` and ``snapshot`` may be missing: one of each. An axis ``re_im`` of length 2 holds real and imaginary
part. Where there is ``tx``, or the base station has one element, ``H = sum g a_R(aoa) a_T(aod)^T exp(-j 2 pi f tau) exp(+j 2 pi t
d/lambda)`` with the phases that waves have at both ends (so have Sionna's and DeepMIMO's); without, the symbols are the beams of
``[radio.beams]``, eq. (2). A rising phase is conjugated whole: then angles and Doppler turn as well.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from dopslam.config.measured import Shown
from dopslam.config.scenario import Scenario, parse
from dopslam.errors import DatasetError
from dopslam.formats.arrays import array_of
from dopslam.formats.times import period_of
from dopslam.pipeline.link import signal_model

AXES = ("subcarrier", "symbol", "rx", "tx")
KEYS: dict[str, tuple[type, ...]] = {
    "variable": (str,), "axes": (list,), "phase": (str,), "order": (str,), "time": (str,), "period": (float, int),
    "select": (dict,),
}  # fmt: skip
CHOICES = {"phase": ("falling", "rising"), "order": ("rising", "fft")}
LEAST = 1e-14  # of the largest value, and the inverse of the most
LATE = 0.8  # share of the power in the later half of the delays that makes one wonder


@dataclass(frozen=True)
class Csi:
    """Channel measurements, read: the scenario of their link, snapshots (S, K, N, M[, N_T]), and what is strange about them."""

    scenario: Scenario
    snapshots: np.ndarray
    doubt: str | None


def read(path: Path, mapping: Path, settings: tuple[str, ...] | list[str] = ()) -> Csi:
    """Read a file of channel measurements.

    Parameters
    ----------
    path, mapping : the numbers and what they mean, as above
    settings : ``key.path=value`` texts of the scenario

    Raises
    ------
    DatasetError, ConfigError
        Naming the file or key, what is wrong with it, and the remedy.
    """
    tree = _tree(mapping)
    csi = tree.pop("csi")
    values = _complex(path, csi, mapping, array_of(path, csi.get("variable")))
    values = _ordered(path, csi, mapping, values)
    _refuse_gaps(path, values)
    scenario = parse(_link(path, mapping, tree, csi, values.shape), settings, str(mapping), None, _shown(path, csi))
    signal = _fitting(path, csi, values, scenario)
    return Csi(scenario, np.ascontiguousarray(signal, np.complex64), _doubt(signal))


def _tree(mapping: Path) -> dict[str, Any]:
    try:
        tree = tomllib.loads(mapping.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{mapping}: not a readable TOML mapping ({error})") from error
    csi, radio = tree.get("csi"), tree.get("radio")
    if not isinstance(csi, dict) or not csi.get("axes"):
        raise DatasetError(f'{mapping}: needs [csi] with axes = ["snapshot", "rx", "subcarrier"], for instance')
    for key, value in csi.items():
        if key not in KEYS:
            raise DatasetError(f"{mapping}: unknown key csi.{key}; known are {', '.join(KEYS)}")
        if not isinstance(value, KEYS[key]) or isinstance(value, bool):
            raise DatasetError(f"{mapping}: csi.{key} = {value!r} is of the wrong type")
        if key in CHOICES and value not in CHOICES[key]:
            raise DatasetError(f"{mapping}: csi.{key} = {value!r}; choose one of {', '.join(CHOICES[key])}")
    axes = csi["axes"]
    if not all(isinstance(axis, str) for axis in axes) or len(set(axes)) < len(axes):
        raise DatasetError(f"{mapping}: csi.axes = {axes}: give different names, one for each axis of the array")
    if "subcarrier" not in axes:
        raise DatasetError(f"{mapping}: csi.axes = {axes}: no axis is called subcarrier; delays need one")
    known = (*AXES, "snapshot", "re_im", *csi.get("select", {}))
    unknown = [axis for axis in axes if axis not in known]
    if unknown:
        raise DatasetError(
            f"{mapping}: csi.axes: what is {unknown[0]!r}? Known are snapshot, {', '.join(AXES)} and re_im; of any other "
            f"one entry is taken: select = {{ {unknown[0]} = 0 }}"
        )
    if not isinstance(radio, dict) or not {"carrier_frequency", "subcarrier_spacing"} <= set(radio):
        raise DatasetError(f"{mapping}: needs [radio] with carrier_frequency and subcarrier_spacing, both in Hz")
    if "symbol" in axes and "symbol_period" not in radio:
        raise DatasetError(f"{mapping}: needs radio.symbol_period [s], the time between the entries of the axis symbol")
    return tree


def _complex(path: Path, csi: dict, mapping: Path, values: np.ndarray) -> np.ndarray:
    """The array with complex numbers, axes as named but re_im."""
    axes = csi["axes"]
    if values.ndim > len(axes) and values.ndim - values.shape.count(1) == len(axes):
        values = values.squeeze()  # MATLAB has no vectors
    if values.ndim < len(axes) and values.ndim + (axes[-1] != "subcarrier") >= len(axes) and path.suffix == ".mat":
        values = values.reshape(values.shape + (1,) * (len(axes) - values.ndim))  # and drops trailing ones
    if values.ndim != len(axes):
        raise DatasetError(
            f"{path}: the array has {values.ndim} axes of lengths {values.shape}, and {mapping} names {len(axes)}: {axes}"
        )
    if "re_im" in axes:
        place = axes.index("re_im")
        if values.shape[place] != 2 or values.dtype.kind == "c":
            raise DatasetError(
                f"{path}: axis re_im must be two real numbers long, it is {values.shape[place]} of {values.dtype}"
            )
        real, imag = np.moveaxis(values, place, 0)
        return real + 1j * imag
    if values.dtype.kind != "c":
        raise DatasetError(
            f"{path}: the array holds real numbers ({values.dtype}); a channel is complex. If real and imaginary part are "
            "an axis, call it re_im; magnitudes alone do not tell paths"
        )
    return values


def _ordered(path: Path, csi: dict, mapping: Path, values: np.ndarray) -> np.ndarray:
    """(S, K, N, M, T), rising subcarriers with falling phase."""
    axes = [axis for axis in csi["axes"] if axis != "re_im"]
    for axis, entry in csi.get("select", {}).items():
        if axis not in axes:
            raise DatasetError(f"{mapping}: csi.select names {axis!r}, which is not among csi.axes")
        place = axes.index(axis)
        if not isinstance(entry, int) or not -values.shape[place] <= entry < values.shape[place]:
            raise DatasetError(
                f"{path}: csi.select.{axis} = {entry!r}, but that axis has {values.shape[place]} entries"
            )
        values = np.take(values, entry, axis=place)
        axes.remove(axis)
    for name in ("snapshot", *AXES):
        if name not in axes:
            axes.append(name)
            values = values[..., None]
    values = values.transpose([axes.index(name) for name in ("snapshot", *AXES)])
    if csi.get("order") == "fft":
        values = np.fft.fftshift(values, axes=1)
    return values.conj() if csi.get("phase") == "rising" else values


def _refuse_gaps(path: Path, values: np.ndarray) -> None:
    if not values.size:
        raise DatasetError(f"{path}: the array is empty, {values.shape} entries along snapshot, {', '.join(AXES)}")
    bad = ~np.isfinite(values)
    if bad.any():
        first = np.unravel_index(int(np.argmax(bad)), bad.shape)
        where = ", ".join(f"{n} {i}" for n, i in zip(("snapshot", *AXES), first, strict=True))
        raise DatasetError(
            f"{path}: {int(bad.sum())} of {bad.size} values are not finite, the first at {where}; drop those snapshots, or "
            "leave those subcarriers out and name the rest in radio.pilots"
        )
    largest = float(np.abs(values).max())
    if not LEAST < largest < 1 / LEAST:
        raise DatasetError(
            f"{path}: the largest value is {largest:.2g}, too {'small' if largest < 1 else 'large'} for single precision; "
            "scale the whole array (gains and noise scale with it)"
        )
    dead = ~np.any(values, axis=(0, 1, 2))
    if dead.any() and not dead.all():
        rx, tx = np.argwhere(dead)[0]
        raise DatasetError(
            f"{path}: nothing but zeros at rx {rx}, tx {tx} in all snapshots; leave dead ports out, of the arrays as well"
        )


def _link(path: Path, mapping: Path, tree: dict, csi: dict, shape: tuple[int, ...]) -> str:
    """TOML text of the scenario, with what the array itself tells."""
    radio = tree["radio"]
    _, pilots, symbols, _, _ = shape
    for key, length in (("subcarriers", radio.get("subcarriers")), ("pilots", radio.get("pilots"))):
        said = len(length) if isinstance(length, list) else length
        if said is not None and said != pilots:
            raise DatasetError(f"{path}: the axis subcarrier has {pilots} entries, and radio.{key} of {mapping} {said}")
    beams = radio.setdefault("beams", {})
    if "tx" in csi["axes"] or "kind" not in beams:
        if beams.get("kind", "digital") != "digital":
            raise DatasetError(
                f'{mapping}: csi.axes has tx, so there are no beams: radio.beams.kind = {beams["kind"]!r} must be "digital"'
            )
        beams |= {"kind": "digital", "sweeps": symbols}
    period = radio.setdefault("symbol_period", 1 / radio["subcarrier_spacing"]) if _number(radio) else 1.0
    radio |= {"subcarriers": pilots, "symbol_period": period}
    if "pilots" not in radio:
        radio.setdefault("comb", 1)
    tree.setdefault("name", mapping.stem)
    if isinstance(tree.setdefault("base_station", {}), dict):
        tree["base_station"].setdefault("position", [0.0, 0.0, 0.0])
    return tomli_w.dumps(tree)


def _number(radio: dict) -> bool:
    spacing = radio["subcarrier_spacing"]
    return isinstance(spacing, int | float) and spacing > 0


def _shown(path: Path, csi: dict) -> Shown:
    if "time" not in csi:
        return Shown(period=csi.get("period"))
    time = np.asarray(array_of(path, csi["time"])).ravel()
    if time.dtype.kind not in "iuf" or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0):
        raise DatasetError(f"{path}: csi.time = {csi['time']!r} must be rising times in s")
    return Shown(period=period_of(time.astype(float)))


def _fitting(path: Path, csi: dict, values: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Snapshots in the shape of the scenario's signals, or an error that names the axis that does not fit."""
    model = signal_model(scenario)
    digital = scenario.radio.beams.kind == "digital"
    wanted = {
        "symbol": (model.schedule.symbols, "radio.beams.sweeps × radio.beams.beams (× those of radio.stagger) make"),
        "rx": (model.receiver.elements, "receiver.array has"),
        "tx": (model.transmitter.elements if digital else 1, "base_station.array has"),
    }
    for axis, (count, who) in wanted.items():
        length = values.shape[1 + AXES.index(axis)]
        if length != count:
            said = f"the axis {axis} has {length} entries" if axis in csi["axes"] else f"there is no axis {axis}"
            raise DatasetError(f"{path}: {said}, and {who} {count}; axes are {csi['axes']}, check their order")
    return values if digital else values[..., 0]


def _doubt(signal: np.ndarray) -> str | None:
    """What looks as if the sign of the phase were the other one: nearly all power arrives late in the range of delays."""
    pilots = signal.shape[1]
    if pilots < 16:
        return None
    profile = np.sum(np.abs(np.fft.ifft(signal, axis=1)) ** 2, axis=(0, *range(2, signal.ndim)))
    late = float(profile[pilots // 2 :].sum() / max(profile.sum(), 1e-300))
    if late < LATE:
        return None
    return (
        f"{late:.0%} of the power arrives in the later half of the delays; if that cannot be, the phase over subcarriers is "
        'the other way round (csi.phase = "rising") or their order is the FFT\'s (csi.order = "fft")'
    )
