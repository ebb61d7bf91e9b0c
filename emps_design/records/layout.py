"""Assignment of a file's columns by the ``[record]`` table of the axis file, by their names, or by their titles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from emps_design.errors import InputError, RecordError, nearest_name
from emps_design.records.columns import (
    LETTERS,
    NAMES,
    PLAIN,
    QUANTITIES,
    RECORD,
    TAILS,
    factor_of,
    listed,
    meanings,
    plain_title,
    read_title,
    title_unit,
    unit_of,
)
from emps_design.units import COUNTS, Units, spelled

# Doubts for which an import refuses a record, unless the ``[record]`` table accepts them.
Doubt = Literal[
    "sampling-period",
    "opposed-reference",
    "reference-scale",
    "rough-position",
    "exchanged-command",
    "exchanged-reference",
    "command-limit",
    "opposed-command",
    "force-scale",
    "inertia-scale",
]
LONGEST_DELAY = 0.1  # s

MAPPED, NAMED, RECOGNISED = "mapped", "named", "recognised"
LONGEST = 5_000_000  # samples of a record; keeps memory well under 1 GiB
LONGEST_TO_CUT = 15_000_000  # samples of a file from which a part is read, an hour at 4 kHz: 1.8 GB, 115 bytes each


class Column(BaseModel):
    """One column: its title with or without the bracketed unit, its unit, scale, sign, delay and modulo."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: Annotated[str, Field(min_length=1)] = Field(description="its title in the file")
    unit: str | None = Field(None, description="its unit, by default that of the title")
    scale: Annotated[float, Field(allow_inf_nan=False)] | None = Field(None, description="factor on its values")
    sign: Literal[1, -1] = Field(1, description="-1 for the opposite sign in the file")
    delay: Annotated[float, Field(ge=-LONGEST_DELAY, le=LONGEST_DELAY, allow_inf_nan=False)] = Field(
        0.0, description="delay of the recorded signal behind the true one, in s"
    )
    modulo: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = Field(
        None, description="period of a position that wraps, in the unit of the column: 360 for an angle in deg"
    )


class ColumnMap(BaseModel):
    """The ``[record]`` table: columns of a record, and the doubts of an import that it accepts.

    >>> ColumnMap.model_validate({"position": {"column": "Lageistwert", "unit": "mm"}}).named["q"].unit
    'mm'
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    time: Column | None = None
    position: Column | None = None
    reference: Column | None = None
    velocity_reference: Column | None = None
    command: Column | None = None
    velocity: Column | None = None
    external_force: Column | None = None
    excitation: Column | None = None
    supply: Column | None = None
    enable: Column | None = None
    accept: tuple[Doubt, ...] = ()

    @model_validator(mode="after")
    def _time_is_the_clock(self) -> ColumnMap:
        if self.time is not None and self.time.delay:
            raise ValueError(f"time: found delay {self.time.delay:g}, expected the delay of the late columns instead")
        for name, column in self.named.items():
            if column.modulo is not None and name not in ("q", "q_ref"):
                raise ValueError(
                    f"{KEYS[name]}: found modulo {column.modulo:g}, expected it only for position and reference"
                )
        return self

    @property
    def named(self) -> dict[str, Column]:
        """The mapped columns by their names in a record."""
        mapped = {name: getattr(self, key) for name, key in KEYS.items()}
        return {name: column for name, column in mapped.items() if column is not None}


# name of a record's column -> key of the table, in the order of the table
_IN_A_RECORD = "t q q_ref velocity_reference u velocity f_ext excitation supply enable"
KEYS = dict(zip(_IN_A_RECORD.split(), (key for key in ColumnMap.model_fields if key != "accept"), strict=True))


@dataclass(frozen=True)
class Layout:
    """What a reader needs of the axis: its units, its ``[record]`` table, its clock.

    Irregular time is resampled to ``period`` [s], None for its own, or refused without ``resample``; ``window`` [s]
    reads a part of the file's time. ``reference_needed`` is False without a controller; ``limit`` is that of the
    command, if known.
    """

    units: Units = PLAIN
    columns: ColumnMap = field(default_factory=ColumnMap)
    period: float | None = None
    resample: bool = True
    window: tuple[float, float] | None = None
    reference_needed: bool = True
    limit: float | None = None

    @property
    def longest(self) -> int:
        """The most samples that a file may have."""
        return LONGEST if self.window is None else LONGEST_TO_CUT

    def unit(self, name: str) -> str:
        """The unit of a record's column called ``name``."""
        return unit_of(name, self.units)


