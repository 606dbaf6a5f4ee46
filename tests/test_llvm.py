"""The search for an LLVM that works: order of trust, versions asked outside this process, one clear error."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dopslam.compute import llvm
from dopslam.errors import LLVMError


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with chosen libraries: call with {file name: version or None}; returns the folder."""

    def make(files, gpus=0):
        for name in files:
            (tmp_path / name).write_bytes(name.encode())
        monkeypatch.setattr(llvm, "_folders", lambda: [("system", tmp_path)])
        monkeypatch.setattr(llvm, "version_of", lambda path: files.get(Path(path).name) or ())
        monkeypatch.setattr(llvm, "cuda_devices", lambda: gpus)
        monkeypatch.setenv(llvm.VARIABLE, "")  # as unset, and undone after the test whatever prepare() sets
        return tmp_path

    return make


def test_newest_that_works_is_taken(machine):
    folder = machine({"libLLVM-14.so.1": (14, 0, 6), "libLLVM.so.19.1": (19, 1, 7), "libLLVM-17.so": (17, 0, 1)})
    assert llvm.prepare() == folder / "libLLVM.so.19.1"
    assert os.environ[llvm.VARIABLE] == str(folder / "libLLVM.so.19.1")


@pytest.mark.parametrize("version", [(14, 0, 6), (15, 0, 6), (16, 0, 0), ()])
def test_versions_that_crash_are_refused(machine, version):
    machine({"libLLVM-15.so": version})
    with pytest.raises(
        LLVMError, match=r"17 or newer.*libLLVM-15.so is (version|not loadable).*libllvm19|install LLVM"
    ):
        llvm.prepare()
    assert not os.environ[llvm.VARIABLE]


def test_nothing_found_names_the_remedy(machine):
    machine({})
    with pytest.raises(LLVMError, match=r"no libLLVM at all.*install"):
        llvm.prepare()


def test_a_gpu_needs_no_llvm(machine):
    machine({"libLLVM-15.so": (15, 0, 6)}, gpus=1)
    assert llvm.prepare() is None


def test_the_users_variable_comes_first(machine, monkeypatch, tmp_path_factory):
    machine({"libLLVM.so.19.1": (19, 1, 7), "mine.so": (18, 1, 0)})
    mine = tmp_path_factory.mktemp("elsewhere") / "mine.so"
    mine.write_bytes(b"")
    monkeypatch.setenv(llvm.VARIABLE, str(mine))
    assert llvm.prepare() == mine


def test_a_variable_that_points_to_nothing_is_replaced(machine, monkeypatch, caplog):
    folder = machine({"libLLVM.so.19.1": (19, 1, 7)})
    monkeypatch.setenv(llvm.VARIABLE, "/nowhere/libLLVM.so")
    assert llvm.prepare() == folder / "libLLVM.so.19.1"
    assert "does not work" in caplog.text


def test_versions_of_files_that_are_no_llvm(tmp_path):
    fake = tmp_path / "libLLVM.so.99"
    fake.write_bytes(b"not an ELF file")
    assert llvm.version_of(fake) == ()
    assert llvm.version_of(tmp_path / "missing.so") == ()


def test_symbolic_links_are_one_candidate(tmp_path, monkeypatch):
    (tmp_path / "libLLVM.so.19.1").write_bytes(b"")
    (tmp_path / "libLLVM-19.so").symlink_to(tmp_path / "libLLVM.so.19.1")
    monkeypatch.setattr(llvm, "_folders", lambda: [("system", tmp_path)])
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    assert len(llvm.candidates()) == 1


def test_looking_does_not_load_anything_here():
    """A wrong libLLVM loaded into this process could be taken by Dr.Jit, or abort it."""
    code = "from dopslam.compute import llvm; llvm.candidates();assert 'libLLVM' not in open('/proc/self/maps').read()"
    if not Path("/proc/self/maps").exists():
        pytest.skip("needs /proc")
    subprocess.run([sys.executable, "-c", code], check=True, env=dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)))


def test_an_interpreter_that_cannot_be_started_asks_itself(tmp_path, monkeypatch):
    real = next((c for c in llvm.candidates() if c.works), None)
    if real is None:
        pytest.skip("no LLVM here")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no_python"))
    assert llvm.version_of.__wrapped__(real.path) == real.version  # not the cached answer
    assert llvm.version_of(tmp_path / "libLLVM-15.so") == ()
    assert llvm.version_of(tmp_path / "libLLVM-18.so") == ()
