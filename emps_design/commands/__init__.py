"""The commands. Each is one module with a request, a frozen dataclass, and ``answer``, a function of the request.

``answer`` computes the numbers, the verdict, the reason and the warnings. :mod:`emps_design.cli` makes the options of
the command line from the request and prints the answer.
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
    """The answer to a request.

    - ``document``: the JSON; ``view``: what is printed without ``--json``, in ``units``.
    - ``reason``: why a design must not run, "" if it may.
    - ``warnings``: printed on standard error; warnings that are part of the view are in the document only.
    - ``write``: function of the JSON text with the advice; it writes the output files and may return their folder.
    - ``error``: raised after the answer is printed, such as for a file that cannot be written.
    - ``then``: runs after the answer is printed, until the user interrupts it.
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
        """Exit status of the command: 0, or 4 with a reason not to run the design."""
        return DO_NOT_RUN if self.reason else 0
