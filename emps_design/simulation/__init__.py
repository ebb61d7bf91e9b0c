"""Simulation of the nonlinear axis: exact where the physics is, event-driven everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.simulation.ensembles import Ensemble as Ensemble, simulate_ensemble as simulate_ensemble
    from emps_design.simulation.environment import Hand as Hand, Wall as Wall
    from emps_design.simulation.plant import Plant as Plant
    from emps_design.simulation.ensembles import (
        Plants as Plants,
        corners as corners,
        monte_carlo as monte_carlo,
        sweep as sweep,
    )
    from emps_design.simulation.run import Run as Run
    from emps_design.simulation.scenarios import breakaway as breakaway, replay as replay
    from emps_design.simulation.synthetic import (
        synthetic_record as synthetic_record,
        trapezoid_laps as trapezoid_laps,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
