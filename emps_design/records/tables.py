"""Text tables as drives export them: ; , tab or space, decimal point or comma, a preamble, comments, encodings.

The header is found by the shape of the rows. The samples are the first rows of numbers that are alike. Their delimiter,
a semicolon, a tab, a comma or white space, is the one that makes most cells numbers. The titles are a row above with as
many cells, commented or not; a cell of the row below may be the unit of a title, or a plainer title.

TwinCAT Scope exports have a header block for each channel, and a time column for one or several channels. Each row of
the header begins with its key (Name, Data-Type, SampleTime[ms], SymbolName, Unit ...). A column with the key as its
entry is a time in ms (or in file time, 100 ns); the channels after it share it.
Format: Beckhoff Information System, TE13xx, "Export to csv".
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice, pairwise
from typing import BinaryIO, TextIO

import numpy as np

from emps_design.errors import RecordError, one_line
from emps_design.messages import Message, warning
from emps_design.records.check import CUT
from emps_design.records.columns import column_titles, plain_title
from emps_design.records.layout import LONGEST
from emps_design.units import is_unit, spelled

SPACE = " "  # any white space
DELIMITERS = (";", "\t", ",")
LOOKED_AT = 400  # lines in which the first samples are expected
COMMENT = "#"
COMMENTS = (COMMENT, "%", "//")
_ALIKE = 3  # lines of numbers in a row that are samples; a preamble has fewer
_OTHER_UNIT = re.compile(r"°C|K|[mk]?Hz|[mk]?W|bar|m?Pa|(\w+|°)/(s|min)(\^?[23]|[²³])?")  # of columns that are not read

Choice = Callable[[list[str]], Sequence[object]]  # selects the titles with a meaning

TIME = "time [ms]"  # title of the time columns, which have none
NAMES, SAMPLE_TIME, UNIT, SCALE = "Name", "SampleTime[ms]", "Unit", "Unit ScaleFactor"
FILE_TIME = 1e15  # above it a time is in ticks of 100 ns since 1601, not in ms since the start
TICK = 1e-4  # ms

LONGEST_LINE = 100_000  # characters
HEAD = 1 << 16  # bytes that determine the encoding
PIECE = 1 << 20  # characters that are scanned at a time
BLOCK = 50_000  # rows that are read at a time
END = "EOF"  # the line after the last sample in some exports


@dataclass(frozen=True)
class Header:
    """``delimiter`` and ``titles`` of a table, and the line (from 0) of the first sample."""

    delimiter: str
    titles: list[str]
    samples: int


def find_header(lines: Sequence[str], known: Choice, source: str) -> Header:
    """Find titles and samples in the first ``lines`` of a file; raises :class:`RecordError` without them.

    Of several possible rows of titles, the one in which ``known`` selects any is taken, otherwise the last. A table
    without titles has the columns data:0, data:1 ..., if ``known`` selects any of these.

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
    """The number in a cell, with decimal point or comma, or hexadecimal; None for no number."""
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
    """Index of the first of several lines of numbers that are alike, None for none, and their delimiter."""
    best: tuple[tuple[float, int], int, str] | None = None
    for delimiter in (*DELIMITERS, SPACE):
        shapes = [_shape(line, delimiter) for line in lines]
        for i, shape in enumerate(shapes):
            block = [other for other in shapes[i:] if other is not None][:_ALIKE]
            if shape is None or shape[0] < 0.5 or shape[1] < 2:
                continue
            if all(other[0] >= 0.5 and abs(other[2] - shape[2]) <= 1 for other in block):
                # Spaces may follow other delimiters: they count only where those leave no numbers.
                key = (shape[0], shape[1] if delimiter != SPACE else 0)
                if best is None or key > best[0]:
                    best = key, i, delimiter
                break
    return (best[1], best[2]) if best else (None, ";")


def _shape(line: str, delimiter: str) -> tuple[float, int, int] | None:
    """Share and count of numbers in the filled cells of a line, and its cells; None for a blank line or a comment."""
    if not line.strip() or is_comment(line):
        return None
    cells = split(line, delimiter)
    filled = [cell for cell in cells if cell.strip()]
    numbers = sum(number(cell) is not None for cell in filled)
    return numbers / max(len(filled), 1), numbers, len(cells)


