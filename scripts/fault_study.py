"""How datasets stand up to faults: damaged files, kills at random moments, full and read-only disks, company.

    python scripts/fault_study.py mutate [--files 500] [--seed 0]
    python scripts/fault_study.py kill [--times 20] [--seed 0] [--scene ring_road] [--positions 4000]
    python scripts/fault_study.py disk --small FOLDER [--read-only FOLDER] [--positions 2000]
    python scripts/fault_study.py share [--times 3] [--positions 2000]

``mutate`` damages a dataset file (flipped bits, overwritten, zeroed, removed, inserted and swapped ranges, truncation)
and reads each copy in a process of its own: allowed are the one documented error or exactly the old content. The others
run ``dopslam dataset`` and compare the manifest with that of an undisturbed run: ``kill`` sends SIGKILL at random
moments and resumes until that many processes have died; ``disk`` fills a small file system (a mounted one of some
megabytes) to the brim at random, wants exit code 2 with one line, makes room and resumes; ``share`` lets two processes
work on one folder. One line of JSON each; exit code 1 if anything else happened.
"""

import argparse
import faulthandler
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from dopslam.errors import DatasetError
from dopslam.records import DetectionSeries, Landmarks, Paths, Track
from dopslam.store import file as dataset

TYPES = {kind.__name__: kind for kind in (Track, Landmarks, Paths, DetectionSeries)}
TIMEOUT = 60  # s, for reading one small file
FILE = "manifest.json"  # not imported: every reading process would load the whole package


