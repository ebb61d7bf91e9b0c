"""Text tables: delimiter ; , or tab, decimal point or comma, a header with or without units."""

from __future__ import annotations

import csv
from contextlib import suppress
from itertools import islice

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.check import LONGEST
from emps_design.records.columns import read_titles

DELIMITERS = (";", "\t", ",")


def read_table(content: bytes, source: str) -> tuple[dict[str, np.ndarray], int]:
    """Return the columns of a text table by title, and the row of the file in which its first sample stands."""
    text = _text(content, source)
    if text.count("\n") > LONGEST:
        raise RecordError(
            f"{source}: found more than {LONGEST} rows, expected fewer; cut the record or save it as .npz"
        )
    lines = text.splitlines()
    del text
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), None)
    if start is None:
        raise RecordError(f"{source}: found no rows, expected a header and samples")
    delimiter = max(DELIMITERS, key=lines[start].count)
    titles = [cell.strip() for cell in next(csv.reader([lines[start]], delimiter=delimiter))]
    while titles and not titles[-1]:
        titles.pop()
    if all(_number(title) is not None for title in titles):
        raise RecordError(f"{source}: row {start + 1}: found numbers, expected a header such as t;q_ref;q;u")
    wanted = [i for i, title in enumerate(read_titles(titles, source)) if title.name]
    rows = lines[start + 1 :]
    while rows and not rows[-1].strip():
        rows.pop()
    if not rows:
        raise RecordError(f"{source}: found a header and no samples")
    table = _parse(rows, delimiter, wanted, titles, source, start + 2)
    return {titles[i]: table[:, k] for k, i in enumerate(wanted)}, start + 2


def _text(content: bytes, source: str) -> str:
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        raise RecordError(
            f"{source}: byte {error.start}: not {encoding[:6].rstrip('-')} text, expected a table"
        ) from error
    if "\0" in text:
        raise RecordError(f"{source}: found binary data, expected a text table")
    return text


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
