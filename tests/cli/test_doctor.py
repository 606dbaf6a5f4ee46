"""``dopslam doctor`` reports and never crashes."""

import pytest

from dopslam.cli.doctor import _writable, doctor
from dopslam.compute import llvm


def test_it_reports_a_machine_that_works(capsys, tmp_path):
    doctor()
    text = capsys.readouterr().out
    for word in (
        "python",
        "sionna-rt",
        "cores",
        "Dr.Jit kernels",
        "numba kernels",
        ", used",
        "Ready to trace",
    ):
        assert word in text


@pytest.mark.parametrize("found", [[], [llvm.Candidate("/usr/lib/libLLVM-15.so", "system", (15, 0, 6))]])
def test_it_leaves_with_1_and_a_remedy_without_llvm(capsys, monkeypatch, found):
    monkeypatch.setattr(llvm, "candidates", lambda: found)
    monkeypatch.setattr(llvm, "_located", lambda: [])
    monkeypatch.setattr(llvm, "cuda_devices", lambda: 0)
    with pytest.raises(SystemExit) as left:
        doctor()
    assert left.value.code == 1
    text = capsys.readouterr().out
    assert "Tracing is not possible" in text and "Remedy: install" in text


def test_nothing_installed_and_no_home_is_only_reported(capsys, monkeypatch):
    from importlib import metadata

    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    doctor()
    text = capsys.readouterr().out
    assert "not installed" in text and "no home folder" in text


def test_folders_that_do_not_exist_yet(tmp_path):
    assert _writable(tmp_path / "a" / "b")
    (tmp_path / "file").write_text("")
    assert not _writable(tmp_path / "file" / "below")
