"""TwinCAT Scope exports: a header block for each channel, and a time column for each channel or for several.

Above the samples stand rows that begin with what they hold (Name, Data-Type, SampleTime[ms], SymbolName, Unit ...). A
column under the word itself is a time in ms (or in file time, 100 ns), the others are the channels that share it.
Format: Beckhoff Information System, TE13xx, "Export to csv".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.header import DELIMITERS, Choice, number, split

TIME = "time [ms]"  # what the time columns, which have no title, are called here
NAMES, SAMPLE_TIME, UNIT, SCALE = "Name", "SampleTime[ms]", "Unit", "Unit ScaleFactor"
FILE_TIME = 1e15  # above it a time is in ticks of 100 ns since 1601, not in ms since the start
TICK = 1e-4  # ms


@dataclass(frozen=True)
class Scope:
    """Columns of an export on one clock, by title; all titles; the row of its first sample; what was done."""

    columns: dict[str, np.ndarray]
    titles: tuple[str, ...]
    first_row: int
    notes: tuple[str, ...]


def is_scope(lines: Sequence[str]) -> bool:
    """Whether the first ``lines`` of a file are the header of such an export."""
    starts = {re.split(r"[;,\t]", line, maxsplit=1)[0].strip() for line in lines[:60]}
    return NAMES in starts and SAMPLE_TIME in starts


def read_scope(lines: Iterable[str], rows: int, source: str, known: Choice) -> Scope:
    """Read the channels in whose titles ``known`` finds a meaning, all at the times of the one sampled most often.

    A slower channel is interpolated; a note says so.
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
    rows: dict[str, list[str]]  # by what stands in their first cell


def _header(numbered: Iterator[tuple[int, str]], source: str) -> tuple[_Header, int, str]:
    """The rows above the samples, and number and text of the first that is one."""
    rows: dict[str, list[str]] = {}
    delimiter = ""
    for place, row in numbered:
        if not delimiter:
            delimiter = next((d for d in DELIMITERS if row.startswith(f"{NAMES}{d}")), "")
        cells = [cell.strip() for cell in split(row, delimiter)] if delimiter else []
        if rows and cells and number(cells[0]) is not None:
            return _Header(delimiter, rows), place, row
        if cells and cells[0]:
            rows[cells[0]] = cells  # the row Name of the file comes before that of the channels
    raise RecordError(f"{source}: found a header and no samples")


def _numbers(
    lines: Iterable[str], delimiter: str, wanted: list[int], source: str, first: int, rows: int, names: list[str]
) -> np.ndarray:
    """The ``wanted`` columns, (rows, wanted); NaN where a channel has ended before the others."""
    table, filled = np.empty((rows, len(wanted))), 0
    for i, line in enumerate(lines):
        cells = split(line.replace(",", ".") if delimiter != "," else line, delimiter)
        if len(cells) <= wanted[0] or not any(cells):
            continue  # a blank line, or the word that ends the file
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
    notes: tuple[str, ...],
) -> Scope:
    """Every channel at the times of the fastest, from where the last begins to where the first ends."""
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
    said = list(notes)
    columns = {TIME: t - t[0]}
    for title, (own, values) in filled.items():
        own_part = own[inside]
        if own_part.size == t.size and np.array_equal(own_part, t):
            columns[title] = values[inside]
            continue
        columns[title] = np.interp(t, own, values)
        said.append(
            f"{title}: sampled every {steps[title]:g} ms, interpolated at the times of {fastest}"
            f" (every {steps[fastest]:g} ms)"
        )
    return Scope(columns, titles, first, tuple(said))


def _scaled(header: dict[str, list[str]], place_of: dict[str, int], chosen: list[str]) -> tuple[str, ...]:
    """A note for each channel to which the Scope gave a scale of its own: only the export knows whether it is in."""
    factors = header.get(SCALE, [])
    return tuple(
        f"{title}: the Scope's unit has the scale {factors[place_of[title]]}; values are taken as they stand"
        for title in chosen
        if place_of[title] < len(factors) and number(factors[place_of[title]]) not in (1.0, None)
    )
