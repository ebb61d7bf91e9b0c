"""The languages that a controller is written in: the files of each, by name."""

from __future__ import annotations

from typing import Any

from emps_design.codegen.ahead import Ahead
from emps_design.codegen.c import functions_in_c
from emps_design.codegen.pages import said_of
from emps_design.simulation.kernels.inverse import HOOKS


def _ahead_in_c(name: str, ahead: Ahead) -> tuple[list[str], dict[str, Any]]:
    """Definitions of the kernels that are fed forward, and what the templates say of them."""
    definitions, calls = [], {hook: list[str]() for hook in HOOKS}
    for part in ahead.parts:
        made, kernel = functions_in_c(part.program, f"{name}_{part.term}", {})
        definitions += made
        calls[part.hook].append(kernel)
    return definitions, {
        "hooks": [{"name": hook, "calls": calls[hook]} for hook in HOOKS],
        "own": [repr(one) for one in ahead.own],
        "repeats": ahead.repeats,
        "passes": ahead.passes,
        "gain": repr(float(ahead.feedforward.axis.drive.force_gain)),
        **said_of(ahead),
    }