def _candidates(lines: Sequence[str], delimiter: str, width: int) -> list[list[str]]:
    """Possible titles of ``width`` columns in ``lines``, last line first: rows with their units, and single rows."""
    near = 0 if delimiter == SPACE else 1  # a row may end with a delimiter
    rows = [row for row in (_titles(line, delimiter, width) for line in lines) if len(row) >= 2]
    rows = [row for row in rows if abs(len(row) - width) <= near]
    candidates = []
    for row, above in pairwise([*rows, []]):
        both = _with_units(above, row)
        candidates += [row] if both is None else [both] if all(map(_unit_in, row)) else [both, row]
    return candidates


def _titles(line: str, delimiter: str, width: int = 0) -> list[str]:
    """The titles in a line; those between white space may contain single spaces, or end with a bracketed unit."""
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
    """The unit in a cell, in brackets or not; "" for an explicit absence of a unit, None for any other text."""
    inner = cell.strip("[]() ")
    if is_unit(inner):
        return inner if spelled(inner) else ""
    return inner if _OTHER_UNIT.fullmatch(inner) else None


def _with_units(titles: list[str], row: list[str]) -> list[str] | None:
    """``titles`` with the units or plainer titles of the ``row`` below them; None where it has no unit."""
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


@dataclass(frozen=True)
class Scope:
    """Columns of an export on one clock, by title; all ``titles``; the row of the first sample; notes."""

    columns: dict[str, np.ndarray]
    titles: tuple[str, ...]
    first_row: int
    notes: tuple[Message, ...]


def is_scope(lines: Sequence[str]) -> bool:
    """Whether the first ``lines`` of a file are the header of a TwinCAT Scope export."""
    starts = {re.split(r"[;,\t]", line, maxsplit=1)[0].strip() for line in lines[:60]}
    return NAMES in starts and SAMPLE_TIME in starts


def read_scope(lines: Iterable[str], rows: int, source: str, known: Choice) -> Scope:
    """Read the channels whose titles ``known`` selects, at the times of the fastest.

    A slower channel is interpolated, with a note.
    """
    numbered = enumerate(lines, 1)
    header, first, row = _header(numbered, source)
    names = header.rows[NAMES]
    clock_of, place_of = _channels(header)
    titles = (TIME, *place_of)
    chosen = [str(title) for title in known(list(titles)) if str(title) in place_of]
    if not chosen or min(clock_of.values()) < 0:
        raise RecordError(
            f"{source}: found {'no channel' if not chosen else 'no time columns'}, expected some in the export"
        )
    wanted = sorted({place_of[title] for title in chosen} | {clock_of[title] for title in chosen})
    samples = chain([row], (line for _, line in numbered))
    table = _numbers(samples, header.delimiter, wanted, source, first, rows, names)
    at = {column: k for k, column in enumerate(wanted)}
    return _on_one_clock(
        {title: (table[:, at[clock_of[title]]], table[:, at[place_of[title]]]) for title in chosen},
        titles,
        first,
        source,
        _scaled(header.rows, place_of, chosen),
    )


def scope_titles(lines: Sequence[str], source: str) -> tuple[str, ...]:
    """The titles of time and channels in the first ``lines`` of an export."""
    return (TIME, *_channels(_header(enumerate(lines, 1), source)[0])[1])


def _channels(header: _Header) -> tuple[dict[str, int], dict[str, int]]:
    """The columns of time and of values of each channel, by its title."""
    clock_of: dict[str, int] = {}
    place_of: dict[str, int] = {}
    clock, units = -1, header.rows.get(UNIT, [])
    for column, name in enumerate(header.rows[NAMES]):
        if name == NAMES:
            clock = column
        elif name:
            unit = units[column].split(" ")[0] if column < len(units) else ""
            title = f"{name} [{unit}]" if unit and not unit.startswith("(") else name
            clock_of[title], place_of[title] = clock, column
    return clock_of, place_of


