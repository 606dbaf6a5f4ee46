"""Arrays of a MATLAB file before v7.3, read in a process of its own.

SciPy's reader is compiled and trusts the file: of 600 single flipped bits four ended the process with SIGSEGV. What
happens to the other process is one line here.
"""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np

SECONDS = 300  # for reading a table
# Numbers come back as they are, texts and cells by name only.
READER = """
import sys
import numpy as np
from scipy.io import loadmat
found = {k: np.asarray(v) for k, v in loadmat(sys.argv[1]).items() if not k.startswith("__")}
plain = {k: v if v.dtype.kind in "biufc" else np.full(v.shape, "?") for k, v in found.items()}
np.savez(sys.stdout.buffer, *plain.values(), names=np.array(list(plain), dtype=str))
"""


def vectors(path: Path) -> dict[str, np.ndarray]:
    """Every variable of the file, flat; one that is no real number is an array of texts. Errors as in :func:`arrays`."""
    found = {name: array.ravel() for name, array in arrays(path).items()}
    return {name: flat if flat.dtype.kind != "c" else np.full(len(flat), "?") for name, flat in found.items()}


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Every variable of the file; one that holds no numbers is an array of texts.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", READER, str(path)], capture_output=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"reading it took more than {SECONDS} s") from None
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(lines[-1] if done.returncode > 0 and lines else "it is damaged")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as archive:
        return {name: archive[f"arr_{number}"] for number, name in enumerate(archive["names"].tolist())}
