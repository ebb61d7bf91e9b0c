"""Where the table of a text file begins, told by its shape: a preamble, comments, rows of titles and of units above it.

The samples are the first rows of numbers that are alike. What stands between their cells is what makes most of them
numbers: a semicolon, a tab, a comma, or white space. The titles are a row above them with as many cells, commented or
not; in the row below it a cell may be the unit of the title above, or the plainer title of the two.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from emps_design.errors import RecordError
from emps_design.records.columns import column_titles, plain_title
from emps_design.units import is_unit, spelled

SPACE = " "  # any white space
DELIMITERS = (";", "\t", ",")
LOOKED_AT = 400  # lines, among which the first samples are expected
COMMENT = "#"
COMMENTS = (COMMENT, "%", "//")
_ALIKE = 3  # lines of numbers in a row that are samples: a preamble has no such block
_OTHER_UNIT = re.compile(r"°C|K|[mk]?Hz|[mk]?W|bar|m?Pa|(\w+|°)/(s|min)(\^?[23]|[²³])?")  # of columns that are not read

Choice = Callable[[list[str]], Sequence[object]]  # of titles, those that mean something


@dataclass(frozen=True)
class Header:
    """``delimiter`` and ``titles`` of a table, and the line (from 0) that has the first sample."""

    delimiter: str
    titles: list[str]
    samples: int


def find_header(lines: Sequence[str], known: Choice, source: str) -> Header:
    """Find titles and samples in the first ``lines`` of a file; raises :class:`RecordError` where there are none.

    Of several rows that could be the titles, the one in which ``known`` finds something is taken, the last of them
    otherwise. A table without titles has the columns data:0, data:1 ..., where ``known`` finds something in these.

    >>> find_header(["Trace;12", "t [ms];q", "0,0;1", "0,5;2", "1,0;3"], lambda titles: [], "a.csv")
    Header(delimiter=';', titles=['t [ms]', 'q'], samples=2)
    >>> find_header(["# Axis 1", "# t speed", "# ms r/min", "0 1", "1 2", "2 3"], lambda titles: [], "a.txt")
    Header(delimiter=' ', titles=['t [ms]', 'speed [r/min]'], samples=3)
    """
    start, delimiter = _first_samples(lines)
    if start is None:
        start, line = next(((i, x) for i, x in enumerate(lines) if x.strip() and not is_comment(x)), (0, ""))
        if not line:
            raise RecordError(f"{source}: found no rows, expected a header and samples")
        delimiter = max((*DELIMITERS, SPACE), key=line.count)
        titles = _titles(line, delimiter)
        if all(number(title) is not None for title in titles):
            raise _no_titles(source, start)
        return Header(delimiter, titles, start + 1)
    width = len(split(lines[start], delimiter))
    above = [line for line in reversed(lines[:start]) if line.strip()]
    plain = [line for line in above if not is_comment(line)]
    candidates = _candidates(plain, delimiter, width)
    candidates += _candidates([_uncommented(line) for line in above if is_comment(line)], delimiter, width)
    if not candidates and delimiter != SPACE:
        candidates = [
            row for row in (_titles(_uncommented(line), delimiter) for line in plain or above) if len(row) > 1
        ]
        del candidates[1:]
    numbered = column_titles("data", width)
    titles = next((row for row in [*candidates, numbered] if _finds(known, row)), (candidates or [[]])[0])
    if not titles:
        raise _no_titles(source, start)
    return Header(delimiter, titles, start)


def is_comment(line: str) -> bool:
    """Whether a line is a comment.

    >>> is_comment("  # Friday"), is_comment("% of rated"), is_comment("t;q")
    (True, True, False)
    """
    return line.lstrip().startswith(COMMENTS)


def number(cell: str) -> float | None:
    """The number in a cell, with a decimal point or comma, or hexadecimal as the word of a state, or None."""
    try:
        if cell.strip()[:2].lower() == "0x":
            return float(int(cell, 16))
        return float(cell.replace(",", ".", 1)) if "_" not in cell else None
    except ValueError:
        return None


def split(line: str, delimiter: str) -> list[str]:
    """The cells of a line; quotes keep a delimiter inside.

    >>> split("1;2", ";"), split('  1   "a b" ', SPACE)
    (['1', '2'], ['1', 'a b'])
    """
    line = line.strip() if delimiter == SPACE else line.rstrip("\r\n")
    if '"' in line:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == SPACE), [])
    return line.split() if delimiter == SPACE else line.split(delimiter)


def _first_samples(lines: Sequence[str]) -> tuple[int | None, str]:
    """The first of several lines of numbers that are alike, and what delimits their cells; None where there is none."""
    best: tuple[tuple[float, int], int, str] | None = None
    for delimiter in (*DELIMITERS, SPACE):
        shapes = [_shape(line, delimiter) for line in lines]
        for i, shape in enumerate(shapes):
            block = [other for other in shapes[i:] if other is not None][:_ALIKE]
            if shape is None or shape[0] < 0.5 or shape[1] < 2:
                continue
            if all(other[0] >= 0.5 and abs(other[2] - shape[2]) <= 1 for other in block):
                # Spaces may stand behind other delimiters too: they only count where these leave words.
                key = (shape[0], shape[1] if delimiter != SPACE else 0)
                if best is None or key > best[0]:
                    best = key, i, delimiter
                break
    return (best[1], best[2]) if best else (None, ";")


def _shape(line: str, delimiter: str) -> tuple[float, int, int] | None:
    """Share and count of numbers among the filled cells of a line, and its cells; None for a blank one or a comment."""
    if not line.strip() or is_comment(line):
        return None
    cells = split(line, delimiter)
    filled = [cell for cell in cells if cell.strip()]
    numbers = sum(number(cell) is not None for cell in filled)
    return numbers / max(len(filled), 1), numbers, len(cells)


def _candidates(lines: Sequence[str], delimiter: str, width: int) -> list[list[str]]:
    """What may be the titles of ``width`` columns in ``lines``, the last line first: two rows together, and each."""
    near = 0 if delimiter == SPACE else 1  # a row may end with a delimiter
    rows = [row for row in (_titles(line, delimiter, width) for line in lines) if len(row) >= 2]
    rows = [row for row in rows if abs(len(row) - width) <= near]
    found = []
    for row, above in pairwise([*rows, []]):
        both = _with_units(above, row)
        found += [row] if both is None else [both] if all(map(_unit_in, row)) else [both, row]
    return found


def _titles(line: str, delimiter: str, width: int = 0) -> list[str]:
    """The titles in a line. Between white space they may have some inside, where two or a bracket tell their end."""
    titles = [cell.strip() for cell in split(line, delimiter)]
    while titles and not titles[-1]:
        titles.pop()
    if delimiter == SPACE and len(titles) > width > 0:
        for ends in (r"\s{2,}|\t", r"(?<=[\])])\s+", r"\s+(?![\[(])"):
            parts = re.split(ends, line.strip())
            if len(parts) == width:
                return parts
    return titles


def _unit_in(cell: str) -> str | None:
    """The unit that a cell is, in brackets or not, "" where it says that there is none, None where it is no unit."""
    inner = cell.strip("[]() ")
    if is_unit(inner):
        return inner if spelled(inner) else ""
    return inner if _OTHER_UNIT.fullmatch(inner) else None


def _with_units(titles: list[str], row: list[str]) -> list[str] | None:
    """``titles`` with what the ``row`` below them adds, a unit or a plainer title; None where it has no unit."""
    cells = [*row, *[""] * (len(titles) - len(row))]
    units = list(map(_unit_in, cells))
    if len(titles) < len(row) or not any(units):
        return None
    both = []
    for title, unit, cell in zip(titles, units, cells, strict=True):
        more = bool(unit) and not plain_title(title)[1]
        both.append(cell if unit is None else f"{title} [{unit}]" if more else title)
    return both


def _uncommented(line: str) -> str:
    line = line.strip()
    mark = next((mark for mark in COMMENTS if line.startswith(mark)), "")
    return line.lstrip(mark).strip() if mark else line


def _finds(known: Choice, titles: list[str]) -> bool:
    try:
        return bool(known(titles))
    except RecordError:
        return False


def _no_titles(source: str, line: int) -> RecordError:
    return RecordError(
        f"{source}: row {line + 1}: found numbers, expected a header such as t;q_ref;q;u, or a [record] table of the "
        "columns data:0, data:1 ..."
    )
