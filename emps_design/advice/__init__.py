"""What to do with a result: use it, take care, or do not run it; why, in one sentence; and the command to run next.

It is made here, from the document of a command alone, for the terminal, the page, the studio and Python. A design
is ``do-not-run`` where its document has a ``reason``, with which the command ends with exit status 4. It is ``safe``
with at least 30 deg and a gain margin of 2 in its worst loop, on every machine that was asked about, and where no
warning speaks of instability, of creep or of structure that is left unexplained; ``caution`` otherwise. What is said
about a record is ``safe`` or ``caution``.
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

JUDGES: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {**DESIGNS, **RECORDS}


def advise(
    name: str,
    document: Mapping[str, Any],
    words: Sequence[str] = (),
    axis: str | None = None,
    records: Sequence[str] = (),
) -> Advice:
    """Return the advice on the ``document`` of the command ``name``.

    ``words`` are the command line from the command's name on, ``axis`` and ``records`` the files that it was given:
    the command to run next is made of them, or of the names in the document.

    >>> worst = {"name": "whole loop", "stable": True, "phase_margin_deg": 21.0, "gain_margin": 3.0}
    >>> advise("margins", {"axis": "servo", "worst_loop": worst, "warnings": []}).level
    'caution'
    """
    own = document.get("axis")
    axis = axis or (own if isinstance(own, str) else "AXIS")
    if not records:
        found = document.get("records", document.get("record", ()))
        records = [found] if isinstance(found, str) else [one for one in found if isinstance(one, str)]
        records = records or ["RECORD"]
    asked = CommandLine(tuple(words) or _usual(name, axis, records), axis, tuple(records))
    return (report if name == "report" else JUDGES[name])(document, asked)


def advise_on_error(
    name: str, status: int, reason: str, nearest: Mapping[str, Any], words: Sequence[str] = ()
) -> Advice:
    """Return the advice where the command ``name`` ends with an error of exit ``status`` 3 or 4.

    >>> advise_on_error("gains", 3, "no gains", {"crossover": 20.0}, ("gains", "--crossover", "99")).next
    'emps-design gains --crossover 20'
    """
    asked = CommandLine(tuple(words) or (name,), "")
    level = DO_NOT_RUN if status == 4 and name not in RECORDS else CAUTION
    return Advice(level, sentence(reason), nearest_command(nearest, asked))


def _usual(name: str, axis: str, records: Sequence[str]) -> tuple[str, ...]:
    return (name, *records, flag_of("axis"), axis) if name in RECORDS else (name, axis)


def with_advice(name: str, document: dict[str, Any], *words: Any, **files: Any) -> dict[str, Any]:
    """Return ``document`` with its ``advice``; arguments as of :func:`advise`."""
    return {**document, "advice": advise(name, document, *words, **files).to_dict()}


def report(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    """The worst advice of what is on the page, in whose order they stand."""
    if document.get("reason"):
        return Advice(DO_NOT_RUN, sentence(document["reason"]), None)
    parts = [DESIGNS["gains"]({**document["velocity_loop"], "worst_loop": document.get("worst_loop")}, asked)]
    for name, judge in DESIGNS.items():
        part = document.get(name, document.get(f"{name}_loop"))
        parts += [] if part is None else [judge(part, asked)]
    parts += [identify(one, asked) for one in list(document.get("identification", {}).values())[:1]]
    worst = max(parts, key=lambda one: LEVELS.index(one.level))
    return Advice(worst.level, worst.text, None)
