"""Surfaces through a neighbourhood: the way down a rough cost, and how sure its end is."""

import numpy as np
import pytest

from emps_design.discrepancy.least_squares import Candidate, bounded, descend, descend_rough
from emps_design.errors import SimulationError
from emps_design.machines import machine

START = Candidate(machine("emps2019").mechanics.array())
SLOTS = START.slots()[:3]
LINES = np.random.default_rng(1).standard_normal((2000, 3)) / np.array([s.magnitude for s in SLOTS])
TRUE = START.vector(SLOTS) * np.array([1.3, 0.8, 1.2])


def smooth(noise: int):
    """A straight line in three numbers under white noise of deviation 1."""
    late = np.random.default_rng(noise).standard_normal(len(LINES))
    return lambda model: 20.0 * LINES @ (model.vector(SLOTS) - TRUE) + late


def rough(noise: int):
    """The same, and now and then an impact that comes early or late: it depends on the last digit of every number."""
    plain, places = smooth(noise), np.random.default_rng(noise + 100).choice(len(LINES), 200, replace=False)

    def residual(model):
        remaining = plain(model)
        remaining[places] += 15.0 * np.sin(4e3 * LINES[places] @ model.vector(SLOTS))
        return bounded(remaining)

    return residual


@pytest.mark.parametrize("noise", range(6))
def test_it_goes_on_where_a_descent_along_slopes_ends_in_a_dent(noise):
    residual = rough(noise)
    along = descend(START, SLOTS, residual, 30)
    over = descend_rough(START, SLOTS, residual)
    error = over.model.vector(SLOTS) / TRUE - 1.0
    assert over.cost < 0.2 * along.cost
    assert np.abs(error).max() < 0.02
    deviations = np.sqrt(np.diag(over.covariance)) / TRUE
    assert np.all(np.abs(error) < 4.0 * deviations)
    assert np.all(deviations < 0.02)


def test_where_nothing_is_rough_the_end_and_its_deviations_are_those_of_least_squares():
    residual = smooth(7)
    along, over = descend(START, SLOTS, residual, 30), descend_rough(START, SLOTS, residual)
    deviations = np.sqrt(np.diag(along.covariance))
    assert np.all(np.abs(over.model.vector(SLOTS) - along.model.vector(SLOTS)) < 0.5 * deviations)
    assert np.all(np.sqrt(np.diag(over.covariance)) > 0.9 * deviations)
    assert np.all(np.sqrt(np.diag(over.covariance)) < 10.0 * deviations)


def test_it_stays_where_the_model_runs_and_within_bounds_and_takes_the_same_way_again():
    def residual(model):
        if model.baseline[0] > 95.5:
            raise SimulationError("no", 0.0)
        return np.array([model.baseline[0] - 97.0, model.baseline[1] + 20.0])

    found = descend_rough(START, SLOTS[:2], residual)
    assert 95.0 < found.model.baseline[0] <= 95.5
    assert 0.0 <= found.model.baseline[1] < 5.0
    again = descend_rough(START, SLOTS[:2], residual)
    assert np.array_equal(found.model.baseline, again.model.baseline)


def test_a_start_that_cannot_run_is_given_back():
    def residual(model):
        raise SimulationError("no", 0.0)

    assert descend_rough(START, SLOTS, residual).model is START
