"""Simulation of the nonlinear axis: exact where the physics is, event-driven everywhere."""

from emps_design.simulation.laws import Law
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import Run

__all__ = ["Law", "Plant", "Run"]
