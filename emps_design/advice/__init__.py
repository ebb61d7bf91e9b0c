"""Advice on a result: use it, take care, or do not run it; the reason in one sentence; and the command to run next.

It is made from the document of a command alone, for the terminal, the page, the studio and Python; ``warnings`` in it
are messages, whose severity counts (a document read from a file has its own advice). A design is
``do-not-run`` if its document has a ``reason``, with which the command ends with exit status 4. It is ``safe`` with at
least 30 deg of phase margin and a gain margin of 2 in its worst loop, on every machine of the specification, if no
message is grave, such as on instability or creep; ``caution`` otherwise. The advice on a record is ``safe`` without
warnings, else ``caution``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from emps_design.advice.advice import (
    CAUTION as CAUTION,
    DESIGNS,
    DO_NOT_RUN as DO_NOT_RUN,
    LEVELS as LEVELS,
    RECORDS,
    SAFE as SAFE,
    Advice as Advice,
    CommandLine,
    flag_of,
    identify,
    nearest_command,
    sentence,
)
from emps_design.units import LINEAR, Units

JUDGES: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {**DESIGNS, **RECORDS}
ADVISED = (*JUDGES, "report")  # the commands whose documents get advice


def advise(
    name: str,
    document: Mapping[str, Any],
    words: Sequence[str] = (),
    axis: str | None = None,
    records: Sequence[str] = (),
    units: Units = LINEAR,
) -> Advice:
    """Return the advice on the ``document`` of the command ``name``.

    ``words`` are the command line from the command's name on, ``axis`` and ``records`` its files; the command to run
    next is made of them, or of the names in the document. ``units`` are those of the axis.

    >>> worst = {"name": "whole loop", "stable": True, "phase_margin_deg": 21.0, "gain_margin": 3.0}
    >>> advise("margins", {"axis": "servo", "worst_loop": worst, "warnings": []}).level
    'caution'
    """
    own = document.get("axis")
    axis = axis or (own if isinstance(own, str) else "AXIS")
    if not records:
        names = document.get("records", document.get("record", ()))
        records = [names] if isinstance(names, str) else [name for name in names if isinstance(name, str)]
        records = records or ["RECORD"]
    command_line = CommandLine(tuple(words) or _usual(name, axis, records), axis, tuple(records), units)
    return (report if name == "report" else JUDGES[name])(document, command_line)


def advise_on_error(
    name: str, status: int, reason: str, nearest: Mapping[str, Any], words: Sequence[str] = ()
) -> Advice:
    """Return the advice if the command ``name`` ends with an error of exit ``status`` 3 or 4.

    >>> advise_on_error("gains", 3, "no gains", {"crossover": 20.0}, ("gains", "--crossover", "99")).next
    'emps-design gains --crossover 20'
    """
    command_line = CommandLine(tuple(words) or (name,), "")
    level = DO_NOT_RUN if status == 4 and name not in RECORDS else CAUTION
    return Advice(level, sentence(reason), nearest_command(nearest, command_line))


def _usual(name: str, axis: str, records: Sequence[str]) -> tuple[str, ...]:
    return (name, *records, flag_of("axis"), axis) if name in RECORDS else (name, axis)


def report(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the worst advice on the parts of a report, the first of equal ones."""
    if document.get("reason"):
        return Advice(DO_NOT_RUN, sentence(document["reason"]), None)
    parts = [DESIGNS["gains"]({**document["velocity_loop"], "worst_loop": document.get("worst_loop")}, command_line)]
    for name, judge in DESIGNS.items():
        part = document.get(name, document.get(f"{name}_loop"))
        parts += [] if part is None else [judge(part, command_line)]
    identifications = list(document.get("identification", {}).values())
    parts += [identify(identification, command_line) for identification in identifications[:1]]
    worst = max(parts, key=lambda advice: LEVELS.index(advice.level))
    return Advice(worst.level, worst.text, None)
