"""A way down where slopes mislead: the simplex search of Nelder and Mead over the logarithms of some numbers.

Play that bounces makes the cost rough: every impact that comes earlier or later moves it a little, and a descent along
slopes ends in the first dent. A simplex spans many of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.least_squares import WORST
from emps_design.errors import SimulationError

SPAN = 0.3  # of the logarithm of each number, the first simplex
ENDS = 0.01  # of the logarithm, size of a simplex that is small enough


def simplex(
    start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray], simulations: int
) -> Candidate:
    """``start`` with the positive numbers in ``slots`` moved to where the sum of squares of ``residual`` is least.

    In as many ``simulations`` at most; a model that cannot be simulated counts as :data:`WORST`.
    """
    from scipy.optimize import minimize

    def moved(logarithms: np.ndarray) -> Candidate:
        return start.with_vector(slots, np.exp(logarithms))

    def cost(logarithms: np.ndarray) -> float:
        try:
            left = residual(moved(logarithms))
        except SimulationError:
            return WORST
        return float(left @ left)

    first = np.log(np.maximum(start.vector(slots), [1e-3 * slot.magnitude for slot in slots]))
    corners = np.vstack([first, first + SPAN * np.eye(first.size)])
    options = {"initial_simplex": corners, "maxfev": simulations, "xatol": ENDS, "fatol": 0.0}
    return moved(minimize(cost, first, method="Nelder-Mead", options=options).x)
