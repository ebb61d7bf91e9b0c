"""Where the table of a text file begins: after a preamble, comments, titles and perhaps a line of units."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from emps_design.errors import RecordError

DELIMITERS = (";", "\t", ",")
LOOKED_AT = 400  # lines, among which the first samples are expected
COMMENT = "#"
_ALIKE = 3  # lines of numbers in a row that are samples: a preamble has no such block
_UNIT = re.compile(
    r"[\[(]?\s*(|-|%|[muµμ]?s|[nmuµμc]?m|rad|deg|°|rev|inc|counts?|m?A|[mk]?V|[mk]?N ?m?|rpm|(\w+|°)/(s|min))\s*[\])]?"
)

Choice = Callable[[list[str]], Sequence[object]]  # of titles, those that mean something


@dataclass(frozen=True)
class Header:
    """``delimiter`` and ``titles`` of a table, and the line (from 0) that has the first sample."""

    delimiter: str
    titles: list[str]
    samples: int


def find_header(lines: Sequence[str], known: Choice, source: str) -> Header:
    """Find titles and samples in the first ``lines`` of a file; raises :class:`RecordError` where there are none.

    Of several lines that could be the titles, the one in which ``known`` finds something is taken, the last of them
    otherwise.

    >>> find_header(["Trace;12", "t [ms];q", "0,0;1", "0,5;2", "1,0;3"], lambda titles: [], "a.csv")
    Header(delimiter=';', titles=['t [ms]', 'q'], samples=2)
    """
    start, delimiter = _first_samples(lines)
    if start is None:
        start, line = next(((i, x) for i, x in enumerate(lines) if x.strip() and x[0] != COMMENT), (0, ""))
        if not line:
            raise RecordError(f"{source}: found no rows, expected a header and samples")
        delimiter = max(DELIMITERS, key=line.count)
        titles = _titles(line, delimiter)
        if all(number(title) is not None for title in titles):
            raise _no_titles(source, start)
        return Header(delimiter, titles, start + 1)
    width = len(split(lines[start], delimiter))
    before = [i for i in range(start) if lines[i].strip()]
    # A comment may be the titles where nothing else is.
    plain = [i for i in before if lines[i][0] != COMMENT] or before
    rows = {i: _titles(lines[i].lstrip(COMMENT), delimiter) for i in reversed(plain)}
    likely = [row for row in rows.values() if len(row) >= 2 and width - 1 <= len(row) <= width + 1]
    candidates = [_with_units(above, row) for row, above in pairwise([*likely, []])] if likely else []
    candidates += [row for row in list(rows.values())[:1] if not likely and len(row) >= 2]
    if not candidates:
        raise _no_titles(source, start)
    titles = next((row for row in candidates if _finds(known, row)), candidates[0])
    return Header(delimiter, titles, start)


def number(cell: str) -> float | None:
    """The number in a cell, with a decimal point or comma, or hexadecimal as the word of a state, or None."""
    try:
        if cell.strip()[:2].lower() == "0x":
            return float(int(cell, 16))
        return float(cell.replace(",", ".", 1)) if "_" not in cell else None
    except ValueError:
        return None


def split(line: str, delimiter: str) -> list[str]:
    """The cells of a line; quotes keep a delimiter inside."""
    line = line.rstrip("\r\n")
    return next(csv.reader([line], delimiter=delimiter), []) if '"' in line else line.split(delimiter)


def _first_samples(lines: Sequence[str]) -> tuple[int | None, str]:
    """The first of several lines of numbers that are alike, and what delimits their cells; None where there is none."""
    best: tuple[tuple[float, int], int, str] | None = None
    for delimiter in DELIMITERS:
        shapes = [_shape(line, delimiter) for line in lines]
        for i, shape in enumerate(shapes):
            block = [other for other in shapes[i:] if other is not None][:_ALIKE]
            if shape is None or shape[0] < 0.5 or shape[1] < 2:
                continue
            if all(other[0] >= 0.5 and abs(other[2] - shape[2]) <= 1 for other in block):
                if best is None or (shape[0], shape[1]) > best[0]:
                    best = (shape[0], shape[1]), i, delimiter
                break
    return (best[1], best[2]) if best else (None, ";")


def _shape(line: str, delimiter: str) -> tuple[float, int, int] | None:
    """Share and count of numbers among the filled cells of a line, and its cells; None for a blank one or a comment."""
    if not line.strip() or line[0] == COMMENT:
        return None
    cells = split(line, delimiter)
    filled = [cell for cell in cells if cell.strip()]
    numbers = sum(number(cell) is not None for cell in filled)
    return numbers / max(len(filled), 1), numbers, len(cells)


def _titles(line: str, delimiter: str) -> list[str]:
    titles = [cell.strip() for cell in split(line, delimiter)]
    while titles and not titles[-1]:
        titles.pop()
    return titles


def _with_units(titles: list[str], row: list[str]) -> list[str]:
    """``titles`` with the units in the ``row`` below them, or ``row`` itself where it is no row of units."""
    if len(titles) < len(row) or not any(row) or not all(_UNIT.fullmatch(cell) for cell in row):
        return row
    units = [cell.strip("[]() -") for cell in row] + [""] * (len(titles) - len(row))
    return [f"{title} [{unit}]" if unit else title for title, unit in zip(titles, units, strict=True)]


def _finds(known: Choice, titles: list[str]) -> bool:
    try:
        return bool(known(titles))
    except RecordError:
        return False


def _no_titles(source: str, line: int) -> RecordError:
    return RecordError(f"{source}: row {line + 1}: found numbers, expected a header such as t;q_ref;q;u")
