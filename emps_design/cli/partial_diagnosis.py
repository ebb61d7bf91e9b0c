"""What an interrupted ``diagnose`` leaves: nothing in the folder that was asked for, what it knew by then beside it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from emps_design.cli.interrupts import heard
from emps_design.cli.output import json_text, tell
from emps_design.errors import EmpsError
from emps_design.files import write_text, write_together
from emps_design.progress import Progress

if TYPE_CHECKING:
    from emps_design.axis import Axis

SCHEMA = "emps-design/partial-diagnosis/1"


class PartialDiagnosis:
    """Remembers how far a diagnosis for the folder ``out`` is; ``write`` puts that into ``out`` with ``.partial``."""

    def __init__(self, out: Path | None):
        named = out is None or out.name not in ("", "..")
        self.folder = None if out is None else Path(f"{out if named else os.path.abspath(out)}.partial")
        self.stage, self.share = "reading", 0.0
        self.axis: Axis | None = None

    def hears(self, bar: Progress) -> Progress:
        """``bar`` that ends the work where an interrupt was heard: the search would conclude from what it has."""

        def progress(stage: str, share: float) -> None:
            self.stage, self.share = stage, share
            bar(stage, share)
            self._stop()

        return progress

    def knows(self, axis: Axis) -> None:
        """Keep the model with which the search ended."""
        self.axis = axis
        self._stop()

    def write(self) -> None:
        """Write what is known, and say where."""
        if self.folder is None:
            return
        document = {
            "schema": SCHEMA,
            "interrupted": True,
            "stage": self.stage,
            "share": self.share,
            "effects": [] if self.axis is None else [effect.kind for effect in self.axis.effects],
            "model_file": None if self.axis is None else "model.toml",
            "text": "The diagnosis was interrupted here; nothing of this was confirmed, and more may be missing.",
        }
        try:
            self.folder.mkdir(exist_ok=True)
            with write_together(self.folder) as aside:
                write_text(aside / "partial.json", f"{json_text(document)}\n")
                if self.axis is not None:
                    head = f"# from a diagnosis that was interrupted: {self.stage}\n"
                    write_text(aside / "model.toml", head + self.axis.to_toml())
        except (EmpsError, OSError) as error:
            tell(f"what was known by then could not be written: {error}")
        else:
            tell(f"what was known by then is in {self.folder}")

    def _stop(self) -> None:
        if heard.is_set():
            raise KeyboardInterrupt
