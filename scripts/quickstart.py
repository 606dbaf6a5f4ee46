#!/usr/bin/env python3
"""Set up dopslam in a virtual environment of its own and run the main job or the tests.

Needs Python 3.11 or newer and nothing else; uses only the standard library until the environment stands.

    python3 scripts/quickstart.py                 # set up, then: dopslam run scenes/ring_road
    python3 scripts/quickstart.py run SCENE …     # set up, then: dopslam run SCENE …
    python3 scripts/quickstart.py test            # set up, then linter, types and all tests (fast, traced, statistical)
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MINIMUM = (3, 11)


def fail(message: str) -> None:
    """Leave with one line that says what to do."""
    print(f"quickstart: {message}", file=sys.stderr)
    sys.exit(2)


def make_environment(folder: Path) -> Path:
    """Create the virtual environment if it is not there; return its folder of programs."""
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    if (programs / "python").exists() or (programs / "python.exe").exists():
        return programs
    try:
        import ensurepip  # noqa: F401  (Debian splits it from the interpreter)
        import venv
    except ImportError:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        fail(f"this Python cannot make virtual environments; on Debian or Ubuntu: apt-get install python{version}-venv")
    print(f"quickstart: making a virtual environment in {folder}", flush=True)
    venv.EnvBuilder(with_pip=True).create(folder)
    return programs


def install(programs: Path, editable: bool, extras: str) -> None:
    """Install this checkout with pip."""
    target = f"{ROOT}{extras}"
    command = [str(programs / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    print("quickstart: installing dopslam and what it needs (about a minute)", flush=True)
    done = subprocess.run([*command, *(["--editable"] if editable else []), target], check=False)
    if done.returncode:
        fail("pip could not install the packages; is a package index reachable? The lines above say what failed")


def checked(programs: Path) -> int:
    """Linter, format and types of this checkout; 0 if nothing is found."""
    failed = 0
    commands = [["ruff", "check", "."], ["ruff", "format", "--check", "."]]
    types = ["basedpyright", "--pythonpath", str(programs / "python")]
    started = subprocess.run([str(programs / types[0]), "--version"], capture_output=True, text=True, check=False)
    if started.returncode:  # its node does not run on every machine; the code is the same there
        said = (started.stderr or started.stdout).strip().splitlines()
        print(f"quickstart: types are not checked, basedpyright does not start here: {said[-1] if said else 'no word'}")
    else:
        commands.append(types)
    for name, *arguments in commands:
        print(f"quickstart: {name} {' '.join(arguments)}", flush=True)
        done = subprocess.run([str(programs / name), *arguments], cwd=ROOT, check=False)
        failed = failed or done.returncode
    return failed


def main() -> int:
    """Entry point; returns the exit code of the job."""
    if sys.version_info < MINIMUM:
        fail(f"Python {MINIMUM[0]}.{MINIMUM[1]} or newer is needed, this is {sys.version.split()[0]}")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", nargs="?", choices=["run", "test"], default="run")
    parser.add_argument("--venv", type=Path, default=ROOT / ".venv", help="folder of the virtual environment")
    parser.add_argument("--wheel", action="store_true", help="install a copy instead of linking this checkout")
    options, rest = parser.parse_known_args()
    programs = make_environment(options.venv)
    install(programs, editable=not options.wheel, extras="[test]" if options.job == "test" else "")
    if options.job == "run":
        command = [str(programs / "dopslam"), "run", *(rest or ["scenes/ring_road"])]
    else:
        failed = checked(programs)
        # All tiers: tracing in one worker (tests/conftest.py groups it), everything else beside it.
        command = [str(programs / "pytest"), "-m", "", "-n", "2", "--dist", "loadgroup", *rest]
        return subprocess.run(command, cwd=ROOT, check=False).returncode or failed
    return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