@dataclass(frozen=True)
class _Header:
    delimiter: str
    rows: dict[str, list[str]]  # by their first cell


def _header(numbered: Iterator[tuple[int, str]], source: str) -> tuple[_Header, int, str]:
    """The rows above the samples, and number and text of the first sample."""
    rows: dict[str, list[str]] = {}
    delimiter = ""
    for place, row in numbered:
        if not delimiter:
            delimiter = next((d for d in DELIMITERS if row.startswith(f"{NAMES}{d}")), "")
        cells = [cell.strip() for cell in split(row, delimiter)] if delimiter else []
        if rows and cells and number(cells[0]) is not None:
            return _Header(delimiter, rows), place, row
        if cells and cells[0]:
            rows[cells[0]] = cells  # the file's own row Name comes before that of the channels, which counts
    raise RecordError(f"{source}: found a header and no samples")


def _numbers(
    lines: Iterable[str], delimiter: str, wanted: list[int], source: str, first: int, rows: int, names: list[str]
) -> np.ndarray:
    """The ``wanted`` columns, (rows, wanted); NaN after the end of a channel."""
    table, filled = np.empty((rows, len(wanted))), 0
    for i, line in enumerate(lines):
        cells = split(line.replace(",", ".") if delimiter != "," else line, delimiter)
        if len(cells) <= wanted[0] or not any(cells):
            continue  # a blank line, or the end mark
        for k, column in enumerate(wanted):
            cell = cells[column].strip() if column < len(cells) else ""
            value = number(cell) if cell else np.nan
            if value is None:
                if cell == "EOF":
                    return table[:filled]
                raise RecordError(
                    f"{source}: row {first + i}, column {names[column]!r}: found {cell[:40]!r}, expected a number"
                )
            table[filled, k] = value
        filled += 1
    return table[:filled]


def _on_one_clock(
    channels: dict[str, tuple[np.ndarray, np.ndarray]],
    titles: tuple[str, ...],
    first: int,
    source: str,
    notes: tuple[Message, ...],
) -> Scope:
    """Every channel at the times of the fastest, over the time that all have in common."""
    filled: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for title, (t, values) in channels.items():
        there = np.isfinite(t) & np.isfinite(values)
        if np.count_nonzero(there) < 2:
            raise RecordError(
                f"{source}: column {title!r}: found fewer than two samples, expected as many as elsewhere"
            )
        filled[title] = (t[there] * (TICK if t[there][0] > FILE_TIME else 1.0), values[there])
        if np.any(np.diff(filled[title][0]) <= 0):
            row = int(np.argmax(np.diff(filled[title][0]) <= 0)) + 1
            raise RecordError(f"{source}: time of {title!r}, row {first + row}: found no later time than before")
    steps = {title: float(np.median(np.diff(t))) for title, (t, _) in filled.items()}
    fastest = min(steps, key=lambda title: (steps[title], list(steps).index(title)))
    low = max(float(t[0]) for t, _ in filled.values())
    high = min(float(t[-1]) for t, _ in filled.values())
    t = filled[fastest][0]
    inside = slice(int(np.searchsorted(t, low - 1e-9)), int(np.searchsorted(t, high + 1e-9)))
    t = t[inside]
    if t.size < 2:
        raise RecordError(f"{source}: the channels have no time in common, expected one recording")
    messages = list(notes)
    columns = {TIME: t - t[0]}
    for title, (own, values) in filled.items():
        own_part = own[inside]
        if own_part.size == t.size and np.array_equal(own_part, t):
            columns[title] = values[inside]
            continue
        columns[title] = np.interp(t, own, values)
        text = (
            f"{title}: sampled every {steps[title]:g} ms, interpolated at the times of {fastest}"
            f" (every {steps[fastest]:g} ms)"
        )
        messages.append(warning("slow-channel", text, column=title))
    return Scope(columns, titles, first, tuple(messages))


