"""Control design for a one-axis electromechanical drive, from a measured record to gains and to the missing physics."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Names resolve on first use: importing the package must not cost a second of start-up.
_HOME = {
    "Axis": "emps_design.axis",
    "Plant": "emps_design.simulation",
    "Record": "emps_design.records",
    "design_force_loop": "emps_design.control.force.design",
    "design_velocity_loop": "emps_design.control.velocity.design",
    "diagnose": "emps_design.discrepancy",
    "identify": "emps_design.identification",
    "impedance_law": "emps_design.control.impedance.law",
    "load_axis": "emps_design.machines",
    "machine": "emps_design.machines",
    "observe": "emps_design.identification.observation",
    "practice_record": "emps_design.simulation.synthetic_record",
    "read_record": "emps_design.records",
}

__all__ = [*sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'emps_design' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
