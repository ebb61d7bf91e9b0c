"""Simulation of the nonlinear axis: exact where the physics is, event-driven everywhere."""

from emps_design.laws import Law
from emps_design.simulation.ensembles import Ensemble, Plants, corners, monte_carlo, simulate_ensemble, sweep
from emps_design.simulation.environment import Hand, Wall
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import Run
from emps_design.simulation.scenarios import breakaway, replay

__all__ = [
    "Ensemble",
    "Hand",
    "Law",
    "Plant",
    "Plants",
    "Run",
    "Wall",
    "breakaway",
    "corners",
    "monte_carlo",
    "replay",
    "simulate_ensemble",
    "sweep",
]
