"""The one family of errors that a user can cause; the command line prints each as one line and exits with 2."""


class DopslamError(Exception):
    """Base of every error with a remedy: the message names what, where, the value and what to do."""


class ConfigError(DopslamError):
    """A scenario file or ``--set`` holds an unknown key or an impossible value."""


class SceneError(DopslamError):
    """A scene cannot be loaded or traced as asked (missing file, material, receiver inside a wall)."""


class LLVMError(DopslamError):
    """No usable LLVM library or GPU for the ray tracer."""


class DatasetError(DopslamError):
    """A dataset file is missing, damaged, of another schema, or lacks what a command needs."""


class FilterError(DopslamError):
    """A filter or bound was given measurements or parameters it cannot work with."""
