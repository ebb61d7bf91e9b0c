"""The advice on what a command found: a key of its document, and the last line that people read."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from emps_design.advice import Advice, advise, advise_on_error
from emps_design.cli.output import show
from emps_design.cli.wording import at_hand, in_command, in_words
from emps_design.errors import EmpsError


def add_advice(
    document: dict[str, Any], axis: str | Path | None = None, records: Iterable[str | Path] = ()
) -> dict[str, Any]:
    """Return the ``document`` of the command at hand, given those files, with its advice."""
    words = at_hand()
    found = advise(words[0], document, words, None if axis is None else str(axis), [str(record) for record in records])
    return {**document, "advice": _in_flags(found).to_dict()}


def advice_on_error(error: EmpsError) -> Advice | None:
    """The advice where the command at hand ends with ``error``; None where that says nothing about a design."""
    words = at_hand()
    if error.exit_code not in (3, 4) or not words:
        return None
    nearest = getattr(error, "nearest", {})
    return _in_flags(advise_on_error(words[0], error.exit_code, str(error), nearest, words))


def _in_flags(found: Advice) -> Advice:
    return Advice(found.level, in_command(found.text), found.next)


def say_advice(document: dict[str, Any]) -> None:
    """Print the advice of ``document`` as one line on standard output."""
    advice = Advice(**document["advice"])
    show(str(Advice(advice.level, in_words(advice.text), advice.next)))