@dataclass(frozen=True)
class Assignment:
    """The column ``title`` of a file is ``name`` of the record: ``factor`` times its values in ``unit``.

    ``entry`` is its entry in ``[record]``, None for none.
    """

    name: str
    title: str
    unit: str = ""
    factor: float = 1.0
    how: str = NAMED
    entry: Column | None = None

    @property
    def delay(self) -> float:
        """Delay [s] with which it was recorded."""
        return 0.0 if self.entry is None else self.entry.delay


def assign(titles: Sequence[str], layout: Layout, source: str) -> list[Assignment]:
    """Assign ``titles`` to columns of a record; raises :class:`RecordError` where one is uncertain or missing.

    >>> [assignment.name for assignment in assign(["t", "q_ref", "q [mm]", "u", "state"], Layout(), "a.csv")]
    ['t', 'q_ref', 'q', 'u']
    """
    assignments = {} if _is_plain(titles, layout) else _all_mapped(titles, layout, source)
    taken = {assignment.title for assignment in assignments.values()}
    for text in titles:
        title = read_title(text, source, layout.units) if text not in taken else None
        if title is None or not title.name or (title.name in assignments and assignments[title.name].how == MAPPED):
            continue
        if title.name in assignments:
            raise RecordError(
                f"{source}: columns {assignments[title.name].title!r} and {title.text!r} both stand for {title.name}; "
                "keep one"
            )
        assignments[title.name] = Assignment(title.name, text, title.unit, title.factor)
    if missing(assignments, layout):
        _recognise(assignments, titles, layout, source)
    lacking = [name for name in missing(assignments, layout) if name != "q" or "velocity" not in assignments]
    if lacking:
        raise RecordError(_lacking(lacking, titles, layout, source))
    return [assignments[name] for name in QUANTITIES if name in assignments]


def _is_plain(titles: Sequence[str], layout: Layout) -> bool:
    """Whether a file is a record of this package rather than an export: by its mark, or by the names of its columns."""
    if RECORD in titles:
        return True
    plain = {plain_title(title)[0].casefold() for title in titles}
    mapped = {plain_title(column.column)[0].casefold() for column in layout.columns.named.values()}
    return plain <= NAMES.keys() and not mapped <= plain


def _all_mapped(titles: Sequence[str], layout: Layout, source: str) -> dict[str, Assignment]:
    """The columns that the axis file maps; a reference may be absent where no controller needs one."""
    assignments: dict[str, Assignment] = {}
    plain = {plain_title(title)[0].casefold() for title in titles}
    for name, column in layout.columns.named.items():
        is_there = plain_title(column.column)[0].casefold() in plain
        if is_there or layout.reference_needed or name not in ("q_ref", "velocity_reference"):
            assignment = _mapped(name, column, titles, layout, source)
            twin = next((KEYS[other.name] for other in assignments.values() if other.title == assignment.title), None)
            if twin is not None:
                raise RecordError(
                    f"{source}: [record] {twin} and {KEYS[name]} both take the column {assignment.title!r}; give them "
                    "different columns, or remove one from [record]"
                )
            assignments[name] = assignment
    return assignments


def missing(assignments: dict[str, Assignment], layout: Layout) -> list[str]:
    """The required names without a column yet; a reference of velocity replaces that of position."""
    needed = ["t", "q_ref", "q", "u"] if layout.reference_needed else ["t", "q", "u"]
    return [
        name
        for name in needed
        if name not in assignments and (name != "q_ref" or "velocity_reference" not in assignments)
    ]


