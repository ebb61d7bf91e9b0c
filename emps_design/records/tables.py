"""Text tables: delimiter ; , or tab, decimal point or comma, a header with or without units."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import BinaryIO, TextIO

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.check import LONGEST
from emps_design.records.columns import read_titles

DELIMITERS = (";", "\t", ",")
LONGEST_LINE = 100_000  # characters
PIECE = 1 << 20  # characters that are looked through at a time
BLOCK = 50_000  # rows that are read at a time


def read_table(file: BinaryIO, source: str) -> tuple[dict[str, np.ndarray], int]:
    """Return the columns of a text table by title, and the row of the file in which its first sample stands.

    It is gone through twice, to count its rows and to read them block by block: its text is never whole in memory.
    """
    encoding = "utf-16" if file.read(2) in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    file.seek(0)
    text = io.TextIOWrapper(file, encoding=encoding)
    try:
        return _read(text, _rows(text, source), source)
    except UnicodeDecodeError as error:
        place = file.tell() - len(error.object) + error.start
        raise RecordError(f"{source}: byte {place}: not {encoding[:6].rstrip('-')} text, expected a table") from error
    finally:
        text.detach()


def _rows(text: TextIO, source: str) -> int:
    """How many rows there are at most; binary data and too many are refused."""
    rows, begun = 1, 0  # ``begun``: characters of the line that goes on in the next piece
    while piece := text.read(PIECE):
        if "\0" in piece:
            raise RecordError(f"{source}: found binary data, expected a text table")
        begun = _unfinished_line(piece, begun, source)
        rows += piece.count("\n")
        if rows > LONGEST + 1:
            raise RecordError(
                f"{source}: found more than {LONGEST} rows, expected fewer; cut the record or save it as .npz"
            )
    text.seek(0)
    return rows


def _unfinished_line(piece: str, begun: int, source: str) -> int:
    """Characters of the last line of ``piece``, whose first began ``begun`` earlier; too long a line is refused."""
    start, room = 0, LONGEST_LINE - begun
    while len(piece) - start > room:
        end = piece.rfind("\n", start, start + room + 1)
        if end < 0:
            raise RecordError(
                f"{source}: found a line of more than {LONGEST_LINE} characters, expected a header and rows of numbers"
            )
        start, room = end + 1, LONGEST_LINE
    last = piece.rfind("\n")
    return begun + len(piece) if last < 0 else len(piece) - last - 1


def _read(text: TextIO, rows: int, source: str) -> tuple[dict[str, np.ndarray], int]:
    start, header = next(((i, line) for i, line in enumerate(text) if line.strip() and line[0] != "#"), (0, ""))
    if not header:
        raise RecordError(f"{source}: found no rows, expected a header and samples")
    delimiter = max(DELIMITERS, key=header.count)
    titles = [cell.strip() for cell in next(csv.reader([header], delimiter=delimiter))]
    while titles and not titles[-1]:
        titles.pop()
    if all(_number(title) is not None for title in titles):
        raise RecordError(f"{source}: row {start + 1}: found numbers, expected a header such as t;q_ref;q;u")
    wanted = [i for i, title in enumerate(read_titles(titles, source)) if title.name]
    columns, filled, first = [np.empty(rows) for _ in wanted], 0, start + 2
    for block in _blocks(text):
        numbers = _parse(block, delimiter, wanted, titles, source, first + filled)
        for k, column in enumerate(columns):
            column[filled : filled + len(block)] = numbers[:, k]
        filled += len(block)
    if not filled:
        raise RecordError(f"{source}: found a header and no samples")
    return {titles[i]: column[:filled] for i, column in zip(wanted, columns, strict=True)}, first


def _blocks(text: TextIO) -> Iterator[list[str]]:
    """The rows that are left, some at a time; blank ones at the end of the file are left out."""
    blank: list[str] = []
    while rows := list(islice(text, BLOCK)):
        rows = blank + rows
        kept = len(rows)
        while kept and not rows[kept - 1].strip():
            kept -= 1
        rows, blank = rows[:kept], rows[kept:]
        if rows:
            yield rows


def _parse(
    rows: list[str], delimiter: str, wanted: list[int], titles: list[str], source: str, first_row: int
) -> np.ndarray:
    """Numbers of the ``wanted`` columns, shape (rows, wanted); the slow way is for naming the cell that is wrong."""
    if not any('"' in row or not row.strip() for row in rows):
        decimal_comma = delimiter != "," and any("," in row for row in islice(rows, 100))
        points = (row.replace(",", ".") for row in rows) if decimal_comma else rows
        with suppress(ValueError):  # a cell is no number, or a decimal comma comes late: cell by cell finds it
            return np.loadtxt(points, delimiter=delimiter, comments=None, usecols=wanted, ndmin=2)
    table = np.empty((len(rows), len(wanted)))
    for i, row in enumerate(rows):
        cells = next(csv.reader([row], delimiter=delimiter), []) if '"' in row else row.split(delimiter)
        for k, column in enumerate(wanted):
            cell = cells[column] if column < len(cells) else ""
            number = _number(cell)
            if number is None:
                found = repr(cell.strip()[:40]) if cell.strip() else "nothing"
                raise RecordError(
                    f"{source}: row {first_row + i}, column {titles[column]!r}: found {found}, expected a number"
                )
            table[i, k] = number
    return table


def _number(cell: str) -> float | None:
    """The number in a cell, with a decimal point or comma, or None."""
    try:
        return float(cell.replace(",", ".", 1)) if "_" not in cell else None
    except ValueError:
        return None
