"""Attacks drawn at random: whatever comes in, a command succeeds or leaves with one line, never with a traceback.

Every attack is a command line on small files, run in a forked process with a limit of time. Allowed are success, and
exit code 2 (1 and 3 where results are kept) with one line on standard error that names the file or the key. A target is
whole or absent, and what was written passes ``dopslam check``. Long runs::

    python tests/test_fuzz.py --first 0 --count 5000 [--kind keys]
"""

import argparse
import contextlib
import csv
import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import h5py
import numpy as np
import pytest
import tomli_w
from pydantic import BaseModel

from dopslam.config.scenario import Scenario, load
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths, Track

LIMIT = 40.0  # s of processor time for one attack on a small file; ordinary ones take less than one
MEMORY = 6 << 30  # bytes of address space beyond which an attack counts as unbounded
SMALL = (
    "track.steps=4", "filter.particles=50", "radio.subcarriers=24", "radio.comb=60",
    "radio.beams={ beams = 4, sweeps = 4, seed = 0 }", "receiver.array={ kind = 'cylinder', columns = 4, rings = 1 }",
    "base_station.array={ kind = 'planar', columns = 4, rows = 1 }", "trace.samples=1000",
)  # fmt: skip


# ---- what comes in ---------------------------------------------------------------------------------------------------

NUMBERS = [
    "nan", "inf", "-inf", "0", "-0.0", "1", "-1", "2", "3", "0.5", "1e-320", "1e-300", "1e-30", "1e-12", "1e-6", "1e6",
    "1e9", "1e12", "1e30", "1e300", "-1e300", "1000000", "1000000000", "9223372036854775807", "9223372036854775808",
    "18446744073709551616", "-9223372036854775809",
]  # fmt: skip
ODD = [
    "true", "false", "''", "'a'", '"\\u0000"', "'snow ❄ 雪 é'", "'[bold]x[/]'", "'../../x'", "'a\"b'", "[]", "[1]",
    "[[]]", "[1, 2, 3, 4, 5, 6, 7]", "[[1, 2], [3]]", "['a', 'b', 'c', 'd']", "{}", "{kind = 'drive'}", "{a = 1}", "1979-05-27",
    "[nan, 0, 0, 0]", "[1e308, 1e308, 1e308, 1e308]", "[0, 0, 0]", "[0, 0]", "[0, 0, 0, 0]", "[1e6, 1e6, 1e6]",
    "[" * 300 + "]" * 300, "'" + "x" * 5000 + "'", "", "=", "word",
]  # fmt: skip


def keys_of(model: type[BaseModel], prefix: str = "") -> dict[str, Any]:
    """Every key of a model, with dots, and what pydantic knows of it."""
    found: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        found[prefix + name] = field
        for inner in models_in(field.annotation):
            found |= keys_of(inner, f"{prefix}{name}.")
    return found


def models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is tuple:
        return []
    return [m for part in get_args(annotation) for m in models_in(part)]


def value_for(field: Any, rng: np.random.Generator) -> str:
    """A value in TOML: odd, extreme, at the edge of what is allowed, or another of the allowed."""
    kind = rng.integers(6)
    if kind == 0:
        return str(rng.choice(ODD))
    if kind == 1:
        return str(rng.choice(NUMBERS))
    return toml_of(allowed(field.annotation, list(field.metadata), rng))


def toml_of(value: Any) -> str:
    return tomli_w.dumps({"v": value}).partition("=")[2].strip() if value is not None else "''"


