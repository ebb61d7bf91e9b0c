"""A proportional law on the position error alone, against the controller of the data set."""

import numpy as np

from emps_design import load_axis
from emps_design.simulation import Law, Plant, trapezoid_laps


def proportional(k, reference, q, f_ext, limit, gains, memory):
    """``u = gain (q_ref - q)``, no damping of its own."""
    return gains[0] * (reference - q)


axis = load_axis("emps2019")
plant = Plant.of(axis)
q_ref = trapezoid_laps(axis.sampling.period, laps=1)
own = plant.closed_loop(q_ref, law=Law(proportional, np.array([2000.0]), memory=0))
theirs = plant.closed_loop(q_ref)
for name, run in (("proportional", own), ("position_pd", theirs)):
    print(f"{name:13} largest position error {1e3 * np.max(np.abs(run.q - q_ref)):.3f} mm")