def _mapped(name: str, column: Column, titles: Sequence[str], layout: Layout, source: str) -> Assignment:
    key, expected = KEYS[name], layout.unit(name) or "a plain number"
    title = _find(column.column, titles, key, source)
    stated, sure = title_unit(title)[1], bool(plain_title(title)[1])
    stated = "" if stated in LETTERS and not sure else stated
    unit = spelled(column.unit) if column.unit is not None else ""
    own = factor_of(stated, name, layout.units) is not None
    foreign = sure and not own and column.scale is None and stated in (*TAILS, *LETTERS, "%", layout.unit("u"))
    if unit and (own or foreign) and stated != unit and COUNTS not in (stated, unit):
        raise RecordError(
            f"{source}: column {title!r}: the title says {stated}, [record] {key} says {unit}; correct the axis file"
        )
    if not unit and own and column.scale is None:
        unit = stated
    elif not unit and foreign:
        raise RecordError(
            f"{source}: column {title!r}: found the unit {stated}, expected {expected} for {key}; is it the right "
            "column? Otherwise give its scale in [record]"
        )
    scale = 1.0 if column.scale is None else column.scale
    if not (math.isfinite(scale) and scale):
        raise RecordError(f"{source}: [record] {key}: found scale {scale:g}, expected a finite number other than 0")
    try:
        factor = _factor(unit, name, column.scale, layout) if unit else scale
    except InputError as error:
        raise RecordError(f"{source}: [record] {key}: {error}") from error
    shown = unit or (layout.unit(name) if column.scale is None else "")
    return Assignment(name, title, shown, column.sign * factor, MAPPED, column)


def _factor(unit: str, name: str, scale: float | None, layout: Layout) -> float:
    """Factor from ``unit`` times ``scale`` to that of column ``name``; the scale for a switch and time in counts."""
    if QUANTITIES[name] == "switch" or (unit == COUNTS and name == "t" and scale is not None):
        return 1.0 if scale is None else scale
    return layout.units.factor(unit, QUANTITIES[name], scale)


def _find(wanted: str, titles: Sequence[str], key: str, source: str) -> str:
    """The title that matches ``wanted``: exactly, without the bracketed unit, or without regard to case."""
    for same in (
        lambda title: title == wanted,
        lambda title: plain_title(title)[0] == wanted.strip() or plain_title(wanted)[0] == title,
        lambda title: plain_title(title)[0].casefold() == plain_title(wanted)[0].casefold(),
    ):
        hits = [title for title in titles if same(title)]
        if len(hits) > 1:
            raise RecordError(f"{source}: [record] {key}: found {len(hits)} columns titled {wanted!r}; keep one")
        if hits:
            return hits[0]
    near = nearest_name(wanted, [plain_title(title)[0] for title in titles])
    raise RecordError(
        f"{source}: [record] {key}: found no column {wanted!r}{near}; found {listed(titles)}; is it the export of "
        "another drive?"
    )


def _recognise(assignments: dict[str, Assignment], titles: Sequence[str], layout: Layout, source: str) -> None:
    """Add the columns whose titles are recognised to ``assignments``; of two with the same meaning neither is taken."""
    free = [title for title in titles if title not in {assignment.title for assignment in assignments.values()}]
    meant, needed = meanings(free, layout.units), missing(assignments, layout)
    if "q" in needed and not meant["q"]:
        needed.append("velocity")
    for name, candidates in meant.items():
        if name in assignments or not candidates:
            continue
        if len(candidates) > 1:
            if name in needed:
                raise RecordError(
                    f"{source}: columns {' and '.join(map(repr, candidates[:3]))} may each be {KEYS[name]}; "
                    f"say which in [record]: {KEYS[name]} = {{ column = ... }}"
                )
            continue
        title = candidates[0]
        unit = title_unit(title)[1]
        factor = factor_of(unit, name, layout.units) if unit else None
        command = QUANTITIES[name] == "command"
        if factor is None and not (unit == "" and command):
            if name in needed:
                own = layout.unit(name)
                expected = f"{own} as the command of the axis" if command else f"one such as {own}"
                raise RecordError(
                    f"{source}: column {title!r}: found {f'the unit {unit}' if unit else 'no unit'}, expected "
                    f"{expected}; say in [record]: {KEYS[name]} = {{ column = ..., unit = ... }}"
                    + ("; for another machine: emps-design init --from TRACE" if command else "")
                )
            continue
        assignments[name] = Assignment(name, title, unit or layout.unit(name), factor or 1.0, RECOGNISED)


def _lacking(lacking: list[str], titles: Sequence[str], layout: Layout, source: str) -> str:
    reference = f"q_ref [{layout.unit('q')}], " if layout.reference_needed else ""
    position = f"q [{layout.unit('q')}] or velocity [{layout.unit('velocity')}]"
    expected = f"t [s], {reference}{position}, u [{layout.unit('u')}] (or the EMPS names t, qg, qm, vir)"
    place = next((title for title in titles if title.endswith(":1")), "")
    hint = f'; the columns of a matrix are for [record] to name: position = {{ column = "{place}" }}' if place else ""
    return f"{source}: missing column {', '.join(lacking)}; found {listed(titles)}; expected {expected}{hint}"
