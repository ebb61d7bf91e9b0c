"""Which column of a file is what: as the axis file maps it, as its name says, or as its title is understood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from emps_design.errors import RecordError, nearest_name
from emps_design.records.columns import NAMES, QUANTITIES, RECORD, listed, plain_title, read_title
from emps_design.records.file_units import factors, inside, spelled
from emps_design.records.mapping import COUNTS, KEYS, Column, ColumnMap
from emps_design.records.recognise import meanings

MAPPED, NAMED, RECOGNISED = "mapped", "named", "recognised"


@dataclass(frozen=True)
class Layout:
    """What a reader has to know of the axis: its units, its ``[record]`` table, its clock.

    ``reference_needed`` is False where no controller needs one; ``parameters`` are further columns, or single numbers,
    that the axis takes from its records.
    """

    motion: str = "linear"
    command_unit: str = "V"
    columns: ColumnMap = field(default_factory=ColumnMap)
    period: float | None = None
    reference_needed: bool = True
    parameters: tuple[str, ...] = ()

    def unit(self, name: str) -> str:
        """The unit of a record's column called ``name``."""
        return inside(QUANTITIES[name], self.motion, self.command_unit)


@dataclass(frozen=True)
class Assignment:
    """The column ``title`` of a file is ``name`` of the record: ``factor`` times its values in ``unit``."""

    name: str
    title: str
    unit: str = ""
    factor: float = 1.0
    how: str = NAMED
    remark: str = ""


def assign(titles: Sequence[str], layout: Layout, source: str) -> list[Assignment]:
    """Say which of ``titles`` is what; raises :class:`RecordError` where that is not certain or something is missing.

    >>> [one.name for one in assign(["t", "q_ref", "q [mm]", "u", "state"], Layout(), "a.csv")]
    ['t', 'q_ref', 'q', 'u']
    """
    found = {} if _is_plain(titles, layout) else _all_mapped(titles, layout, source)
    taken = {one.title for one in found.values()}
    for text in titles:
        title = read_title(text, source, layout.motion, layout.command_unit) if text not in taken else None
        if title is None or not title.name or (title.name in found and found[title.name].how == MAPPED):
            continue
        if title.name in found:
            raise RecordError(
                f"{source}: columns {found[title.name].title!r} and {title.text!r} both stand for {title.name}; "
                "keep one"
            )
        found[title.name] = Assignment(title.name, text, title.unit, title.factor)
    if missing(found, layout):
        _recognise(found, titles, layout, source)
    lacking = missing(found, layout)
    if lacking:
        raise RecordError(_lacking(lacking, found, titles, layout, source))
    return [found[name] for name in QUANTITIES if name in found]


def _is_plain(titles: Sequence[str], layout: Layout) -> bool:
    """Whether a file is a record of this package rather than an export: it says so, or has no mapped column."""
    if RECORD in titles:
        return True
    mapped = [column.column for name, column in layout.columns.named.items() if column.column not in NAMES]
    plain = {plain_title(title)[0].casefold() for title in titles}
    has_none = not any(plain_title(column)[0].casefold() in plain for column in mapped)
    return bool(mapped) and has_none and {"t", "q", "u"} <= {NAMES.get(title, "") for title in plain}


def _all_mapped(titles: Sequence[str], layout: Layout, source: str) -> dict[str, Assignment]:
    """The columns that the axis file maps; a reference may be absent where no controller needs one."""
    found = {}
    plain = {plain_title(title)[0].casefold() for title in titles}
    for name, column in layout.columns.named.items():
        is_there = plain_title(column.column)[0].casefold() in plain
        if is_there or layout.reference_needed or name not in ("q_ref", "velocity_reference"):
            found[name] = _mapped(name, column, titles, layout, source)
    return found


def missing(found: dict[str, Assignment], layout: Layout) -> list[str]:
    """The names of a record that have no column yet and need one."""
    needed = ["t", "q_ref", "q", "u"] if layout.reference_needed else ["t", "q", "u"]
    return [name for name in needed if name not in found and (name != "q_ref" or "velocity_reference" not in found)]


