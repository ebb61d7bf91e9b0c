from .ensembles import (
    Ensemble as Ensemble,
    Plants as Plants,
    corners as corners,
    monte_carlo as monte_carlo,
    simulate_ensemble as simulate_ensemble,
    sweep as sweep,
)
from .environment import Hand as Hand, Wall as Wall
from .plant import Plant as Plant
from .run import Run as Run
from .scenarios import breakaway as breakaway, replay as replay
from .synthetic import synthetic_record as synthetic_record, trapezoid_laps as trapezoid_laps