def make_file(path: Path) -> None:
    """A small dataset file with every kind of record, drawn from the measurement model, and a signal."""
    from dopslam.config.scenario import load
    from dopslam.pipeline import file as stages

    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=10"]), 0)
    rng, count = np.random.default_rng(0), 60
    names = ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler")
    columns = {name: rng.normal(size=count) for name in names}
    offsets = np.arange(0, count + 1, count // 10)
    paths = Paths(
        offsets, np.arange(count) % 9, rng.normal(size=count) + 0j, vertex_offsets=np.arange(count + 1),
        vertices=rng.normal(size=(count, 3)), **columns,
    )  # fmt: skip
    dataset.write_record(path, "paths", paths)
    dataset.write_signal(path, rng.normal(size=(10, 8, 4, 2)).astype(np.complex64), 10)


def content(path: Path) -> dict:
    """Everything a reader gets from the file, as hashes."""
    found = {"root": dataset.read_root(path)}
    for group, name in (
        ("track", "Track"),
        ("landmarks", "Landmarks"),
        ("paths", "Paths"),
        ("detections", "DetectionSeries"),
    ):
        found[group] = dataset.content_hash(dataset.read_record(path, group, TYPES[name]))
    found["signal"] = [dataset.read_snapshot(path, step).tobytes() for step in range(dataset.signal_steps(path))]
    return found


def mutated(whole: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy."""
    data, size = bytearray(whole), len(whole)
    at = int(rng.integers(size))
    span = int(min(size - at, 2 ** rng.integers(0, 13)))
    match rng.integers(7):
        case 0:
            data[at] ^= 1 << int(rng.integers(8))
        case 1:
            data[at : at + span] = rng.bytes(span)
        case 2:
            data[at : at + span] = bytes(span)
        case 3:
            del data[at : at + span]
        case 4:
            data[at:at] = rng.bytes(span)
        case 5:
            other = int(rng.integers(size - span + 1))
            data[at : at + span], data[other : other + span] = data[other : other + span], data[at : at + span]
        case _:
            del data[at:]
    return bytes(data)


def _read(path: Path, expected: dict, answers) -> None:
    faulthandler.dump_traceback_later(TIMEOUT - 5, exit=True)
    try:
        answers.put("same" if content(path) == expected else "CHANGED SILENTLY")
    except DatasetError:
        answers.put("error")
    except BaseException as error:
        answers.put(f"{type(error).__name__}: {error}")


def mutate(files: int, seed: int) -> dict:
    """Counts of what happened to the files."""
    rng, counts, wrong = np.random.default_rng(seed), {"error": 0, "same": 0}, []
    context = get_context("forkserver")  # a clean parent: a fork of this process may inherit a held lock
    context.set_forkserver_preload(["dopslam.store.file"])
    with tempfile.TemporaryDirectory() as folder:
        original, copy = Path(folder) / "d.h5", Path(folder) / "m.h5"
        make_file(original)
        whole, expected = original.read_bytes(), content(original)
        for number in range(files):
            copy.write_bytes(mutated(whole, rng))
            answers = context.SimpleQueue()
            reader = context.Process(target=_read, args=(copy, expected, answers))
            reader.start()
            reader.join(TIMEOUT)
            if reader.is_alive():
                reader.kill()
                reader.join()
                result = "HUNG"
            else:
                result = answers.get() if reader.exitcode == 0 and not answers.empty() else f"CRASHED {reader.exitcode}"
            if result in counts:
                counts[result] += 1
            else:
                wrong.append(f"file {number}: {result}")
    return {"files": files, "seed": seed, **counts, "wrong": wrong}


def command(scene: str, positions: int) -> list[str]:
    """``dopslam dataset`` in small shards; the folder follows."""
    program = [sys.executable, "-c", "from dopslam.cli import main; main()", "dataset", scene]
    settings = ["--set", "trace.samples=20000", "--set", "dataset.shard_positions=200"]
    return [*program, "--positions", str(positions), *settings, "--resume", "--out"]


def differences(folder: Path, calm: Path) -> list[str]:
    """What differs from the undisturbed folder: the manifest, or files that one has alone."""
    same = (folder / FILE).read_bytes() == (calm / FILE).read_bytes()
    names = set(os.listdir(folder)) ^ set(os.listdir(calm))
    return ([] if same else ["another manifest"]) + [f"only in one: {name}" for name in sorted(names)]


def kill(times: int, seed: int, scene: str, positions: int) -> dict:
    """Kill, resume, compare."""
    rng, killed, finished, wrong, survivors = np.random.default_rng(seed), 0, 0, [], []
    program = command(scene, positions)
    with tempfile.TemporaryDirectory() as place:
        calm, stormy = Path(place) / "calm", Path(place) / "stormy"
        started = time.perf_counter()
        subprocess.run([*program, str(calm)], check=True, capture_output=True)
        whole = time.perf_counter() - started
        while killed < times:
            process = subprocess.Popen([*program, str(stormy)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(rng.uniform(0, whole))
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            killed += process.wait() == -signal.SIGKILL
            survivors.append(len(list(stormy.glob("shard-*.h5"))))
            if (stormy / FILE).exists() and json.loads((stormy / FILE).read_text())["complete"]:
                finished += 1
                wrong += differences(stormy, calm)
                shutil.rmtree(stormy)
        subprocess.run([*program, str(stormy)], check=True, capture_output=True)
        wrong += differences(stormy, calm)
    return {"killed": killed, "finished_before": finished, "shards_after_each": survivors, "wrong": wrong}


def disk(small: Path, read_only: Path | None, times: int, seed: int, scene: str, positions: int) -> dict:
    """Fill the disk, run into its end, make room, resume, compare."""
    rng, refused, wrong = np.random.default_rng(seed), 0, []
    program = command(scene, positions)

    def refusal(folder: Path) -> str:
        done = subprocess.run([*program, str(folder)], capture_output=True, text=True, check=False)
        lines = [line for line in done.stderr.splitlines() if line.startswith("dopslam:")]
        return "" if done.returncode == 2 and len(lines) == 1 else f"exit {done.returncode}: {done.stderr[-200:]}"

    with tempfile.TemporaryDirectory() as place:
        calm, folder, filler = Path(place) / "calm", small / "d", small / "filler"
        subprocess.run([*program, str(calm)], check=True, capture_output=True)
        size = sum(p.stat().st_size for p in calm.iterdir())
        for _ in range(times):
            room = int(rng.uniform(0, 0.9) * size)
            filler.write_bytes(bytes(max(0, shutil.disk_usage(small).free - room)))
            refused += not (fault := refusal(folder))
            wrong += [fault] if fault else []
            filler.unlink()
            subprocess.run([*program, str(folder)], check=True, capture_output=True)
            wrong += differences(folder, calm)
            shutil.rmtree(folder)
        if read_only is not None:
            wrong += [fault] if (fault := refusal(read_only / "d")) else []
    return {"full": times, "refused_in_one_line": refused, "read_only": read_only is not None, "wrong": wrong}


def share(times: int, scene: str, positions: int) -> dict:
    """Two processes on one folder."""
    program, wrong = command(scene, positions), []
    with tempfile.TemporaryDirectory() as place:
        calm = Path(place) / "calm"
        subprocess.run([*program, str(calm)], check=True, capture_output=True)
        for number in range(times):
            folder = Path(place) / f"shared-{number}"
            pair = [
                subprocess.Popen([*program, str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
                for _ in range(2)
            ]
            for process in pair:
                _, errors = process.communicate()
                wrong += [errors.decode()[-200:]] if process.returncode else []
            wrong += differences(folder, calm)
    return {"pairs": times, "wrong": wrong}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=["mutate", "kill", "disk", "share"])
    parser.add_argument("--files", type=int, default=500)
    parser.add_argument("--times", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", default="ring_road")
    parser.add_argument("--positions", type=int)
    parser.add_argument("--small", type=Path)
    parser.add_argument("--read-only", type=Path)
    o = parser.parse_args()
    if o.study == "mutate":
        result = mutate(o.files, o.seed)
    elif o.study == "kill":
        result = kill(o.times or 20, o.seed, o.scene, o.positions or 4000)
    elif o.study == "share":
        result = share(o.times or 3, o.scene, o.positions or 2000)
    elif o.small is None:
        parser.error("disk needs --small FOLDER, on a file system of some megabytes")
    else:
        result = disk(o.small, o.read_only, o.times or 4, o.seed, o.scene, o.positions or 2000)
    print(json.dumps(result))
    sys.exit(bool(result["wrong"]))