def allowed(annotation: Any, metadata: list, rng: np.random.Generator) -> Any:
    """Something of the right type, mostly at the edge of its range."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return allowed(args[0], [*args[1:], *metadata], rng)
    if origin is Literal:
        return args[rng.integers(len(args))]
    if origin is tuple:
        if len(args) == 2 and args[1] is Ellipsis:
            return [allowed(args[0], [], rng) for _ in range(rng.integers(0, 5))]
        return [allowed(part, [], rng) for part in args]
    if origin in (Union, type(int | str)):
        choices = [part for part in args if part is not type(None)]
        return allowed(choices[rng.integers(len(choices))], metadata, rng)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        filled = {
            name: allowed(field.annotation, list(field.metadata), rng)
            for name, field in annotation.model_fields.items()
            if field.is_required() or rng.integers(3) == 0
        }
        return {name: value for name, value in filled.items() if value is not None}
    if annotation is bool:
        return bool(rng.integers(2))
    if annotation in (int, float):
        return number(annotation, metadata, rng)
    if origin is dict:
        return {"concrete": "glass"}
    return str(rng.choice(["x", "a b", "é", "scene.xml", "CON", "-", "%s", "a/b", "[b]"]))


def number(annotation: type, metadata: list, rng: np.random.Generator) -> Any:
    low, high = -1e9, 1e9
    for item in (inner for m in metadata for inner in (getattr(m, "metadata", None) or [m])):
        low = max([low, *(v for n in ("ge", "gt") if (v := getattr(item, n, None)) is not None)])
        high = next((v for n in ("le", "lt") if (v := getattr(item, n, None)) is not None), high)
    edges = [low, high, low + 1e-9, high * (1 - 1e-12), low / 2 + high / 2, *(10.0 ** rng.uniform(-12, 12, 6)), *rng.uniform(-3, 3, 4)]  # fmt: skip
    value = edges[rng.integers(len(edges))]
    value = min(max(value, low), high)
    return int(value) if annotation is int else float(value)


KEYS = keys_of(Scenario)


def settings(rng: np.random.Generator, keys: list[str]) -> list[str]:
    """One to three overrides."""
    chosen = rng.choice(keys, size=rng.integers(1, 4), replace=False)
    made = [f"{key}={value_for(KEYS[key], rng)}" for key in map(str, chosen)]
    if rng.integers(12) == 0:
        made.append(str(rng.choice(["", "=", "a", "track", "track.speed", ".=1", "a.b.c=1", "track.speed.x=1", "name=", "track..speed=1", "trak.speed=1"])))  # fmt: skip
    return made


@dataclass(frozen=True)
class Material:
    """Small files that attacks start from."""

    drawn: Path  # a dataset file drawn from the model, filtered, bounded
    traced: Path  # one with paths, for the estimator
    table: Path
    mapping: Path
    track: Path


@dataclass(frozen=True)
class Attack:
    """A sequence of commands, the words of which one must stand in a refusal, and targets that are whole or absent."""

    commands: list[list[str]]
    names: tuple[str, ...]
    targets: tuple[Path, ...] = ()


def keys_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """Keys of every table, through the stages that read them."""
    path, change = here / "d.h5", settings(rng, list(KEYS))
    for_all = [part for setting in (*SMALL, *change) for part in ("--set", setting)]
    mine = [part for setting in change for part in ("--set", setting)]
    route = rng.integers(7)
    if route <= 1:
        seed = ["--seed", str(rng.integers(100))]
        commands = [["simulate", "ring_road", "--out", path, *seed, "--set", "source.kind=model", *for_all]]
        commands += [["slam", path, "--filter", str(rng.choice(["joint", "marginal", "bp"]))], ["bound", path], ["check", path], ["evaluate", path]]  # fmt: skip
    elif route == 2:
        commands = [["bound", "ring_road", *for_all]]
    elif route == 3:
        filters = str(rng.choice(["joint", "marginal", "smoother", "bp"]))
        where = "pedestrian" if filters == "bp" else "ring_road"
        commands = [["montecarlo", where, "--runs", "1", "--jobs", "1", "--filter", filters, *for_all]]
    elif route == 4:
        shutil.copy(have.traced, path)
        commands = [["estimate", path, "--jobs", "1", *mine], ["slam", path, *mine], ["check", path]]
    elif route == 5:
        shutil.copy(have.traced, path)
        commands = [["synthesize", path, *mine], ["estimate", path, "--jobs", "1"], ["check", path]]
    else:
        shutil.copy(have.drawn, path)
        verb = str(rng.choice(["slam", "bound", "evaluate"]))
        commands = [[verb, path, *mine], ["check", path]]
    return Attack(commands, named(change), (path,))


def named(change: list[str]) -> tuple[str, ...]:
    """Words of which a refusal of these overrides must have one."""
    last = [setting.partition("=")[0].strip() for setting in change]
    return tuple(word for key in last for word in key.split(".") if word) or ("--set",)


def mutated_text(text: str, rng: np.random.Generator) -> str:
    """Lines and fields of a text damaged."""
    for _ in range(rng.integers(1, 4)):
        lines = text.split("\n")
        at = int(rng.integers(len(lines)))
        match rng.integers(9):
            case 0:
                lines[at] = ""
            case 1:
                lines[at] = lines[at] + ",1"
            case 2:
                cells = lines[at].split(",")
                cells[rng.integers(len(cells))] = str(
                    rng.choice([*NUMBERS, "", "x", " ", "1,5", '"', "é", "0x10", "--1"])
                )
                lines[at] = ",".join(cells)
            case 3:
                lines.insert(at, lines[rng.integers(len(lines))])
            case 4:
                del lines[at:]
            case 5:
                lines = lines[:at] + lines[at + 1 :]
            case 6:
                lines[at] = lines[at].replace(",", str(rng.choice([";", "\t", " ", ",,", "\0"])))
            case 7:
                lines[at] = "9" * 200_000
            case _:
                lines[0] = str(rng.choice(["", "\ufeff" + lines[0], lines[0].upper(), lines[0] + ",t", "#" + lines[0]]))
        text = "\n".join(lines)
    return text


def table_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """A foreign table, its mapping and its track, damaged."""
    table, mapping, track, path = here / "t.csv", here / "m.toml", here / "tr.csv", here / "d.h5"
    for source, target in ((have.table, table), (have.mapping, mapping), (have.track, track)):
        shutil.copy(source, target)
    spoiled = [table, mapping, track][rng.integers(3)]
    if spoiled == mapping and rng.integers(2):
        tree = tomllib.loads(mapping.read_text())
        sections = [*tree, "assumed", "noise_floor_db", "x"]
        section = str(rng.choice(sections))
        key = str(rng.choice(["delay", "aoa_azimuth", "aod_elevation", "doppler", "power", "snr", "step", "time", "uplink", "elevation", "y"]))  # fmt: skip
        odd = [v for v in ODD if v and v not in ("=", "word") and "[[[" not in v]
        value = tomllib.loads(f"v = {rng.choice([*NUMBERS, *odd])}")["v"]
        if section in tree and isinstance(tree[section], dict) and rng.integers(4):
            tree[section][key] = value
        else:
            tree[section] = value
        mapping.write_text(tomli_w.dumps(tree), encoding="utf-8")
    else:
        spoiled.write_text(mutated_text(spoiled.read_text(encoding="utf-8"), rng), encoding="utf-8")
    if rng.integers(4) == 0:
        table = here / "t.mat"
        spoiled = table
        from scipy.io import savemat

        read = np.genfromtxt(have.table, delimiter=",", names=True)
        savemat(table, {name: read[name] for name in read.dtype.names or ()})
        data = bytearray(table.read_bytes())
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        table.write_bytes(bytes(data))
    bring = ["import", table, "--map", mapping, "--scene", "ring_road", "--out", path]
    bring += ["--track", track] if rng.integers(2) else []
    return Attack([bring, ["slam", path], ["check", path]], (spoiled.name, track.name, mapping.name, table.name, path.name), (path,))  # fmt: skip


def dataset_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """A dataset file that somebody else wrote: wrong shapes, types, values, parts missing, bits flipped."""
    path = here / "d.h5"
    source = have.drawn if rng.integers(3) else have.traced
    shutil.copy(source, path)
    if rng.integers(3) == 0:
        data = bytearray(path.read_bytes())
        for _ in range(rng.integers(1, 30)):
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(data[: rng.integers(len(data))] if rng.integers(6) == 0 else data))
    else:
        with h5py.File(path, "r+") as file:
            for group in list(file):
                file[group].attrs.pop("sha256", None)
            for _ in range(rng.integers(1, 3)):
                spoil(file, rng)
    verb = str(rng.choice(["info", "check", "slam", "bound", "evaluate", "export", "estimate", "synthesize"]))
    command: list[Any] = [verb, path]
    if verb == "export":
        command += ["--to", str(rng.choice(["mat", "deepmimo", "tum", "sigmf", "csv", "drives"])), "--out", here / "e"]
    if verb == "slam":
        command += ["--filter", str(rng.choice(["joint", "bp"]))]
    if verb == "evaluate":
        command += ["--out", here / "e"]
    return Attack([command], (path.name, "dataset"), ())


def spoil(file: h5py.File, rng: np.random.Generator) -> None:
    """One fault in a dataset file."""
    group = str(rng.choice(list(file)))
    node = file[group]
    if not isinstance(node, h5py.Group):
        return
    name = str(rng.choice(list(node)))
    data = node[name]
    match rng.integers(10):
        case 0:
            del node[name]
        case 1:
            node.move(name, name + "x")
        case 2:
            del file[group]
            file[group] = rng.normal(size=3)
        case 3:
            del node[name]
            node[name] = np.array(["a", "b"], dtype=h5py.string_dtype())
        case 4:
            shape = data.shape
            del node[name]
            node[name] = np.zeros(tuple(rng.integers(0, 6, rng.integers(0, 4))) if rng.integers(2) else (*shape, 2))
        case 5 | 6 | 7:
            if data.size and data.dtype.kind in "iufc" and data.shape:
                value = np.array(data[()])
                flat, small = value.reshape(-1), value.dtype.itemsize < 4
                whole = [-1, 99, 127] if small else [-1, -5, 99, 2**31 - 1]
                odd = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-320, 0.0, -1.0, 1e9]
                with np.errstate(over="ignore"):  # single precision makes an infinity of it
                    flat[rng.integers(flat.size)] = rng.choice(whole if value.dtype.kind in "iu" else odd)
                data[...] = value
        case 8:
            target = file if rng.integers(2) else node
            names = list(target.attrs)
            if names:
                target.attrs[str(rng.choice(names))] = rng.choice([np.nan, -1.0, 1e300, 0.0])
        case _:
            target = file if rng.integers(2) else node
            names = list(target.attrs)
            if names:
                key = str(rng.choice(names))
                del target.attrs[key]
                if rng.integers(2):
                    target.attrs[key] = [b"\xff\xfe", "x", np.zeros(3), np.int64(2**62)][rng.integers(4)]


def folder_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """A manifest whose keys are spoiled."""
    folder = here / "ds"
    folder.mkdir()
    plan = {
        "name": "x", "scenario": load("ring_road").to_toml(), "seed": 0, "positions": 5, "shard_positions": 3,
        "signal": False, "detections": False, "tracks_sha256": "",
    }  # fmt: skip
    tree: dict[str, Any] = {
        "schema": "dopslam-dataset", "version": 1, "complete": False, "plan": plan, "shards": [], "landmarks": [], "sha256": "",
    }  # fmt: skip
    target = tree if rng.integers(3) == 0 else plan
    key = str(rng.choice(list(target)))
    target[key] = [None, -1, 0, 1, 10**12, 2**70, 1.5, "x", [], {}, [1], True, {"a": 1}, "é\0"][rng.integers(14)]
    (folder / "manifest.json").write_text(json.dumps(tree) if rng.integers(5) else json.dumps(tree)[: rng.integers(99)])
    (folder / "shard-00000.h5").write_bytes(have.drawn.read_bytes())
    verbs: list[list[Any]] = [
        ["check", folder],
        ["export", folder, "--to", str(rng.choice(["mat", "csv", "tum", "deepmimo"])), "--out", here / "e"],
        ["info", folder],
    ]
    return Attack([verbs[rng.integers(3)]], ("manifest.json", "ds", "shard"), ())


def tracks_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """A track file and the tables of drives and sweeps."""
    if rng.integers(2):
        track = here / "tr.csv"
        track.write_text(mutated_text(have.track.read_text(), rng), encoding="utf-8")
        command = ["import", have.table, "--map", have.mapping, "--scene", "ring_road", "--out", here / "d.h5", "--track", track]  # fmt: skip
        return Attack([command], (track.name, have.table.name), (here / "d.h5",))
    file = here / "s.toml"
    tree: dict[str, Any] = {
        "scenario": "ring_road",
        "runs": 1,
        "seed": 0,
        "set": list(SMALL),
        "vary": {"track.speed": [1.0]},
    }
    place = rng.integers(3)
    if place == 0:
        key = str(rng.choice([*tree, "filter", "source", "x"]))
        tree[key] = [-1, 0, 2**64, 1.5, "x", [], {}, [1], True, {"a": 1}, "bp", 10**9][rng.integers(12)]
    else:
        key = str(rng.choice(list(KEYS)))
        tree["vary"] = {key: [tomllib.loads(f"v = {number}")["v"] for number in rng.choice(NUMBERS, 2)]}
        if place == 2:
            tree["vary"][key] = [allowed(KEYS[key].annotation, list(KEYS[key].metadata), rng)]
    with contextlib.suppress(TypeError, RecursionError):
        file.write_text(tomli_w.dumps(tree) if rng.integers(6) else tomli_w.dumps(tree)[: rng.integers(200)])
    return Attack([["sweep", file, "--out", here / "o", "--jobs", "1"]], (file.name, *tree["vary"]) if isinstance(tree.get("vary"), dict) else (file.name,))  # fmt: skip


WORDS = [
    "run", "bound", "slam", "--set", "--seed", "-1", "1e400", "--out", "/proc/x", "/", ".", "", "é", "ring_road", "--filter",
    "bp", "joint", "--doppler-std", "nan", "none", "inf", "--visibility", "--runs", "0", "-5", "--jobs", "--json", "--csv",
    "--help", "--version", "--", "-", "=", "\udce9", "--particles", "--prior", "std", "--set=track.speed=nan", "[/x]", "\n",
]  # fmt: skip


def options_attack(rng: np.random.Generator, have: Material, here: Path) -> Attack:
    """Options that make no sense, on verbs that do little."""
    path = here / "d.h5"
    shutil.copy(have.drawn, path)
    heads: list[list[Any]] = [
        ["bound", "ring_road"], ["slam", path], ["evaluate", path, "--out", here / "o"], ["check", path], ["info", path],
        ["export", path, "--to", "csv", "--out", here / "e"], ["montecarlo", "ring_road", "--runs", "1", "--jobs", "1"],
        ["simulate", "ring_road", "--out", here / "n.h5"], ["scenes"], ["sweep"], ["import"], [],
    ]  # fmt: skip
    head = heads[rng.integers(len(heads))]
    tail = [str(rng.choice(WORDS)) for _ in range(rng.integers(1, 4))]
    tail = ["-" if word in ("run", "/") else word for word in tail]  # nothing long, nothing outside of here
    return Attack([[*head, *tail]], ())


ATTACKS = {
    "keys": keys_attack, "tables": table_attack, "datasets": dataset_attack, "folders": folder_attack,
    "tracks": tracks_attack, "options": options_attack,
}  # fmt: skip


# ---- what comes out --------------------------------------------------------------------------------------------------


def run(command: list[Any], here: Path) -> tuple[int, str]:
    """Run a command in a forked process; its exit code (minus the signal that ended it) and standard error."""
    said = here / "stderr.txt"
    pid = os.fork()
    if pid == 0:
        _child(command, here, said)
    deadline = time.monotonic() + 10 * LIMIT  # a sleeper uses no processor time
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.005)
    code = os.waitstatus_to_exitcode(status)
    return code, said.read_text(encoding="utf-8", errors="replace") if said.exists() else ""


def _child(command: list[Any], here: Path, said: Path) -> None:
    code = 99
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + LIMIT),) * 2)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os.chdir(here)
        with open(said, "wb") as errors, open(os.devnull, "wb") as quiet:
            os.dup2(errors.fileno(), 2)
            os.dup2(quiet.fileno(), 1)
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115
        faulthandler.enable()
        from dopslam.cli import main

        try:
            main([str(token) for token in command])
            code = 0
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else 0 if left.code is None else 98
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        import traceback

        os.write(2, traceback.format_exc().encode(errors="replace"))
        code = 97
    finally:
        os._exit(code)


def faults(attack: Attack, here: Path) -> list[str]:
    """What is wrong with the way an attack ended."""
    for command in attack.commands:
        code, said = run(command, here)
        lines = [line for line in said.splitlines() if line.strip() and not _progress(line)]
        text = " ".join(map(str, command))[:400]
        if code not in (0, 1, 2, 3):
            what = {-signal.SIGXCPU: "hangs", -signal.SIGKILL: "hangs", -signal.SIGSEGV: "crashes"}.get(code, f"leaves with {code}")  # fmt: skip
            return [f"{what}: {text}: {' / '.join(lines[-4:])}"]
        if "Traceback" in said or "a fault of dopslam" in said:
            return [f"unforeseen: {text}: {' / '.join(lines[-3:])}"]
        if code == 1 and command[0] not in ("run", "doctor"):
            return [f"exit code 1: {text}: {' / '.join(lines[-3:])}"]
        if code == 2:
            if len(lines) != 1 or not lines[0].startswith("dopslam: "):
                return [f"{len(lines)} lines: {text}: {' / '.join(lines[:4])}"]
            if attack.names and not any(name in lines[0] for name in (*attack.names, "--set")):
                return [f"names nothing: {text}: {lines[0][:300]}"]
            left = [p.name for p in here.rglob("*") if p.name.endswith(".part") or p.name.startswith(".")]
            if left:
                return [f"leaves {left}: {text}"]
            return []
        if code == 0 and lines:
            return [f"says on success: {text}: {' / '.join(lines[:3])}"]
    return []


def _progress(line: str) -> bool:
    """Whether a line is the last state of a progress bar."""
    return "━" in line or "╸" in line or "0:00:" in line or "-:--:--" in line


def attack_with(seed: int, have: Material, kind: str | None = None) -> tuple[str, list[str]]:
    """Draw an attack, carry it out in a folder of its own, judge it."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(13,)))
    kind = kind or list(ATTACKS)[seed % len(ATTACKS)]
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        here = Path(folder)
        return kind, faults(ATTACKS[kind](rng, have, here), here)


