"""The best estimate of the parameters where structure is left that no effect explains."""

from __future__ import annotations

from functools import partial

import numpy as np

from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.fit import Fit, evaluate
from emps_design.discrepancy.model.least_squares import descend
from emps_design.discrepancy.model.problem import Hypothesis, Problem
from emps_design.discrepancy.search.noise_floor import LEFT, floor_of_residual

HUBER = 1.345  # standard deviations beyond which a sample pulls no harder: 95 % efficient where all is Gaussian noise
REWEIGHTED = 3  # times the noise is taken again from what the fit leaves
STEPS = 20


def robust(fitted: Fit) -> Fit:
    """Refit the least squares of ``fitted`` to all that may be used: what structure is left pulls less at its numbers.

    Least squares under the noise of the laps takes slow structure for what a parameter does. Here what is left is
    itself the noise (feasible generalised least squares): it weighs least where the structure is, and bursts pull no
    harder than their neighbours (Huber's loss). The result is judged under the noise of ``fitted`` again, of whose
    residual it leaves more.
    """
    model, covariance, slots = fitted.model, fitted.covariance, fitted.model.slots()
    numbers = []
    for _ in range(REWEIGHTED):
        noise = floor_of_residual(fitted.with_model(model).left(), fitted.problem.period, LEFT)
        weighed = fitted.problem.with_whitening(noise.whitening)
        found = descend(model, slots, partial(_loss, weighed), STEPS)
        model, covariance = found.model, found.covariance
        numbers.append(model.vector(slots))
    return evaluate(fitted.with_model(model), slots, widened(covariance, numbers))


def widened(covariance: np.ndarray, numbers: list[np.ndarray]) -> np.ndarray:
    """``covariance`` (k, k) with no deviation smaller than how far ``numbers``, each (k,), lie apart.

    A number that depends on how it is taken from the records is not known better than it moved.
    """
    wider = np.maximum(1.0, np.ptp(numbers, axis=0) / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(wider, wider)


def _loss(problem: Problem, model: Candidate) -> np.ndarray:
    """Numbers (n,) whose sum of squares is Huber's loss of the innovations (n,) that ``model`` leaves."""
    innovations = Hypothesis(problem, model).residual("used")
    size = np.abs(innovations)
    far = np.sqrt(np.maximum(2 * HUBER * size - HUBER**2, 0.0))
    return np.where(size <= HUBER, innovations, np.sign(innovations) * far)
