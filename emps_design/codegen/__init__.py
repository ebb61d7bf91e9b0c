"""Control laws as code for a drive, translated from the law's own kernel: C99, Structured Text, and proof with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.codegen.export import (
        Exported as Exported,
        export_controller as export_controller,
        export_observer as export_observer,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