def _scaled(header: dict[str, list[str]], place_of: dict[str, int], chosen: list[str]) -> tuple[Message, ...]:
    """A note for each channel with a scale of the Scope, which may or may not be applied in the export."""
    factors = header.get(SCALE, [])
    return tuple(
        warning(
            "scope-scale",
            f"{title}: the Scope's unit has the scale {factors[place_of[title]]}; values are taken as they stand",
            column=title,
        )
        for title in chosen
        if place_of[title] < len(factors) and number(factors[place_of[title]]) not in (1.0, None)
    )


@dataclass(frozen=True)
class TextTable:
    """The selected columns by title; all ``titles``; the row of the first sample in the file; notes."""

    columns: dict[str, np.ndarray]
    titles: tuple[str, ...]
    first_row: int = 0
    notes: tuple[Message, ...] = ()


def read_table(file: BinaryIO, source: str, known: Choice, most: int = LONGEST) -> TextTable:
    """Return the columns of a text table whose titles ``known`` selects; ``most`` limits the samples.

    The file is read twice, to count its rows and to read them block by block: its text is never in memory as a whole.
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
            return TextTable(scope.columns, scope.titles, scope.first_row, scope.notes)
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
    """Return the columns of a simple table: a row of titles, numbers below it.

    Cells are separated by commas or semicolons, # begins a comment. Where a ``needed`` title is missing the columns are
    empty, so that the caller reports the titles. ``expected`` ends a message.

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
    """The encoding of the first bytes: by byte-order mark or zeros UTF-16, else UTF-8, else Windows-1252."""
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
    """Upper bound on the number of rows; raises :class:`RecordError` for binary data and for too many rows."""
    rows, pending = 1, 0  # ``pending``: characters of the unfinished line at the end of the last piece
    while piece := text.read(PIECE):
        if "\0" in piece:
            raise RecordError(f"{source}: found binary data, expected a text table")
        pending = _unfinished_line(piece, pending, source)
        rows += piece.count("\n")
        if rows > most + 1:
            raise RecordError(f"{source}: found more than {most} rows, expected fewer; {CUT}")
    text.seek(0)
    return rows


def _unfinished_line(piece: str, pending: int, source: str) -> int:
    """Characters of the last line of ``piece``, whose first has ``pending`` before it; refuses too long a line."""
    start, room = 0, LONGEST_LINE - pending
    while len(piece) - start > room:
        end = piece.rfind("\n", start, start + room + 1)
        if end < 0:
            raise RecordError(
                f"{source}: found a line of more than {LONGEST_LINE} characters, expected a header and rows of numbers"
            )
        start, room = end + 1, LONGEST_LINE
    last = piece.rfind("\n")
    return pending + len(piece) if last < 0 else len(piece) - last - 1


def _read(head: list[str], lines: Iterator[str], rows: int, source: str, known: Choice) -> TextTable:
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
    by_title = {titles[i]: column[:filled] for i, column in zip(wanted, columns, strict=True)}
    return TextTable(by_title, tuple(titles), header.samples + 1)


def _blocks(lines: Iterator[str], row: int) -> Iterator[tuple[int, list[str]]]:
    """The remaining rows in blocks, with the number of the first, without blank lines and end mark at the end."""
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

    Fast where all cells are numbers, otherwise cell by cell, to accept empty cells and to name a wrong one.
    """
    between = None if delimiter == SPACE else delimiter
    longer = max(len(row.split()) - 1 if between is None else row.count(between) for row in rows) >= len(titles)
    if not longer and not any('"' in row or is_comment(row) or not row.strip() for row in rows):
        decimal_comma = delimiter != "," and any("," in row for row in islice(rows, 100))
        points = (row.replace(",", ".") for row in rows) if decimal_comma else rows
        with suppress(ValueError):  # a cell is no number, or the first decimal comma comes late
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
            value = number(cell) if cell.strip() else np.nan  # refused later, unless it is cut off
            if value is None:
                again = "; the titles come again there, delete that row" if cell.strip() in titles else ""
                raise RecordError(
                    f"{source}: row {first_row + i}, column {titles[column]!r}: found {cell.strip()[:40]!r}, expected "
                    f"a number{again}"
                )
            table[filled, k] = value
        filled += 1
    return table[:filled]
