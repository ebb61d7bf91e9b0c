"""What makes a page repeatable: the versions that made it and the SHA-256 of every input. No clock."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version

from emps_design.report.page import Html, Table

PACKAGES = ("emps-design", "numpy", "scipy", "control", "sympy", "matplotlib")


def versions_table() -> Table:
    """Return the versions of Python and of the packages that computed and drew the page."""
    rows = [["Python", Html(platform.python_version())], *([name, Html(version(name))] for name in PACKAGES)]
    return Table(["program", "version"], rows, "Versions that made this page.")


def inputs_table(inputs: Mapping[str, str | None]) -> Table:
    """Return the SHA-256 of every input by name."""
    rows = [[name, Html(f"<code>{digest}</code>") if digest else "built in"] for name, digest in inputs.items()]
    return Table(["input", "SHA-256"], rows, "Every input of this page; the same inputs give the same bytes.")
