"""The house keeps its shape: who imports whom, who prints, how long a room may be."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MODULES = sorted(p for package in ("dopslam", "estimation") for p in (ROOT / package).rglob("*.py"))


def imports(path: Path) -> set[str]:
    """Absolute names of everything a module imports, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def top_levels(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(path)}


def test_the_import_contracts_hold():
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [program, "--no-cache"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_module_stays_in_its_room(path):
    room = path.relative_to(ROOT).parts
    used = top_levels(path)
    if room[0] == "estimation":
        assert not used & {"dopslam", "sionna", "mitsuba", "drjit"}
    if room[:2] != ("dopslam", "raytracing") and path.name != "doctor.py":
        assert not used & {"sionna", "mitsuba"}
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 400
    assert not text.strip() or ast.get_docstring(ast.parse(text))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_only_the_command_line_prints_or_exits(path):
    if path.relative_to(ROOT).parts[:2] == ("dopslam", "cli"):
        return
    calls = [n.func for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
    assert "print" not in {f.id for f in calls if isinstance(f, ast.Name)}
    assert "exit" not in {f.attr for f in calls if isinstance(f, ast.Attribute)}


ONCE = {
    "estimation/statistics.py": r"2\.5, 97\.5|\bppf\(0\.(025|975)|\bt as student\b|\bdef _?bootstrap",
    "dopslam/models/paths.py": r"\bdef (mirror|incidence|spreading_loss)\b|\bclass Reflection\b",
    "dopslam/evaluate/recursion.py": r"\bclass LinearizedRun\b",
    "dopslam/pipeline/problem.py": r"\bdef chosen_filter\b",
}
"""What is said in one place only: a pattern of its code, and the module that may hold it."""


@pytest.mark.parametrize("where", ONCE)
def test_each_thing_is_said_once(where):
    others = [p for p in MODULES if p.relative_to(ROOT).as_posix() != where]
    again = [str(p.relative_to(ROOT)) for p in others if re.search(ONCE[where], p.read_text(encoding="utf-8"))]
    assert not again, f"{again} say anew what {where} says"
    assert re.search(ONCE[where], (ROOT / where).read_text(encoding="utf-8"))


FLOORS = [
    {"errors"},
    {"records", "filters", "compute", "scenes", "store"},
    {"config", "models"},
    {"raytracing", "slam", "simulate"},
    {"evaluate"},
    {"report"},
    {"pipeline"},
    {"datasets"},
    {"formats", "studies"},
    {"api"},
    {"cli"},
]
MOST_ARROWS = 110  # from room to room, estimation counted as one


def test_the_plan_stays_small():
    """Few rooms at the top of the package, few arrows between them: a person can hold the plan in mind."""
    rooms = {p.stem for p in (ROOT / "dopslam").iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    rooms.discard("__init__")
    assert len(rooms) <= 25
    arrows = set()
    for path in (ROOT / "dopslam").rglob("*.py"):
        own = path.relative_to(ROOT / "dopslam").with_suffix("").parts[0]
        for name in imports(path):
            steps = name.split(".")
            room = "estimation" if steps[0] == "estimation" else steps[1] if name.startswith("dopslam.") else own
            if room in rooms | {"estimation"} and room != own:
                arrows.add((own, room))
    assert len(arrows) <= MOST_ARROWS


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path: Path, known: set[str]) -> set[str]:
    """Modules of this house that one imports, also inside functions and for types alone; a package's face is left out."""
    package = module_name(path) if path.name == "__init__.py" else module_name(path).rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{source}.{a.name}" if f"{source}.{a.name}" in known else source for a in node.names}
    return found & known


def test_no_files_import_each_other_in_a_circle():
    known = {module_name(path): path for path in MODULES if path.name != "__init__.py"}
    arrows = {name: imported_modules(path, set(known)) for name, path in known.items()}
    standing = dict(arrows)
    while ground := [name for name, below in standing.items() if not below & standing.keys()]:
        for name in ground:
            del standing[name]
    assert not standing, f"circles among {sorted(standing)}"


def test_rooms_import_only_from_floors_below():
    floor = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
    for path in (ROOT / "dopslam").rglob("*.py"):
        parts = path.relative_to(ROOT / "dopslam").with_suffix("").parts
        if parts == ("__init__",):
            continue
        assert parts[0] in floor, f"{path} has no floor: give its room one in FLOORS"
        for name in imports(path):
            steps = name.split(".")
            if steps[0] == "dopslam" and len(steps) > 1 and steps[1] in floor and steps[1] != parts[0]:
                assert floor[steps[1]] < floor[parts[0]], f"{path} imports {name}, which is on no floor below"


def test_help_never_imports_what_is_heavy():
    code = (
        "import sys; from dopslam.cli import main\n"
        "try: main(['run', '--help'])\n"
        "except SystemExit: pass\n"
        "print({'numpy', 'sionna', 'mitsuba', 'drjit', 'numba', 'h5py', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip().endswith("set()")
