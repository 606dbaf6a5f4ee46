"""The command line: one module and one function per verb, loaded only when called.

This is the only room that prints. Errors that a user can mend come out as one line, exit code 2.
"""

from __future__ import annotations

import os
import sys

from cyclopts import App, CycloptsError

VERBS = {
    "run": "Trace, synthesize, estimate, run SLAM, bound and evaluate one scenario; leaves a results folder.",
    "simulate": "Draw a track and detections from the measurement model into a dataset file, without tracing.",
    "trace": "Drive a track through a scene and trace its paths into a dataset file.",
    "synthesize": "Add the received signal of every step (paper A, eq. 2) to a dataset file.",
    "estimate": "Estimate the paths of every snapshot: detections with their covariances.",
    "slam": "Run a SLAM filter over the detections of a dataset file.",
    "bound": "Posterior Cramér–Rao bounds of a scenario or of a dataset file.",
    "evaluate": "Compare track and map with the truth and the bound: table, summary, figures.",
    "view": "Open the report of a run: what came out, a replay in three dimensions, tables and figures.",
    "montecarlo": "Many runs of a filter in parallel, beside their bounds.",
    "dataset": "Make a large dataset in shards: many positions, resumable, the same whoever makes it.",
    "check": "Validate a dataset folder or file and say what is wrong where.",
    "import": "Turn foreign detections (CSV, MATLAB) into a dataset file that slam runs on.",
    "export": "Write a dataset for other programs: MATLAB, DeepMIMO, TUM, SigMF, CSV.",
    "sweep": "Repeat a Monte Carlo study over values of scenario keys: one table, one figure.",
    "scenes": "List the scenes that ship.",
    "info": "Say what a dataset file holds.",
    "doctor": "Say what the ray tracer found here: LLVM, GPU, threads, versions.",
}

app = App(
    name="dopslam",
    help="Radio SLAM end to end: trace a scene, synthesize, estimate the channel, run SLAM, compare with bounds.",
    version_flags=["--version"],
    help_format="plaintext",
)
for _verb, _help in VERBS.items():
    _name = "import_" if _verb == "import" else _verb  # a keyword is no module
    app.command(f"dopslam.cli.{_name}:{_name}", name=_verb, help=_help)


def main(tokens: list[str] | None = None) -> None:
    """Run the command line and leave with 0, or with 2 and one line on standard error."""
    # One BLAS thread a process, set before NumPy loads: parallelism is over snapshots and runs.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        if not _is_known(error):
            raise
        _fail(str(error))


def _is_known(error: Exception) -> bool:
    from dopslam.errors import DopslamError
    from estimation.errors import EstimationError

    return isinstance(error, DopslamError | EstimationError)


def _fail(message: str) -> None:
    print("dopslam: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(2)
