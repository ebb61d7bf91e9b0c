"""What a search sums once for many timings, and when it need not begin anew."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.identification.controller import best_law as module
from emps_design.identification.controller.best_law import best_law
from emps_design.identification.controller.identify_law import without_steps
from emps_design.identification.controller.regressors import PROPORTIONAL, ControllerSignals, Timing, regressors
from emps_design.identification.controller.search import Spectrum, best_starts, cross, evaluate, transform


@pytest.fixture(scope="module")
def signals():
    """A proportional law on a sine, 0.02 of noise in a command of 2: flat at its tops, and no limit."""
    t, random = np.arange(3000) * 1e-3, np.random.default_rng(4)
    q = 0.1 * np.sin(5.0 * t) + 1e-5 * np.cumsum(random.standard_normal(t.size))
    r = q + 0.02 * np.sin(8.0 * t) + 1e-4 * random.standard_normal(t.size)
    command = 100.0 * (r - q) + 0.02 * random.standard_normal(t.size)
    return ControllerSignals(r, q, command, 1e-3, np.ones(t.size, bool))


@pytest.mark.parametrize("limited", [None, slice(200, 300)])
@pytest.mark.parametrize("timing", [Timing(4, 1), Timing(3, 0, 0, "two_tap", True)])
def test_spectra_of_a_slower_position_loop_are_those_summed_anew(signals, timing, limited):
    stands = None
    if limited is not None:
        stands = np.zeros(len(signals), bool)
        stands[limited] = True
    spectrum = Spectrum(signals, stands)
    whole = cross(signals, transform(signals, regressors(signals, timing, stands)), spectrum.command, timing)
    found = spectrum.at(timing)
    np.testing.assert_array_equal(found.regressors, whole.regressors)
    np.testing.assert_array_equal(found.answer, whole.answer)


def test_steps_that_something_adds_to_the_command_are_taken_off(signals):
    """A switch of 1 V, on for half a second; the law tells its height, and a constant over all is the law's own."""
    switched = np.zeros(len(signals))
    switched[1000:1500] = 1.0
    assert without_steps(signals) is None
    found, steps = without_steps(replace(signals, command=signals.command + switched))
    np.testing.assert_allclose(steps - steps[0], switched, atol=0.02)
    np.testing.assert_allclose(found.command, signals.command - steps[0], atol=0.02)


def test_filters_to_start_from_are_the_best_and_apart(signals):
    spectrum = Spectrum(signals, None)
    notches, responses = spectrum.starts[1]
    now = evaluate(spectrum, PROPORTIONAL, Timing(), ())
    found = best_starts(spectrum, now, notches, responses, 3)
    places = np.sort([one.filters[0].numbers[0] for one in found])
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    assert len(places) == 3
    assert np.all(np.diff(places) > 0.3)


def test_a_law_that_explains_what_is_flat_is_searched_once(signals, monkeypatch):
    searches = []

    def counted(*args):
        searches.append(args)
        return found(*args)

    found = module.search
    monkeypatch.setattr(module, "search", counted)
    assert module.plateau(signals.command).any()
    best = best_law(signals)
    assert (len(searches), best.limit) == (1, None)
    assert best.share < 0.05