# ---- material --------------------------------------------------------------------------------------------------------


def small_paths(scenario: Scenario, track: Track) -> tuple[Landmarks, Paths]:
    """Line of sight and scattered paths by hand."""
    from dopslam.pipeline import problem as build

    landmarks = build.model_landmarks(scenario)
    bs, count = landmarks.position[0], len(landmarks)
    rows = [(step, mark) for step in range(track.steps) for mark in range(count)]
    last = np.array([landmarks.position[mark] for _, mark in rows])
    place = np.array([track.position[step] for step, _ in rows])
    first = np.array([landmarks.position[mark] if mark else track.position[step] for step, mark in rows])
    bounced = np.array([mark > 0 for _, mark in rows])
    length = np.linalg.norm(place - last, axis=1) + np.linalg.norm(last - bs, axis=1)

    def angles(vector):
        return np.arccos(vector[:, 2] / np.linalg.norm(vector, axis=1)), np.arctan2(vector[:, 1], vector[:, 0])

    (theta_t, phi_t), (theta_r, phi_r) = angles(first - bs), angles(last - place)
    arrival = (last - place) / np.linalg.norm(last - place, axis=1)[:, None]
    speed = np.sum(np.repeat(track.velocity, count, axis=0) * arrival, axis=1)
    return landmarks, Paths(
        offsets=count * np.arange(track.steps + 1),
        landmark=np.array([mark for _, mark in rows]),
        a=0.0107 / (4 * np.pi * length) + 0j,
        tau=length / SPEED_OF_LIGHT,
        theta_t=theta_t, phi_t=phi_t, theta_r=theta_r, phi_r=phi_r,
        doppler=speed * 28e9 / SPEED_OF_LIGHT,
        vertex_offsets=np.concatenate([[0], np.cumsum(bounced)]),
        vertices=last[bounced],
    )  # fmt: skip


