"""Simulation of the nonlinear axis: exact where the physics is, event-driven everywhere."""

from emps_design.simulation.laws import Law
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import Run
from emps_design.simulation.surroundings import Hand, Wall

__all__ = ["Hand", "Law", "Plant", "Run", "Wall"]
