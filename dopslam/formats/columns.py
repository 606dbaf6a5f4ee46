"""Columns of a foreign table, CSV or MATLAB, as numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dopslam.config.delimited import cells_of, numbers_of
from dopslam.errors import DatasetError
from dopslam.formats import matlab


def read_table(path: str | Path, names: list[str], may_miss: frozenset[str] = frozenset()) -> dict[str, np.ndarray]:
    """Columns of a CSV or MATLAB (up to v7.2) file as equally long float vectors.

    Parameters
    ----------
    path : the file
    names : of the columns that are wanted
    may_miss : those that may hold NaN, where nothing was measured

    Raises
    ------
    DatasetError
        For a file that cannot be read, a missing column (naming those there are), or values that are no finite numbers.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ".mat":
            found = matlab.vectors(path)
        else:
            header, rows = cells_of(path)
            twice = sorted({name for name in header if header.count(name) > 1} & set(names))
            if twice:
                raise DatasetError(f"{path}: column {twice[0]!r} stands in the header twice; rename or remove one")
            columns = zip(*rows, strict=True) if rows else [()] * len(header)
            found = dict(zip(header, columns, strict=True))
    except DatasetError:
        raise
    except Exception as error:  # scipy and csv raise all kinds for damaged files
        raise DatasetError(
            f"{path}: cannot be read as CSV with a header or a MATLAB file before v7.3 ({error})"
        ) from error
    table = {}
    for name in names:
        if name not in found:
            raise DatasetError(f"{path}: has no column {name!r}; it has {', '.join(found) or 'none'}")
        try:
            cells = found[name]
            table[name] = numbers_of(list(cells)) if isinstance(cells, tuple) else cells.astype(float)
        except (ValueError, TypeError) as error:
            raise DatasetError(f"{path}: column {name!r} holds something that is no number ({error})") from error
        wrong = np.isinf(table[name]) if name in may_miss else ~np.isfinite(table[name])
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise DatasetError(
                f"{path}: column {name!r} holds {table[name][row]} in data row {row + 1}; remove such rows"
            )
    if not any(len(column) for column in table.values()):
        raise DatasetError(f"{path}: holds a header but no row; give at least one detection")
    if len({len(column) for column in table.values()}) > 1:
        sizes = ", ".join(f"{name} {len(column)}" for name, column in table.items())
        raise DatasetError(f"{path}: columns differ in length: {sizes}")
    return table