def make_material(folder: Path) -> Material:
    """Small files, made by the program itself; everything that is compiled is loaded once, here."""
    from dopslam.cli import main
    from dopslam.pipeline import file as stages
    from dopslam.pipeline import problem as build
    from dopslam.pipeline.stages import draw_track
    from dopslam.records import DetectionSeries
    from dopslam.store import file as dataset

    drawn, traced = folder / "drawn.h5", folder / "traced.h5"
    stages.simulate(drawn, load("ring_road", ["source.kind=model", *SMALL]), 3)
    for density in ("joint", "bp"):
        stages.slam(drawn, (), density)
    for doppler in (True, False):
        stages.bound(drawn, (), doppler)
    stages.evaluate(drawn)
    scenario = load("ring_road", ["source.traced.transmit_power_dbm=40", *SMALL])
    track = draw_track(scenario, 3)
    landmarks, paths = small_paths(scenario, track)
    records = {
        "base_stations": build.base_stations(scenario), "track": track, "landmarks": landmarks, "paths": paths,
    }  # fmt: skip
    dataset.write_records(traced, records, scenario.to_toml(), 3)
    stages.estimate(traced)
    stages.slam(traced)
    stages.bound(traced)
    stages.evaluate(traced)
    detections = dataset.read_record(drawn, "detections", DetectionSeries)
    table, mapping, truth = folder / "t.csv", folder / "m.toml", folder / "tr.csv"
    columns = {
        "t": 0.5 * (1 + detections.step_of_row), "toa": detections.delay * 1e9, "phi": detections.aoa[:, 0],
        "th": detections.aoa[:, 1], "pa": detections.aod[:, 0], "pe": detections.aod[:, 1], "v": detections.radial_velocity,
        "snr": 100 + 0 * detections.delay,
    }  # fmt: skip
    real = dataset.read_record(drawn, "track", Track)
    rows = {
        "time": real.time,
        "x": real.position[:, 0],
        "y": real.position[:, 1],
        "heading": real.heading,
        "bias": real.bias,
    }
    for file, content in ((table, columns), (truth, rows)):
        with open(file, "w", newline="", encoding="utf-8") as target:
            writer = csv.writer(target)
            writer.writerow(content)
            writer.writerows(np.column_stack(list(content.values())).tolist())
    mapping.write_text("""[columns]
time = "t"
delay = "toa"
aoa_azimuth = "phi"
aoa_elevation = "th"
aod_azimuth = "pa"
aod_elevation = "pe"
radial_velocity = "v"
snr = "snr"
[units]
delay = "ns"
[std]
delay = 0.3
aoa_azimuth = 0.05
aoa_elevation = 0.05
aod_azimuth = 0.05
aod_elevation = 0.05
radial_velocity = 0.1
""")
    with contextlib.suppress(SystemExit), open(os.devnull, "w") as quiet, contextlib.redirect_stdout(quiet):
        main(["montecarlo", "pedestrian", "--runs", "1", "--jobs", "1", "--filter", "bp", *(p for s in SMALL for p in ("--set", s))])  # fmt: skip
    return Material(drawn, traced, table, mapping, truth)


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    return make_material(tmp_path_factory.mktemp("material"))


@pytest.mark.mc
@pytest.mark.parametrize("kind", list(ATTACKS))
def test_attacks_end_well_or_in_one_line(material, kind):
    wrong = []
    for seed in range(1000, 1006):
        wrong += [f"seed {seed}: {fault}" for fault in attack_with(seed, material, kind)[1]]
    assert not wrong, "\n".join(wrong)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--kind", choices=list(ATTACKS))
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-material-") as folder:
        have = make_material(Path(folder))
        for seed in range(given.first, given.first + given.count):
            start = time.monotonic()
            kind, wrong = attack_with(seed, have, given.kind)
            took = time.monotonic() - start
            counts[f"{kind} {'wrong' if wrong else 'well'}"] += 1
            for fault in wrong:
                print(f"{seed} {kind} {took:.1f} s: {fault}", flush=True)
            if took > 20 and not wrong:
                print(f"{seed} {kind} {took:.1f} s: slow", flush=True)
    print(dict(counts))


if __name__ == "__main__":
    main()
