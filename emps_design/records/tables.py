"""Text tables as drives export them: ; , tab or space, decimal point or comma, a preamble, comments, encodings."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from typing import BinaryIO, TextIO

import numpy as np

from emps_design.errors import RecordError, one_line
from emps_design.records.check import CUT
from emps_design.records.header import (
    COMMENT,
    LOOKED_AT,
    SPACE,
    Choice,
    find_header,
    is_comment,
    number,
    split,
)
from emps_design.records.layout import LONGEST
from emps_design.records.scope import is_scope, read_scope, scope_titles

LONGEST_LINE = 100_000  # characters
HEAD = 1 << 16  # bytes that say which encoding it is
PIECE = 1 << 20  # characters that are looked through at a time
BLOCK = 50_000  # rows that are read at a time
END = "EOF"  # what some exports write below the last sample


@dataclass(frozen=True)
class Table:
    """Columns by title, those that were asked for; all ``titles``; the row of the file with the first sample."""

    columns: dict[str, np.ndarray]
    titles: tuple[str, ...]
    first_row: int = 0
    notes: tuple[str, ...] = ()


def read_table(file: BinaryIO, source: str, known: Choice, most: int = LONGEST) -> Table:
    """Return the columns of a text table in whose titles ``known`` finds a meaning; it has at ``most`` so many samples.

    It is gone through twice, to count its rows and to read them block by block: its text is never whole in memory.
    """
    encoding = _encoding(file.read(HEAD))
    file.seek(0)
    text = io.TextIOWrapper(file, encoding=encoding)
    try:
        rows = _rows(text, source, most)
        head = list(islice(text, LOOKED_AT))
        lines = chain(head, text)
        if is_scope(head):
            scope = read_scope(lines, rows, source, known)
            return Table(scope.columns, scope.titles, scope.first_row, scope.notes)
        return _read(head, lines, rows, source, known)
    except UnicodeDecodeError as error:
        place = file.tell() - len(error.object) + error.start
        raise RecordError(f"{source}: byte {place}: not {encoding[:6].rstrip('-')} text, expected a table") from error
    finally:
        text.detach()


def table_titles(file: BinaryIO, source: str) -> list[str]:
    """The titles of the columns of a text table."""
    encoding = _encoding(file.read(HEAD))
    file.seek(0)
    text = io.TextIOWrapper(file, encoding=encoding, errors="replace")
    try:
        head = list(islice((line[:LONGEST_LINE] for line in text), LOOKED_AT))
    finally:
        text.detach()
    return list(
        scope_titles(head, source) if is_scope(head) else find_header(head, lambda titles: titles, source).titles
    )


def read_plain_table(content: bytes, source: str, expected: str, needed: Collection[str] = ()) -> dict[str, np.ndarray]:
    """Return the columns of a table that this package or a script wrote: a row of titles, numbers below it.

    Commas or semicolons stand between cells, # begins a comment. Where a title that is ``needed`` is missing the
    columns are empty: the titles are the trouble then, not what is below them. ``expected`` ends a message.

    >>> {name: values.tolist() for name, values in read_plain_table(b"t; q\\n0; 1\\n1; 3 # end", "a.csv", "").items()}
    {'t': [0.0, 1.0], 'q': [1.0, 3.0]}
    """
    try:
        head, *lines = content.decode("utf-8-sig").splitlines()
        between = ";" if ";" in head else ","
        titles = [title.strip() for title in next(csv.reader([head], delimiter=between), [])]
    except (UnicodeDecodeError, ValueError, csv.Error) as error:
        raise RecordError(f"{source}: not a text table; {expected}") from error
    if not any(line.partition(COMMENT)[0].strip() for line in lines):
        raise RecordError(f"{source}: found a header and no lines, expected numbers below the titles")
    if not {title.lower() for title in titles}.issuperset(needed):
        return dict.fromkeys(titles, np.zeros(0))
    try:
        numbers = np.loadtxt(lines, delimiter=between, ndmin=2)
    except ValueError as error:
        raise RecordError(f"{source}: {one_line(error)}; expected numbers below the titles") from error
    if numbers.shape[1] != len(titles):
        raise RecordError(f"{source}: found {numbers.shape[1]} columns below {len(titles)} titles, expected as many")
    return dict(zip(titles, numbers.T, strict=True))


def _encoding(head: bytes) -> str:
    """What the first bytes are: a byte-order mark says it, otherwise UTF-8, or what Western European Windows writes."""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    pairs = len(head) // 2
    for encoding, zeros in (("utf-16-le", head[1::2].count(0)), ("utf-16-be", head[::2].count(0))):
        if pairs > 4 and zeros > 0.9 * pairs and head.count(0) == zeros:
            return encoding
    with suppress(UnicodeDecodeError):
        head[: len(head) - 3 if len(head) == HEAD else len(head)].decode("utf-8")
        return "utf-8-sig"
    return "cp1252"


def _rows(text: TextIO, source: str, most: int) -> int:
    """How many rows there are at most; binary data and too many are refused."""
    rows, begun = 1, 0  # ``begun``: characters of the line that goes on in the next piece
    while piece := text.read(PIECE):
        if "\0" in piece:
            raise RecordError(f"{source}: found binary data, expected a text table")
        begun = _unfinished_line(piece, begun, source)
        rows += piece.count("\n")
        if rows > most + 1:
            raise RecordError(f"{source}: found more than {most} rows, expected fewer; {CUT}")
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


def _read(head: list[str], lines: Iterator[str], rows: int, source: str, known: Choice) -> Table:
    header = find_header(head, known, source)
    titles = header.titles
    chosen = set(map(str, known(titles)))
    wanted = [i for i, title in enumerate(titles) if title in chosen]
    columns, filled = [np.empty(rows) for _ in wanted], 0
    for row, block in _blocks(islice(lines, header.samples, None), header.samples + 1):
        numbers = _parse(block, header.delimiter, wanted, titles, source, row)
        for k, column in enumerate(columns):
            column[filled : filled + len(numbers)] = numbers[:, k]
        filled += len(numbers)
    if not filled:
        raise RecordError(f"{source}: found a header and no samples")
    found = {titles[i]: column[:filled] for i, column in zip(wanted, columns, strict=True)}
    return Table(found, tuple(titles), header.samples + 1)


def _blocks(lines: Iterator[str], row: int) -> Iterator[tuple[int, list[str]]]:
    """The rows that are left, some at a time, with the number of the first; what ends the file is left out."""
    blank: list[str] = []
    while rows := list(islice(lines, BLOCK)):
        rows = blank + rows
        kept = len(rows)
        while kept and rows[kept - 1].strip() in ("", END):
            kept -= 1
        rows, blank = rows[:kept], rows[kept:]
        if rows:
            yield row, rows
            row += len(rows)


def _parse(
    rows: list[str], delimiter: str, wanted: list[int], titles: list[str], source: str, first_row: int
) -> np.ndarray:
    """Numbers of the ``wanted`` columns, shape (rows, wanted), NaN for an empty cell.

    The slow way is for empty cells, and for naming the cell that is wrong.
    """
    between = None if delimiter == SPACE else delimiter
    longer = max(len(row.split()) - 1 if between is None else row.count(between) for row in rows) >= len(titles)
    if not longer and not any('"' in row or is_comment(row) or not row.strip() for row in rows):
        decimal_comma = delimiter != "," and any("," in row for row in islice(rows, 100))
        points = (row.replace(",", ".") for row in rows) if decimal_comma else rows
        with suppress(ValueError):  # a cell is no number, or a decimal comma comes late: cell by cell finds it
            return np.loadtxt(points, delimiter=between, comments=None, usecols=wanted, ndmin=2)
    table, filled = np.empty((len(rows), len(wanted))), 0
    for i, row in enumerate(rows):
        if is_comment(row):
            continue
        cells = split(row, delimiter)
        if any(cell.strip() for cell in cells[len(titles) :]):
            raise RecordError(
                f"{source}: row {first_row + i}: found {len(cells)} cells under {len(titles)} titles, expected as "
                "many; decimal commas need another delimiter"
            )
        for k, column in enumerate(wanted):
            cell = cells[column] if column < len(cells) else ""
            value = number(cell) if cell.strip() else np.nan  # refused where it is not cut off
            if value is None:
                raise RecordError(
                    f"{source}: row {first_row + i}, column {titles[column]!r}: found {cell.strip()[:40]!r}, expected "
                    "a number"
                )
            table[filled, k] = value
        filled += 1
    return table[:filled]
