"""Channel measurements of one's own: every kind of file, the axes by name, and one clear line for what is wrong."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from dopslam.errors import ConfigError, DatasetError
from dopslam.formats import csi
from dopslam.pipeline.file import read_detections

SPEED_OF_LIGHT = 299_792_458.0
MAPPING = """
[csi]
variable = "H"
axes = ["snapshot", "rx", "tx", "symbol", "subcarrier"]
period = 0.1
[radio]
carrier_frequency = 28e9
subcarrier_spacing = 4e6
symbol_period = 125e-6
[receiver]
array = { kind = "planar", rows = 2, columns = 3 }
[base_station]
array = { kind = "planar", rows = 2, columns = 2, pattern = "isotropic" }
"""
PATHS = (  # delay [s], AOA and AOD azimuth and elevation [rad], radial velocity [m/s], gain
    (40e-9, (0.3, 0.1), (-0.4, -0.2), 6.0, 1.0),
    (75e-9, (-0.6, 0.2), (0.5, 0.1), -4.0, 0.3j),
)


def unit(azimuth, elevation):
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def panel(rows, columns):
    z, y = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2, indexing="ij")
    return 0.5 * np.stack([0 * y, y, z], axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def channel():
    """(2, 6, 4, 8, 32), written down from the physics: e^{j 2 pi p.u} at both ends, e^{-j 2 pi f tau}, e^{j 2 pi f_d t}."""
    rng = np.random.default_rng(0)
    frequencies = 4e6 * (np.arange(32) - 15.5)
    times = 125e-6 * (np.arange(8) - 3.5)
    total = np.zeros((6, 4, 8, 32), complex)
    for delay, aoa, aod, speed, gain in PATHS:
        total += gain * np.einsum(
            "r,t,n,k->rtnk", np.exp(2j * np.pi * panel(2, 3) @ unit(*aoa)), np.exp(2j * np.pi * panel(2, 2) @ unit(*aod)),
            np.exp(2j * np.pi * times * speed * 28e9 / SPEED_OF_LIGHT), np.exp(-2j * np.pi * frequencies * delay),
        )  # fmt: skip
    noise = rng.standard_normal((2, *total.shape, 2)) @ [1, 1j]
    return total + 0.02 * noise


@pytest.fixture
def place(tmp_path, channel):
    """A folder with the file, and the mapping with some of its text replaced."""

    def placed(values=channel, change=("", ""), name="my.npz"):
        (tmp_path / "csi.toml").write_text(MAPPING.replace(*change) if change[0] else MAPPING)
        path = tmp_path / name
        if path.suffix == ".npy":
            np.save(path, values)
        elif path.suffix == ".npz":
            np.savez(path, **(values if isinstance(values, dict) else {"H": values}))
        elif path.suffix == ".mat":
            savemat(path, {"H": values, "note": "mine", "fs": 1.0})
        return path, tmp_path / "csi.toml"

    return placed


def test_what_is_measured_becomes_paths(call, place, tmp_path, capsys):
    path, mapping = place()
    out = tmp_path / "mine.h5"
    assert call("import", str(path), "--format", "csi", "--map", str(mapping), "--out", str(out)) == 0
    assert "2 snapshots of 32 × 8 × 6 × 4 samples" in capsys.readouterr().out
    assert call("estimate", str(out), "--jobs", "1") == 0
    found = read_detections(out)
    assert found.offsets.tolist() == [0, 2, 4]
    for step in range(2):
        rows = found.rows(step)
        order = np.argsort(found.delay[rows])
        for row, (delay, aoa, aod, speed, gain) in zip(np.arange(4)[rows][order], PATHS, strict=True):
            assert found.delay[row] == pytest.approx(delay, abs=0.1e-9)
            assert found.aoa[row] == pytest.approx(aoa, abs=0.02)
            assert found.aod[row] == pytest.approx(aod, abs=0.02)
            assert found.radial_velocity[row] == pytest.approx(speed, abs=0.2)
            # Patches at the receiver: what they take of the gain is the pattern's.
            assert np.angle(found.gain[row] / gain) == pytest.approx(0, abs=0.05)


def test_all_files_say_the_same(place, channel, tmp_path):
    wanted = csi.read(*place()).snapshots
    for name in ("my.mat", "my.npz"):
        assert np.allclose(csi.read(*place(name=name)).snapshots, wanted)
    assert np.allclose(csi.read(*place(name="my.npy", change=('variable = "H"\n', ""))).snapshots, wanted)
    for name, kind, values in (("my.h5", None, channel), ("v73.mat", b"double", channel.T)):
        _, mapping = place()
        pair = np.zeros(values.shape, [("real", "f8"), ("imag", "f8")])
        pair["real"], pair["imag"] = values.real, values.imag
        with h5py.File(tmp_path / name, "w") as file:
            file["H"] = pair if kind else values
            if kind:
                file["H"].attrs["MATLAB_class"] = np.bytes_(kind)
        assert np.allclose(csi.read(tmp_path / name, mapping).snapshots, wanted)


def test_axes_in_any_order_and_form(place, channel):
    wanted = csi.read(*place()).snapshots
    axes = '["snapshot", "rx", "tx", "symbol", "subcarrier"]'
    turned = channel.transpose(4, 3, 0, 2, 1)
    assert np.allclose(
        csi.read(*place(turned, (axes, '["subcarrier", "symbol", "snapshot", "tx", "rx"]'))).snapshots, wanted
    )
    halves = np.stack([channel.real, channel.imag])
    assert np.allclose(csi.read(*place(halves, (axes, '["re_im"' + ", " + axes[1:]))).snapshots, wanted)
    users = np.stack([0 * channel + 1, channel])
    chosen = (axes, '["user", ' + axes[1:] + "\nselect = { user = 1 }")
    assert np.allclose(csi.read(*place(users, chosen)).snapshots, wanted)
    fft = (f"axes = {axes}", f'axes = {axes}\norder = "fft"')
    assert np.allclose(csi.read(*place(np.fft.ifftshift(channel, axes=4), fft)).snapshots, wanted)
    rising = (f"axes = {axes}", f'axes = {axes}\nphase = "rising"')
    assert np.allclose(csi.read(*place(channel.conj(), rising)).snapshots, wanted)


def test_pilots_of_ones_own_and_one_port(place, channel):
    pilots = [*range(-28, -1, 2), *range(1, 36, 2)]
    change = ("subcarrier_spacing = 4e6", f"subcarrier_spacing = 4e6\npilots = {pilots}")
    read = csi.read(*place(channel, change))
    assert read.scenario.radio.pilots == tuple(pilots)
    single = channel[0, :, 0]
    path, mapping = place(single, ('"snapshot", "rx", "tx", "symbol"', '"rx", "symbol"'))
    mapping.write_text(mapping.read_text().replace('{ kind = "planar", rows = 2, columns = 2, pattern = "isotropic" }',
                                                   '{ kind = "custom", positions_wavelengths = [[0, 0, 0]] }'))  # fmt: skip
    assert csi.read(path, mapping).snapshots.shape == (1, 32, 8, 6, 1)


def test_a_phase_the_wrong_way_round_is_noticed(place, channel):
    assert csi.read(*place()).doubt is None
    assert 'csi.phase = "rising"' in str(csi.read(*place(channel.conj())).doubt)


AXES = 'axes = ["snapshot", "rx", "tx", "symbol", "subcarrier"]'
STRANGE = {
    "real": (lambda h: np.abs(h), ("", ""), "real numbers"),
    "nan": (lambda h: np.where(np.arange(32) == 5, np.nan, h), ("", ""), "384 of 12288 values are not finite.*subcarrier 5"),
    "swapped": (lambda h: h.swapaxes(1, 2), ("", ""), "the axis rx has 4 entries, and receiver.array has 6"),
    "too few axes": (lambda h: h[0], ("", ""), "has 4 axes .* names 5"),
    "twice": (lambda h: h, (AXES, AXES.replace("tx", "rx")), "different names"),
    "no subcarriers": (lambda h: h, (AXES, AXES.replace("subcarrier", "tap")), "no axis is called subcarrier"),
    "unknown axis": (lambda h: h, (AXES, AXES.replace("tx", "port")), "what is 'port'.*select"),
    "unknown key": (lambda h: h, ("period = 0.1", "periode = 0.1"), "unknown key csi.periode"),
    "wrong choice": (lambda h: h, ("period = 0.1", 'phase = "up"'), "choose one of falling, rising"),
    "other pilots": (lambda h: h, ("symbol_period", "subcarriers = 64\nsymbol_period"), "32 entries, and radio.subcarriers"),
    "carrier in GHz": (lambda h: h, ("28e9", "28"), "carrier_frequency"),
    "no carrier": (lambda h: h, ("carrier_frequency = 28e9\n", ""), "needs .radio. with carrier_frequency"),
    "no period": (lambda h: h, ("symbol_period = 125e-6\n", ""), "needs radio.symbol_period"),
    "spacing a word": (lambda h: h, ("4e6", '"4 MHz"'), "radio.subcarrier_spacing"),
    "dead port": (lambda h: h * (np.arange(6) != 2)[:, None, None, None], ("", ""), "nothing but zeros at rx 2, tx 0"),
    "all zero": (lambda h: 0 * h, ("", ""), "largest value is 0"),
    "tiny": (lambda h: h * 1e-30, ("", ""), "too small for single precision"),
    "empty": (lambda h: h[:0], ("", ""), "is empty"),
    "two arrays": (lambda h: {"a": h, "b": h}, ('variable = "H"\n', ""), "which array is meant.*a, b"),
    "other name": (lambda h: {"a": h}, ("", ""), "no array 'H'; it has a"),
    "objects": (lambda h: {"H": np.array([{}], object)}, ("", ""), "cannot be read"),
    "beams and ports": (lambda h: h, ("[receiver]", '[radio.beams]\nkind = "dft"\n[receiver]'), "there are no beams"),
    "time falls": (lambda h: {"H": h, "t": [1.0, 0.5]}, ("period = 0.1", 'time = "t"'), "rising times"),
    "selected beyond": (lambda h: h[None], (AXES, AXES.replace("[", '["user", ') + "\nselect = { user = 3 }"), "has 1 entries"),
}  # fmt: skip


@pytest.mark.parametrize("name", STRANGE)
def test_what_is_strange_is_one_clear_line(name, place, channel):
    values, change, said = STRANGE[name]
    with pytest.raises((DatasetError, ConfigError), match=said):
        csi.read(*place(values(channel), change))


@pytest.mark.parametrize("name", ["no.npy", "text.mat", "cut.h5", "cut.npz", "list.csv"])
def test_what_is_no_array_is_refused(name, place, tmp_path):
    good, mapping = place()
    if not name.startswith("no."):
        (tmp_path / name).write_bytes(good.read_bytes()[:1000] if name.startswith("cut") else b"1,2,3\n")
    with pytest.raises(DatasetError, match=name):
        csi.read(Path(tmp_path, name), mapping)


def test_the_command_says_what_it_needs(call, place, tmp_path, capsys):
    path, mapping = place()
    assert call("import", str(path), "--format", "csi", "--out", str(tmp_path / "x.h5")) == 2
    assert "need --map" in capsys.readouterr().err
    assert call("import", str(path), "--map", str(mapping), "--out", str(tmp_path / "x.h5")) == 2
    assert "give --scene" in capsys.readouterr().err
