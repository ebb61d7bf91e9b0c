"""What makes a page repeatable: the versions that made it and the SHA-256 of every input. No clock."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version

from emps_design.report.page import Table, html

PACKAGES = ("emps-design", "numpy", "scipy", "control", "sympy", "matplotlib")


def versions() -> str:
    """Return the versions of Python and of the packages that computed and drew the page, in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES[1:])
    return f"Made by {PACKAGES[0]} {version(PACKAGES[0])} with Python {platform.python_version()}, {packages}."


def inputs_table(inputs: Mapping[str, str | None]) -> Table:
    """Return the SHA-256 of every input by name."""
    rows = [[name, html("<code>{}</code>", digest) if digest else "built in"] for name, digest in inputs.items()]
    return Table(["input", "SHA-256"], rows, "Every input of this page; the same inputs give the same bytes.")
