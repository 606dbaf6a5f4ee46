"""The command line: one module and one function per verb, loaded only when called.

This is the only room that prints. Errors that a user can mend come out as one line, exit code 2.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

from cyclopts import App, CycloptsError

from dopslam.cli.failure import renamed, sentence

VERBS = {
    "new": "Write a scene folder that runs, from a kind, a floor plan, a map, a model or a builtin scene.",
    "run": "Trace, synthesize, estimate, run SLAM, bound and evaluate one scenario; leaves a results folder.",
    "simulate": "Draw a track and detections from the measurement model into a dataset file, without tracing.",
    "trace": "Drive a track through a scene and trace its paths into a dataset file.",
    "synthesize": "Add the received signal of every step (paper A, eq. 2) to a dataset file.",
    "estimate": "Estimate the paths of every snapshot: detections with their covariances.",
    "slam": "Run a SLAM filter over the detections of a dataset file.",
    "bound": "Posterior Cramér–Rao bounds of a scenario or of a dataset file.",
    "evaluate": "Compare track and map with the truth and the bound: table, summary, figures.",
    "view": "Open the report of a run: what came out, a replay in three dimensions, tables and figures.",
    "compare": "Put several runs beside each other: one table, one figure, differences on the same seeds.",
    "benchmark": "Make a frozen suite of detections with the truth apart, and run filters on it.",
    "score": "Score an answer to a suite (CSV of any program, or dataset files) beside truth and bound.",
    "montecarlo": "Many runs of a filter in parallel, beside their bounds.",
    "dataset": "Make a large dataset in shards: many positions, resumable, the same whoever makes it.",
    "check": "Say everything that is wrong with a scene, before it runs, or with a dataset.",
    "import": "Turn foreign detections (CSV, MATLAB) into a dataset file that slam runs on.",
    "export": "Write a dataset, map or run for other programs: MATLAB, DeepMIMO, TUM, SigMF, CSV, GeoJSON, glTF, PLY, MCAP, Rerun.",
    "sweep": "Repeat a Monte Carlo study over values of scenario keys: one table, one figure.",
    "scenes": "List the scenes that ship.",
    "keys": "List the keys of a scenario with their ranges and defaults.",
    "info": "Say what a dataset file holds.",
    "doctor": "Say what the ray tracer found here: LLVM, GPU, threads, versions.",
}

NUMBA_KEPT = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_THREADING_LAYER", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")

app = App(
    name="dopslam",
    help="Radio SLAM end to end: trace a scene, synthesize, estimate the channel, run SLAM, compare with bounds.",
    version_flags=["--version"],
    help_format="plaintext",
    suppress_keyboard_interrupt=False,  # it leaves with one line, below
)
app.register_install_completion_command()
for _verb, _help in VERBS.items():
    _name = "import_" if _verb == "import" else _verb  # a keyword is no module
    app.command(f"dopslam.cli.{_name}:{_name}", name=_verb, help=_help)


FIRST_HOUR = """Radio SLAM end to end. Five commands of a first hour:

  dopslam run                                    trace a shipped scene, run SLAM, leave runs/latest/report.html
  dopslam view                                   look at it: what came out, a replay, tables and figures
  dopslam new mine --kind street                 a scene of your own (or --from plan.geojson); then: dopslam run mine
  dopslam run mine --filter joint,smoother,bp    every filter on the same detections
  dopslam compare runs/latest runs/ANOTHER       two runs beside each other

All commands: dopslam --help. One of them: dopslam run --help. What is missing here: dopslam doctor.
Shell completion: dopslam --install-completion."""


def main(tokens: list[str] | None = None) -> None:
    """Run the command line; whatever happens, leave with one line and a number, never with a traceback.

    0: done. 1: done in part, results are kept and what failed is named. 2: refused or failed. 3: done, but a filter
    diverged. 130, 143: interrupted, terminated. ``DOPSLAM_DEBUG=1`` lets a fault of the program show its traceback.
    """
    # One BLAS thread a process, set before NumPy loads: parallelism is over snapshots and runs.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    _forget_settings()
    _tolerate_narrow_terminals()
    if not (sys.argv[1:] if tokens is None else tokens):
        print(FIRST_HOUR)
        return
    previous = _handled()
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        _fail(renamed(sys.argv[1:] if tokens is None else tokens) or str(error))
    except KeyboardInterrupt as error:
        _fail("; ".join(["interrupted", *getattr(error, "__notes__", ())]), 130)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except Exception as error:
        if os.environ.get("DOPSLAM_DEBUG"):
            raise
        _fail(sentence(error))
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _forget_settings() -> None:
    """Settings of other libraries that people made for other programs: figures and numbers do not follow them.

    A user's matplotlibrc (which may ask for LaTeX), numba without its compiler or with its own dumps. Library calls from
    Python are left alone.
    """
    os.environ["MATPLOTLIBRC"] = str(Path(__file__).resolve().parents[1] / "report" / "dopslam.mplstyle")
    for name in [name for name in os.environ if name.startswith("NUMBA_") and name not in NUMBA_KEPT]:
        del os.environ[name]


def _handled() -> dict[int, Any]:
    """Handle SIGTERM and SIGINT; returns the former handlers, none outside the main thread.

    An exception that unwinds through a compiler at work brings the process down. SIGTERM therefore leaves at once, workers
    first; what is half written lies beside its target under a hidden name, as after any other sudden end. SIGINT, after
    which finished results are moved into place, waits until the compiler has done; a second one leaves at once.
    """
    waiting: list[int] = []

    def end(number, _):
        _end_workers()
        os.write(2, b"dopslam: terminated\n" if number == signal.SIGTERM else b"dopslam: interrupted\n")
        os._exit(128 + number)

    def interrupt(number, frame):
        if number == signal.SIGINT and waiting:
            end(number, frame)
        if _compiling(frame):
            waiting.append(number)
            signal.setitimer(signal.ITIMER_REAL, 0.2)
        else:
            raise KeyboardInterrupt

    try:
        return {
            number: signal.signal(number, handler)
            for number, handler in ((signal.SIGTERM, end), (signal.SIGINT, interrupt), (signal.SIGALRM, interrupt))
        }
    except ValueError:
        return {}


def _compiling(frame: FrameType | None) -> bool:
    while frame is not None:
        if f"{os.sep}numba{os.sep}" in frame.f_code.co_filename or "llvmlite" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


def _tolerate_narrow_terminals() -> None:
    """A terminal that knows few characters shows others as question marks; it is no reason to fail after the work."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError, OSError):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]


def _fail(message: str, code: int = 2) -> None:
    with contextlib.suppress(ValueError):  # a second one finds the leaving under way
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    _end_workers()
    print("dopslam: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(code)


def _end_workers() -> None:
    """End worker processes that were started, so that none outlives the command."""
    loky = sys.modules.get("joblib.externals.loky.reusable_executor")
    executor = getattr(loky, "_executor", None)
    if executor is not None:
        for pid in list(getattr(executor, "_processes", None) or ()):
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
