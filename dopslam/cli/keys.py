"""``dopslam keys``."""

from __future__ import annotations


def keys(prefix: str = "") -> None:
    """List the keys of a scenario with their ranges and defaults.

    Parameters
    ----------
    prefix
        Only keys that begin with this, for instance track or source.model.
    """
    import difflib

    from rich.console import Console
    from rich.table import Table

    from dopslam.config.reference import listed
    from dopslam.errors import ConfigError

    found = listed()
    rows = [key for key in found if key.name.startswith(prefix)]
    if not rows:
        near = difflib.get_close_matches(prefix, [key.name for key in found], n=1, cutoff=0.3)
        raise ConfigError(f"no key begins with {prefix!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
    table = Table("key", "may be", "default", box=None)
    for key in rows:
        table.add_row(key.name, key.allowed, key.default)
    Console(markup=False, highlight=False).print(table)
