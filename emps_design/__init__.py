"""Control design for a one-axis electromechanical drive, from a measured record to gains and to the missing physics."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Names resolve on first use: importing the package must not cost a second of start-up.
_HOME = {
    "Axis": "emps_design.axis",
    "Record": "emps_design.records",
    "read_record": "emps_design.records",
    "load_axis": "emps_design.machines",
    "machine": "emps_design.machines",
}

__all__ = [*sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'emps_design' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
