"""The commands: for each one its request, and the function that answers it, for command line, studio, page and Python.

A module per command has its request, a frozen dataclass, and ``answer``, which decides everything: numbers, verdict,
reason, warnings. :mod:`emps_design.cli` makes the options of the command line from the request and renders the answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from emps_design.errors import EmpsError
from emps_design.units import Units
from emps_design.view import View

DO_NOT_RUN = 4  # exit status of a design with a reason not to run it


@dataclass(frozen=True)
class Reply:
    """What a command answers.

    ``document`` is the JSON, ``view`` what is printed instead, in ``units``. ``reason`` says why a design must not run.
    ``warnings`` go to standard error; those that the view prints are in the document alone. ``write`` gets the
    JSON text with the advice, writes the files of an answer that hold it, and may return their folder. ``error`` is
    raised after the answer is printed: a file that it cannot make, for example. ``then`` runs after the answer is
    printed, until the user interrupts it.
    """

    document: dict[str, Any]
    view: View
    units: Units
    reason: str = ""
    warnings: tuple[str, ...] = ()
    write: Callable[[str], str | None] | None = None
    error: EmpsError | None = None
    then: Callable[[], None] | None = None

    @property
    def status(self) -> int:
        """Exit status of the command."""
        return DO_NOT_RUN if self.reason else 0
