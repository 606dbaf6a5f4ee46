"""Tables as text, whoever wrote them: commas, semicolons with decimal commas, or tabs; UTF-8, UTF-16, or what Excel on Windows
saves; a header line, or one behind ``#`` as ``numpy.savetxt`` leaves it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "nat"})
"""What stands in a cell where nothing was measured, in small letters."""
_SEPARATORS = ",;\t"


def decoded(content: bytes) -> str:
    """Text of a file, whose encoding its first bytes tell."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252")


def cells_of(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a table, all cells as texts that Python can read as numbers where they are numbers.

    Raises
    ------
    ValueError
        For a table without header, or with a row that is longer or shorter than it, naming the row.
    OSError, csv.Error
        If it cannot be read.
    """
    lines = [line for line in decoded(Path(path).read_bytes()).splitlines() if line.strip()]
    notes = [line.lstrip("#").strip() for line in lines if line.startswith("#")]
    lines = [line for line in lines if not line.startswith("#")]
    if not lines:
        raise ValueError("it is empty; a header with the names of the columns is needed, and rows of numbers")
    separator = max(_SEPARATORS, key=lambda s: len(next(csv.reader([lines[0]], delimiter=s))))
    header, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    if separator != ",":  # a comma is then the decimal one
        rows = [[cell.replace(",", ".") if "." not in cell else cell for cell in row] for row in rows]
    if all(is_number(cell.replace(",", ".") if separator != "," else cell) for cell in header):
        named = [cell.strip() for cell in next(csv.reader(notes[-1:], delimiter=separator), [])]
        if len(named) != len(header):
            raise ValueError("its first row holds numbers; a header with the names of the columns is needed before it")
        header, rows = named, [[cell.replace(",", ".") if separator != "," else cell for cell in header], *rows]
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise ValueError(f"data row {number} has {len(row)} cells where the header has {len(header)}")
    return header, rows


def is_number(cell: str) -> bool:
    """Whether a cell holds a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def numbers_of(cells: list[str]) -> np.ndarray:
    """A column as numbers, NaN where nothing was measured.

    Raises
    ------
    ValueError
        For what is neither, naming the row.
    """
    column = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if cell.lower() in MISSING:
            continue
        try:
            column[row] = float(cell)
        except ValueError:
            raise ValueError(f"data row {row + 1} holds {cell[:40]!r}, which is no number") from None
    return column