def _mapped(name: str, column: Column, titles: Sequence[str], layout: Layout, source: str) -> Assignment:
    key = KEYS[name]
    title = _find(column.column, titles, key, source)
    stated = spelled(plain_title(title)[1])
    unit = spelled(column.unit) if column.unit is not None else ""
    known = factors(QUANTITIES[name], layout.motion, layout.command_unit)
    if unit == COUNTS and column.scale is None:
        raise RecordError(
            f"{source}: [record] {key}: found unit 'counts' without a scale, expected scale = "
            f"{layout.unit(name) or '1'} per count"
        )
    if unit and unit != COUNTS and unit not in known:
        raise RecordError(f"{source}: [record] {key}: found unit {column.unit!r}, expected one of {', '.join(known)}")
    if unit and stated in known and stated != unit:
        raise RecordError(
            f"{source}: column {title!r}: the title says {stated}, [record] {key} says {unit}; correct the axis file"
        )
    if not unit and column.scale is None:
        if stated in known:
            unit = stated
        elif _is_other_quantity(stated, name, layout):
            expected = layout.unit(name) or "a plain number"
            raise RecordError(
                f"{source}: column {title!r}: found the unit {stated}, expected {expected} for {key}; is it the right "
                "column? Otherwise give its scale in [record]"
            )
    factor = column.sign * (1.0 if column.scale is None else column.scale) * known.get(unit, 1.0)
    if not (math.isfinite(factor) and factor):
        raise RecordError(f"{source}: [record] {key}: found scale {column.scale}, expected a number other than 0")
    return Assignment(name, title, unit or (layout.unit(name) if column.scale is None else ""), factor, MAPPED)


def _find(wanted: str, titles: Sequence[str], key: str, source: str) -> str:
    """The title that ``wanted`` means: the same text, the same without its bracketed unit, or but for capitals."""
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


def _is_other_quantity(unit: str, name: str, layout: Layout) -> bool:
    """Whether a title's ``unit`` is one that what ``name`` measures cannot have."""
    others = [set(factors(quantity, layout.motion, "")) for quantity in ("time", "position", "velocity", "force")]
    others += [{"V", "mV"}, {"A", "mA"}, {"%"}, {"N m"}, {"N"}]
    return any(unit in other for other in others)


def _recognise(found: dict[str, Assignment], titles: Sequence[str], layout: Layout, source: str) -> None:
    """Add to ``found`` what titles say in plain words; two that say the same are not chosen between."""
    free = [title for title in titles if title not in {one.title for one in found.values()}]
    for name, candidates in meanings(free, layout.motion, layout.command_unit).items():
        if name in found or not candidates:
            continue
        if len(candidates) > 1:
            if name in missing(found, layout):
                raise RecordError(
                    f"{source}: columns {' and '.join(map(repr, candidates[:3]))} may each be {KEYS[name]}; "
                    f"say which in [record]: {KEYS[name]} = {{ column = ... }}"
                )
            continue
        title = candidates[0]
        unit = spelled(plain_title(title)[1])
        known = factors(QUANTITIES[name], layout.motion, layout.command_unit)
        if unit and unit not in known:
            if name in missing(found, layout):
                raise RecordError(
                    f"{source}: column {title!r}: found the unit {unit}, expected one of {', '.join(known)}; say what "
                    f"it is in [record]: {KEYS[name]} = {{ column = ..., unit = ... }}"
                )
            continue
        found[name] = Assignment(name, title, unit or layout.unit(name), known.get(unit, 1.0), RECOGNISED)


def _lacking(
    lacking: list[str], found: dict[str, Assignment], titles: Sequence[str], layout: Layout, source: str
) -> str:
    expected = (
        f"t [s], q_ref [{layout.unit('q')}], q [{layout.unit('q')}], u [{layout.command_unit}] (or the EMPS names t, "
        "qg, qm, vir)"
    )
    return f"{source}: missing column {', '.join(lacking)}; found {listed(titles)}; expected {expected}"
