"""What went wrong in one sentence, whatever it was."""

from __future__ import annotations

from collections.abc import Sequence


def sentence(error: Exception) -> str:
    """What a person is told of an error: what, where, the remedy, and what was kept."""
    return "; ".join([_what(error), *getattr(error, "__notes__", ())])


EARLIER = {
    ("run", "--runs"): "--out",
    ("import", "--scenario"): "--scene",
    ("import", "--from"): "--format",
    ("new", "--name"): "--out",
    ("export", "--source"): "--dataset",
}
"""Options by command and earlier spelling, and how they are called now."""


def renamed(tokens: Sequence[str]) -> str | None:
    """What to say of the first option in its earlier spelling; None if there is none."""
    for token in tokens[1:]:
        option = token.partition("=")[0]
        if (tokens[0], option) in EARLIER:
            return f"{tokens[0]} {option} is now called {EARLIER[tokens[0], option]}"
    return None


def _what(error: Exception) -> str:
    from dopslam.errors import DopslamError
    from estimation.errors import EstimationError

    if isinstance(error, DopslamError | EstimationError):
        return str(error)
    if isinstance(error, MemoryError):
        return "out of memory; ask for less at once (fewer positions, pilots, elements or workers)"
    if type(error).__name__ in ("TerminatedWorkerError", "BrokenProcessPool"):
        return "a worker process was killed, probably for want of memory; use fewer workers with --jobs"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'a file'}: {error.strerror}; name another place or make room"
    return f"{type(error).__name__}: {error}: a fault of dopslam; DOPSLAM_DEBUG=1 shows where, please report it"
